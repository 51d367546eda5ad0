"""Rows, bins and fits of a calibration."""

import math

import numpy as np
import pytest

from service.core.estimation.calibration.calibration_bins import (
    SEGMENT_PENALTY,
    reading_sigma_deg,
    segment_starts,
    smoothed_angles,
    still_stretches,
    stretch_means,
)
from service.core.estimation.calibration.geometry_columns import daily_columns
from service.core.estimation.calibration.joint_tukey import fit_daily, fit_separable
from service.core.estimation.calibration.responses import gathered_torque
from service.core.estimation.calibration.whitened_fit import ColouredNoise, stretch_variance_db2, whitened_rows
from service.core.estimation.design import FAR_YAW_DEG, recommended_turns
from service.core.estimation.filtering.filter_model import FilterSettings, MomentumModel

SEED = 31
ROWS = 1440
PHASE = np.linspace(0.0, 6.0 * np.pi, ROWS, endpoint=False)
TRUTH = np.array([-45.0, 0.3, 0.1, -0.05, 0.08])
SIGMA_DB = 0.15


def powers(carriers=4, seed=SEED, sigma_db=SIGMA_DB):
    columns = daily_columns(None, PHASE, carriers)
    noise = np.random.default_rng(seed).normal(0.0, sigma_db, (ROWS, carriers))
    return columns, TRUTH[0] + columns @ TRUTH[1:] + noise


def test_noise_free_powers_give_the_truth():
    fits = fit_daily(*powers(sigma_db=0.0))
    assert fits.coefficients == pytest.approx(np.tile(TRUTH, (4, 1)), abs=1e-9)  # rounding of 45 dBm
    assert fits.converged.all()


@pytest.mark.parametrize("share", [0.1, 0.2, 0.45])
@pytest.mark.parametrize("size_db", [1.5, 3.0])
def test_blocks_of_wrong_samples_move_it_by_less_than_three_hundredths(share, size_db):
    """Acceptance test 2: block outliers of 3 dB in up to 45 % of the samples: dh, dam <= 0.03."""
    columns, power = powers(8)
    begin, wrong = int(0.2 * ROWS), round(share * ROWS)
    power[begin : begin + wrong] -= size_db
    fits = fit_daily(columns, power)
    error = np.abs(fits.coefficients - TRUTH)
    amplitude = np.hypot(fits.coefficients[:, 1], fits.coefficients[:, 2])
    # the bound of the acceptance test is for the level and amplitude of 1440 samples; 792 good ones are left at worst:
    # five sigma of a coefficient of them is 0.15 sqrt(2 / 792) 5 = 0.038
    assert error[:, 0].max() <= 0.03
    assert np.abs(amplitude - math.hypot(0.3, 0.1)).max() <= 0.038
    assert (fits.samples_rejected >= wrong).all()
    assert (fits.samples_rejected <= wrong + 0.01 * ROWS).all()
    # a spread of 792 samples is good to 2.5 %; four of these
    assert fits.rms_db == pytest.approx(np.full(8, SIGMA_DB), rel=0.1)


def test_the_covariance_is_that_of_the_errors():
    columns, power = powers(100, seed=SEED + 1)
    fits = fit_daily(columns, power)
    errors = fits.coefficients - TRUTH
    ratio = np.sqrt(np.mean(errors**2, axis=0) / np.mean(np.diagonal(fits.covariance, axis1=1, axis2=2), axis=0))
    # a spread of 100 draws is good to 7 %; four of these
    assert ratio == pytest.approx(np.ones(5), abs=0.28)
    # Tukey's function at 4.685 costs five per cent of variance against least squares on normal noise: of all five
    # coefficients together, 500 draws, good to 6 %
    design = np.column_stack([np.ones(ROWS), columns[:, 0]])
    least = SIGMA_DB**2 * np.diag(np.linalg.inv(design.T @ design))
    assert np.mean(errors**2 / least) < 1.05 * 1.25


def test_what_cannot_be_fitted_is_nan():
    columns, power = powers(3)
    power[:, 0] = np.nan
    power[19:, 1] = np.nan
    columns[:, 2] = np.nan
    fits = fit_daily(columns, power)
    assert np.isnan(fits.coefficients).all()
    assert np.isnan(fits.covariance).all()
    assert fits.samples_used.tolist() == fits.samples_rejected.tolist() == [0, 0, 0]
    assert not fits.converged.any()


def test_no_rows_and_no_carriers():
    assert np.isnan(fit_daily(np.empty((0, 2, 4)), np.empty((0, 2))).coefficients).all()
    assert fit_daily(np.empty((9, 0, 4)), np.empty((9, 0))).coefficients.shape == (0, 5)


def test_a_constant_power_is_fitted_exactly():
    """No scatter at all: the scale is zero and nothing is thrown away for rounding."""
    columns = daily_columns(None, PHASE, 1)
    fits = fit_daily(columns, np.full((ROWS, 1), -40.0))
    assert fits.coefficients[0] == pytest.approx([-40.0, 0.0, 0.0, 0.0, 0.0], abs=1e-12)  # rounding
    assert fits.samples_used[0] == ROWS


NOISE = ColouredNoise(np.array([0.15, 0.1]), np.array([[0.09, 0.2], [0.0, 0.0]]), np.array([[1200.0, 9e3], [1.0, 1.0]]))
CENTRE_S = np.arange(40) * 600.0
COUNT = np.full((2, 40), 10.0)


def covariance(carrier):
    variance = stretch_variance_db2(NOISE, COUNT, np.full(40, 600.0))[carrier]
    lag = np.abs(CENTRE_S[:, None] - CENTRE_S)
    apart = sum(s**2 * np.exp(-lag / t) for s, t in zip(NOISE.sigma_db[carrier], NOISE.tau_s[carrier], strict=True))
    return np.where(np.eye(40) > 0, np.diag(variance), apart)


def test_variance_of_a_mean_is_that_of_the_closed_form():
    """White part over ten, coloured parts nearly whole."""
    variance = stretch_variance_db2(NOISE, COUNT, np.full(40, 600.0))
    x = 600.0 / np.array([1200.0, 9e3])
    kept = 2.0 * (x - 1.0 + np.exp(-x)) / x**2
    assert variance[0, 0] == pytest.approx(0.15**2 / 10 + kept @ np.array([0.09, 0.2]) ** 2, rel=1e-12)
    assert variance[1, 0] == pytest.approx(0.1**2 / 10, rel=1e-12)


@pytest.mark.parametrize("carrier", [0, 1])
def test_whitened_rows_are_independent(carrier):
    """Whitening the identity gives W with W C W' = 1."""
    variance = stretch_variance_db2(NOISE, COUNT, np.full(40, 600.0))
    rows = np.tile(np.eye(40), (2, 1, 1))
    white = whitened_rows(rows, CENTRE_S, variance, NOISE, np.ones((2, 40)))[carrier]
    assert white @ covariance(carrier) @ white.T == pytest.approx(np.eye(40), abs=1e-10)  # rounding


def test_rows_without_weight_or_samples_vanish_and_leave_the_others_alone():
    """An outlier and an absent stretch are zero; the rest is as if they had never been."""
    count, weight = COUNT.copy(), np.ones((2, 40))
    count[0, 3], weight[0, 7] = 0.0, 0.0
    variance = stretch_variance_db2(NOISE, count, np.full(40, 600.0))
    white = whitened_rows(np.tile(np.eye(40), (2, 1, 1)), CENTRE_S, variance, NOISE, weight)[0]
    left = np.setdiff1d(np.arange(40), [3, 7])
    assert not white[[3, 7]].any()
    part = covariance(0)[np.ix_(left, left)]
    assert white[np.ix_(left, left)] @ part @ white[np.ix_(left, left)].T == pytest.approx(np.eye(38), abs=1e-10)


FIT_SEED = 3


def problem():
    rng = np.random.default_rng(FIT_SEED)
    own, shared = rng.normal(size=(4, 30, 3)), rng.normal(size=(4, 30, 2))
    return own, shared, rng.normal(size=(4, 30))


def dense(own, shared, values, own_prior, shared_prior):
    """Coefficients and covariance of the joint system with its prior rows."""
    carriers, rows, size = own.shape
    big = np.zeros((carriers * rows, carriers * size + shared.shape[2]))
    for k in range(carriers):
        big[k * rows : (k + 1) * rows, k * size : (k + 1) * size] = own[k]
        big[k * rows : (k + 1) * rows, carriers * size :] = shared[k]
    prior = np.diag(1.0 / np.append(own_prior.ravel(), np.full(shared.shape[2], shared_prior)))
    full = np.concatenate([big, prior])
    covariance = np.linalg.inv(full.T @ full)
    return covariance @ full.T @ np.append(values.ravel(), np.zeros(len(prior))), covariance


def test_elimination_is_the_dense_solution():
    """Coefficients, covariances and the correlation through the shared ones."""
    own, shared, values = problem()
    prior = np.full((4, 3), 2.0)
    fit = fit_separable(own, shared, values, prior, 0.5)
    solution, covariance = dense(own, shared, values, prior, 0.5)
    # rounding of a well conditioned system of 14 unknowns
    assert fit.own.ravel() == pytest.approx(solution[:12], abs=1e-11)
    assert fit.shared == pytest.approx(solution[12:], abs=1e-11)
    assert fit.shared_covariance == pytest.approx(covariance[12:, 12:], abs=1e-11)
    assert fit.own_covariance[1] == pytest.approx(covariance[3:6, 3:6], abs=1e-11)
    between = fit.gain[0] @ fit.shared_covariance @ fit.gain[2].T
    assert between == pytest.approx(covariance[:3, 6:9], abs=1e-11)


BINS_SEED = 4


def test_stretches_end_with_time_and_with_every_axis():
    """600 s, and 0.06 deg of roll or pitch, and 0.12 deg of yaw."""
    epoch_s = np.arange(40) * 60.0
    angles = np.zeros((40, 3))
    angles[10:, 1], angles[15:, 2], angles[18:, 0] = 0.07, -0.07, 0.13
    stretches = still_stretches(epoch_s, angles, 600.0)
    assert stretches.rows[:, 0].tolist() == [0, 10, 15, 18, 28, 38]
    assert stretches.is_filled.sum(axis=1).tolist() == [10, 5, 3, 10, 10, 2]


def test_rows_without_attitude_belong_to_none():
    """NaN in one angle leaves the row out; without any row there is no stretch."""
    angles = np.zeros((5, 3))
    angles[2, 1] = np.nan
    stretches = still_stretches(np.arange(5) * 60.0, angles, 600.0)
    assert stretches.rows[stretches.is_filled].tolist() == [0, 1, 3, 4]
    nothing = still_stretches(np.arange(5.0), np.full((5, 3), np.nan), 600.0)
    assert nothing.rows.shape == (1, 1)
    assert not nothing.is_filled.any()


def test_means_skip_absent_samples_and_impulses():
    """Powers and columns are averaged over the very same samples."""
    rng = np.random.default_rng(BINS_SEED)
    power = 0.1 * rng.normal(size=(100, 2))
    power[3, 0], power[4, 0], power[10:20, 1] = 9.0, np.nan, np.nan
    columns = np.repeat(np.arange(100.0)[:, None, None], 2, axis=1)
    stretches = still_stretches(np.arange(100) * 60.0, np.zeros((100, 3)), 600.0)
    means = stretch_means(stretches, power, columns)
    kept = [0, 1, 2, 5, 6, 7, 8, 9]
    assert means.power_db[0, 0] == pytest.approx(power[kept, 0].mean(), abs=1e-12)  # rounding
    assert means.columns[0, 0, 0] == pytest.approx(np.mean(kept), abs=1e-12)  # rounding
    assert means.rows_used[:, 1].tolist() == [10, 0]
    assert means.power_db[1, 1] == 0.0
    assert not means.is_kept[[3, 4], 0].any()
    # 90 samples: 1.5 sigma of a MAD is 0.1 * 1.17 * 1.5 / sqrt(90), three times that
    assert means.white_db == pytest.approx([0.1, 0.1], abs=0.04)


def test_a_sample_of_an_unknown_orbit_is_absent():
    """Columns with NaN take their sample out."""
    columns = np.ones((4, 1, 2))
    columns[1, 0, 1] = np.nan
    stretches = still_stretches(np.arange(4) * 60.0, np.zeros((4, 3)), 600.0)
    means = stretch_means(stretches, np.ones((4, 1)), columns)
    assert means.rows_used.tolist() == [[3]]
    assert means.white_db.tolist() == [0.0]


def test_turns_cover_both_signs_of_every_axis_and_all_corners():
    """8.5 hours; far yaw doubles the yaw levels only."""
    turns, far = recommended_turns(), recommended_turns(far_yaw=True)
    angles = np.array([turn.attitude_deg for turn in turns])
    assert sum(turn.minutes for turn in turns) == 510.0
    for axis in range(3):
        assert {-0.5, 0.5} <= set(angles[:, axis])
    corners = {tuple(row) for row in angles if np.count_nonzero(row) == 3}
    assert len(corners) == 8
    changes = np.diff([row for row in angles if np.count_nonzero(row) == 3], axis=0)
    assert (np.count_nonzero(changes, axis=1) == 1).all()
    assert max(turn.attitude_deg[0] for turn in far) == FAR_YAW_DEG
    assert np.array([turn.attitude_deg for turn in far])[:, 1:] == pytest.approx(angles[:, 1:], abs=0.0)


INERTIA = np.array([2600.0, 2600.0, 1400.0])
SETTINGS = FilterSettings(
    momentum=MomentumModel(0.01, 0.005, 0.05, (2600.0, 2600.0, 1400.0), unknown_torque_deg_h2=(5.7, 5.7, 10.6))
)
#: constant, cosine, sine, each yaw, roll, pitch, N m; misalignment of roll and yaw, deg; scales
TRUE_TORQUE = np.array([4e-6, -3e-6, 5e-6, 8e-6, 2e-6, -6e-6, -3e-6, 9e-6, 4e-6, 0.04, -0.03, 0.003, -0.004])
START_US, STEP_US = 1_793_491_200_000_000, 300_000_000
ORBIT_RAD_S, DAY_RAD_S = 7.292115e-5, 2.0 * np.pi / 86_400.0
#: of the integration: Euler's error of three days is a tenth of a record's noise
_STEP_S = 20
#: momentum that an unloading takes away, N m s along roll, pitch, yaw
UNLOADED = np.array([0.8, -0.1, -1.1])


def acceleration_scale():
    """Return the factors of the thirteen from N m to deg/h^2."""
    return np.concatenate([np.tile(np.degrees(3600.0**2 / INERTIA), 3), np.ones(4)])


def flown(seed, hours=72.0, unloaded_h=None):
    """Return epochs, records, sensor angles and their noise of a spacecraft integrated in short steps."""
    rng = np.random.default_rng(seed)
    constant, cosine, sine = TRUE_TORQUE[:9].reshape(3, 3)[:, [1, 2, 0]]
    (bx, bz), (sx, sz) = np.radians(TRUE_TORQUE[9:11]), TRUE_TORQUE[11:]
    momentum, epochs, records, angles = np.array([0.3, -8.0, -0.5]), [], [], []
    count = round(hours * 12.0)
    wander = np.cumsum(rng.normal(0.0, 0.002, (count, 3)), axis=0) * 0.3
    for k in range(count):
        epoch_us = START_US + k * STEP_US
        if unloaded_h is not None and k == round(unloaded_h * 12.0):
            momentum = momentum - UNLOADED
        yaw, roll, pitch = np.radians(wander[k])
        x, y, z = momentum
        whole = y - INERTIA[2] * ORBIT_RAD_S
        seen = [x + whole * (yaw + bx) - z * pitch, y + z * roll - x * yaw, z - whole * (roll + bz) + x * pitch]
        record = np.array([1.0 + sx, 1.0, 1.0 + sz]) * seen + rng.normal(0.0, 0.01, 3)
        epochs.append(epoch_us)
        records.append(record)
        angles.append(wander[k] + rng.normal(0.0, 0.01, 3))
        for second in range(0, 300, _STEP_S):
            phase = DAY_RAD_S * ((epoch_us / 1e6 + second + 0.5 * _STEP_S) % 86_400.0)
            torque = constant + cosine * np.cos(phase) + sine * np.sin(phase)
            turned = ORBIT_RAD_S * np.array([momentum[2], 0.0, -momentum[0]])
            momentum = momentum + _STEP_S * (turned + torque) + rng.normal(0.0, 2e-5 * np.sqrt(_STEP_S), 3)
    return np.array(epochs), np.array(records), np.array(angles), np.full(3, 0.01)


def learned(epochs, records, angles, sigma, unloading=None):
    marked = np.zeros(len(epochs), dtype=np.bool_) if unloading is None else unloading
    return gathered_torque(epochs, records, angles, sigma, marked, SETTINGS)


def chi_square(found):
    off = found.mean - acceleration_scale() * TRUE_TORQUE
    return float(off @ np.linalg.solve(found.covariance, off))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("unloaded_h", [None, 31.0])
@pytest.mark.parametrize("is_marked", [True, False])
def test_the_torque_is_found_within_its_covariance(seed, unloaded_h, *, is_marked):
    epochs, records, angles, sigma = flown(seed, unloaded_h=unloaded_h)
    unloading = np.zeros(len(epochs), dtype=np.bool_)
    if unloaded_h is not None:
        unloading[round(unloaded_h * 12.0)] = is_marked
    found = learned(epochs, records, angles, sigma, unloading)
    # thirteen degrees of freedom exceed 34.5 once in a thousand
    assert chi_square(found) < 34.5
    # the wave is known to a few per cent of 1e-5 N m, which without records is 1.4e-5
    sigma_n_m = np.sqrt(np.diag(found.covariance))[3:9] / acceleration_scale()[3:9]
    assert (sigma_n_m < 5e-7).all()


def test_two_hours_tell_little_and_say_so():
    found = learned(*flown(4, hours=2.0))
    assert chi_square(found) < 34.5
    prior = np.array([5.7, 5.7, 10.6]) * np.sqrt(0.5)
    assert (np.sqrt(np.diag(found.covariance))[3:6] > 0.3 * prior).all()


def test_records_of_another_spacecraft_in_between_tell_nothing():
    epochs, records, angles, sigma = flown(5)
    mixed = records.copy()
    mixed[::2] = records[::2] @ np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    assert learned(epochs, mixed, angles, sigma) is None


def test_rows_without_angles_take_no_part():
    epochs, records, angles, sigma = flown(6, hours=24.0)
    blind = angles.copy()
    blind[::2] = np.nan
    some, fewer = learned(epochs, records, blind, sigma), learned(epochs[1::2], records[1::2], angles[1::2], sigma)
    np.testing.assert_array_equal(some.mean, fewer.mean)
    assert some.records == len(epochs) // 2


def test_settings_without_wheels_are_refused():
    with pytest.raises(ValueError, match="momentum of wheels"):
        gathered_torque(
            *(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(3)),
            np.zeros(0, dtype=np.bool_),
            FilterSettings(),
        )


def turned(seed, sigma_deg):
    """Return times, truth and readings (T, 3): a quiet day of slow motion and turns of 15 min."""
    rng = np.random.default_rng(seed)
    truth = 0.04 * np.sin(np.arange(1800)[:, None] / np.array([150.0, 120.0, 140.0]))
    for number, size in enumerate((0.25, 0.5, -0.25, -0.5)):
        begin = 1500 + 25 * number
        truth[begin : begin + 15, 1] += size
    return np.arange(1800) * 60.0, truth, truth + sigma_deg * rng.normal(size=truth.shape)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("sigma_deg", [0.03, 0.06, 0.1])
def test_noise_falls_and_edges_stay(seed, sigma_deg):
    epoch_s, truth, reported = turned(seed, sigma_deg)
    smoothed = smoothed_angles(epoch_s, reported)
    error = smoothed.attitude_deg - truth
    quiet = np.sqrt((error[:1400] ** 2).mean(axis=0))
    # pieces of an hour or two: noise of their means and the steps in which slow motion is followed
    assert (quiet < [0.3 * sigma_deg + 0.004] * 3).all()
    assert smoothed.sensor_sigma_deg == pytest.approx(np.full(3, sigma_deg), rel=0.1)
    assert (smoothed.remaining_sigma_deg < 0.35 * sigma_deg).all()
    plateau = error[1525:1540, 1]
    assert abs(plateau.mean()) < sigma_deg  # mean of fifteen readings: a quarter of it, four times that


def test_a_star_tracker_is_left_as_it_is():
    epoch_s, _, reported = turned(1, 0.01)
    assert (smoothed_angles(epoch_s, reported).attitude_deg == reported).all()


def test_axes_without_readings_stay_absent():
    epoch_s, _, reported = turned(1, 0.06)
    reported[:, 0] = np.nan
    reported[100:200, 2] = np.nan
    smoothed = smoothed_angles(epoch_s, reported)
    assert np.isnan(smoothed.attitude_deg[:, 0]).all()
    assert np.isnan(smoothed.sensor_sigma_deg[0])
    assert np.isnan(smoothed.attitude_deg[100:200, 2]).all()
    assert np.isfinite(smoothed.attitude_deg[:, 1]).all()


def test_pieces_are_the_cheapest_of_all():
    """Against every way of cutting nine readings."""
    values = np.array([0.1, -0.3, 0.2, 6.0, 6.4, 5.7, 5.9, -4.0, -4.4])

    def cost(starts):
        chunks = np.split(values, starts[1:])
        return sum(((chunk - chunk.mean()) ** 2).sum() for chunk in chunks) + SEGMENT_PENALTY * len(chunks)

    ways = [[0, *(k + 1 for k in range(8) if number >> k & 1)] for number in range(256)]
    best = min(ways, key=cost)
    assert segment_starts(np.arange(9) * 60.0, values).tolist() == best == [0, 3, 7]


def test_no_piece_is_longer_than_two_hours():
    starts = segment_starts(np.arange(400) * 60.0, np.zeros(400))
    assert np.diff([*starts, 400]).max() <= 120
    sparse = segment_starts(np.arange(100) * 600.0, np.zeros(100))
    assert np.diff([*sparse, 100]).max() <= 13


def test_few_readings_have_no_noise():
    assert np.isnan(reading_sigma_deg(np.array([0.1, np.nan, 0.2])))
    assert np.isnan(smoothed_angles(np.zeros(0), np.zeros((0, 3))).sensor_sigma_deg).all()
