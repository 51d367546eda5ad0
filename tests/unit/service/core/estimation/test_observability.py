"""Observability by carriers: bounds, sets of carriers and designs."""

import itertools
import math

import numpy as np
import pytest

from service.core.estimation.attitude_bound import DriftStatistics, WheelStatistics, attitude_bound_deg
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.estimation.design import choose_carriers, largest_share, weighted_variance_deg2
from service.core.estimation.filtering.filter_model import LearnedFeed, PolarimeterModel
from service.core.estimation.observability import (
    GATE_SIGMAS,
    angle_dilution_deg_per_db,
    averaged_crlb_deg,
    common_share,
    condition_number,
    crlb_deg,
    judge_set,
    normal_inverse,
)

RNG = np.random.default_rng(19)
SENSITIVITY = RNG.normal(0.0, [0.16, 1.4, 1.2], (16, 3))
SIGMA_DB = RNG.uniform(0.1, 0.3, 16)


def test_an_unbiased_fix_reaches_the_bound():
    root = np.linalg.qr(SENSITIVITY / SIGMA_DB[:, None])
    noise = np.random.default_rng(3).standard_normal((20_000, 16))
    errors_deg = np.linalg.solve(root.R, root.Q.T @ noise.T)
    # a standard deviation of 20 000 draws is good to 0.5 per cent; four of these
    np.testing.assert_allclose(errors_deg.std(axis=1), crlb_deg(SENSITIVITY, SIGMA_DB, with_common=False), rtol=0.02)


def test_absent_carriers_do_not_count():
    sensitivity, sigma_db = SENSITIVITY.copy(), SIGMA_DB.copy()
    sensitivity[0, 1], sigma_db[1], sigma_db[2] = np.nan, np.nan, 0.0
    expected = crlb_deg(SENSITIVITY[3:], SIGMA_DB[3:], with_common=True)
    np.testing.assert_allclose(crlb_deg(sensitivity, sigma_db, with_common=True), expected, rtol=1e-13)  # rounding
    assert condition_number(sensitivity) == condition_number(SENSITIVITY[1:])


@pytest.mark.parametrize(
    "sensitivity",
    [
        np.ones((2, 3)),  # two carriers
        np.outer(np.arange(1.0, 9.0), [1.0, 2.0, 3.0]),  # one mixture of angles
        np.column_stack([np.zeros(8), RNG.standard_normal((8, 2))]),  # yaw moves nothing
        np.full((8, 3), np.nan),
    ],
)
def test_what_cannot_be_observed_is_nan_and_infinitely_conditioned(sensitivity):
    assert np.isnan(crlb_deg(sensitivity, np.ones(len(sensitivity)), with_common=False)).all()
    assert math.isnan(angle_dilution_deg_per_db(sensitivity))
    assert math.isnan(common_share(sensitivity))
    assert condition_number(sensitivity) > 1e15
    assert np.isnan(judge_set(sensitivity, np.ones(len(sensitivity))).leverage).all()


def test_a_matrix_of_zeros_has_no_condition():
    assert condition_number(np.zeros((5, 3))) == math.inf


def test_the_share_of_a_common_change_lies_between_none_and_all():
    balanced = np.vstack([np.eye(3), -np.eye(3)])
    assert common_share(balanced) == pytest.approx(0.0, abs=1e-15)  # rounding
    one_sided = np.column_stack([np.ones(6), RNG.standard_normal((6, 2))])
    assert common_share(one_sided) == pytest.approx(1.0, abs=1e-12)  # rounding


def test_the_inverse_is_good_for_columns_of_any_unit():
    design = SENSITIVITY * [1e-6, 1.0, 1e6]
    expected = np.linalg.inv(SENSITIVITY.T @ SENSITIVITY) / np.outer([1e-6, 1.0, 1e6], [1e-6, 1.0, 1e6])
    np.testing.assert_allclose(normal_inverse(design), expected, rtol=1e-11)  # normal equations at a condition of 1e3


SLOPES = np.random.default_rng(3).normal(0.0, [0.12, 1.0, 0.8], (16, 3))
NOISE = ColouredNoise(np.full(16, 0.15), np.tile([0.08, 0.06], (16, 1)), np.tile([1200.0, 7200.0], (16, 1)))


@pytest.fixture(scope="module")
def powers_deg():
    return attitude_bound_deg(SLOPES, NOISE)


def with_wheels(*figures, **more):
    return attitude_bound_deg(SLOPES, NOISE, WheelStatistics(*figures, **more))


def test_wheels_without_momentum_along_pitch_tell_nothing(powers_deg):
    np.testing.assert_allclose(with_wheels(0.0), powers_deg, rtol=1e-9)


def test_momentum_halves_yaw_and_its_sign_does_not_matter(powers_deg):
    bound = with_wheels(8.0)
    assert bound[0] < 0.6 * powers_deg[0]
    assert (bound <= powers_deg).all()
    np.testing.assert_allclose(with_wheels(-8.0), bound, rtol=1e-6)


def test_more_momentum_less_noise_and_more_records_are_never_worse():
    yaw = [with_wheels(*figures)[0] for figures in ((50.0,), (8.0,), (8.0, 0.01, 3600.0), (8.0, 0.1, 3600.0))]
    assert yaw == sorted(yaw)
    assert with_wheels(8.0, torque_error_n_m=5e-8)[0] < yaw[1]


def test_a_still_spacecraft_is_known_to_the_noise_of_its_references():
    white = ColouredNoise(np.full(16, 0.15), np.zeros((16, 1)), np.ones((16, 1)))
    bound = attitude_bound_deg(SLOPES, white, None, DriftStatistics((1e-9, 1e-9, 1e-9)))
    assert (bound <= 0.011).all()


def test_a_polarimeter_along_yaw_helps_yaw_and_one_that_wanders_far_tells_nothing(powers_deg):
    ordinary, better, useless = (
        attitude_bound_deg(SLOPES, NOISE, polarimeters=(PolarimeterModel((1.0, 0.0, 0.0), *figures),))
        for figures in ((), (0.03, 0.02, 0.02), (0.07, 0.05, 100.0, 0.1))
    )
    assert better[0] < ordinary[0] < 0.8 * powers_deg[0]
    np.testing.assert_allclose(useless, powers_deg, rtol=1e-3)
    two = attitude_bound_deg(SLOPES, NOISE, polarimeters=(PolarimeterModel((1.0, 0.0, 0.0)),) * 2)
    assert better[0] < two[0] < ordinary[0]


def test_a_feed_that_quiet_days_know_is_a_better_polarimeter_and_one_they_do_not_know_the_same():
    unknown, known, still = (
        attitude_bound_deg(
            SLOPES,
            NOISE,
            polarimeters=(
                PolarimeterModel((1.0, 0.0, 0.0), learned=LearnedFeed((0.0, 0.0, 0.0), _diagonal(*variances))),
            ),
        )
        for variances in ((9.0, 0.05**2, 0.05**2), (4e-4, 7e-4, 7e-4), (4e-4, 1e-8, 1e-8))
    )
    free = attitude_bound_deg(SLOPES, NOISE, polarimeters=(PolarimeterModel((1.0, 0.0, 0.0)),))
    np.testing.assert_array_equal(unknown, free)
    assert still[0] < known[0] < 0.95 * free[0]


def _diagonal(*variances):
    return tuple(map(tuple, np.diag(variances).tolist()))


def test_a_rate_sensor_that_is_better_than_the_drift_helps_and_its_noise_does_not(powers_deg):
    quiet, noisy = (
        attitude_bound_deg(SLOPES, NOISE, drift=DriftStatistics((0.01, 0.01, 0.01), 8.0, walk)) for walk in (0.0, 0.05)
    )
    assert (quiet < powers_deg).all()
    assert (quiet < noisy).all()


def test_everything_together_is_better_than_each(powers_deg):
    read, sensor = (PolarimeterModel((0.99, -0.09, -0.13)),), DriftStatistics((0.01, 0.01, 0.01))
    together = attitude_bound_deg(SLOPES, NOISE, WheelStatistics(8.0), sensor, read)
    for alone in (with_wheels(8.0), attitude_bound_deg(SLOPES, NOISE, None, sensor, read)):
        assert together[0] < alone[0] < powers_deg[0]


SEED = 23
SET_RNG = np.random.default_rng(SEED)
SET_SLOPES = SET_RNG.normal(0.0, [0.16, 1.4, 1.2], (16, 3))
SET_SIGMA_DB = SET_RNG.uniform(0.1, 0.3, 16)
#: normal equations at a condition of 1e3 against QR
ROUNDING = 1e-9


def weighted_inverse(with_common=True):
    design = np.column_stack([SET_SLOPES, np.ones(16)]) if with_common else SET_SLOPES
    weighted = design / SET_SIGMA_DB[:, None]
    return design, np.linalg.inv(weighted.T @ weighted)


def test_figures_are_the_textbook_formulas():
    figures = judge_set(SET_SLOPES, SET_SIGMA_DB)
    design, inverse = weighted_inverse()
    plain = np.linalg.inv(SET_SLOPES.T @ SET_SLOPES)
    with_common = np.linalg.inv(design.T @ design)
    assert figures.crlb_deg == pytest.approx(np.sqrt(np.diag(inverse))[:3], rel=ROUNDING)
    assert figures.crlb_without_common_deg == pytest.approx(np.sqrt(np.diag(weighted_inverse(False)[1])), rel=ROUNDING)
    assert figures.dop_deg_per_db == pytest.approx(np.sqrt(np.diag(plain)), rel=ROUNDING)
    assert figures.dop_with_common_deg_per_db == pytest.approx(np.sqrt(np.diag(with_common))[:3], rel=ROUNDING)
    assert figures.angle_dop_deg_per_db == pytest.approx(np.linalg.det(plain) ** (1 / 6), rel=ROUNDING)
    assert figures.condition == pytest.approx(np.linalg.cond(SET_SLOPES), rel=ROUNDING)
    hat = design @ inverse @ design.T / SET_SIGMA_DB**2
    assert figures.leverage == pytest.approx(np.diag(hat), rel=ROUNDING)
    ones = np.ones(16)
    fitted = SET_SLOPES @ (plain @ SET_SLOPES.T @ ones)
    assert figures.common_share == pytest.approx(fitted @ fitted / 16.0, rel=ROUNDING)
    assert figures.redundancy == 11


@pytest.mark.parametrize("carrier", [0, 7, 15])
def test_largest_undetectable_fault_is_seen_in_nine_rows_of_ten(carrier):
    """Rows with the fault, solved by weighted least squares: share beyond the gate, and what the fix takes."""
    rows, rng = 20_000, np.random.default_rng(SEED + carrier)
    figures = judge_set(SET_SLOPES, SET_SIGMA_DB)
    design, inverse = weighted_inverse()
    deviation = rng.normal(0.0, SET_SIGMA_DB, (rows, 16))
    deviation[:, carrier] += figures.undetectable_fault_db[carrier]
    solved = deviation / SET_SIGMA_DB**2 @ design @ inverse
    residual = deviation - solved @ design.T
    seen = np.mean(residual[:, carrier] > GATE_SIGMAS * SET_SIGMA_DB[carrier])
    # binomial: sqrt(0.9 0.1 / 20000) = 0.0021; four of these
    assert seen == pytest.approx(0.9, abs=0.0085)
    # mean of 20 000 fixes: bound / 141; five of these
    assert solved[:, :3].mean(axis=0) == pytest.approx(
        figures.fault_shift_deg[carrier], abs=5.0 * float(figures.crlb_deg.max()) / math.sqrt(rows)
    )


def test_what_is_not_determined_is_nan():
    """Three carriers, and sixteen that answer to one mixture: nothing is told but the condition."""
    for sensitivity in (SET_SLOPES[:3], np.outer(np.arange(1.0, 17.0), [0.1, 1.0, 2.0])):
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
    sensitivity = np.vstack([SET_SLOPES, [[np.nan, 1.0, 1.0], [0.1, 1.0, 1.0]]])
    sigma = np.append(SET_SIGMA_DB, [0.1, np.nan])
    figures, expected = judge_set(sensitivity, sigma), judge_set(SET_SLOPES, SET_SIGMA_DB)
    assert figures.crlb_deg == pytest.approx(expected.crlb_deg, rel=1e-12)  # rounding
    assert np.isnan(figures.leverage[16:]).all()
    assert np.isnan(figures.undetectable_fault_db[16:]).all()
    assert figures.redundancy == expected.redundancy


def test_a_carrier_that_nothing_checks_hides_any_fault():
    """Yaw is seen by the first carrier alone: no fault of it shows, and yaw takes all of it."""
    sensitivity = SET_SLOPES.copy()
    sensitivity[1:, 0] = 0.0
    figures = judge_set(sensitivity, SET_SIGMA_DB)
    assert figures.leverage[0] == pytest.approx(1.0, abs=1e-9)  # rounding
    assert figures.undetectable_fault_db[0] == math.inf
    assert abs(figures.fault_shift_deg[0, 0]) == math.inf


def test_averages_follow_the_closed_form():
    """White noise shrinks with the rows, correlated noise by 2 (x - 1 + exp -x) / x^2."""
    count, span_s = 16, np.array([900.0, 3600.0, 14_400.0, 43_200.0])
    noise = ColouredNoise(
        np.full(count, 0.155), np.tile([0.09, 0.05], (count, 1)), np.tile([1200.0, 36_000.0], (count, 1))
    )
    reported = averaged_crlb_deg(SET_SLOPES, noise, span_s, 60.0)
    dop = judge_set(SET_SLOPES, np.ones(count)).crlb_deg
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
    design = np.column_stack([SET_SLOPES, np.ones(16)])
    solved = mean @ np.linalg.pinv(design).T
    noise = ColouredNoise(np.full(16, 0.155), np.full((16, 1), 0.09), np.full((16, 1), 1200.0))
    reported = averaged_crlb_deg(SET_SLOPES, noise, np.array([3600.0]), 60.0)[0]
    # a standard deviation of 4000 draws is good to 1.1 %; sixty samples against the continuous form differ by 1 %
    assert solved[:, :3].std(axis=0) == pytest.approx(reported, rel=0.05)


DESIGN_SEED = 41


def stations(count, seed=DESIGN_SEED):
    return np.random.default_rng(seed).normal(0.0, [0.16, 1.4, 1.2], (count, 3))


def cost_of(sensitivity, chosen):
    bound = crlb_deg(sensitivity[list(chosen)], np.full(len(chosen), 0.1), with_common=True)
    return float(weighted_variance_deg2(bound))


@pytest.mark.parametrize("seed", range(5))
def test_exchange_is_within_three_per_cent_of_the_best_subset(seed):
    """All 1287 choices of 8 out of 13; exchange ends at a local optimum, which may lie a little above."""
    sensitivity = stations(13, seed)
    best = min(cost_of(sensitivity, chosen) for chosen in itertools.combinations(range(13), 8))
    assert cost_of(sensitivity, choose_carriers(sensitivity, np.full(13, 0.1), np.arange(13), 8)) <= 1.03 * best


def test_choice_beats_chance():
    """16 of 40: roll and pitch bounds below the median of random choices by 20 % (section 3: 35 %)."""
    sensitivity, rng = stations(40), np.random.default_rng(DESIGN_SEED)
    chosen = choose_carriers(sensitivity, np.full(40, 0.1), np.arange(40) % 8, 16)
    figures = judge_set(sensitivity[chosen], np.full(16, 0.1))
    random = [
        crlb_deg(sensitivity[rng.choice(40, 16, replace=False)], np.full(16, 0.1), with_common=True) for _ in range(200)
    ]
    median = np.median(random, axis=0)
    assert (figures.crlb_deg[1:] < 0.8 * median[1:]).all()
    assert figures.redundancy == 11


def test_what_may_not_be_chosen_is_not():
    """NaN, a sigma of zero, and carriers that are not eligible; fewer than asked for is told."""
    sensitivity, sigma = stations(12), np.full(12, 0.1)
    sensitivity[0, 0], sigma[1] = np.nan, 0.0
    eligible = np.ones(12, dtype=bool)
    eligible[2] = False
    chosen = choose_carriers(sensitivity, sigma, np.arange(12), 12, eligible=eligible)
    assert chosen.tolist() == list(range(3, 12))


def test_nothing_to_choose():
    """No carrier gives an empty choice."""
    assert choose_carriers(np.full((3, 3), np.nan), np.full(3, 0.1), np.arange(3), 3).size == 0


def test_share_that_the_plan_cannot_keep_is_exceeded_as_little_as_possible():
    """Two transponders of ten: 35 % of 12 are 4 each, so 6 and 6 are taken, and it is told."""
    sensitivity = stations(20)
    sensitivity[:10] *= 3.0
    transponder = np.repeat([0, 1], 10)
    chosen = choose_carriers(sensitivity, np.full(20, 0.1), transponder, 12)
    assert np.bincount(transponder[chosen]).tolist() == [6, 6]
    assert largest_share(transponder[chosen]) == 0.5


def test_noisy_carriers_are_left_out_and_weigh_little():
    """Two copies of each carrier, one ten times noisier: the quiet copies are taken."""
    sensitivity, sigma = np.repeat(stations(12), 2, axis=0), np.tile([0.1, 1.0], 12)
    assert choose_carriers(sensitivity, sigma, np.arange(24), 12).tolist() == list(range(0, 24, 2))
    leverage = judge_set(sensitivity, sigma).leverage
    # leverages go as the weights: a hundredth
    assert leverage[1::2] == pytest.approx(leverage[::2] / 100.0, rel=1e-9)


def test_hundreds_of_carriers_are_chosen_without_delay():
    """256 of 512 took 20 s with a matrix inverse for each exchange; a term of rank two takes 0.3 s."""
    sensitivity = stations(512)
    assert len(choose_carriers(sensitivity, np.full(512, 0.1), np.arange(512) % 9, 256)) == 256
