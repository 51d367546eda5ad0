"""Figures of a set against formulas written out, against brute force and against draws."""

import itertools
import math

import numpy as np
import pytest

from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.core.estimation.carrier_sets import averaged_crlb_deg, judge_set
from service.core.estimation.snapshot.fault_bounds import GATE_SIGMAS

SEED = 23
RNG = np.random.default_rng(SEED)
SENSITIVITY = RNG.normal(0.0, [0.16, 1.4, 1.2], (16, 3))
SIGMA_DB = RNG.uniform(0.1, 0.3, 16)
#: normal equations at a condition of 1e3 against QR
ROUNDING = 1e-9


def weighted_inverse(with_common=True):
    design = np.column_stack([SENSITIVITY, np.ones(16)]) if with_common else SENSITIVITY
    weighted = design / SIGMA_DB[:, None]
    return design, np.linalg.inv(weighted.T @ weighted)


def test_figures_are_the_textbook_formulas():
    figures = judge_set(SENSITIVITY, SIGMA_DB)
    design, inverse = weighted_inverse()
    plain = np.linalg.inv(SENSITIVITY.T @ SENSITIVITY)
    with_common = np.linalg.inv(design.T @ design)
    print(f"seed {SEED}: {figures}")
    assert figures.crlb_deg == pytest.approx(np.sqrt(np.diag(inverse))[:3], rel=ROUNDING)
    assert figures.crlb_without_common_deg == pytest.approx(np.sqrt(np.diag(weighted_inverse(False)[1])), rel=ROUNDING)
    assert figures.dop_deg_per_db == pytest.approx(np.sqrt(np.diag(plain)), rel=ROUNDING)
    assert figures.dop_with_common_deg_per_db == pytest.approx(np.sqrt(np.diag(with_common))[:3], rel=ROUNDING)
    assert figures.angle_dop_deg_per_db == pytest.approx(np.linalg.det(plain) ** (1 / 6), rel=ROUNDING)
    assert figures.condition == pytest.approx(np.linalg.cond(SENSITIVITY), rel=ROUNDING)
    hat = design @ inverse @ design.T / SIGMA_DB**2
    assert figures.leverage == pytest.approx(np.diag(hat), rel=ROUNDING)
    ones = np.ones(16)
    fitted = SENSITIVITY @ (plain @ SENSITIVITY.T @ ones)
    assert figures.common_share == pytest.approx(fitted @ fitted / 16.0, rel=ROUNDING)
    assert figures.redundancy == 11


def test_the_determinant_is_that_of_all_triples():
    """Cauchy and Binet: det A'A is the sum over all choices of three carriers of their determinants squared."""
    total = sum(np.linalg.det(SENSITIVITY[list(three)]) ** 2 for three in itertools.combinations(range(16), 3))
    assert judge_set(SENSITIVITY, SIGMA_DB).angle_dop_deg_per_db == pytest.approx(total ** (-1 / 6), rel=ROUNDING)


@pytest.mark.parametrize("carrier", [0, 7, 15])
def test_largest_undetectable_fault_is_seen_in_nine_rows_of_ten(carrier):
    """Rows with the fault, solved by weighted least squares: share beyond the gate, and what the fix takes."""
    rows, rng = 20_000, np.random.default_rng(SEED + carrier)
    figures = judge_set(SENSITIVITY, SIGMA_DB)
    design, inverse = weighted_inverse()
    deviation = rng.normal(0.0, SIGMA_DB, (rows, 16))
    deviation[:, carrier] += figures.undetectable_fault_db[carrier]
    solved = deviation / SIGMA_DB**2 @ design @ inverse
    residual = deviation - solved @ design.T
    seen = np.mean(residual[:, carrier] > GATE_SIGMAS * SIGMA_DB[carrier])
    print(f"seed {SEED + carrier}: seen {seen:.4f}, shift {solved[:, :3].mean(axis=0)}")
    # binomial: sqrt(0.9 0.1 / 20000) = 0.0021; four of these
    assert seen == pytest.approx(0.9, abs=0.0085)
    # mean of 20 000 fixes: bound / 141; five of these
    assert solved[:, :3].mean(axis=0) == pytest.approx(
        figures.fault_shift_deg[carrier], abs=5.0 * float(figures.crlb_deg.max()) / math.sqrt(rows)
    )


def test_what_is_not_determined_is_nan():
    """Three carriers, and sixteen that answer to one mixture: nothing is told but the condition."""
    for sensitivity in (SENSITIVITY[:3], np.outer(np.arange(1.0, 17.0), [0.1, 1.0, 2.0])):
        figures = judge_set(sensitivity, np.full(len(sensitivity), 0.1))
        assert np.isnan(figures.crlb_deg).all()
        assert np.isnan(figures.leverage).all()
        assert np.isnan(figures.undetectable_fault_db).all()
        assert np.isnan(figures.fault_shift_deg).all()


def test_no_carriers():
    figures = judge_set(np.empty((0, 3)), np.empty(0))
    assert figures.condition == math.inf
    assert np.isnan(figures.crlb_deg).all()
    assert figures.leverage.shape == figures.undetectable_fault_db.shape == (0,)
    assert figures.redundancy == -5


def test_absent_carriers_change_nothing():
    sensitivity = np.vstack([SENSITIVITY, [[np.nan, 1.0, 1.0], [0.1, 1.0, 1.0]]])
    sigma = np.append(SIGMA_DB, [0.1, np.nan])
    figures, expected = judge_set(sensitivity, sigma), judge_set(SENSITIVITY, SIGMA_DB)
    assert figures.crlb_deg == pytest.approx(expected.crlb_deg, rel=1e-12)  # rounding
    assert np.isnan(figures.leverage[16:]).all()
    assert np.isnan(figures.undetectable_fault_db[16:]).all()
    assert figures.redundancy == expected.redundancy


def test_a_carrier_that_nothing_checks_hides_any_fault():
    """Yaw is seen by the first carrier alone: no fault of it shows, and yaw takes all of it."""
    sensitivity = SENSITIVITY.copy()
    sensitivity[1:, 0] = 0.0
    figures = judge_set(sensitivity, SIGMA_DB)
    assert figures.leverage[0] == pytest.approx(1.0, abs=1e-9)  # rounding
    assert figures.undetectable_fault_db[0] == math.inf
    assert abs(figures.fault_shift_deg[0, 0]) == math.inf


def test_averages_follow_the_closed_form():
    """White noise shrinks with the rows, correlated noise by 2 (x - 1 + exp -x) / x^2."""
    count, span_s = 16, np.array([900.0, 3600.0, 14_400.0, 43_200.0])
    noise = ColouredNoise(
        np.full(count, 0.155), np.tile([0.09, 0.05], (count, 1)), np.tile([1200.0, 36_000.0], (count, 1))
    )
    reported = averaged_crlb_deg(SENSITIVITY, noise, span_s, 60.0)
    dop = judge_set(SENSITIVITY, np.ones(count)).crlb_deg
    for row, span in zip(reported, span_s, strict=True):
        variance = 0.155**2 / (span / 60.0)
        for sigma, tau in ((0.09, 1200.0), (0.05, 36_000.0)):
            x = span / tau
            variance += sigma**2 * 2.0 * (x - 1.0 + math.exp(-x)) / x**2
        assert row == pytest.approx(dop * math.sqrt(variance), rel=1e-9)  # rounding


def test_an_average_of_drawn_noise_has_the_spread_told():
    """One hour of rows a minute apart, white and AR(1): empirical spread of the fix over 4000 hours."""
    hours, rows, rng = 4000, 60, np.random.default_rng(SEED)
    keep = math.exp(-60.0 / 1200.0)
    wander = np.empty((hours, rows, 16))
    wander[:, 0] = rng.normal(0.0, 0.09, (hours, 16))
    for k in range(1, rows):
        wander[:, k] = keep * wander[:, k - 1] + rng.normal(0.0, 0.09 * math.sqrt(1.0 - keep**2), (hours, 16))
    mean = wander.mean(axis=1) + rng.normal(0.0, 0.155 / math.sqrt(rows), (hours, 16))
    design = np.column_stack([SENSITIVITY, np.ones(16)])
    solved = mean @ np.linalg.pinv(design).T
    noise = ColouredNoise(np.full(16, 0.155), np.full((16, 1), 0.09), np.full((16, 1), 1200.0))
    reported = averaged_crlb_deg(SENSITIVITY, noise, np.array([3600.0]), 60.0)[0]
    print(f"seed {SEED}: {solved[:, :3].std(axis=0)} against {reported}")
    # a standard deviation of 4000 draws is good to 1.1 %; sixty samples against the continuous form differ by 1 %
    assert solved[:, :3].std(axis=0) == pytest.approx(reported, rel=0.05)
