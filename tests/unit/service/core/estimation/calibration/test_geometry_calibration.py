"""Calibration of the geometry and of the level over the days."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from flight_geometry import turned_direction

from service.core.estimation.calibration.geometry_calibration import (
    CalibrationRows,
    fit_geometry,
    predict_level_dbm,
    response_of,
)
from service.core.estimation.calibration.geometry_columns import (
    CarrierGeometry,
    OrbitMotion,
    QuadraticResponse,
    beam_columns,
    daily_columns,
    displacement_matrix,
    exact_response,
    is_known_orbit,
    predict_deviation,
    predict_jacobian,
    response_errors,
    response_monomials,
    response_transform,
    solar_columns,
    symmetric_matrix,
)
from service.core.estimation.calibration.joint_tukey import trimmed_fit
from service.core.estimation.noise_identification import LADDER_S, IdentifiedNoise, level_drift, without_common
from service.core.geometry.frames import AntennaDirection

SEED = 21
CARRIERS = 6
MINUTES = 2880
WHITE_DB = 0.05


class Payload(NamedTuple):
    rows: CalibrationRows
    geometry: CarrierGeometry
    daily: np.ndarray
    beam: np.ndarray
    downlink: np.ndarray
    level: np.ndarray


def attitudes(rng):
    """Two quiet days of small motion, the last hours turned about every axis and to the corners."""
    angles = np.cumsum(rng.normal(size=(MINUTES, 3)), axis=0) * 0.0004
    levels = [s * e for e in np.eye(3) for s in (0.25, 0.5, -0.25, -0.5)]
    levels += [0.3 * np.array([y, r, p]) for y in (1, -1) for r in (1, -1) for p in (1, -1)]
    turned = np.repeat(np.array(levels), 15, axis=0)
    angles[-len(turned) :] += turned
    return angles


def make(rng, bands=2, k_least=5.0, noise_db=WHITE_DB, is_orbit=True):
    """Return a payload with two bands of three carriers."""
    geometry = CarrierGeometry(
        rng.uniform(-5.0, 5.0, CARRIERS),
        rng.uniform(6.3, 8.5, CARRIERS),
        np.array([-3.6, 7.1]),
        np.arange(CARRIERS) % bands,
    )
    phase = np.arange(MINUTES) * 2.0 * np.pi / 1436.0
    wave = 0.04 * np.stack([np.sin(phase), np.cos(phase + 0.3)], axis=-1)
    turn = rng.uniform(0.0, 2.0 * np.pi, CARRIERS)
    sight = np.stack(
        [np.outer(wave[:, 0], np.cos(turn)) + np.outer(wave[:, 1], np.sin(turn)), np.outer(wave[:, 1], np.cos(turn))],
        axis=-1,
    )
    motion = OrbitMotion(sight, 0.006 * rng.normal(size=(MINUTES, CARRIERS + 1, 2))) if is_orbit else None
    angles = attitudes(rng)
    daily = np.column_stack([rng.normal(0, 3, (CARRIERS, 2)), rng.uniform(k_least, 60.0, CARRIERS)])
    if not is_orbit:
        daily = rng.normal(0.0, 0.2, (CARRIERS, 4))
    beam = np.column_stack([rng.normal(0.0, 1.4, (CARRIERS, 2)), rng.normal([-1.5, 0.0, -2.7], 0.3, (CARRIERS, 3))])
    downlink, level = rng.normal(0.0, 0.5, 2 * bands), rng.uniform(-45.0, -40.0, CARRIERS)
    own, shared = beam_columns(angles, geometry, motion)
    power = level + (daily_columns(motion, phase, CARRIERS) * daily).sum(-1) + (own * beam).sum(-1) + shared @ downlink
    power = power + noise_db * rng.normal(size=power.shape)
    rows = CalibrationRows(np.arange(MINUTES) * 60.0, power, angles, phase, motion)
    return Payload(rows, geometry, daily, beam, downlink, level)


def standardised(fit, payload):
    """Errors of all own coefficients over their own sigmas, (N, K)."""
    found = np.column_stack([fit.level_dbm, fit.daily, fit.gradient, fit.hessian])
    truth = np.column_stack([payload.level, payload.daily, payload.beam])
    return (found - truth) / np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))


def test_coefficients_come_out_within_their_own_sigmas():
    """White noise: every coefficient of every carrier, and the downlinks of two bands."""
    payload = make(np.random.default_rng(SEED))
    fit = fit_geometry(payload.rows, payload.geometry)
    errors = standardised(fit, payload)
    # 54 errors of about unit variance: rms 1 +- 0.1, three times that; largest below 4
    assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.3
    assert np.abs(errors).max() < 4.0
    sigma = np.sqrt(np.diag(fit.downlink_covariance))
    assert np.abs((fit.downlink.ravel() - payload.downlink) / sigma).max() < 4.0
    assert fit.noise.white_db == pytest.approx(np.full(CARRIERS, WHITE_DB), rel=0.1)
    assert fit.is_dish_law


def test_prediction_is_that_of_the_truth_and_its_error_is_stated():
    """Levels over the orbit and deviations at 0.3 deg."""
    payload = make(np.random.default_rng(SEED))
    fit = fit_geometry(payload.rows, payload.geometry)
    truth = replace(
        fit,
        level_dbm=payload.level,
        daily=payload.daily,
        gradient=payload.beam[:, :2],
        hessian=payload.beam[:, 2:],
        downlink=payload.downlink.reshape(-1, 2),
    )
    rows = payload.rows
    levels = [predict_level_dbm(one, payload.geometry, rows.motion, rows.phase_rad) for one in (fit, truth)]
    # dish and solar day share what looks alike over two days: only their sum is compared
    levels[0] = levels[0] + (solar_columns(rows.epoch_s, CARRIERS) * fit.solar_db).sum(-1)
    # 3000 rows of 0.05 dB for nine coefficients
    assert np.sqrt(np.mean((levels[0] - levels[1]) ** 2)) < 0.006
    attitude = np.random.default_rng(1).uniform(-0.3, 0.3, (200, 3))
    answers = [predict_deviation(attitude, response_of(one, payload.geometry)) for one in (fit, truth)]
    rms = np.sqrt(np.mean((answers[0] - answers[1]) ** 2))
    assert rms < 0.02
    assert np.isnan(predict_level_dbm(fit, payload.geometry, None, rows.phase_rad)).all()


def test_a_step_of_a_third_and_impulses_do_not_move_the_fit():
    """One carrier is 3 dB down for a third of the quiet days; each carrier has impulses of 20 dB."""
    rng = np.random.default_rng(SEED)
    payload = make(rng)
    power = payload.rows.power_dbm.copy()
    power[300:1260, 2] -= 3.0
    power[rng.random(power.shape) < 0.01] += 20.0
    fit = fit_geometry(payload.rows._replace(power_dbm=power), payload.geometry)
    assert np.abs(standardised(fit, payload)).max() < 4.5  # as without faults, a little fewer rows
    assert not fit.weight[400:1200, 2].any()


def test_without_a_track_two_harmonics_stand_for_the_dish():
    """Their coefficients come out within their sigmas, and levels are predicted from the phase."""
    payload = make(np.random.default_rng(SEED), is_orbit=False)
    fit = fit_geometry(payload.rows, payload.geometry)
    assert not fit.is_dish_law
    assert fit.daily.shape == (CARRIERS, 4)
    assert np.abs(standardised(fit, payload)).max() < 4.0  # 60 errors of unit variance
    levels = predict_level_dbm(fit, payload.geometry, None, payload.rows.phase_rad)
    truth = payload.level + (daily_columns(None, payload.rows.phase_rad, CARRIERS) * payload.daily).sum(-1)
    assert np.abs(levels - truth).max() < 0.02  # 0.05 dB over 2800 rows, five coefficients


def test_a_track_that_covers_nothing_is_no_track():
    """All NaN falls back to harmonics; a part covered keeps the dish law on that part."""
    payload = make(np.random.default_rng(SEED))
    sight = payload.rows.motion.sight_deg.copy()
    sight[:100] = np.nan
    partly = payload.rows._replace(motion=payload.rows.motion._replace(sight_deg=sight))
    fit = fit_geometry(partly, payload.geometry)
    assert fit.is_dish_law
    assert not fit.weight[:100].any()
    nothing = payload.rows.motion._replace(sight_deg=np.full_like(sight, np.nan))
    assert not is_known_orbit(nothing)
    assert not is_known_orbit(None)
    assert not fit_geometry(payload.rows._replace(motion=nothing), payload.geometry).is_dish_law


def test_a_dish_never_gains_by_looking_away():
    """True k below zero: k is held at zero, and its variance with it."""
    payload = make(np.random.default_rng(SEED), k_least=5.0)
    k = payload.daily[:, 2].copy()
    power = payload.rows.power_dbm.copy()
    power[:, 1] += (k[1] + 40.0) * np.square(payload.rows.motion.sight_deg[:, 1]).sum(-1)
    fit = fit_geometry(payload.rows._replace(power_dbm=power), payload.geometry)
    assert fit.daily[1, 2] == 0.0
    assert not fit.covariance[1, 3].any()
    assert (fit.daily[np.arange(CARRIERS) != 1, 2] > 0.0).all()


def test_carriers_that_were_hardly_seen_are_not_calibrated():
    """Absent, or present for three hours; the others are untouched."""
    payload = make(np.random.default_rng(SEED))
    power = payload.rows.power_dbm.copy()
    power[:, 0], power[180:, 3] = np.nan, np.nan
    fit = fit_geometry(payload.rows._replace(power_dbm=power), payload.geometry)
    for values in (fit.level_dbm, fit.gradient, fit.residual_rms_db, fit.covariance, fit.daily, fit.hessian):
        assert np.isnan(values[[0, 3]]).all()
        assert np.isfinite(values[[1, 2, 4, 5]]).all()
    response = response_of(fit, payload.geometry)
    assert np.isnan(response.slope[[0, 3]]).all()
    assert np.isfinite(response.slope[[1, 2, 4, 5]]).all()


def test_an_axis_that_was_not_turned_says_so_by_its_variance():
    """Without turns gradients rest on the small motion, Hessians on the prior."""
    payload = make(np.random.default_rng(SEED))
    quiet = CalibrationRows(
        *(column[:2400] for column in payload.rows[:4]), OrbitMotion(*(m[:2400] for m in payload.rows.motion))
    )
    fit = fit_geometry(quiet, payload.geometry)
    sigma = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
    assert np.isfinite(sigma).all()
    assert (sigma[:, -3:] > 5.0).all(), "dB/deg^2, the Hessian is unknown"


def test_no_rows_at_all():
    """Nothing known gives NaN, never an exception."""
    payload = make(np.random.default_rng(SEED))
    for rows in (
        payload.rows._replace(power_dbm=np.full_like(payload.rows.power_dbm, np.nan)),
        payload.rows._replace(attitude_deg=np.full_like(payload.rows.attitude_deg, np.nan)),
    ):
        fit = fit_geometry(rows, payload.geometry)
        assert np.isnan(fit.level_dbm).all()
        assert np.isnan(fit.covariance).all()


def test_absent_samples_and_carriers():
    """A carrier with fewer samples than coefficients is zero; absent samples change nothing."""
    columns = np.stack([np.ones(30), np.arange(30.0)], axis=-1)
    values = np.tile(columns @ [1.0, 2.0], (2, 1))
    is_present = np.ones((2, 30), dtype=bool)
    is_present[0, 2:], is_present[1, 5:9] = False, False
    values[1, 5:9] = 1e6
    fit = trimmed_fit(np.tile(columns, (2, 1, 1)), values, is_present)
    assert fit[0].tolist() == [0.0, 0.0]
    assert fit[1] == pytest.approx([1.0, 2.0], abs=1e-3)  # the pull of 1e-6 towards zero


def test_a_column_of_zeros_is_survived():
    """An axis that was not turned."""
    columns = np.stack([np.ones(40), np.zeros(40)], axis=-1)
    fit = trimmed_fit(columns[None], np.full((1, 40), 3.0), np.ones((1, 40), dtype=bool))
    assert fit[0] == pytest.approx([3.0, 0.0], abs=1e-3)  # the pull of 1e-6 towards zero


RESPONSE_SEED = 11
STATIONS = AntennaDirection(np.array([-5.2, 0.1, 5.0]), np.array([6.3, 8.6, 7.0]))


def moved_deg(attitude_deg):
    """Exact displacement (3, 2) of the stations."""
    turned = turned_direction(STATIONS, attitude_deg)
    return np.stack(turned, axis=-1) - np.stack(STATIONS, axis=-1)


def test_displacement_is_the_derivative_of_the_exact_rotation():
    """Central differences of the rotation."""
    step_deg = 0.01
    exact = np.stack([(moved_deg(step_deg * e) - moved_deg(-step_deg * e)) / (2 * step_deg) for e in np.eye(3)], -1)
    # third derivatives are of order 1 / rad^2: (0.01 deg)^2 in rad is 3e-8
    assert displacement_matrix(*STATIONS) == pytest.approx(exact, abs=1e-7)


def random_response(rng, carriers=6, shared=2):
    slope, half = rng.normal(size=(carriers, 3)), rng.normal(size=(carriers, 3, 3))
    root = 0.1 * rng.normal(size=(carriers, 9, 9))
    common = 0.05 * rng.normal(size=(carriers, 9, shared))
    covariance = root @ np.swapaxes(root, 1, 2) + common @ np.swapaxes(common, 1, 2)
    return QuadraticResponse(slope, half + np.swapaxes(half, 1, 2), covariance, common)


def test_prediction_and_derivative_agree():
    """A quadratic's central difference is exact."""
    rng = np.random.default_rng(RESPONSE_SEED)
    model, attitude = random_response(rng), rng.uniform(-0.5, 0.5, (4, 3))
    steps = 0.1 * np.eye(3)
    slope = np.stack(
        [(predict_deviation(attitude + s, model) - predict_deviation(attitude - s, model)) / 0.2 for s in steps], -1
    )
    assert predict_jacobian(attitude, model) == pytest.approx(slope, abs=1e-12)  # rounding
    assert predict_deviation(attitude[0], model) == pytest.approx(predict_deviation(attitude, model)[0], abs=1e-14)


def test_monomials_carry_slopes_and_curvature():
    """The nine factors times the nine coefficients are the prediction."""
    rng = np.random.default_rng(RESPONSE_SEED)
    model, attitude = random_response(rng), rng.uniform(-0.5, 0.5, 3)
    six = model.curvature[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    nine = np.concatenate([model.slope, six], axis=1)
    assert symmetric_matrix(six) == pytest.approx(model.curvature, abs=0.0)
    assert nine @ response_monomials(attitude) == pytest.approx(predict_deviation(attitude, model), abs=1e-13)


def test_errors_are_those_of_the_coefficients():
    """Variance and common part at one attitude and at many."""
    rng = np.random.default_rng(RESPONSE_SEED)
    model, attitude = random_response(rng), rng.uniform(-0.5, 0.5, (5, 3))
    variance, common = response_errors(attitude, model)
    for row, factors in enumerate(response_monomials(attitude)):
        expected = [factors @ one @ factors for one in model.covariance]
        assert variance[row] == pytest.approx(np.array(expected), rel=1e-10)
        assert common[row] == pytest.approx(factors @ model.common_root, rel=1e-10)
    one, _ = response_errors(attitude[2], model)
    assert one == pytest.approx(variance[2], rel=1e-12)


def test_transform_gives_what_the_beam_would():
    """Gradient, Hessian and downlink act on displacements; the collected quadratic gives the same."""
    rng = np.random.default_rng(RESPONSE_SEED)
    position = displacement_matrix(*STATIONS)
    site = displacement_matrix(np.array([-3.6]), np.array([7.1]))[0]
    own, downlink = response_transform(position, site)
    beam, gradient = rng.normal(size=(3, 5)), rng.normal(size=2)
    nine = np.einsum("nij,nj->ni", own, beam) + downlink @ gradient
    model = exact_response(nine[:, :3], symmetric_matrix(nine[:, 3:]))
    attitude = rng.uniform(-0.5, 0.5, 3)
    moved = position @ attitude
    az, el = moved.T
    direct = beam[:, 0] * az + beam[:, 1] * el + 0.5 * beam[:, 2] * az**2 + beam[:, 3] * az * el
    direct = direct + 0.5 * beam[:, 4] * el**2 + (site @ attitude - moved) @ gradient
    assert predict_deviation(attitude, model) == pytest.approx(direct, abs=1e-12)  # rounding


FLOOR = 0.006
EPOCH_S = np.arange(4320) * 60.0


def white_noise(carriers, sigma_db=0.1):
    nothing = np.zeros((carriers, len(LADDER_S)))
    return IdentifiedNoise(np.full(carriers, sigma_db), nothing, np.array(LADDER_S), nothing[0])


def walks(seed, walk_db, carriers=16):
    rng = np.random.default_rng(seed)
    steps = walk_db * np.sqrt(1.0 / 60.0) * rng.normal(size=(len(EPOCH_S), carriers))
    return np.cumsum(steps, axis=0) + 0.1 * rng.normal(size=steps.shape)


def test_levels_that_stand_have_the_floor():
    found = [level_drift(walks(seed, 0.0), EPOCH_S, white_noise(16), FLOOR).walk_db for seed in range(10)]
    assert np.max(found) == FLOOR


def test_a_walk_comes_out_of_all_carriers_together():
    found = [level_drift(walks(seed, 0.03), EPOCH_S, white_noise(16), FLOOR).walk_db for seed in range(10)]
    # 160 slopes: one sigma of their mean square is 11 %, of its root 6 %
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(0.03, rel=0.2)


def test_a_slope_is_told_with_what_noise_leaves():
    rng = np.random.default_rng(4)
    values = 0.1 * rng.normal(size=(len(EPOCH_S), 8))
    values[:, 3] += 0.4 * EPOCH_S / 86_400.0
    drift = level_drift(values, EPOCH_S, white_noise(8), FLOOR)
    # the median of eight follows the one that goes away only as long as it is among them
    assert drift.slope_db_per_day[3] == pytest.approx(0.4, abs=0.03)
    assert np.abs(np.delete(drift.slope_db_per_day, 3)).max() < 0.02
    # white: 0.1 sqrt(12 / 4320) / 3 d
    assert drift.sigma_db_per_day == pytest.approx(np.full(8, 0.1 * np.sqrt(12.0 / 4320.0) / 3.0), rel=0.01)


def test_what_all_do_together_is_no_walk():
    values = walks(2, 0.0) + np.cumsum(np.random.default_rng(9).normal(size=(len(EPOCH_S), 1)), axis=0) * 0.01
    assert level_drift(values, EPOCH_S, white_noise(16), FLOOR).walk_db == pytest.approx(np.full(16, FLOOR))


def test_carriers_that_are_absent_have_the_walk_of_all():
    values = walks(1, 0.03)
    values[:, 0] = np.nan
    drift = level_drift(values, EPOCH_S, white_noise(16), FLOOR)
    assert np.isnan(drift.slope_db_per_day[0])
    assert FLOOR < drift.walk_db[0] < 0.06


def test_rows_of_few_carriers_are_left_alone():
    values = np.array([[1.0, 1.0, 1.0, np.nan], [1.0, 2.0, 3.0, 2.0]])
    assert without_common(values)[0, :3] == pytest.approx(np.ones(3))
    assert without_common(values)[1] == pytest.approx([-1.0, 0.0, 1.0, 0.0])
