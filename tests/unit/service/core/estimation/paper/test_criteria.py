"""Claims about the three requirements: figures on known answers, and that noise alone fails no carrier."""

import math

import numpy as np
import pytest

from service.core.estimation.paper.criteria import judge_carriers
from service.core.estimation.paper.sensitivity import fit_turn_sensitivity

SIZES_DEG = (0.125, 0.25, 0.375, 0.5)


def turn_plan(rows=15):
    stops = [sign * size * np.eye(3)[axis] for axis in range(3) for size in SIZES_DEG for sign in (1.0, -1.0)]
    return np.repeat(np.array([level for stop in stops for level in (stop, np.zeros(3))]), rows, axis=0)


def judge(slopes, bends, *, noise_db=0.0, block_db=0.0, seed=0, rms_db=0.1, angle_deg=None, **limits):
    """Judge carriers that answer ``slope x + bend x^2`` to each angle, with white noise and noise of each level."""
    rng = np.random.default_rng(seed)
    angle_deg = turn_plan() if angle_deg is None else angle_deg
    slopes, bends = np.atleast_2d(slopes), np.atleast_2d(bends)
    shape = (len(angle_deg), len(slopes))
    deviation_db = angle_deg @ slopes.T + angle_deg**2 @ bends.T + noise_db * rng.standard_normal(shape)
    deviation_db += np.repeat(block_db * rng.standard_normal((-(-shape[0] // 15), shape[1])), 15, axis=0)[: shape[0]]
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    return judge_carriers(np.full(len(slopes), rms_db), angle_deg, deviation_db, fit.plus, fit.minus, **limits)


def test_a_straight_steep_stable_roll_carrier_is_eligible():
    verdicts = judge([0.02, 1.2, 0.3], [0.0, 0.0, 0.0])
    assert (verdicts.stable[0], verdicts.linear[0], verdicts.dominant[0]) == (True, True, True)
    assert (verdicts.stable & verdicts.linear & verdicts.dominant)[0]
    assert verdicts.axis[0] == 1
    assert verdicts.axis_ratio[0] == pytest.approx(4.0, rel=1e-9)  # 1.2 / 0.3, rounding
    assert verdicts.nonlinearity_deg[0] == pytest.approx(0.0, abs=1e-9)  # rounding
    assert verdicts.range_deg[0] == pytest.approx(0.5, abs=1e-12)  # the excursion made


def test_the_departure_is_that_of_a_parabola_from_its_line():
    verdicts = judge([0.02, 1.2, 0.3], [0.0, -1.6, 0.0])
    assert verdicts.deviation_at_0p5_deg_db[0] == pytest.approx(-1.6 * 0.25 / 4.0, abs=1e-9)  # rounding
    assert verdicts.nonlinearity_deg[0] == pytest.approx(0.1 / 1.2, abs=1e-9)  # rounding
    # range where the departure reaches the limit: q R^2 / 4 = 0.1 * 1.2, beyond the excursion
    assert verdicts.range_deg[0] == pytest.approx(0.5, abs=1e-12)
    assert verdicts.linear[0]


def test_a_bent_flat_carrier_is_not_linear_and_its_range_says_how_far():
    verdicts = judge([0.02, 0.5, 0.1], [0.0, -1.35, 0.0])
    assert not verdicts.linear[0]
    assert verdicts.range_deg[0] == pytest.approx(math.sqrt(4.0 * 0.1 * 0.5 / 1.35), rel=1e-6)  # rounding
    assert not (verdicts.stable & verdicts.linear & verdicts.dominant)[0]


def test_the_worse_side_counts():
    angle_deg = turn_plan()
    deviation_db = (1.2 * angle_deg[:, 1] - 4.0 * np.minimum(angle_deg[:, 1], 0.0) ** 2)[:, np.newaxis]
    fit = fit_turn_sensitivity(angle_deg, deviation_db)
    verdicts = judge_carriers(np.array([0.1]), angle_deg, deviation_db, fit.plus, fit.minus)
    assert verdicts.deviation_at_0p5_deg_db[0] == pytest.approx(-0.25, abs=1e-9)  # rounding
    assert not verdicts.linear[0]


@pytest.mark.parametrize(("rms_db", "is_stable"), [(0.25, True), (0.2501, False), (np.nan, False)])
def test_stability_is_the_residual_of_the_harmonic(rms_db, is_stable):
    assert judge([0.02, 1.2, 0.3], np.zeros(3), rms_db=rms_db).stable[0] == is_stable


@pytest.mark.parametrize(
    ("slopes", "axis", "is_dominant"),
    [
        ([0.02, 1.2, 0.3], 1, True),
        ([0.02, -0.3, -1.2], 2, True),
        ([0.3, 0.6, 0.6], 0, True),  # 8 * 0.3 against 0.6
        ([0.02, 1.0, 0.6], -1, False),
        ([0.1, 1.0, 0.1], -1, False),  # 8 * 0.1 against 1
    ],
)
def test_dominance_scales_yaw(slopes, axis, is_dominant):
    verdicts = judge(slopes, np.zeros(3))
    assert verdicts.axis[0] == axis
    assert verdicts.dominant[0] == is_dominant


def test_limits_are_settings():
    verdicts = judge([0.02, 1.0, 0.6], [0.0, -1.35, 0.0], dominance_ratio=1.5, max_nonlinearity_deg=0.05)
    assert verdicts.dominant[0]
    assert not verdicts.linear[0]
    assert judge([0.02, 1.0, 0.6], [0.0, -1.35, 0.0], linear_range_deg=0.3, max_nonlinearity_deg=0.05).linear[0]


@pytest.mark.parametrize(("noise_db", "block_db"), [(0.2, 0.0), (1.0, 0.0), (0.15, 0.1), (0.15, 0.3)])
def test_noise_alone_fails_no_straight_carrier(noise_db, block_db):
    slopes = np.tile([0.02, 0.9, 0.2], (400, 1))
    verdicts = judge(slopes, np.zeros((400, 3)), noise_db=noise_db, block_db=block_db, seed=5)
    # two sides at three standard errors with 38 degrees of freedom: 0.9 per cent if the limit were nought
    assert np.mean(~verdicts.linear) <= 0.01


def test_a_bend_stays_visible_through_the_noise_of_real_links():
    slopes, bends = np.tile([0.02, 0.8, 0.2], (200, 1)), np.tile([0.0, -6.0, 0.0], (200, 1))
    verdicts = judge(slopes, bends, noise_db=0.15, block_db=0.05, seed=6)
    assert np.mean(~verdicts.linear) > 0.75  # measured 0.84; four levels a side see no finer
    errors = (verdicts.nonlinearity_deg - 6.0 * 0.25 / 4.0 / 0.8) / verdicts.nonlinearity_sigma_deg
    assert np.abs(np.median(errors)) < 1.0  # the larger of two sides is biased upwards by less than one error


def test_what_was_not_turned_is_not_called_linear_or_dominant():
    angle_deg = turn_plan()
    angle_deg[:, 0] = 0.0
    verdicts = judge([0.02, 1.2, 0.3], np.zeros(3), angle_deg=angle_deg)
    assert (verdicts.linear[0], verdicts.dominant[0], verdicts.axis[0]) == (False, False, -1)
    figures = [verdicts.axis_ratio, verdicts.nonlinearity_deg, verdicts.range_deg, verdicts.deviation_at_0p5_deg_db]
    assert np.isnan(figures).all()


def test_a_side_of_the_main_axis_that_was_not_turned_leaves_linearity_open():
    angle_deg = turn_plan()
    angle_deg[:, 1] = np.abs(angle_deg[:, 1])
    verdicts = judge([0.02, 1.2, 0.3], np.zeros(3), angle_deg=angle_deg)
    assert not verdicts.linear[0]
    assert verdicts.dominant[0]
    assert np.isnan(verdicts.range_deg[0])


def test_a_carrier_without_any_answer_meets_nothing_but_stability():
    verdicts = judge(np.zeros(3), np.zeros(3))
    assert (verdicts.stable[0], verdicts.dominant[0]) == (True, False)
    assert not (verdicts.stable & verdicts.linear & verdicts.dominant)[0]
