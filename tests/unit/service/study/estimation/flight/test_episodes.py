"""Episodes of the truth whose delays and shares are known by hand."""

import numpy as np
import pytest

from service.study.estimation.flight.episodes import (
    measure_alarms,
    measure_dark,
    measure_faults,
    measure_group_steps,
    measure_rain,
    stretches,
)
from service.study.estimation.flight.world import Truth

MINUTE_US = 60_000_000
ROWS = 400
EPOCHS_US = 1_800_000_000_000_000 + MINUTE_US * np.arange(ROWS)
BITS = {
    "uplink_rain": 1,
    "off": 4,
    "step": 8,
    "group_step": 16,
    "interference": 64,
    "wet_antenna": 256,
}


def truth(level_db=None, flags=None, carriers=2):
    """Return a truth in which nothing happens unless it is said."""
    return Truth(
        np.zeros((ROWS, 3)),
        np.zeros(ROWS),
        np.zeros((ROWS, carriers)) if level_db is None else level_db,
        np.zeros((ROWS, carriers), dtype=np.int64) if flags is None else flags,
        BITS,
        np.zeros((carriers, 3)),
        np.zeros(carriers),
        tuple(f"s{k}" for k in range(carriers)),
        np.zeros((ROWS, carriers)),
    )


def faults(world, is_excluded, is_judged=(True, True)):
    return measure_faults(EPOCHS_US, world, np.arange(ROWS), is_excluded, np.array(is_judged))


def at(*rows, carriers=2, carrier=0):
    """Return exclusions of one carrier in some rows."""
    out = np.zeros((ROWS, carriers), dtype=bool)
    out[list(rows), carrier] = True
    return out


def stepped(*steps, carrier=0):
    """Return a truth with lasting steps (row, dB) of one carrier."""
    level_db, flags = np.zeros((ROWS, 2)), np.zeros((ROWS, 2), dtype=np.int64)
    for row, size_db in steps:
        level_db[row:, carrier] += size_db
        flags[row:, carrier] |= BITS["step"]
    return truth(level_db, flags)


@pytest.mark.parametrize(
    ("rows", "wanted"), [("0110", [(1, 3)]), ("1001", [(0, 1), (3, 4)]), ("0000", []), ("111", [(0, 3)])]
)
def test_stretches(rows, wanted):
    assert stretches(np.array([letter == "1" for letter in rows])) == wanted


def rain(flagged, fade_db=None, wrong=()):
    """Judge a rain that rises by 0.11 dB a minute from row 100, stays at 1 dB and ends at row 200."""
    if fade_db is None:
        fade_db = np.zeros(ROWS)
        fade_db[100:200] = np.minimum(1.0, 0.11 * np.arange(1, 101))
    is_flagged, is_wrong = np.zeros(ROWS, dtype=bool), np.zeros(ROWS, dtype=bool)
    is_flagged[flagged] = True
    is_wrong[list(wrong)] = True
    return measure_rain(EPOCHS_US, fade_db, is_flagged, is_wrong, row_min=1.0)


def test_a_rain_is_found_some_minutes_after_it_counts():
    # rows 100, 101, 102 hold 0.11, 0.22, 0.33 dB: row 102 is the first beyond 0.3
    found = rain(slice(105, 200), wrong=(103, 104, 250))
    assert found.delay_min.tolist() == [3.0]
    assert found.coverage.tolist() == [pytest.approx(95 / 98)]
    assert found.wrong_min.tolist() == [2.0]
    assert (found.dry_rows, found.false_rows) == (300, 0)


def test_a_rain_found_before_it_counts_has_a_negative_delay():
    assert rain(slice(101, 220)).delay_min.tolist() == [-1.0]
    assert rain(slice(101, 220)).false_rows == 20


def test_a_rain_that_is_never_found_has_no_end_of_delay():
    found = rain(slice(0, 0))
    assert found.delay_min.tolist() == [np.inf]
    assert found.coverage.tolist() == [0.0]


def test_a_drizzle_is_no_rain():
    fade_db = np.zeros(ROWS)
    fade_db[100:200] = 0.2
    found = rain(slice(0, 0), fade_db)
    assert len(found.delay_min) == 0
    assert found.dry_rows == 300


def test_a_step_is_found_some_minutes_later():
    assert faults(stepped((100, 1.0)), at(104, 105)).delay_min.tolist() == [4.0]


def test_a_step_is_not_found_after_half_an_hour():
    assert faults(stepped((100, 1.0)), at(131)).delay_min.tolist() == [np.inf]
    assert faults(stepped((100, 1.0)), at(130)).delay_min.tolist() == [30.0]


def test_each_step_of_one_carrier_counts():
    found = faults(stepped((100, 1.0), (200, -2.0)), at(101, 203))
    assert found.delay_min.tolist() == [1.0, 3.0]


@pytest.mark.parametrize("steps", [((100, 0.7),), ((0, 3.0),)])
def test_small_steps_and_those_before_the_first_row_do_not_count(steps):
    assert len(faults(stepped(*steps), at())) == 3
    assert len(faults(stepped(*steps), at()).delay_min) == 0


def test_only_carriers_that_the_answer_uses_are_judged():
    assert len(faults(stepped((100, 1.0)), at(), (False, True)).delay_min) == 0


def test_a_shower_counts_from_its_depth_and_its_wet_antenna_belongs_to_it():
    level_db, flags = np.zeros((ROWS, 2)), np.zeros((ROWS, 2), dtype=np.int64)
    level_db[100:150, 0] = -np.minimum(3.0, 0.2 * np.arange(1, 51))
    level_db[150:180, 0] = -1.0
    flags[100:150, 0], flags[150:180, 0] = BITS["uplink_rain"], BITS["wet_antenna"]
    # 0.8 dB is reached in the fourth row
    assert faults(truth(level_db, flags), at(102)).delay_min.tolist() == [-1.0]


def test_interference_counts_although_the_truth_holds_no_level_of_it():
    flags = np.zeros((ROWS, 2), dtype=np.int64)
    flags[100:120, 0] = BITS["interference"]
    assert faults(truth(flags=flags), at(101)).delay_min.tolist() == [1.0]


def test_a_carrier_off_the_air_is_no_fault_and_its_new_level_is():
    level_db, flags = np.zeros((ROWS, 2)), np.zeros((ROWS, 2), dtype=np.int64)
    flags[100:150, 0] = BITS["off"]
    assert len(faults(truth(level_db, flags), at(101)).delay_min) == 0
    level_db[150:, 0] = 1.5
    flags[150:, 0] = BITS["step"]
    assert faults(truth(level_db, flags), at(155)).delay_min.tolist() == [5.0]


def test_false_exclusions_are_counted_two_hours_after_the_last_fault():
    flags = np.zeros((ROWS, 2), dtype=np.int64)
    flags[50:60, 0] = BITS["uplink_rain"]
    excluded = np.zeros((ROWS, 2), dtype=bool)
    excluded[[20, 100, 300], 0] = True
    found = faults(truth(flags=flags), excluded)
    # carrier 0 is unclean from row 50 to two hours after row 59
    assert found.clean_pairs == 2 * ROWS - (180 - 50)
    assert found.false_pairs == 2


def test_an_alarm_is_due_from_the_moment_of_the_deed():
    is_alarm = np.zeros(ROWS, dtype=bool)
    is_alarm[[30, 130, 131]] = True
    delays, per_day = measure_alarms(EPOCHS_US, is_alarm, int(EPOCHS_US[0]), (1.0, 2.0, 5.0, 100.0))
    # row 130 belongs to the second deed, so the first was never told; the last lies beyond the rows
    assert delays.tolist() == [np.inf, 10.0, np.inf]
    assert per_day == pytest.approx(2 * 1440 / (ROWS - 1))


def test_darkness_has_errors_inside_and_an_hour_after():
    is_dark = np.zeros(ROWS, dtype=bool)
    is_dark[100:200] = True
    error_deg = np.zeros((ROWS, 3))
    error_deg[100:200], error_deg[200:259], error_deg[262] = 0.2, 9.0, [0.1, 0.02, 0.03]
    found = measure_dark(EPOCHS_US, is_dark, error_deg)
    assert found.rows == 100
    assert np.sqrt(found.square_sum / found.rows) == pytest.approx([0.2] * 3)
    assert found.after == pytest.approx(np.array([[0.1, 0.02, 0.03]]))


def test_a_step_of_a_transponder_is_judged_by_what_it_does_to_the_answer():
    is_moved = np.zeros((ROWS, 2), dtype=bool)
    is_moved[100:200, 1] = True
    error_deg = np.full((ROWS, 3), 0.01)
    error_deg[120:, 1] += 0.04
    error_deg[205:215, 2] = 9.0
    found = measure_group_steps(EPOCHS_US, is_moved, error_deg)
    # both edges count; what goes away within twenty minutes is not left
    assert found == pytest.approx(np.array([[0.0, 0.04, 0.0], [0.0, 0.0, 0.0]]), abs=1e-12)


def test_carriers_of_a_transponder_are_no_single_faults():
    level_db, flags = np.zeros((ROWS, 2)), np.zeros((ROWS, 2), dtype=np.int64)
    level_db[100:], flags[100:] = 2.0, BITS["group_step"]
    assert len(faults(truth(level_db, flags), at()).delay_min) == 0
