"""Line of sight against an independent computation: topocentric azimuth and elevation, and the simulator's orbit."""

import numpy as np
import pytest

from analyzer_sim.world.orbit.geometry import antenna_frame_deg
from analyzer_sim.world.orbit.orbit import Orbit
from analyzer_sim.world.payload.carriers import PLANS
from analyzer_sim.world.payload.payload import plan_positions_km
from service.core.geometry.line_of_sight import (
    Positions,
    PredictedTrack,
    antenna_motion_deg,
    frame_turn_deg,
    sight_motion_deg,
    track_position_deg,
)

HALF_HOUR_US = 1_800_000_000
SEED = 5


def topocentric_deg(latitude_deg, longitude_deg, height_m, satellite_deg):
    """Azimuth and elevation in the sky of a station, by spherical trigonometry and the law of cosines only."""
    phi, lam = np.radians(latitude_deg), np.radians(longitude_deg)
    e2 = (2.0 - 1.0 / 298.257223563) / 298.257223563
    curvature = 6_378_137.0 / np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    radius_m = 42_164_172.0
    sat = np.radians(satellite_deg)
    x = np.array([np.cos(sat[0]) * np.cos(sat[1] - lam), np.cos(sat[0]) * np.sin(sat[1] - lam), np.sin(sat[0])])
    x = radius_m * x - np.array(
        [(curvature + height_m) * np.cos(phi), 0.0, (curvature * (1.0 - e2) + height_m) * np.sin(phi)]
    )
    up = x[0] * np.cos(phi) + x[2] * np.sin(phi)
    north = -x[0] * np.sin(phi) + x[2] * np.cos(phi)
    return np.degrees(np.arctan2(x[1], north)), np.degrees(np.arctan2(up, np.hypot(x[1], north)))


@pytest.mark.parametrize(("latitude_deg", "longitude_deg"), [(55.75, 37.6), (46.96, 142.7), (-33.0, 80.0)])
def test_length_of_the_motion_is_that_of_the_topocentric_angles(latitude_deg, longitude_deg):
    """The arc between two places in the sky does not depend on the axes that measure it."""
    station = Positions(np.array([latitude_deg]), np.array([longitude_deg]), np.array([120.0]))
    nominal = topocentric_deg(latitude_deg, longitude_deg, 120.0, np.array([0.0, 90.0]))
    for position in ([0.05, 90.03], [-0.04, 90.0], [0.0, 89.95]):
        azimuth, elevation = topocentric_deg(latitude_deg, longitude_deg, 120.0, np.array(position))
        across = (azimuth - nominal[0]) * np.cos(np.radians(nominal[1]))
        arc = np.hypot(across, elevation - nominal[1])
        motion = sight_motion_deg(np.array([position]), station, 90.0)[0, 0]
        # plane against sphere: second order in 0.06 deg times the tangent of the elevation
        assert np.hypot(*motion) == pytest.approx(arc, rel=2e-3)


def test_moving_east_is_positive_and_moving_north_is_up_or_tilted():
    """Below the satellite East is along and North is across."""
    below = Positions(np.zeros(1), np.array([90.0]), np.zeros(1))
    east, north = (
        sight_motion_deg(np.array([position]), below, 90.0)[0, 0] for position in ([0.0, 90.01], [0.01, 90.0])
    )
    # 42164 / 35786 is the ratio of the distances from the centre and from the station
    assert east == pytest.approx([0.01 * 42164.172 / 35786.035, 0.0], abs=1e-6)
    assert north == pytest.approx([0.0, 0.01 * 42164.172 / 35786.035], abs=1e-6)


def orbit_and_track():
    orbit = Orbit.drawn(SEED, 90.0, 0)
    epochs_us = np.arange(-10 * HALF_HOUR_US, 150 * HALF_HOUR_US, HALF_HOUR_US, dtype=np.int64)
    return orbit, PredictedTrack(epochs_us, *orbit.sub_satellite_deg(epochs_us))


def test_track_is_interpolated_to_a_millionth_of_a_degree():
    """Half-hour points carry the daily motion."""
    orbit, track = orbit_and_track()
    epochs_us = np.arange(0, 86_400_000_000, 611_000_000, dtype=np.int64)
    truth = np.stack(orbit.sub_satellite_deg(epochs_us), axis=1)
    # the fourth difference of 0.05 deg a day is 0.05 (w h)^4 = 1.5e-5 deg; a cubic leaves 3 / 128 of it
    assert np.abs(track_position_deg(track, epochs_us) - truth).max() < 1e-6


def test_outside_the_track_and_on_short_tracks_nothing_is_known():
    """Ballistics is not extrapolated."""
    _, track = orbit_and_track()
    outside_us = np.array([track.epoch_us[0] - 1, track.epoch_us[-1] + 1])
    assert np.isnan(track_position_deg(track, outside_us)).all()
    assert np.isfinite(track_position_deg(track, track.epoch_us[[0, -1]])).all()
    short = PredictedTrack(*(column[:3] for column in track))
    assert np.isnan(track_position_deg(short, track.epoch_us[:3])).all()


def test_antenna_motion_is_that_of_the_simulated_satellite():
    """The simulator turns its own frame by its own orbit; only the wandering distance is not in the track."""
    orbit, track = orbit_and_track()
    epochs_us = np.arange(0, 2 * 86_400_000_000, 3_600_000_000, dtype=np.int64)
    plan = PLANS["ku16"]
    stations = [carrier.station for carrier in plan.carriers] + [plan.receiving_site]
    positions = Positions(
        *(np.array([getattr(s, name) for s in stations]) for name in ("latitude_deg", "longitude_deg", "height_m"))
    )
    still = Orbit(90.0, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
    seen = [
        np.stack(
            antenna_frame_deg(o.orbital_from_earth(epochs_us), o.position_km(epochs_us), plan_positions_km(plan)), -1
        )
        for o in (orbit, still)
    ]
    motion = antenna_motion_deg(track, epochs_us, positions, 90.0)
    print(f"seed {SEED}: largest antenna motion {np.abs(motion).max():.4f} deg")
    assert np.abs(motion).max() > 0.005, "the orbit must move for the claim to mean anything"
    # distance: eccentricity 2.2e-4 times elevation 8.6 deg
    assert np.abs(motion - (seen[0] - seen[1])).max() < 0.0021


def test_an_inclined_orbit_turns_the_frame_about_nadir_and_a_drift_about_the_pole():
    epochs_us = HALF_HOUR_US * np.arange(49)
    day = 2.0 * np.pi * epochs_us / 86_164e6
    inclined = PredictedTrack(epochs_us, 0.05 * np.sin(day), np.full(49, 90.0))
    at_us = epochs_us[4:45]
    turn_deg = frame_turn_deg(inclined, at_us, 90.0)
    # at the node the flight is turned to the North; at its greatest latitude nadir is turned to the South
    np.testing.assert_allclose(turn_deg[:, 0], -0.05 * np.cos(day[4:45]), atol=2e-4)
    np.testing.assert_allclose(turn_deg[:, 1], -0.05 * np.sin(day[4:45]), atol=2e-4)
    moved = frame_turn_deg(PredictedTrack(epochs_us, np.zeros(49), np.full(49, 90.1)), at_us, 90.0)
    np.testing.assert_allclose(moved, np.broadcast_to([0.0, 0.0, -0.1], moved.shape), atol=1e-6)
    assert np.isnan(frame_turn_deg(inclined, epochs_us[:1], 90.0)).all()
