"""Beams at the stations: changes between campaigns, and the surface between the stations."""

import numpy as np
import pytest
from geometry_flight import FlightPayload

from service.core.estimation.beams.station_beams import (
    StationBeams,
    beam_surface,
    changes_in_sigmas,
    station_beams,
    surface_db,
)
from service.pipeline.carrier_model.calibrated_arrays import geometry_model

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
    print("seed", SEED, "greatest error", np.ptp(error_db))
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
    print("seed", SEED, "share above three sigma", np.mean(change > 3.0))
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
