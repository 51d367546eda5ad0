"""Report of the beams: antennas and what a daily change of theirs proves, hours of turns, campaigns compared."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_flight import START_US, FlightPayload

from service.core.estimation.calibration.quadratic_response import predict_deviation
from service.pipeline.carrier_model.beam_report import HOUR_US, Group, HourlyMeans, WaveCause, beam_report
from service.pipeline.carrier_model.calibrated_arrays import geometry_model
from service.records.calibration import Window

SEED = 8
QUIET = Window(START_US - 72 * HOUR_US, START_US)
HOURS = 72
WAVE_DEG = 0.06


@pytest.fixture(scope="module")
def result():
    return FlightPayload.make(16).calibration().result


def two_bands(result):
    """Return the calibration with its carriers in two bands, so with two antennas."""
    fit = result.geometry
    half = len(result.carriers) // 2
    band = (0,) * half + (1,) * (len(result.carriers) - half)
    zeros = tuple(tuple(0.0 for _ in range(4)) for _ in range(np.array(fit.downlink_gain).shape[1]))
    return replace(
        result,
        geometry=replace(
            fit,
            bands=("C", "Ku"),
            band=band,
            rain_share=(0.1, 1.0),
            downlink=((0.0, 0.0),) * 2,
            downlink_covariance=tuple(map(tuple, 0.01 * np.eye(4))),
            downlink_gain=(zeros,) * len(result.carriers),
        ),
    )


def hours(result, waves, noise_db=0.01):
    """Return hours at held angles in which carriers see their antenna move; waves (N,) in deg to the North."""
    rng = np.random.default_rng(SEED)
    fit = result.geometry
    attitude = rng.normal(0.0, 0.02, (HOURS, 3))
    model = geometry_model(fit, result.carriers)
    north = np.array(waves) * np.cos(2 * np.pi * np.arange(HOURS) / 24.0)[:, None]
    deviation = predict_deviation(attitude, model.response) - np.array(fit.gradient)[:, 1] * north
    deviation += rng.normal(0.0, noise_db, deviation.shape)
    rows = np.full(deviation.shape, 60)
    start_us = START_US + HOUR_US * np.arange(HOURS)
    return HourlyMeans(start_us, deviation, rows, attitude, np.full(HOURS, 0.03))


def reported(result, waves, before=None, group=Group.BAND):
    return beam_report(result, result.geometry, QUIET, before, hours(result, waves), group)


def test_one_antenna_may_be_the_sensor(result):
    (antenna,) = reported(result, np.full(16, WAVE_DEG)).antennas
    print("seed", SEED, antenna.north.daily, antenna.east.daily)
    assert antenna.cause is WaveCause.ANTENNA_OR_SENSOR
    assert antenna.north.daily.amplitude_deg == pytest.approx(WAVE_DEG, abs=0.008)
    assert antenna.east.daily.amplitude_deg < 0.01
    (still,) = reported(result, np.zeros(16)).antennas
    assert still.cause is WaveCause.NONE


@pytest.mark.parametrize(
    ("first", "second", "causes"),
    [
        (WAVE_DEG, 0.0, (WaveCause.ANTENNA, WaveCause.NONE)),
        (WAVE_DEG, WAVE_DEG, (WaveCause.BODY_OR_SENSOR, WaveCause.BODY_OR_SENSOR)),
        (0.0, 0.0, (WaveCause.NONE, WaveCause.NONE)),
    ],
    ids=["one moves", "both move alike", "neither"],
)
def test_only_a_difference_of_antennas_is_proven(result, first, second, causes):
    both = two_bands(result)
    found = reported(both, [first] * 8 + [second] * 8).antennas
    assert [one.antenna for one in found] == ["C", "Ku"]
    assert tuple(one.cause for one in found) == causes


def test_transponders_of_few_carriers_are_no_antenna(result):
    found = reported(result, np.zeros(16), group=Group.TRANSPONDER)
    held = np.bincount(result.geometry.transponder)
    assert len(found.antennas) == np.count_nonzero(held >= 5)
    assert len(found.stations) == 16


def test_hours_of_a_turn_tell_nothing(result):
    told = hours(result, np.zeros(16))
    turning = told._replace(range_deg=np.where(np.arange(HOURS) < 5, 0.4, told.range_deg))
    report = beam_report(result, result.geometry, QUIET, None, turning, Group.BAND)
    assert report.is_turned.sum() == 5
    assert np.isnan(report.antennas[0].series.boresight_deg[:5]).all()
    assert np.isfinite(report.antennas[0].series.boresight_deg[5:]).all()


def test_beacons_and_level_control_tell_nothing(result):
    fit = replace(result.geometry, alc_group=(-1, 0, 0, 0) + (-1,) * 12)
    one = replace(result, geometry=replace(fit, station_azimuth_deg=(*fit.station_azimuth_deg[:15], float("nan"))))
    (antenna,) = reported(one, np.zeros(16)).antennas
    (plain,) = reported(result, np.zeros(16)).antennas
    left_out = {carrier.id for carrier in (*result.carriers[1:4], result.carriers[15])}
    assert left_out <= set(plain.carrier_ids)
    assert antenna.carrier_ids == tuple(name for name in plain.carrier_ids if name not in left_out)


def test_no_hours_give_stations_and_no_boresight(result):
    none = np.zeros((0, 16))
    hours_of_none = HourlyMeans(np.zeros(0, np.int64), none, none.astype(np.int64), np.zeros((0, 3)), np.zeros(0))
    report = beam_report(result, result.geometry, QUIET, None, hours_of_none, Group.BAND)
    assert len(report.stations) == 16
    assert np.isnan(report.antennas[0].north.mean_deg)
    assert report.antennas[0].cause is WaveCause.NONE


def test_beams_are_compared_with_those_of_the_campaign_before(result):
    assert all(np.isnan(one.change_sigmas) for one in reported(result, np.zeros(16)).stations)
    moved = list(map(list, result.geometry.gradient))
    sigma = np.sqrt(np.array(result.geometry.covariance)[2, -5, -5])
    moved[2][0] += 10.0 * sigma
    places = (*result.geometry.station_azimuth_deg[:15], result.geometry.station_azimuth_deg[15] + 1.0)
    before = replace(
        result,
        carriers=(*result.carriers[:5], replace(result.carriers[5], id="former"), *result.carriers[6:]),
        geometry=replace(result.geometry, gradient=tuple(map(tuple, moved)), station_azimuth_deg=places),
    )
    change = np.array([one.change_sigmas for one in reported(result, np.zeros(16), before).stations])
    assert change[2] > 5.0
    assert np.isnan(change[[5, 15]]).all(), "another carrier, and one that stood elsewhere"
    np.testing.assert_allclose(np.delete(change, [2, 5, 15]), 0.0, atol=1e-6)
