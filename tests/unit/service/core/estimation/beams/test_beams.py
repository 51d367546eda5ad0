"""Beams: gains seen from the station and the boresight that turns and waves."""

import math

import numpy as np
import pytest
from geometry_flight import FlightPayload

from service.core.estimation.beams import (
    UNKNOWN_FIT,
    StationBeams,
    beam_surface,
    boresight_series,
    changes_in_sigmas,
    fit_boresight,
    station_beams,
    surface_db,
)
from service.pipeline.carrier_model.expected_level import geometry_model

SEED = 4
#: a beam with its peak at (1, -0.5): 0.2 dB/deg^3 of skew on a bend of -2 dB/deg^2
TRUTH = np.array([2.0, -1.0, -1.0, 0.3, -1.1, 0.05, 0.0, -0.04, 0.02])


def beams_at(place, surface, sigma=(0.06, 0.3)):
    """Return gradients and curvatures of a surface by small differences."""
    step = 1e-3
    east, north = step * np.eye(2)

    def gain(shift):
        return surface_db(place + shift, surface)

    gradient = np.stack([(gain(e) - gain(-e)) / (2 * step) for e in (east, north)], axis=1)
    bend = [(gain(e) - 2 * gain(np.zeros(2)) + gain(-e)) / step**2 for e in (east, north)]
    both = gain(east + north) - gain(east - north) - gain(north - east) + gain(-east - north)
    curvature = np.stack([bend[0], both / (4 * step**2), bend[1]], axis=1)
    count = len(place)
    covariance = np.tile(sigma[0] ** 2 * np.eye(2), (count, 1, 1))
    return StationBeams(gradient, np.full((count, 2), sigma[0]), covariance, curvature, np.full((count, 3), sigma[1]))


@pytest.fixture
def place():
    return np.random.default_rng(SEED).uniform(-1.5, 1.5, (12, 2))


def test_a_surface_comes_back_between_its_stations(place):
    found = beam_surface(place, beams_at(place, TRUTH))
    inside = np.random.default_rng(SEED + 1).uniform(-1.2, 1.2, (50, 2))
    error_db = surface_db(inside, found) - surface_db(inside, TRUTH)
    assert np.ptp(error_db) < 0.03
    assert np.ptp(surface_db(inside, TRUTH)) > 3.0, "a flat beam proves nothing"


def test_unknown_stations_are_left_out(place):
    beams = beams_at(place, TRUTH)
    beams.gradient_db_deg[0] = np.nan
    beams.curvature_sigma[1] = np.nan
    inside = np.zeros((1, 2))
    np.testing.assert_allclose(surface_db(inside, beam_surface(place, beams)), 0.0, atol=1e-12)


def test_changes_have_the_distribution_that_is_stated():
    rng = np.random.default_rng(SEED)
    place = np.zeros((4000, 2))
    now, before = (beams_at(place, TRUTH) for _ in range(2))
    noisy = [
        one._replace(gradient_db_deg=one.gradient_db_deg + rng.normal(0.0, 0.06, (4000, 2))) for one in (now, before)
    ]
    change = changes_in_sigmas(*noisy)
    # exp(-9 / 2) = 0.011; the sigma of the share is 0.0016
    assert np.mean(change > 3.0) == pytest.approx(0.0111, abs=0.005)
    turned = now._replace(gradient_db_deg=now.gradient_db_deg + np.array([0.5, 0.0]))
    assert (changes_in_sigmas(turned, before) > 5.0).all()
    assert np.isnan(changes_in_sigmas(now._replace(gradient_db_deg=now.gradient_db_deg * np.nan), before)).all()


def test_a_calibration_gives_its_gradients():
    result = FlightPayload.make().calibration().result
    calibration = geometry_model(result.geometry, result.carriers).calibration
    beams = station_beams(calibration)
    np.testing.assert_array_equal(beams.gradient_db_deg, np.array(result.geometry.gradient))
    np.testing.assert_allclose(beams.gradient_sigma**2, np.diagonal(beams.covariance, axis1=1, axis2=2))
    assert beams.curvature_sigma.shape == (len(result.carriers), 3)


WAVE_SEED = 11
GRADIENT = np.random.default_rng(WAVE_SEED).normal(0.0, 1.3, (16, 2))
SIGMA_DB = np.full(16, 0.03)
HOURS = 96


def moved(boresight_deg, common_db=0.0):
    """Return deviations (H, N) of a moved antenna without noise."""
    return -boresight_deg @ GRADIENT.T + np.reshape(common_db, (-1, 1))


@pytest.fixture
def noisy():
    """A wave of 0.03 deg, levels that wander together, and noise of 0.03 dB."""
    rng = np.random.default_rng(WAVE_SEED + 1)
    angle = 2.0 * np.pi * np.arange(HOURS) / 24.0
    truth = 0.03 * np.column_stack([np.cos(angle), np.sin(angle)])
    return truth, moved(truth, rng.normal(0.0, 0.5, HOURS)) + rng.normal(0.0, 0.03, (HOURS, 16))


def test_errors_are_those_that_it_states(noisy):
    truth, residual_db = noisy
    series = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    scaled = (series.boresight_deg - truth) / series.sigma_deg
    # the sigma of a sigma of 96 hours is seven percent; three of them
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, atol=0.22)
    zero_rms = np.sqrt(np.mean(truth**2, axis=0))
    assert (np.sqrt(np.mean((series.boresight_deg - truth) ** 2, axis=0)) < 0.6 * zero_rms).all(), "zero is as good"


def test_wrong_carriers_and_steps_leave_it(noisy):
    truth, residual_db = noisy
    plain = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    # a user steps, one fades for a day, one leaves the air
    residual_db[40:, 3] += 0.8
    residual_db[20:44, 7] -= 3.0
    residual_db[60:, 9] = np.nan
    series = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    errors = [np.sqrt(np.mean((one.boresight_deg - truth) ** 2, axis=0)) for one in (plain, series)]
    # three of sixteen carriers less cost a tenth; the least wise answer, all carriers alike, errs by 0.1 deg
    assert (errors[1] < 1.3 * errors[0]).all()
    assert np.abs(series.boresight_deg - truth).max() < 0.04


def test_what_all_carriers_share_is_no_boresight():
    shared = GRADIENT @ [0.0, 0.0] + np.full((30, 1), -4.0)
    series = boresight_series(shared, GRADIENT, SIGMA_DB)
    np.testing.assert_allclose(series.boresight_deg, 0.0, atol=1e-9)
    np.testing.assert_allclose(series.common_db, -4.0)


def test_a_part_of_the_gradient_that_all_share_changes_nothing(noisy):
    _, residual_db = noisy
    plain = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    shifted = boresight_series(residual_db, GRADIENT + np.array([0.7, -0.4]), SIGMA_DB)
    np.testing.assert_allclose(shifted.boresight_deg, plain.boresight_deg, atol=1e-6)


def test_few_carriers_tell_nothing():
    residual_db = moved(np.full((10, 2), 0.02))
    residual_db[5:, 4:] = np.nan
    series = boresight_series(residual_db, GRADIENT, SIGMA_DB)
    assert np.isfinite(series.boresight_deg[:5]).all()
    assert np.isnan(series.boresight_deg[5:]).all()
    assert (series.carriers_used[5:] <= 4).all()


def test_beams_of_one_direction_do_not_determine_it():
    series = boresight_series(np.zeros((4, 16)), np.outer(np.linspace(-1.0, 1.0, 16), [1.0, 0.5]), SIGMA_DB)
    assert np.isnan(series.boresight_deg).all()


def test_levels_that_changed_since_the_calibration_widen_the_constant_part(noisy):
    _, residual_db = noisy
    sure = boresight_series(residual_db, GRADIENT, SIGMA_DB).constant_sigma_deg
    levels_db = np.random.default_rng(WAVE_SEED + 2).normal(0.0, 0.08, 16)
    unsure = boresight_series(residual_db + levels_db, GRADIENT, SIGMA_DB).constant_sigma_deg
    # 0.08 dB on sixteen carriers of 1.3 dB/deg
    assert (unsure > 2.0 * sure).all()
    np.testing.assert_allclose(unsure, 0.08 / 1.3 / 4.0, rtol=0.6)


def test_nothing_measured():
    series = boresight_series(np.full((3, 16), np.nan), GRADIENT, SIGMA_DB)
    assert np.isnan(series.boresight_deg).all()
    assert series.boresight_deg.shape == (3, 2)
    assert boresight_series(np.zeros((0, 16)), GRADIENT, SIGMA_DB).boresight_deg.shape == (0, 2)


DAY_S, YEAR_S = 86_400.0, 365.25 * 86_400.0
START_S = 20_800 * DAY_S + 7200.0


def hours(days, step_h=1):
    return START_S + 3600.0 * np.arange(0, int(24 * days), step_h)


def test_mean_drift_and_wave_come_back():
    at_s = hours(3)
    value = 0.01 + 0.002 * (at_s - at_s.mean()) / DAY_S + 0.03 * np.cos(2 * np.pi * (at_s - 5 * 3600.0) / DAY_S)
    fit = fit_boresight(at_s, value, np.full(len(at_s), 0.01))
    assert fit.mean_deg == pytest.approx(0.01)
    assert fit.drift_deg_per_day == pytest.approx(0.002)
    assert (fit.daily.amplitude_deg, fit.daily.peak_s) == pytest.approx((0.03, 5 * 3600.0))
    assert math.isnan(fit.yearly.amplitude_deg)
    assert fit.residual_rms_deg == pytest.approx(0.0, abs=1e-12)


def test_a_year_of_every_seventh_day_tells_both_waves():
    at_s = np.concatenate([hours(1) + 7 * k * DAY_S for k in range(53)])
    value = 0.02 * np.cos(2 * np.pi * (at_s % YEAR_S) / YEAR_S - 1.0) + 0.01 * np.sin(2 * np.pi * at_s / DAY_S)
    fit = fit_boresight(at_s, value, np.full(len(at_s), 0.01))
    assert fit.yearly.amplitude_deg == pytest.approx(0.02)
    assert fit.yearly.peak_s == pytest.approx(YEAR_S / (2 * np.pi))
    assert fit.daily.amplitude_deg == pytest.approx(0.01)


@pytest.mark.parametrize("common", [0.0, 0.7], ids=["white", "coloured"])
def test_sigma_of_the_wave_holds_also_for_noise_of_hours(common):
    seed = 3
    rng = np.random.default_rng(seed)
    at_s = hours(4)
    parts, stated = [], []
    for _ in range(200):
        noise = rng.normal(0.0, 0.01, len(at_s))
        for k in range(1, len(noise)):
            noise[k] = common * noise[k - 1] + math.sqrt(1.0 - common**2) * noise[k]
        daily = fit_boresight(at_s, noise, np.full(len(at_s), 0.01)).daily
        angle = 2 * np.pi * daily.peak_s / DAY_S
        parts.append(daily.amplitude_deg * np.array([np.cos(angle), np.sin(angle)]))
        stated.append(daily.sigma_deg)
    ratio = np.std(parts) / np.mean(stated)
    assert 0.7 < ratio < 1.35


@pytest.mark.parametrize(
    ("at_s", "why"),
    [(hours(1), "a day does not tell a wave from a drift"), (hours(3)[::8], "three hours of the day alone")],
)
def test_too_short_for_a_wave(at_s, why):
    fit = fit_boresight(at_s, np.full(len(at_s), 0.01), np.full(len(at_s), 0.01))
    assert fit.mean_deg == pytest.approx(0.01), why
    assert math.isnan(fit.daily.amplitude_deg), why


def test_too_short_for_anything():
    assert fit_boresight(hours(1)[:4], np.zeros(4), np.ones(4)) == UNKNOWN_FIT
    at_s = hours(2)
    assert fit_boresight(at_s, np.full(len(at_s), np.nan), np.ones(len(at_s))) == UNKNOWN_FIT
