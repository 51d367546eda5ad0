"""Joint calibration on payloads that follow its model exactly, so that every coefficient is known."""

from typing import NamedTuple

import numpy as np
import pytest

from service.core.estimation.calibration.geometry_calibration import CalibrationRows, fit_geometry
from service.core.estimation.calibration.geometry_columns import (
    CarrierGeometry,
    OrbitMotion,
    beam_columns,
    daily_columns,
    is_known_orbit,
    solar_columns,
)
from service.core.estimation.calibration.geometry_prediction import predict_level_dbm, response_of
from service.core.estimation.calibration.quadratic_response import predict_deviation

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
    print(f"seed {SEED}: errors over sigma, rms {np.sqrt(np.mean(errors**2)):.2f}, largest {np.abs(errors).max():.2f}")
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
    truth = fit._replace(
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
    print(f"deviation error {rms:.4f} dB")
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
    assert fit.stretches_used[2] < fit.stretches_used[1]


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
