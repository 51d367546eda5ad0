"""Claims about the fade rule: what it sees, what turns do to it, how the watch counts."""

import math

import numpy as np
import pytest

from service.core.estimation.paper.downlink_fade import FadeTest, FadeWatch, fade_sign_test, step_fade_watch
from service.core.estimation.paper.octants import solve_octants_rows

WET = FadeTest(is_fade=True, median_db=-1.0, spread_db=0.1, share_below=1.0)
DRY = FadeTest(is_fade=False, median_db=0.0, spread_db=0.1, share_below=0.0)
LOW = FadeTest(is_fade=False, median_db=-0.5, spread_db=0.6, share_below=0.6)
BLIND = FadeTest(is_fade=False, median_db=math.nan, spread_db=math.nan, share_below=math.nan)


def test_median_spread_and_share_are_what_they_say():
    test = fade_sign_test(np.array([-1.0, -1.1, -0.9, -1.3, -0.1, np.nan]))
    assert test.median_db == -1.0
    assert test.spread_db == pytest.approx(1.4826 * 0.1, abs=1e-12)  # deviations 0, .1, .1, .3, .9
    assert test.share_below == 0.8
    assert test.is_fade


@pytest.mark.parametrize(
    ("deviation_db", "is_fade"),
    [
        ([-1.0, -1.0, -1.0, -1.0, 0.0], True),  # four of five
        ([-1.0, -1.0, -1.0, 0.0, 0.0], False),  # three of five
        ([-0.29] * 8, False),  # not deep enough
        ([-0.5, -1.0, -2.0, -3.0, -4.0], False),  # one sign, but not near one amplitude
        ([1.0] * 8, False),  # a rise is no rain
        ([-1.0] * 3, False),  # three carriers show nothing
        ([], False),
    ],
)
def test_the_condition(deviation_db, is_fade):
    assert fade_sign_test(np.array(deviation_db)).is_fade == is_fade


def test_too_few_carriers_give_no_figures():
    test = fade_sign_test(np.array([-1.0, np.nan, -1.0, -1.0]))
    assert np.isnan([test.median_db, test.spread_db, test.share_below]).all()


def test_what_an_attitude_explains_better_is_no_fade():
    deviation_db = np.array([-1.0, -1.1, -0.9, -1.2, -0.8, -1.0])
    assert not fade_sign_test(deviation_db, fix_residual_db=np.full(6, 0.01)).is_fade
    assert fade_sign_test(deviation_db, fix_residual_db=np.full(6, 0.5)).is_fade


def test_a_fix_of_too_few_carriers_does_not_vote():
    residual_db = np.array([0.01, 0.01, 0.01, np.nan, np.nan, np.nan])
    assert fade_sign_test(np.array([-1.0, -1.1, -0.9, -1.2, -0.8, -1.0]), fix_residual_db=residual_db).is_fade


def steps(tests, dt_s=60.0, state=None):
    state = FadeWatch() if state is None else state
    states = []
    for test in tests:
        state = step_fade_watch(state, dt_s, test)
        states.append(state)
    return states


def test_five_minutes_of_the_condition_stop():
    assert [state.is_stopped for state in steps([WET] * 6)] == [False] * 4 + [True] * 2


def test_a_break_starts_the_five_minutes_anew():
    assert not any(state.is_stopped for state in steps([WET] * 4 + [DRY] + [WET] * 4))


def test_ten_dry_minutes_return_control():
    states = steps([WET] * 5 + [DRY] * 10)
    assert [state.is_stopped for state in states[4:]] == [True] * 10 + [False]


def test_a_low_median_without_the_condition_neither_stops_nor_returns():
    assert not steps([LOW] * 30)[-1].is_stopped
    assert steps([WET] * 5 + [LOW] * 60)[-1].is_stopped
    assert steps([WET] * 5 + [DRY] * 9 + [LOW] + [DRY] * 9)[-1].is_stopped


def test_a_gap_starts_the_entry_anew_but_keeps_a_standing_stop():
    wet = steps([WET] * 4)[-1]
    assert not step_fade_watch(wet, 301.0, WET).is_stopped
    assert step_fade_watch(wet, 300.0, WET).is_stopped
    stopped = steps([WET] * 5)[-1]
    after = step_fade_watch(stopped, 86_400.0, DRY)
    assert after.is_stopped
    assert after.dry_s == 0.0
    assert steps([DRY] * 9, state=after)[-1].is_stopped
    assert not steps([DRY] * 10, state=after)[-1].is_stopped


def test_rows_that_cannot_be_judged_count_as_time_without_evidence():
    bridged = steps([WET, WET, BLIND, WET, WET])[-1]
    assert bridged.is_stopped
    assert not steps([WET] * 4 + [BLIND] * 5 + [WET])[-1].is_stopped
    assert steps([BLIND] * 3)[-1].blind_s == 180.0


def world(rng, minutes, *, amplitude_deg, mean_slope=0.0, fade_db=0.0):
    """Rows, sensitivities: 16 carriers, slopes and curvature as the studies found, slow turns about all axes."""
    slope_x = rng.normal(0.0, 1.2, 16)
    slope_y = rng.normal(mean_slope, math.sqrt(1.4**2 - mean_slope**2), 16)
    azimuth, elevation = np.radians(rng.uniform(-5.2, 5.0, 16)), np.radians(rng.uniform(6.3, 8.5, 16))
    minute = np.arange(minutes)
    yaw, roll, pitch = (
        amplitude_deg * np.sin(2.0 * np.pi * (minute / rng.uniform(200.0, 900.0) + rng.uniform()))[:, None]
        for _ in range(3)
    )
    dx, dy = -pitch - yaw * elevation, -roll + yaw * azimuth
    noise_db, coloured_db = rng.normal(0.0, 0.155, (minutes, 16)), rng.normal(0.0, 0.09, (minutes, 16))
    keep = math.exp(-1.0 / 20.0)
    for k in range(1, minutes):
        coloured_db[k] = keep * coloured_db[k - 1] + math.sqrt(1.0 - keep**2) * coloured_db[k]
    power_db = slope_x * dx + slope_y * dy - 0.75 * dx**2 - 1.35 * dy**2 + noise_db + coloured_db
    steep = np.stack([-slope_x * elevation + slope_y * azimuth, -slope_y, -slope_x], axis=1)
    bend = np.array([0.0, 0.51, 0.28])
    return power_db - np.reshape(fade_db, (-1, 1)), steep - bend, steep + bend


def trailing(power_db, rows=15):
    total = np.cumsum(np.vstack([np.zeros(16), power_db]), axis=0)
    last = np.arange(len(power_db)) + 1
    first = np.maximum(last - rows, 0)
    return (total[last] - total[first]) / (last - first)[:, None]


def is_stopped(power_db, plus, minus, *, use_fix):
    rows = trailing(power_db)
    residual_db = solve_octants_rows(plus, minus, rows, None).residual_db
    tests = [
        fade_sign_test(row, fix_residual_db=residual if use_fix else None)
        for row, residual in zip(rows, residual_db, strict=True)
    ]
    return np.array([state.is_stopped for state in steps(tests)])


@pytest.mark.parametrize("use_fix", [False, True])
def test_two_dry_days_of_turns_of_0p3_deg_never_stop(use_fix):
    for seed in (1, 2, 3):
        rows = world(np.random.default_rng(seed), 2880, amplitude_deg=0.3)
        assert not is_stopped(*rows, use_fix=use_fix).any()


def test_where_all_stations_stand_on_one_side_only_the_fix_tells_turns_from_rain():
    # mean roll slope 1.2 of 1.4 dB/deg: an attitude imitates three quarters of a common change
    stopped = {True: 0.0, False: 0.0}
    for seed in range(4):
        rows = world(np.random.default_rng(seed), 1440, amplitude_deg=0.3, mean_slope=1.2)
        for use_fix in stopped:
            stopped[use_fix] += is_stopped(*rows, use_fix=use_fix).mean() / 4.0
    assert stopped[False] > 0.05  # measured 0.10 over ten seeds: the known weakness of the paper's rule
    assert stopped[True] == 0.0  # measured 0 over ten seeds; 0.02 at a mean slope of 1.3


@pytest.mark.parametrize("slope_db_min", [0.05, 0.3, 3.0])
@pytest.mark.parametrize("mean_slope", [0.0, 1.1])
@pytest.mark.parametrize("use_fix", [False, True])
def test_a_fade_to_two_db_is_found_within_twenty_minutes_of_0p3_db(slope_db_min, mean_slope, use_fix):
    late = 0
    for seed in range(20):
        fade_db = np.clip(slope_db_min * (np.arange(200) - 60), 0.0, 2.0)
        rows = world(
            np.random.default_rng(500 + seed),
            200,
            amplitude_deg=0.05 * (seed % 4),
            mean_slope=mean_slope,
            fade_db=fade_db,
        )
        stopped = np.flatnonzero(is_stopped(*rows, use_fix=use_fix)[60:])
        late += stopped.size == 0 or stopped[0] > 0.3 / slope_db_min + 20.0
    assert late <= 1  # 95 per cent of 20; measured 0
