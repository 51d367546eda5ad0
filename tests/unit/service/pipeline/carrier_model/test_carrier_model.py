"""Expectations of the model of carriers: level and its control, errors."""

from dataclasses import replace

import filter_models
import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, SITE, START_US, FlightPayload, S
from geometry_payload import GeometryPayload

from service.core.estimation.calibration.geometry_columns import exact_response, predict_deviation
from service.pipeline.carrier_model.expected_level import (
    ExpectedLevel,
    carrier_model,
    daily_error_db,
    expected_levels,
    geometry_model,
)
from service.pipeline.carrier_model.level_control import (
    alc_groups,
    centred_model,
    centred_response,
    first_model_dbm,
    member_groups,
    small_groups,
    without_group_gain,
    without_group_means,
)
from service.pipeline.config import RobustConfig
from service.records.calibration import NoiseComponent
from service.records.catalogue import CarrierPlan

DAY_US = 86_400_000_000
GROUP = np.array([-1, 0, 0, 0, 1, 1, 1, 1])


def test_groups_are_transponders_under_level_control():
    carriers = list(GeometryPayload.make(8).carriers)
    assert alc_groups(CarrierPlan(1, "x", tuple(carriers))).tolist() == [-1] * 8
    for k in (4, 5, 6, 7):
        carriers[k] = replace(carriers[k], transponder_mode="alc")
    carriers[0] = replace(carriers[0], transponder_mode="alc")
    group = alc_groups(CarrierPlan(1, "x", tuple(carriers)))
    assert group.tolist() == [0, -1, -1, -1, 1, 1, 1, 1]
    assert small_groups(group).tolist() == [True] + [False] * 7


def test_what_a_group_does_together_goes_and_the_rest_stays():
    rng = np.random.default_rng(1)
    model, own = rng.uniform(-45.0, -40.0, 8), rng.normal(size=(50, 8))
    gain = rng.normal(size=(50, 2))
    power = model + own + np.where(GROUP < 0, 0.0, gain[:, GROUP])
    taken = without_group_means(power, model, GROUP)
    assert (taken[:, 0] == power[:, 0]).all()
    # the group's gain is gone, and with it the mean of its carriers; rounding of levels of 45 dB
    assert taken[:, 1:4] == pytest.approx(model[1:4] + own[:, 1:4] - own[:, 1:4].mean(axis=1, keepdims=True), abs=1e-12)


def test_an_absent_carrier_does_not_move_the_others_by_its_level():
    model = np.array([-40.0, -41.0, -45.0, -49.0, -40.0, -40.0, -40.0, -40.0])
    power = np.tile(model, (3, 1))
    power[1, 6] = np.nan
    taken = without_group_means(power, model, GROUP)
    assert taken[1, [4, 5, 7]] == pytest.approx(model[[4, 5, 7]], abs=1e-12)
    assert np.isnan(taken[1, 6])


def test_rows_of_two_say_nothing():
    power = np.full((2, 8), -40.0)
    power[0, 2] = np.nan
    assert np.isnan(without_group_means(power, np.full(8, -40.0), GROUP)[0, 1:4]).all()
    assert np.isfinite(without_group_means(power, np.full(8, -40.0), GROUP)[1]).all()


def test_the_first_model_is_the_median():
    power = np.array([[-40.0, np.nan], [-41.0, np.nan], [-60.0, np.nan]])
    assert first_model_dbm(power).tolist() == [-41.0, 0.0]


NAN = float("nan")
EVERY = np.ones(6, dtype=np.bool_)


def test_members_are_the_used_carriers_of_each_group():
    is_used = np.array([True, True, False, True, True, True])
    found = member_groups((0, -1, 0, 1, 0, 1), is_used)
    assert [members.tolist() for members in found] == [[0, 4], [3, 5]]
    assert member_groups((), EVERY) == ()
    assert member_groups((-1,) * 6, EVERY) == ()


def test_a_gain_of_the_group_changes_nothing_and_the_others_are_not_touched():
    groups = member_groups((0, 0, 0, 0, -1, -1), EVERY)
    rng = np.random.default_rng(3)
    response = exact_response(rng.normal(size=(6, 3)), np.zeros((6, 3, 3)))
    attitude = np.array([0.1, -0.2, 0.3])
    centred = predict_deviation(attitude, centred_response(response, groups))
    plain = predict_deviation(attitude, response)
    for gain_db in (0.0, 3.7):
        measured = plain + gain_db * np.array([1, 1, 1, 1, 0, 0])
        # what is explained beforehand is the centred answer, so the median finds gain and mean answer to rounding
        np.testing.assert_allclose(without_group_gain(measured, centred, groups), centred, atol=1e-12)
    np.testing.assert_array_equal(centred[4:], plain[4:])


def test_rain_on_one_member_does_not_move_the_others():
    groups = member_groups((0,) * 6, EVERY)
    rained = np.array([0.01, -0.02, 0.0, 0.02, -0.01, -5.0])
    kept = without_group_gain(rained, np.zeros(6), groups)
    # the median moves by no more than the spread of the dry ones
    np.testing.assert_allclose(kept[:5], rained[:5], atol=0.02)
    assert kept[5] < -4.9


def test_too_few_members_tell_nothing_and_absent_ones_stay_absent():
    groups = member_groups((0,) * 6, EVERY)
    rows = np.array([[1.0, 2.0, NAN, NAN, NAN, NAN], [1.0, 2.0, 3.0, NAN, NAN, NAN]])
    kept = without_group_gain(rows, np.zeros((2, 6)), groups)
    assert np.isnan(kept[0]).all()
    np.testing.assert_allclose(kept[1, :3], [-1.0, 0.0, 1.0], atol=1e-12)
    assert np.isnan(kept[1, 3:]).all()


def test_without_groups_everything_stays_what_it_is():
    model = filter_models.carrier_model()
    response = exact_response(np.ones((6, 3)), np.zeros((6, 3, 3)))
    values = np.arange(6.0)
    assert centred_model(model, ()) is model
    assert centred_response(response, ()) is response
    assert without_group_gain(values, values, ()) is values


def test_the_filter_counts_patterns_from_the_groups_mean_and_keeps_its_rain_away():
    model = filter_models.carrier_model()
    groups = member_groups((0, 0, 0, *(-1,) * 9), np.ones(12, dtype=np.bool_))
    found = centred_model(model, groups)
    np.testing.assert_allclose(found.gradient_db_deg[:3].mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(found.hessian_db_deg2[:3].mean(axis=0), 0.0, atol=1e-12)
    assert found.rain_share[:3].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(found.gradient_db_deg[3:], model.gradient_db_deg[3:])
    np.testing.assert_array_equal(found.rain_share[3:], model.rain_share[3:])


def level_of(payload, ephemeris=None, **changes):
    result = payload.calibration(**changes).result
    model = geometry_model(result.geometry)
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
    return daily_error_db(geometry_model(result.geometry), result.geometry, ephemeris, START_US)


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
    model = geometry_model(result.geometry)
    at = expected_levels(model, result.geometry, payload.ephemeris())
    angle = 2.0 * np.pi * ((START_US % DAY_US) / DAY_US)
    solar = payload.solar_db @ np.array([np.cos(angle), np.sin(angle)])
    np.testing.assert_allclose(
        at(np.array([START_US]))[0] + solar, payload.power_dbm([START_US], np.zeros(3))[0], atol=1e-10
    )


CONFIG = RobustConfig()


@pytest.mark.parametrize("has_track", [True, False], ids=["dish law", "harmonics"])
def test_the_response_is_that_of_turned_direction_vectors(has_track):
    payload = FlightPayload.make(has_track=has_track)
    result = payload.calibration().result
    model = geometry_model(result.geometry)
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
    _, fit = with_beacon(payload)
    model = geometry_model(fit)
    assert model.positions.latitude_deg[2] == SITE.latitude_deg
    assert model.positions.longitude_deg[2] == SITE.longitude_deg
    np.testing.assert_array_equal(model.calibration.hessian[2], 0.0)
    np.testing.assert_array_equal(model.calibration.gradient[2], payload.downlink[payload.band()[2]])
    # the downlink's gradient alone: turned by the displacement of the site
    angles = np.array([0.0, 0.2, -0.1])
    moved = np.array([0.1, -0.2])
    change = predict_deviation(angles, model.response)[2]
    assert change == pytest.approx(moved @ payload.downlink[payload.band()[2]], abs=1e-3)
    untouched = geometry_model(payload.geometry())
    others = np.arange(16) != 2
    np.testing.assert_array_equal(model.response.slope[others], untouched.response.slope[others])


def test_the_filters_model_has_the_sizes_of_the_record():
    payload = FlightPayload.make()
    result = payload.calibration(common_noise=(NoiseComponent(3600.0, 0.04),)).result
    arrays = geometry_model(result.geometry)
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
    arrays = geometry_model(result.geometry)
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
    arrays = geometry_model(result.geometry)
    model = carrier_model(arrays, result.geometry, result.carriers, CONFIG)
    assert np.isfinite(model.gradient_db_deg).all()
    np.testing.assert_array_equal(model.gradient_db_deg[0], 0.0)
    np.testing.assert_array_equal(model.hessian_db_deg2[0], 0.0)
    np.testing.assert_array_equal(model.coefficient_covariance[0], 0.0)
    assert np.abs(model.gradient_db_deg[1:]).max() > 0.1
