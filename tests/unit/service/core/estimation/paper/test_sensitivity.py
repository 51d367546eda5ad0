"""Claims about the sensitivities from calibration turns."""

import numpy as np
import pytest

from service.core.estimation.paper.sensitivity import (
    fit_turn_sensitivity,
    level_knots,
    one_sided_columns,
    symmetric_sensitivity,
)

SIZES_DEG = (0.125, 0.25, 0.375, 0.5)


def turn_plan(rows=15, jitter_deg=0.01, seed=0):
    """Return angles (K, 3): +-4 sizes about each axis with rests between, then the eight corners of 0.3 deg."""
    stops = [sign * size * np.eye(3)[axis] for axis in range(3) for size in SIZES_DEG for sign in (1.0, -1.0)]
    stops += [0.3 * np.array([1 - 2 * (k >> 2 & 1), 1 - 2 * (k >> 1 & 1), 1 - 2 * (k & 1)]) for k in range(8)]
    levels = [level for stop in stops for level in (stop, np.zeros(3))]
    angle_deg = np.repeat(np.array(levels), rows, axis=0)
    return angle_deg + jitter_deg * np.random.default_rng(seed).standard_normal(angle_deg.shape)


def random_slopes(rng, carriers):
    steep = rng.normal(0.0, [0.16, 1.4, 1.2], (carriers, 3))
    bend = rng.normal([0.0, 0.5, 0.28], 0.1, (carriers, 3))
    return steep - bend, steep + bend


def answer(angle_deg, plus, minus):
    return np.maximum(angle_deg, 0.0) @ plus.T + np.minimum(angle_deg, 0.0) @ minus.T


def test_slopes_and_level_of_noise_free_turns_are_exact():
    plus, minus = random_slopes(np.random.default_rng(1), 5)
    angle_deg = turn_plan()
    level_db = np.array([0.0, 0.3, -0.2, 0.1, 5.0])
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus) + level_db)
    # rounding at a condition of about 10
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(fit.minus, minus, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(fit.symmetric, 0.5 * (plus + minus), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(fit.level_db, level_db, rtol=0.0, atol=1e-12)
    assert np.all(fit.residual_db < 1e-12)
    assert not fit.is_missing.any()
    assert not fit.samples_rejected.any()


def test_standard_errors_are_those_of_repeated_experiments():
    plus, minus = random_slopes(np.random.default_rng(2), 1)
    angle_deg = turn_plan(rows=8)
    noise_db = 0.1 * np.random.default_rng(3).standard_normal((len(angle_deg), 400))
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus) + noise_db, gate_sigma=50.0)
    # a standard deviation from 400 draws is good to 3.5 per cent; four of these
    np.testing.assert_allclose(fit.plus_sigma.mean(axis=0), fit.plus.std(axis=0), rtol=0.15)
    np.testing.assert_allclose(fit.minus_sigma.mean(axis=0), fit.minus.std(axis=0), rtol=0.15)
    assert fit.residual_db.mean() == pytest.approx(0.1, rel=0.02)  # 400 x 500 draws


def test_small_angles_about_the_other_axes_are_accounted_for():
    # every turn of roll drags 0.08 deg of pitch along: a fit of roll alone would be 7 per cent off
    plus, minus = random_slopes(np.random.default_rng(4), 3)
    angle_deg = turn_plan()
    angle_deg[:, 2] += 0.16 * angle_deg[:, 1]
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus))
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)  # rounding


def test_an_error_of_the_reference_does_not_reach_the_slopes():
    plus, minus = random_slopes(np.random.default_rng(5), 3)
    angle_deg = turn_plan()
    deviation_db = answer(angle_deg, plus, minus) + 0.05 * np.random.default_rng(6).standard_normal((len(angle_deg), 3))
    right, wrong = fit_turn_sensitivity(angle_deg, deviation_db), fit_turn_sensitivity(angle_deg, deviation_db + 1.0)
    np.testing.assert_allclose(right.plus, wrong.plus, rtol=0.0, atol=1e-12)  # rounding
    np.testing.assert_allclose(wrong.level_db - right.level_db, 1.0, rtol=0.0, atol=1e-12)  # rounding


def test_a_shower_and_impulses_are_rejected_and_counted():
    plus, minus = random_slopes(np.random.default_rng(7), 2)
    angle_deg = turn_plan()
    deviation_db = answer(angle_deg, plus, minus) + 0.02 * np.random.default_rng(8).uniform(
        -1.0, 1.0, (len(angle_deg), 2)
    )
    deviation_db[100:112, 0] -= 5.0
    deviation_db[300, 1] += 9.0
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    assert fit.samples_rejected.tolist() == [12, 1]
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=0.02)  # five sigmas of 0.004 dB/deg


def test_a_side_never_turned_is_nan_and_flagged_for_all():
    plus, minus = random_slopes(np.random.default_rng(9), 2)
    angle_deg = np.abs(turn_plan(jitter_deg=0.0))
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus))
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)  # rounding
    assert np.isnan(fit.minus).all()
    assert np.isnan(fit.minus_sigma).all()
    np.testing.assert_allclose(fit.symmetric, plus, rtol=0.0, atol=1e-12)  # the side there is
    assert fit.is_missing.tolist() == [[[False, True]] * 3] * 2


def test_small_angles_on_a_missing_side_follow_the_other_side():
    plus, minus = random_slopes(np.random.default_rng(10), 1)
    angle_deg = turn_plan(jitter_deg=0.0)
    angle_deg[:, 0] = np.maximum(angle_deg[:, 0], -0.09)  # yaw never reaches -0.1 deg
    minus[:, 0] = plus[:, 0]
    fit = fit_turn_sensitivity(angle_deg, answer(angle_deg, plus, minus))
    np.testing.assert_allclose(fit.plus, plus, rtol=0.0, atol=1e-12)  # rounding
    assert np.isnan(fit.minus[0, 0])
    assert fit.residual_db[0] < 1e-12


def test_a_carrier_that_was_off_during_a_turn_misses_that_side_alone():
    plus, minus = random_slopes(np.random.default_rng(11), 2)
    angle_deg = turn_plan()
    deviation_db = answer(angle_deg, plus, minus)
    deviation_db[angle_deg[:, 1] > 0.1, 1] = np.nan
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    assert not fit.is_missing[0].any()
    assert np.argwhere(fit.is_missing[1]).tolist() == [[1, 0]]
    np.testing.assert_allclose(
        fit.minus, minus, rtol=0.0, atol=0.02
    )  # jitter of roll reaches 0.04 deg on the plus side


def test_a_carrier_with_too_few_samples_is_nan():
    angle_deg = turn_plan()
    deviation_db = np.zeros((len(angle_deg), 2))
    deviation_db[15:, 0] = np.nan
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    assert np.isnan(fit.plus[0]).all()
    assert np.isnan([fit.level_db[0], fit.residual_db[0]]).all()
    assert (fit.samples_used[0], fit.samples_rejected[0]) == (0, 0)
    assert fit.is_missing[0].all()
    assert np.isfinite(fit.plus[1]).all()


def test_turns_that_do_not_tell_the_axes_apart_give_nan():
    angle_deg = np.outer(np.tile([-0.4, 0.4], 30), [1.0, 1.0, 1.0])
    assert np.isnan(fit_turn_sensitivity(angle_deg, np.zeros((60, 1))).plus).all()


def test_a_level_that_wanders_is_kept_out_of_the_slopes():
    plus, minus = random_slopes(np.random.default_rng(12), 3)
    angle_deg = turn_plan()
    time_s = 60.0 * np.arange(len(angle_deg))
    wander_db = level_knots(time_s, 7200.0) @ np.random.default_rng(13).normal(
        0.0, 0.1, (len(level_knots(time_s, 7200.0).T), 3)
    )
    deviation_db = answer(angle_deg, plus, minus) + wander_db
    with_knots = fit_turn_sensitivity(angle_deg, deviation_db, baseline=level_knots(time_s, 7200.0))
    np.testing.assert_allclose(with_knots.plus, plus, rtol=0.0, atol=1e-11)  # rounding
    constant = fit_turn_sensitivity(angle_deg, deviation_db)
    assert np.abs(constant.plus - plus)[:, 0].max() > 0.02


def test_knots_without_samples_have_no_level():
    plus, minus = random_slopes(np.random.default_rng(14), 1)
    angle_deg = turn_plan()
    time_s = 60.0 * np.arange(len(angle_deg))
    deviation_db = answer(angle_deg, plus, minus)
    deviation_db[:200] = np.nan
    fit = fit_turn_sensitivity(angle_deg, deviation_db, baseline=level_knots(time_s, 1800.0))
    np.testing.assert_allclose(
        fit.plus[0, 1:], plus[0, 1:], rtol=0.0, atol=1e-11
    )  # rounding; yaw was lost with the rows


@pytest.mark.parametrize("span_s", [0.0, 100.0, 5000.0, 86_400.0])
def test_knots_add_up_to_one(span_s):
    knots = level_knots(np.linspace(7.0, 7.0 + span_s, 50), 1000.0)
    np.testing.assert_allclose(knots.sum(axis=1), 1.0, rtol=0.0, atol=1e-12)  # rounding
    assert np.all(knots >= 0.0)


def test_columns_and_mean_slope():
    columns = one_sided_columns(np.array([[0.1, -0.2, 0.3]]))
    assert columns.tolist() == [[0.1, 0.0, 0.3, 0.0, -0.2, 0.0]]
    assert symmetric_sensitivity(np.array([np.nan]), np.array([3.0])).tolist() == [3.0]
