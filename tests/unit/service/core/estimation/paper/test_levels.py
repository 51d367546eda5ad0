"""Level of the published method: harmonic, trailing mean, turn levels and fades of the downlink."""

import math

import numpy as np
import pytest
from paper_rows import FADE_LIMITS, solve

from service.core.estimation.paper.downlink_fade import (
    FADE,
    FadeTest,
    fade_sign_test,
    left_by_angles,
    step_fade_watch,
    trailing_mean,
)
from service.core.estimation.paper.harmonic import evaluate_harmonic, fit_harmonic, fit_harmonics
from service.core.estimation.paper.sensitivity import TurnLevels, one_sided_curvature, reduce_to_levels
from service.core.estimation.paper.snapshot import residual_db

PHASE_RAD = np.linspace(0.0, 2.0 * np.pi, 288, endpoint=False)


def test_the_fit_evaluates_to_the_data_without_their_level():
    rng = np.random.default_rng(3)
    power_dbm = rng.normal(-50.0, 5.0, 4) + evaluate_harmonic(PHASE_RAD, [0.1, 0.2, 0.3, 0.4], [3.0, -1.0, 0.0, 1.5])
    fits = fit_harmonics(PHASE_RAD, power_dbm)
    model_dbm = fits.offset_dbm + evaluate_harmonic(PHASE_RAD, fits.amplitude_db, fits.phase_rad)
    np.testing.assert_allclose(model_dbm, power_dbm, rtol=0.0, atol=1e-12)  # rounding


def test_it_is_the_solution_of_the_papers_normal_equations():
    rng = np.random.default_rng(20)
    power_dbm = -40.0 + 0.3 * np.cos(PHASE_RAD + 1.0) + 0.18 * rng.uniform(-1.0, 1.0, 288)  # bounded: nothing rejected
    c, s = np.cos(PHASE_RAD), np.sin(PHASE_RAD)
    matrix = np.array(
        [[288.0, c.sum(), s.sum()], [c.sum(), (c * c).sum(), (c * s).sum()], [s.sum(), (c * s).sum(), (s * s).sum()]]
    )
    h, a1, a2 = np.linalg.solve(matrix, [power_dbm.sum(), (power_dbm * c).sum(), (power_dbm * s).sum()])
    fit = fit_harmonic(PHASE_RAD, power_dbm)
    assert fit.samples_rejected == 0
    # rounding of sums of 288 values of 40
    assert fit.offset_dbm == pytest.approx(h, abs=1e-11)
    assert fit.amplitude_db == pytest.approx(np.hypot(a1, a2), abs=1e-11)
    assert fit.phase_rad == pytest.approx(np.arctan2(-a2, a1), abs=1e-10)


def test_impulses_are_rejected_and_counted():
    rng = np.random.default_rng(7)
    power_dbm = -42.0 + 0.3 * np.cos(PHASE_RAD) + 0.05 * rng.uniform(-1.0, 1.0, 288)
    power_dbm[[5, 100, 200]] -= 6.0
    power_dbm[[6, 101]] = np.nan
    fit = fit_harmonic(PHASE_RAD, power_dbm)
    assert (fit.samples_used, fit.samples_rejected, fit.converged) == (283, 3, True)
    assert fit.amplitude_db == pytest.approx(0.3, abs=0.01)  # 3 sigma of 0.029 sqrt(2 / 283)


def test_the_covariance_is_that_of_repeated_experiments():
    rng = np.random.default_rng(13)
    phase_rad = PHASE_RAD[:200]  # not a full turn: h, a1, a2 correlate
    noise_db = 0.1 * rng.standard_normal((200, 3000))
    fits = fit_harmonics(phase_rad, noise_db, gate_sigma=100.0)
    a1, a2 = fits.amplitude_db * np.cos(fits.phase_rad), -fits.amplitude_db * np.sin(fits.phase_rad)
    spread = np.cov(np.stack([fits.offset_dbm, a1, a2]))
    # a (co)variance from 3000 draws is good to 2.6 per cent of the product of both sigmas; 10 per cent is four sigmas
    sigmas = np.sqrt(np.diagonal(spread))
    error = (fits.covariance.mean(axis=0) - spread) / np.outer(sigmas, sigmas)
    np.testing.assert_allclose(error, 0.0, rtol=0.0, atol=0.1)


@pytest.mark.parametrize(
    ("phase_rad", "power_dbm"),
    [
        (PHASE_RAD[:7], np.full(7, -42.0)),  # seven samples
        (np.full(100, 1.0), np.full(100, -42.0)),  # one phase
        (np.tile([0.0, 2.0], 50), np.full(100, -42.0)),  # two phases
        (PHASE_RAD, np.full(288, np.nan)),  # nothing measured
        (np.full(288, np.nan), np.full(288, -42.0)),  # no phase known
    ],
)
def test_what_cannot_be_fitted_is_nan(phase_rad, power_dbm):
    fit = fit_harmonic(phase_rad, power_dbm)
    assert np.isnan([fit.amplitude_db, fit.phase_rad, fit.offset_dbm, fit.rms_db]).all()
    assert np.isnan(fit.covariance).all()
    assert (fit.samples_used, fit.samples_rejected, fit.converged) == (0, 0, False)


def test_eight_samples_are_enough():
    fit = fit_harmonic(PHASE_RAD[::36], 0.2 * np.cos(PHASE_RAD[::36]) - 30.0)
    assert fit.samples_used == 8
    assert fit.amplitude_db == pytest.approx(0.2, abs=1e-12)  # rounding


def test_a_block_of_rain_of_45_per_cent_masks_the_rule():
    # a documented weakness of the published rule, held here so that nobody takes it for robust
    power_dbm = np.where(np.arange(288) < 130, -45.0, -42.0)
    fit = fit_harmonic(PHASE_RAD, power_dbm + 0.01 * np.sin(7.0 * PHASE_RAD))
    assert fit.samples_rejected == 0
    assert (
        fit.amplitude_db > 0.5
    )  # 3 dB over 45 per cent of the turn: first harmonic of a pulse, 2 * 3 sin(0.45 pi) / pi


def test_many_carriers_equal_one_at_a_time():
    rng = np.random.default_rng(2)
    power_dbm = rng.standard_t(3, (288, 5)) - 40.0
    power_dbm[rng.random((288, 5)) < 0.1] = np.nan
    fits = fit_harmonics(PHASE_RAD, power_dbm)
    for carrier in range(5):
        fit = fit_harmonic(PHASE_RAD, power_dbm[:, carrier])
        assert fit.samples_used == fits.samples_used[carrier] == fits.is_used[:, carrier].sum()
        assert fit.amplitude_db == pytest.approx(fits.amplitude_db[carrier], abs=1e-11)  # order of sums


MINUTE_US = 60_000_000


def mean(rows, window_s=900.0, min_rows=8):
    """Return the mean of rows a minute apart."""
    rows = np.asarray(rows, dtype=float)
    epochs_us = MINUTE_US * np.arange(len(rows))
    return trailing_mean(epochs_us, rows, len(rows), round(window_s * 1e6), min_rows)[0]


def test_it_is_the_mean_of_the_rows_in_the_window():
    rows = np.random.default_rng(1).standard_normal((40, 3))
    expected = rows[-15:].mean(axis=0)  # 900 s at 60 s
    np.testing.assert_allclose(mean(rows), expected, rtol=0.0, atol=1e-15)  # order of sums


def test_absent_values_are_left_out_and_too_few_give_nan():
    rows = np.ones((15, 2))
    rows[:7, 0] = np.nan
    rows[:8, 1] = np.nan
    result = mean(rows, window_s=900.0, min_rows=8)
    assert result[0] == 1.0
    assert np.isnan(result[1])


def test_the_window_is_open_at_its_old_end():
    assert mean([[100.0], [1.0], [3.0]], window_s=120.0, min_rows=1)[0] == 2.0


def test_an_absent_neighbour_leaves_every_bit_of_a_mean():
    rows = np.random.default_rng(2).standard_normal((40, 3))
    with_gap = rows.copy()
    with_gap[33, 0] = np.nan
    assert np.array_equal(mean(rows)[1:], mean(with_gap)[1:])


def test_an_empty_window_has_no_mean():
    assert np.isnan(mean(np.zeros((0, 4)), min_rows=0)).all()


def test_a_gap_longer_than_the_window_leaves_only_the_new_rows():
    epochs_us, rows = np.append(MINUTE_US * np.arange(15), 10_000 * MINUTE_US), np.append(np.zeros(15), 5.0)[:, None]
    few, count = trailing_mean(epochs_us, rows, 16, 15 * MINUTE_US, 1)
    assert (few[0], count) == (5.0, 1)
    assert np.isnan(trailing_mean(epochs_us, rows, 16, 15 * MINUTE_US, 2)[0][0])


def test_rows_before_the_window_and_room_behind_it_change_no_bit():
    rng = np.random.default_rng(4)
    rows = rng.standard_normal((120, 16)) * 10.0 ** rng.integers(-6, 3, (120, 16))
    rows[rng.random((120, 16)) < 0.2] = np.nan
    for start in (30, 80, 105):
        assert mean(rows).tobytes() == mean(rows[start:]).tobytes()
    with_room = trailing_mean(MINUTE_US * np.arange(120), rows, 100, 15 * MINUTE_US, 8)[0]
    assert with_room.tobytes() == mean(rows[:100]).tobytes()


SIZES_DEG = (0.125, 0.25, 0.375, 0.5)


def levels_of(axis_answer, axis=1, sizes=SIZES_DEG, noise_db=0.0, seed=0):
    """Return levels of turns about each axis and rests, the carrier answering to one axis by a function."""
    stops = [sign * size * np.eye(3)[turned] for turned in range(3) for size in sizes for sign in (1.0, -1.0)]
    angle_deg = np.array([level for stop in stops for level in (stop, np.zeros(3))])
    deviation_db = axis_answer(angle_deg[:, axis])[:, np.newaxis]
    return TurnLevels(
        angle_deg, deviation_db + noise_db * np.random.default_rng(seed).standard_normal(deviation_db.shape)
    )


def test_levels_are_means_of_angles_and_medians_of_powers():
    angle_deg = np.array([[0.0, 0.0, 0.0]] * 3 + [[0.0, 0.3, 0.0], [0.0, 0.31, 0.0], [0.0, 0.32, 0.0]])
    deviation_db = np.array([[1.0], [1.2], [50.0], [2.0], [-70.0], [2.1]])
    levels = reduce_to_levels(angle_deg, deviation_db)
    np.testing.assert_allclose(levels.angle_deg, [[0.0, 0.0, 0.0], [0.0, 0.31, 0.0]], rtol=0.0, atol=1e-15)  # rounding
    assert levels.deviation_db.tolist() == [[1.2], [2.0]]


@pytest.mark.parametrize("slew", [[0.1, 0.2, 0.3, 0.4], [math.nan]])
def test_slews_and_rows_without_angles_are_left_out(slew):
    angle_deg = np.zeros((20 + len(slew), 3))
    angle_deg[10:, 1] = slew + [0.5] * 10
    assert reduce_to_levels(angle_deg, np.zeros((len(angle_deg), 1))).angle_deg[:, 1].tolist() == [0.0, 0.5]


def test_rows_that_are_levels_already_pass_through():
    angle_deg = np.array([[0.0, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.5, 0.0]])
    levels = reduce_to_levels(angle_deg, np.array([[0.0], [1.0], [3.0]]))
    assert np.array_equal(levels.angle_deg, angle_deg)
    assert levels.deviation_db.tolist() == [[0.0], [1.0], [3.0]]


def test_absent_rows_count_and_half_of_them_blank_a_level():
    deviation_db = np.array([[1.0, np.nan], [np.nan, np.nan], [3.0, 5.0], [np.nan, np.nan]])
    levels = reduce_to_levels(np.zeros((4, 3)), deviation_db)
    assert levels.deviation_db[0, 0] == 2.0
    assert np.isnan(levels.deviation_db[0, 1])


def test_nothing_gives_no_levels():
    levels = reduce_to_levels(np.full((3, 3), np.nan), np.zeros((3, 2)))
    assert levels.angle_deg.shape == (0, 3)
    assert levels.deviation_db.shape == (0, 2)


def test_levels_beyond_the_range_take_no_part():
    levels = levels_of(lambda x: 1.2 * x - 5.0 * np.maximum(np.abs(x) - 0.5, 0.0), sizes=(0.2, 0.35, 0.5, 0.9))
    curvature = one_sided_curvature(levels, 0, 1, 0.5)
    np.testing.assert_allclose(curvature.q_db_per_deg2, 0.0, rtol=0.0, atol=1e-10)  # rounding
    assert curvature.excursion_deg == 0.5


def test_one_level_on_a_side_measures_no_curvature():
    levels = levels_of(lambda x: 1.2 * x, sizes=(0.5,))
    jitter = 0.005 * np.random.default_rng(1).standard_normal(levels.angle_deg.shape)
    curvature = one_sided_curvature(TurnLevels(levels.angle_deg + jitter, levels.deviation_db), 0, 1, 0.5)
    assert np.isnan(curvature.q_db_per_deg2).all()


WET = FadeTest(is_fade=True, is_turn=False, median_db=-0.3, spread_db=0.1, share_below=1.0)
DEEP = WET._replace(median_db=-1.2)
DRY = FadeTest(is_fade=False, is_turn=False, median_db=0.0, spread_db=0.1, share_below=0.0)
LOW = FadeTest(is_fade=False, is_turn=False, median_db=-0.5, spread_db=0.6, share_below=0.6)
TURNED = LOW._replace(is_turn=True)
BLIND = FadeTest(is_fade=False, is_turn=False, median_db=math.nan, spread_db=math.nan, share_below=math.nan)


def fade(deviation_db, residual_db=None):
    """Return the verdict by the settings in print."""
    left_db = math.inf if residual_db is None else left_by_angles(residual_db, np.zeros(len(residual_db), dtype=int))
    return fade_sign_test(np.asarray(deviation_db, dtype=float), 1.0, 0.3, 0.8, 0.5, left_db)


def test_median_spread_and_share_are_what_they_say():
    test = fade(np.array([-1.0, -1.1, -0.9, -1.3, -0.1, np.nan]))
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
    assert fade(deviation_db).is_fade == is_fade


def test_too_few_carriers_give_no_figures():
    test = fade([-1.0, np.nan, -1.0, -1.0])
    assert np.isnan([test.median_db, test.spread_db, test.share_below]).all()


@pytest.mark.parametrize(
    ("residual_db", "is_fade", "is_turn"),
    [
        ([0.01] * 6, False, True),
        ([0.06] * 6, False, False),  # 0.13 dB of the levels' 0.15 are left: better, and not clearly
        ([0.5] * 6, True, False),
        ([0.01] * 3 + [math.nan] * 3, True, False),
    ],
)
def test_what_an_attitude_of_enough_carriers_explains_better_is_no_fade(residual_db, is_fade, is_turn):
    deviation_db = np.array([-1.0, -1.1, -0.9, -1.2, -0.8, -1.0])
    test = fade(deviation_db, np.array(residual_db))
    assert (test.is_fade, test.is_turn) == (is_fade, is_turn)


def step(state, dt_s, test):
    """Return the state of a watch after one row."""
    watch = state.copy()
    step_fade_watch(watch, 0, dt_s, test, FADE_LIMITS)
    return watch


def steps(tests, dt_s=60.0, state=None):
    state = np.zeros(1, FADE) if state is None else state
    states = []
    for test in tests:
        state = step(state, dt_s, test)
        states.append(state)
    return states


def are_stopped(states):
    return np.array([state["is_stopped"][0] for state in states])


@pytest.mark.parametrize(
    ("minutes", "stopped"),
    [
        pytest.param([WET] * 6, [4, 5], id="five minutes of the condition stop"),
        pytest.param([DEEP] * 3, [1, 2], id="a change four times as deep stops in a quarter of the time"),
        pytest.param([WET] * 4 + [DRY] + [WET] * 4, [], id="a break starts the five minutes again"),
        pytest.param([WET] * 5 + [DRY] * 10, range(4, 14), id="ten dry minutes return control"),
        pytest.param([LOW] * 30, [], id="a low median alone does not stop"),
        pytest.param([WET] * 5 + [LOW] * 60, range(4, 65), id="a low median does not return control"),
        pytest.param([WET] * 5 + [TURNED] * 10, range(4, 14), id="ten minutes of a turn return control"),
        pytest.param(
            [WET] * 5 + [DRY] * 9 + [LOW] + [DRY] * 9, range(4, 24), id="a low median starts dry minutes again"
        ),
    ],
)
def test_a_fade_stops_control_and_dry_minutes_return_it(minutes, stopped):
    assert np.flatnonzero(are_stopped(steps(minutes))).tolist() == list(stopped)


def test_a_gap_starts_the_entry_anew_but_keeps_a_standing_stop():
    wet = steps([WET] * 4)[-1]
    assert not step(wet, 301.0, WET)["is_stopped"]
    assert step(wet, 300.0, WET)["is_stopped"]
    stopped = steps([WET] * 5)[-1]
    after = step(stopped, 86_400.0, DRY)
    assert after["is_stopped"]
    assert after["dry_s"] == 0.0
    assert steps([DRY] * 9, state=after)[-1]["is_stopped"]
    assert not steps([DRY] * 10, state=after)[-1]["is_stopped"]


def test_rows_that_cannot_be_judged_count_as_time_without_evidence():
    bridged = steps([WET, WET, BLIND, WET, WET])[-1]
    assert bridged["is_stopped"]
    assert not steps([WET] * 4 + [BLIND] * 5 + [WET])[-1]["is_stopped"]
    assert steps([BLIND] * 3)[-1]["blind_s"] == 180.0


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
    tests = []
    for row in trailing(power_db):
        # a fix is asked for where the plain rule finds a fade
        test = fade(row)
        if use_fix and test.is_fade:
            test = fade(row, residual_db(plus, minus, row, solve(plus, minus, row).attitude_deg))
        tests.append(test)
    return are_stopped(steps(tests))


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
