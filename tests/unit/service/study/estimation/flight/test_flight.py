"""Flights of the study: episodes, catalogue, journal and baselines."""

import json
from dataclasses import replace

import numpy as np
import pytest

from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.catalogue import Carrier, ControlMode, Method, Release, Spacecraft, WheelMomentum
from service.records.epoch import parse_epoch
from service.records.inputs import Correction, Operation, PlanChange, SourceSelection
from service.records.levels.attitude import Axes
from service.study.estimation.flight.baselines import (
    BASELINES,
    COUPLING_RAD_H,
    FEEDBACK_H,
    baseline_answers,
    commanded_deg,
)
from service.study.estimation.flight.drive import measurements, slow_entries
from service.study.estimation.flight.episodes import (
    measure_alarms,
    measure_dark,
    measure_faults,
    measure_group_steps,
    measure_rain,
    stretches,
)
from service.study.estimation.flight.motion_statistics import NOTHING_MEASURED, TrueRates, read_motion_statistics
from service.study.estimation.flight.world import (
    GroundEvent,
    Truth,
    read_carriers,
    read_contents,
    read_ephemeris,
    read_record,
)

MINUTE_US = 60_000_000
ROWS = 400
EPOCHS_US = 1_800_000_000_000_000 + MINUTE_US * np.arange(ROWS)
BITS = {"uplink_rain": 1, "off": 4, "step": 8, "group_step": 16, "interference": 64, "wet_antenna": 256}


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


START = "2026-11-21T00:00:00.000000Z"
STOP = "2026-11-21T01:00:00.000000Z"
SPACECRAFT = {
    "id": "yamal-202",
    "name": "Yamal-202 (simulated)",
    "cospar_id": "2003-053B",
    "longitude_deg": 90,
    "simulated": True,
    "receiving_site": {"name": "site", "latitude_deg": 55.0, "longitude_deg": 37.0, "height_m": 180.0},
    "inertia_kg_m2": [[2600, 0, 0], [0, 1400, 0], [0, 0, 2600]],
    "torque_limit_n_m": 0.05,
    "onboard": {"fast_loop": True, "forecast_mode": True, "roll_yaw_coupling": False},
    "control": {"method": "paper", "mode": "ground", "release": "automatic"},
}
CARRIER = {
    "id": "c00",
    "name": "station 512k",
    "station": {"name": "station", "latitude_deg": 60.0, "longitude_deg": 90.0},
    "band": "Ku",
    "transponder": "Ku1",
    "polarization": "H",
    "uplink_hz": 14.1e9,
    "downlink_hz": 11.1e9,
    "intermediate_hz": 1.2e9,
    "bandwidth_hz": 6e5,
    "kind": "traffic",
    "uplink_power_control": "none",
    "transponder_mode": "alc",
    "enabled": True,
}


def test_a_spacecraft_keeps_what_the_ground_says_of_its_coupling_and_control():
    record = read_record(Spacecraft, SPACECRAFT)
    assert record.onboard.roll_yaw_coupling is False
    assert record.inertia_kg_m2[1] == (0.0, 1400.0, 0.0)
    assert (record.control.method, record.control.mode, record.control.release) == (
        Method.PAPER,
        ControlMode.GROUND,
        Release.AUTOMATIC,
    )
    assert record.receiving_site.height_m == 180.0


def test_a_flown_spacecraft_states_its_wheels_without_a_torque_of_their_own():
    stated = {"sigma_n_m_s": 0.02, "scale_error": 0.005, "misalignment_deg": 0.05, "used": True}
    record = read_record(Spacecraft, {**SPACECRAFT, "onboard": {**SPACECRAFT["onboard"], "momentum": stated}})
    assert record.onboard.momentum == WheelMomentum(sigma_n_m_s=0.02)


def test_carriers_keep_their_order_and_a_beacon_has_no_station():
    beacon = {**CARRIER, "id": "b1", "station": None, "uplink_hz": None, "kind": "beacon"}
    first, second = read_carriers({"carriers": [CARRIER, beacon]})
    assert (first.id, first.station.latitude_deg, first.transponder_mode) == ("c00", 60.0, "alc")
    assert second.station is None
    assert not second.is_usable_for_attitude


def test_an_ephemeris_is_valid_as_far_as_its_track():
    track = {"epochs": [START, STOP], "latitude_deg": [0.0, 0.01], "longitude_deg": [90.0, 90.01]}
    reported = read_ephemeris({"ascending_nodes": [START], "nodal_period_s": 86_164.0, "track": track})
    assert (reported.valid_start_us, reported.valid_stop_us) == (parse_epoch(START), parse_epoch(STOP))
    assert reported.track.latitude_deg == (0.0, 0.01)


def test_an_operation_keeps_its_uncertainty_by_axis():
    body = {
        "kind": "station_keeping",
        "start": START,
        "stop": STOP,
        "carriers": None,
        "transponders": ["Ku1"],
        "inhibit_control": True,
        "comment": "",
        "attitude_uncertainty_deg": {"yaw": 0.2, "roll": 0.1, "pitch": 0.05},
    }
    reported = read_record(Operation, body, id=7)
    assert (reported.id, reported.transponders, reported.carriers) == (7, ("Ku1",), None)
    assert reported.attitude_uncertainty_deg == Axes(0.2, 0.1, 0.05)
    del body["attitude_uncertainty_deg"]
    assert read_record(Operation, body, id=8).attitude_uncertainty_deg is None


def test_telemetry_keeps_wheels_and_thrusters():
    record = {
        "epoch": START,
        "onboard_mode": "forecast",
        "wheel_momentum_n_m_s": [1.0, -8.0, 0.5],
        "thrusters_active": False,
    }
    (reported,) = read_contents({"kind": "telemetry", "body": {"records": [record]}}, 1)
    assert reported.epoch_us == parse_epoch(START)
    assert reported.wheel_momentum_n_m_s == (1.0, -8.0, 0.5)
    assert reported.thrusters_active is False


HOUR_US = 3_600_000_000
START_US = 1_800_000_000_000_000
AT_START = np.array([0.2, -0.1, 0.05])


def epochs(hours):
    return (START_US + np.asarray(hours) * HOUR_US).astype(np.int64)


def test_names_are_those_of_the_table():
    assert tuple(baseline_answers(epochs([1.0]), START_US, AT_START, ())) == BASELINES


def test_without_corrections_a_quarter_of_a_day_turns_yaw_into_roll():
    quarter_h = 0.5 * np.pi / COUPLING_RAD_H
    answers = baseline_answers(epochs(np.linspace(0.01, quarter_h, 300)), START_US, AT_START, ())
    yaw, roll, pitch = AT_START
    # roll' = w yaw, yaw' = -w roll; the last epoch is rounded to a microsecond
    assert answers["coupling"][-1] == pytest.approx([-roll, yaw, pitch], abs=1e-9)
    assert answers["corrections"] == pytest.approx(np.tile(AT_START, (300, 1)), abs=0.0)
    assert not answers["zero"].any()


def test_a_correction_is_spread_evenly_over_its_interval():
    correction = Correction(START_US + HOUR_US, START_US + 3 * HOUR_US, Axes(0.4, 0.0, -0.2))
    reported = commanded_deg(epochs([0.5, 1.0, 2.0, 3.0, 9.0]), (correction,))
    assert reported[:, 0] == pytest.approx([0.0, 0.0, 0.2, 0.4, 0.4], abs=1e-12)
    assert reported[:, 2] == pytest.approx([0.0, 0.0, -0.1, -0.2, -0.2], abs=1e-12)


def test_what_was_commanded_before_the_alignment_is_in_its_attitude():
    early = Correction(START_US - HOUR_US, START_US + HOUR_US, Axes(0.0, 0.2, 0.0))
    answers = baseline_answers(epochs([0.5, 2.0]), START_US, np.zeros(3), (early,))
    assert answers["corrections"][:, 1] == pytest.approx([0.05, 0.1], abs=1e-12)


def test_pitch_does_not_couple():
    nod = Correction(START_US, START_US + HOUR_US, Axes(0.0, 0.0, 0.3))
    answers = baseline_answers(epochs(np.linspace(0.1, 5.0, 50)), START_US, np.zeros(3), (nod,))
    assert answers["coupling"][:, :2] == pytest.approx(np.zeros((50, 2)), abs=0.0)
    assert answers["coupling"][-1, 2] == pytest.approx(0.3, abs=1e-12)


def test_corrections_against_the_exchange_hold_the_craft_still():
    """Told to hold 0.1 deg of roll, the ground takes out what the exchange would bring."""
    hold = Correction(START_US, START_US + 2 * HOUR_US, Axes(2.0 * COUPLING_RAD_H * 0.1, 0.0, 0.0))
    answers = baseline_answers(epochs(np.arange(1, 121) / 60.0), START_US, np.array([0.0, 0.1, 0.0]), (hold,))
    # a minute's rotation with its correction in the middle: exact but for the third power of 0.004 rad
    assert answers["coupling"][-1] == pytest.approx([0.0, 0.1, 0.0], abs=1e-5)


def test_a_correction_read_as_a_measurement_tells_what_its_operator_saw():
    seen = np.array([0.06, -0.04, 0.02])
    share = -np.expm1(-0.5 / FEEDBACK_H)
    change = -share * seen
    correction = Correction(START_US + HOUR_US, START_US + 3 * HOUR_US // 2, Axes(*change.tolist()))
    answers = baseline_answers(epochs([0.5, 1.0, 1.5]), START_US, AT_START, (correction,))["corrections_read"]
    np.testing.assert_allclose(answers[0], AT_START)
    np.testing.assert_allclose(answers[1], seen, atol=1e-12)  # rounding
    angle = 0.5 * COUPLING_RAD_H
    yaw, roll, pitch = seen
    turned = [np.cos(angle) * yaw - np.sin(angle) * roll, np.sin(angle) * yaw + np.cos(angle) * roll, pitch]
    np.testing.assert_allclose(answers[2], turned + change, atol=1e-12)  # rounding


def test_without_corrections_nothing_can_be_read():
    answers = baseline_answers(epochs([0.5, 1.0]), START_US, AT_START, ())["corrections_read"]
    np.testing.assert_allclose(answers, [AT_START, AT_START])


class Listener:
    """Writes down what a chain is taught."""

    def __init__(self):
        self.taught = []

    def update(self, content):
        self.taught.append(content)


def carriers(*names):
    return tuple(Carrier(name, "Ku", "Ku1", 11e9, 1e6) for name in names)


@pytest.fixture
def ground(toured_world):
    """Four columns, ten rows; the plan holds two carriers in another order."""
    world = toured_world.ground
    power_dbm = np.arange(40.0).reshape(10, 4)
    return replace(
        world,
        carriers=carriers("c2", "c0"),
        epochs_us=world.epochs_us[:10],
        power_dbm=power_dbm,
        source=np.array([0] * 5 + [1] * 5),
        source_names=("sa-1", "sa-2"),
    )


def reported(ground, *events):
    """Return what a chain hears of the ten rows: the rows and, of each slow input, how many rows came before it."""
    ground = replace(ground, events=events)
    documents, listener = JournalDocuments(), Listener()
    documents.add_plan(ground.carriers)
    entries = slow_entries(ground, documents)
    rows, before = [], []
    for row in measurements(listener, ground, documents, entries, np.arange(10)):
        before += [len(rows)] * (len(listener.taught) - len(before))
        rows.append(row)
    return rows, listener.taught, before


def test_powers_stand_in_the_order_of_the_plan(ground):
    rows, _, _ = reported(ground)
    assert rows[3].power_dbm.tolist() == [14.0, 12.0]
    assert [row.number for row in rows] == list(range(1, 11))


def test_an_input_comes_before_the_first_row_that_is_not_older(ground):
    corrections = [
        GroundEvent(int(ground.epochs_us[row]) + late_us, Correction(1, 2, Axes(0.0, 0.0, float(row))))
        for row, late_us in ((7, 0), (2, 1))
    ]
    _, taught, before = reported(ground, *corrections)
    # told in the order of time; what comes a microsecond after a row is heard before the next
    assert [(content.change_deg.pitch, count) for content, count in zip(taught, before, strict=True)] == [
        (2.0, 3),
        (7.0, 7),
    ]


def test_a_new_plan_gives_another_order_from_its_row_on(ground):
    rows, taught, _ = reported(ground, GroundEvent(int(ground.epochs_us[4]), carriers("c0", "c1", "c3")))
    assert taught == [PlanChange(2)]
    assert [row.plan_id for row in rows] == [1] * 4 + [2] * 6
    assert rows[4].power_dbm.tolist() == [16.0, 17.0, 19.0]


def test_only_the_prime_analyzer_feeds_the_estimator(ground):
    rows, _, _ = reported(ground)
    assert [row.feeds_estimator for row in rows] == [True] * 5 + [False] * 5
    rows, _, _ = reported(ground, GroundEvent(int(ground.epochs_us[6]), SourceSelection("sa-2", 1)))
    assert [row.feeds_estimator for row in rows] == [True] * 5 + [False] + [True] * 4
    assert rows[9].source == "sa-2"


def test_what_is_not_measured_is_none():
    text = json.dumps({"wheels": None, "rates": None, "polarimeter": None})
    read = read_motion_statistics(text, np.empty(0))
    assert (read.wheels, read.rates, read.polarimeter) == NOTHING_MEASURED[:3] == (None, None, None)


def test_figures_are_read_by_name_and_unknown_ones_are_left_out():
    rates = {"bias_deg_h": 0.01, "bias_tau_h": 8.0, "noise_deg_sqrt_h": 0.003, "bias_factor": 5.0, "colour": "red"}
    text = json.dumps({"wheels": None, "rates": rates, "polarimeter": None})
    read = read_motion_statistics(text, np.empty(0))
    assert read.rates == TrueRates(bias_deg_h=0.01, bias_tau_h=8.0, bias_factor=5.0, noise_deg_sqrt_h=0.003)
