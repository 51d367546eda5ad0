"""From the record of a calibration to arrays: beacons, groups under level control, unknown carriers, noise ladders."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import SITE, START_US, FlightPayload

from service.core.estimation.calibration.quadratic_response import predict_deviation
from service.pipeline.carrier_model.calibrated_arrays import carrier_model, geometry_model
from service.pipeline.config import RobustConfig
from service.records.noise import NoiseComponent

NAN = float("nan")
CONFIG = RobustConfig()


@pytest.mark.parametrize("has_track", [True, False], ids=["dish law", "harmonics"])
def test_the_response_is_that_of_turned_direction_vectors(has_track):
    payload = FlightPayload.make(has_track=has_track)
    result = payload.calibration().result
    model = geometry_model(result.geometry, result.carriers)
    angles = np.random.default_rng(1).uniform(-0.3, 0.3, (60, 3))
    epochs_us = np.full(60, START_US)
    truth = payload.power_dbm(epochs_us, angles) - payload.power_dbm(epochs_us, np.zeros(3))
    assert np.abs(truth).max() > 1.0
    # second order of the rotation 0.001 deg at 0.3 deg, and 0.05 deg of orbit times a bend of 3 dB/deg^2, turned
    np.testing.assert_allclose(predict_deviation(angles, model.response), truth, atol=0.01)


def with_beacon(payload, k=2):
    """Return result and fit in which one carrier is a beacon."""
    result = payload.calibration().result
    fit = result.geometry
    blank = {
        name: tuple(NAN if j == k else value for j, value in enumerate(getattr(fit, name)))
        for name in ("station_azimuth_deg", "station_elevation_deg", "station_latitude_deg", "station_longitude_deg")
    }
    fit = replace(fit, **blank)
    return replace(result, geometry=fit), fit


def test_a_beacon_stands_at_the_receiving_site_and_tells_its_downlink():
    payload = FlightPayload.make()
    result, fit = with_beacon(payload)
    model = geometry_model(fit, result.carriers)
    assert model.positions.latitude_deg[2] == SITE.latitude_deg
    assert model.positions.longitude_deg[2] == SITE.longitude_deg
    np.testing.assert_array_equal(model.calibration.hessian[2], 0.0)
    np.testing.assert_array_equal(model.calibration.gradient[2], payload.downlink[payload.band()[2]])
    # the downlink's gradient alone: turned by the displacement of the site
    angles = np.array([0.0, 0.2, -0.1])
    moved = np.array([0.1, -0.2])
    change = predict_deviation(angles, model.response)[2]
    assert change == pytest.approx(moved @ payload.downlink[payload.band()[2]], abs=1e-3)
    untouched = geometry_model(payload.geometry(), result.carriers)
    others = np.arange(16) != 2
    np.testing.assert_array_equal(model.response.slope[others], untouched.response.slope[others])


def test_the_filters_model_has_the_sizes_of_the_record():
    payload = FlightPayload.make()
    result = payload.calibration(common_noise=(NoiseComponent(3600.0, 0.04),)).result
    arrays = geometry_model(result.geometry, result.carriers)
    model = carrier_model(arrays, result.geometry, result.carriers, CONFIG)
    np.testing.assert_array_equal(model.rain_share, np.where(payload.band() == 0, 0.1, 1.0))
    np.testing.assert_array_equal(model.transponder, np.arange(16) % 4)
    np.testing.assert_array_equal(model.white_sigma_db, 0.05)
    np.testing.assert_array_equal(model.coloured_tau_s, np.tile([1200.0, 7200.0], (16, 1)))
    np.testing.assert_array_equal(model.coloured_sigma_db, np.tile([0.02, 0.01], (16, 1)))
    np.testing.assert_array_equal(model.common_sigma_db, [0.04])
    np.testing.assert_array_equal(model.common_tau_s, [3600.0])
    # the filter's order of second degree is yy, yr, yp, rr, rp, pp
    assert model.coefficient_covariance.shape == (16, 9, 9)
    own = arrays.response.covariance
    np.testing.assert_array_equal(model.coefficient_covariance[:, 3, 3], own[:, 3, 3])
    np.testing.assert_array_equal(model.coefficient_covariance[:, 4, 8], own[:, 6, 5])
    np.testing.assert_array_equal(model.coefficient_covariance[:, 6, 7], own[:, 4, 8])


def test_carriers_of_other_noise_share_one_ladder_and_unlearned_ones_have_the_usual():
    payload = FlightPayload.make(4)
    result = payload.calibration().result
    noise = ((NoiseComponent(60.0, 0.1),), (), (NoiseComponent(7200.0, 0.3), NoiseComponent(60.0, 0.2)), ())
    white = (0.001, NAN, 0.2, 0.3)
    carriers = tuple(
        replace(one, noise=own, sigma_white_db=sigma)
        for one, own, sigma in zip(result.carriers, noise, white, strict=True)
    )
    arrays = geometry_model(result.geometry, carriers)
    model = carrier_model(arrays, result.geometry, carriers, CONFIG)
    np.testing.assert_array_equal(model.coloured_tau_s, np.tile([60.0, 1200.0, 7200.0], (4, 1)))
    np.testing.assert_array_equal(model.coloured_sigma_db, [[0.1, 0, 0], [0, 0.09, 0], [0.2, 0, 0.3], [0, 0.09, 0]])
    # never believed below 0.02, one decibel where nothing is known
    np.testing.assert_array_equal(model.white_sigma_db, [0.02, 1.0, 0.2, 0.3])


def test_a_carrier_without_coefficients_stands_in_the_model_with_zeros():
    payload = FlightPayload.make(5)
    fit = payload.geometry()
    gradient = ((NAN, NAN), *fit.gradient[1:])
    result = payload.calibration(gradient=gradient).result
    arrays = geometry_model(result.geometry, result.carriers)
    model = carrier_model(arrays, result.geometry, result.carriers, CONFIG)
    assert np.isfinite(model.gradient_db_deg).all()
    np.testing.assert_array_equal(model.gradient_db_deg[0], 0.0)
    np.testing.assert_array_equal(model.hessian_db_deg2[0], 0.0)
    np.testing.assert_array_equal(model.coefficient_covariance[0], 0.0)
    assert np.abs(model.gradient_db_deg[1:]).max() > 0.1
