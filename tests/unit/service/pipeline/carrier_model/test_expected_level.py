"""Expected levels: the geometry's own to microdecibels, the same bits for every caller, NaN where nothing is known."""

import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, START_US, FlightPayload, S

from service.pipeline.carrier_model.calibrated_arrays import geometry_model
from service.pipeline.carrier_model.expected_level import ExpectedLevel, daily_error_db, expected_levels

DAY_US = 86_400 * S


def level_of(payload, ephemeris=None, **changes):
    result = payload.calibration(**changes).result
    model = geometry_model(result.geometry, result.carriers)
    return ExpectedLevel(model, result.geometry, ephemeris or payload.ephemeris())


@pytest.mark.parametrize(
    ("has_track", "tolerance_db"),
    [
        # knots ten minutes apart, read by a cubic
        pytest.param(True, 1e-5, id="dish law"),
        pytest.param(False, 1e-10, id="harmonics"),
    ],
)
def test_levels_are_those_of_an_independent_geometry(has_track, tolerance_db):
    payload = FlightPayload.make(has_track=has_track)
    level = level_of(payload)
    epochs_us = START_US + np.arange(0, DAY_US, 1777 * S)
    reported = np.array([level(int(epoch_us)) for epoch_us in epochs_us])
    truth = payload.power_dbm(epochs_us, np.zeros(3))
    assert np.ptp(truth, axis=0).max() > 0.2
    np.testing.assert_allclose(reported, truth, atol=tolerance_db)
    np.testing.assert_allclose(level.mean_dbm(epochs_us), truth.mean(axis=0), atol=tolerance_db)


@pytest.mark.parametrize("has_track", [True, False], ids=["dish law", "harmonics"])
def test_a_level_is_the_same_to_the_last_bit_whatever_was_asked_before(has_track):
    payload = FlightPayload.make(6, has_track=has_track)
    epochs_us = (START_US + np.random.default_rng(2).integers(0, 2 * DAY_US, 60)).tolist()
    straight, fresh = level_of(payload), level_of(payload)
    forwards = [straight(epoch_us) for epoch_us in epochs_us]
    backwards = [fresh(epoch_us) for epoch_us in reversed(epochs_us)][::-1]
    np.testing.assert_array_equal(forwards, backwards)


def test_midnight_is_no_seam():
    level = level_of(FlightPayload.make(6))
    midnight_us = (START_US // DAY_US + 1) * DAY_US
    around = np.array([level(midnight_us + offset) for offset in (-1, 0, 1)])
    # a microsecond of a wave of half a decibel a day
    np.testing.assert_allclose(around[0], around[1], atol=1e-9)
    np.testing.assert_allclose(around[2], around[1], atol=1e-9)


def test_beyond_the_track_nothing_is_known():
    payload = FlightPayload.make(6)
    level = level_of(payload, payload.ephemeris(stop_us=START_US + 3 * HOUR))
    assert np.isfinite(level(START_US + 2 * HOUR)).all()
    assert np.isnan(level(START_US + 3 * HOUR + MINUTE)).all()
    assert np.isnan(level(START_US - 2 * DAY_US)).all()


def test_a_dish_law_without_a_track_knows_nothing():
    harmonics = FlightPayload.make(6, has_track=False)
    assert np.isnan(level_of(FlightPayload.make(6), harmonics.ephemeris())(START_US)).all()


def test_a_long_replay_keeps_only_some_days(monkeypatch):
    monkeypatch.setattr("service.pipeline.carrier_model.expected_level._MAX_DAYS", 2)
    payload = FlightPayload.make(4)
    level, all_days = level_of(payload), level_of(payload)
    epochs_us = [START_US + day * DAY_US for day in (0, 1, 2, 3, 0)]
    reported = [level(epoch_us) for epoch_us in epochs_us]
    assert len(level._days) <= 2
    monkeypatch.undo()
    np.testing.assert_array_equal(reported, [all_days(epoch_us) for epoch_us in epochs_us])


# ---- what the daily change may have wrong ----------------------------------------------------------------------------


def error_of(payload, ephemeris, **changes):
    result = payload.calibration(**changes).result
    return daily_error_db(geometry_model(result.geometry, result.carriers), result.geometry, ephemeris, START_US)


def spread(payload, sigma):
    """Return the covariance of a fit whose daily coefficients have one standard deviation."""
    size = 1 + payload.daily.shape[1] + 5
    variance = np.full(size, 1e-10)
    variance[1:-5] = sigma**2
    return (tuple(map(tuple, np.diag(variance).tolist())),) * len(payload.ids)


def test_errors_of_two_harmonics_are_waves():
    payload = FlightPayload.make(4, has_track=False)
    reported = error_of(payload, payload.ephemeris(), covariance=spread(payload, 0.1))
    # four waves of amplitude 0.1, half the square each; one day is not quite one period
    np.testing.assert_allclose(reported, 0.1 * np.sqrt(2.0), rtol=0.01)


def test_errors_of_the_dish_law_grow_with_the_orbit():
    payload = FlightPayload.make(6)
    reported = error_of(payload, payload.ephemeris(), covariance=spread(payload, 2.0))
    # 0.05 deg up and down and 0.015 along, seen from below a seventh nearer: 2 dB/deg times about 0.04 deg rms
    assert (reported > 0.05).all()
    assert (reported < 0.15).all()
    np.testing.assert_allclose(error_of(payload, payload.ephemeris()), 0.0, atol=1e-5)


def test_where_the_ephemeris_does_not_reach_no_error_is_told():
    payload = FlightPayload.make(4)
    wide = spread(payload, 2.0)
    ended = payload.ephemeris(stop_us=START_US - 2 * HOUR)
    without = FlightPayload.make(4, has_track=False).ephemeris()
    for ephemeris in (ended, without):
        np.testing.assert_array_equal(error_of(payload, ephemeris, covariance=wide), 0.0)


def test_levels_of_many_epochs_leave_the_solar_day_out():
    payload = FlightPayload.make(4, has_track=False)
    result = payload.calibration().result
    model = geometry_model(result.geometry, result.carriers)
    at = expected_levels(model, result.geometry, payload.ephemeris())
    angle = 2.0 * np.pi * ((START_US % DAY_US) / DAY_US)
    solar = payload.solar_db @ np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(
        at(np.array([START_US]))[0] + solar, payload.power_dbm([START_US], np.zeros(3))[0], atol=1e-10
    )
