"""Warnings of a calibration by geometry: each fires on its case and on no healthy one."""

from dataclasses import replace

import numpy as np
import pytest
from geometry_payload import GeometryPayload, turned_angles

from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.config import CalibrationConfig
from service.records.catalogue import Station, Track

CONFIG = CalibrationConfig()
#: first words of every warning of the joint fit
KINDS = (
    "quiet window",
    "no turn",
    "operation",
    "no track",
    "the daily change contradicts",
    "the sign of yaw",
    "the track covers",
    "the roll sensor",
    "c00 was silent",
    "c00 is flat",
    "c00 drifts",
    "check the coordinates of c00",
)


def kinds(data):
    """Return which kinds of warning a calibration has; the paper part's advice on numbers is not of the joint fit."""
    reported = [text for text in calibrate_geometry(data, CONFIG).warnings if not text.startswith("paper method")]
    found = {kind for kind in KINDS if any(text.startswith(kind) for text in reported)}
    assert len(found) == len(reported), reported
    return found


def with_column(data, k, change):
    parts = []
    for part in (data.quiet, data.turns):
        power = part.power_dbm.copy()
        power[:, k] = change(power[:, k], part.epochs_us)
        parts.append(replace(part, power_dbm=power))
    return replace(data, quiet=parts[0], turns=parts[1])


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_healthy_calibrations_are_silent(seed):
    assert kinds(GeometryPayload.make(8, seed=seed).data(noise_db=0.12)) == set()


def test_a_short_quiet_window():
    assert kinds(GeometryPayload.make(8, quiet_days=2.0).data()) == {"quiet window"}


@pytest.mark.parametrize(("axis", "sides"), [(0, "+yaw, -yaw"), (1, "+roll, -roll"), (2, "+pitch, -pitch")])
def test_an_axis_that_was_not_turned_is_named(axis, sides):
    turned = turned_angles()
    turned[:, axis] = 0.0
    payload = GeometryPayload.make(8)
    result = calibrate_geometry(payload.data(turned=turned), CONFIG)
    assert [text for text in result.warnings if f"towards {sides}:" in text]
    assert all(np.isnan(carrier.sensitivity_plus_db_per_deg[axis]) for carrier in result.carriers)
    assert np.isfinite(result.geometry.gradient).all()
    found = np.array([carrier.sensitivity_db_per_deg for carrier in result.carriers])
    # yaw is told by the stations' places; roll and pitch by 0.03 deg of motion over three days
    limit = {0: 0.02, 1: 0.3, 2: 0.3}[axis]
    assert np.abs(found - payload.slopes())[:, axis].max() < limit


def test_a_side_that_was_not_turned_is_named():
    turned = turned_angles()
    turned[turned[:, 1] < 0.0, 1] = 0.0
    result = calibrate_geometry(GeometryPayload.make(8).data(turned=turned), CONFIG)
    assert any("towards -roll: its slopes rest on one side" in text for text in result.warnings)


def test_no_track():
    payload = GeometryPayload.make(8)
    data = payload.data()
    assert kinds(replace(data, ephemeris=payload.ephemeris(is_tracked=False))) == {"no track"}


def moved(track, rows, east_deg=0.0):
    """Return a track that is some rows ahead, or that of a satellite farther East."""
    last = len(track.epochs_us) - 1
    ahead = [min(k + rows, last) for k in range(last + 1)]
    return Track(
        track.epochs_us,
        tuple(track.latitude_deg[k] for k in ahead),
        tuple(track.longitude_deg[k] + east_deg for k in ahead),
    )


@pytest.mark.parametrize(("rows", "east_deg"), [(6, 0.0), (12, 0.0), (0, 50.0), (10, 50.0)])
def test_a_track_that_the_daily_change_contradicts(rows, east_deg):
    """Half-hourly track: three and six hours ahead, and of satellites 50 deg away."""
    data = GeometryPayload.make(8).data(noise_db=0.12)
    wrong = replace(data.ephemeris, track=moved(data.ephemeris.track, rows, east_deg))
    assert kinds(replace(data, ephemeris=wrong)) == {"the daily change contradicts"}


def test_a_track_that_ends_too_early():
    data = GeometryPayload.make(8).data()
    reported = data.ephemeris.track
    stop = int(np.searchsorted(reported.epochs_us, data.request.turns.start_us - 86_400_000_000))
    track = Track(reported.epochs_us[48:stop], reported.latitude_deg[48:stop], reported.longitude_deg[48:stop])
    result = calibrate_geometry(replace(data, ephemeris=replace(data.ephemeris, track=track)), CONFIG)
    assert any(text.startswith("the track covers only") for text in result.warnings)


def test_a_noisy_sensor():
    warnings = calibrate_geometry(GeometryPayload.make(8).data(sensor_deg=0.12), CONFIG).warnings
    assert any(text.startswith("the roll sensor has a noise of 0.1") for text in warnings)
    assert not any("yaw sensor" in text for text in warnings)


def test_a_silent_carrier():
    data = with_column(GeometryPayload.make(8).data(), 0, lambda power, _: np.full_like(power, np.nan))
    assert kinds(data) == {"c00 was silent"}


def test_a_flat_carrier():
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    beam[0] = (0.02, 0.02, -0.05, 0.0, -0.05)
    flat = replace(payload, beam=beam, downlink=np.zeros((1, 2)))
    assert kinds(flat.data(noise_db=0.1)) == {"c00 is flat"}


def test_a_carrier_that_drifts():
    data = GeometryPayload.make(8).data()
    start_us = data.request.quiet.start_us
    drifting = with_column(data, 0, lambda power, us: power + 0.5 * (us - start_us) / 86_400e6)
    assert "c00 drifts" in kinds(drifting)


def test_a_station_in_another_country():
    """Sixty degrees of longitude, 5 deg in the antenna frame."""
    payload = GeometryPayload.make(8)
    beam = payload.beam.copy()
    beam[0, :2] = (-1.5, 1.5)
    data = replace(payload, beam=beam).data()
    carriers = list(data.plan.carriers)
    position = carriers[0].station
    carriers[0] = replace(carriers[0], station=Station(position.latitude_deg, position.longitude_deg - 60.0))
    wrong = replace(data, plan=replace(data.plan, carriers=tuple(carriers)))
    assert kinds(wrong) == {"check the coordinates of c00"}
