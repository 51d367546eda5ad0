"""Orbit: nodes, periods, frames, predicted track."""

import numpy as np
import pytest

from analyzer_sim.epochs import US_PER_DAY
from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S, Orbit, predicted_track

START_US = 1_793_491_200_000_000
DAYS = 6
EPOCHS_US = START_US + np.arange(DAYS * 144, dtype=np.int64) * 600_000_000


def drawn(seed: int) -> Orbit:
    return Orbit.drawn(seed, 90.0, START_US)


@pytest.mark.parametrize("seed", range(20))
def test_motion_and_nodal_period_stay_in_their_ranges(seed: int) -> None:
    orbit = drawn(seed)
    latitude, longitude = orbit.sub_satellite_deg(EPOCHS_US)
    assert 0.02 < np.abs(latitude).max() <= 0.05  # the paper's bound of the orbit's motion
    assert np.abs(longitude - 90.0).max() <= 0.05
    periods_h = np.diff(orbit.ascending_nodes_us(START_US, START_US + DAYS * US_PER_DAY)) / 3.6e9
    assert np.all((periods_h > 23.76) & (periods_h < 24.11))  # range of the method's description


def test_nodes_are_northward_crossings_to_a_microsecond() -> None:
    orbit = drawn(3)
    nodes = np.array(orbit.ascending_nodes_us(START_US, START_US + DAYS * US_PER_DAY))
    assert len(nodes) in {DAYS, DAYS + 1}
    before, after = (orbit.sub_satellite_deg(nodes + step)[0] for step in (-1, 0))
    assert np.all(before < 0.0)
    assert np.all(after >= 0.0)


def test_nodal_period_changes_as_the_node_drifts() -> None:
    nodes = np.array(drawn(1).ascending_nodes_us(START_US, START_US + DAYS * US_PER_DAY))
    assert np.ptp(np.diff(nodes)) > 1e6  # more than a second over six days


def test_orbital_frame_follows_the_inertial_motion() -> None:
    orbit = drawn(2)
    position = orbit.position_km(EPOCHS_US)
    velocity = np.gradient(position, 600.0, axis=0) + np.cross([0.0, 0.0, EARTH_RATE_RAD_S], position)
    normal = np.cross(position, velocity)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    south = orbit.orbital_from_earth(EPOCHS_US)[:, 1, :]
    # y = anti-normal; 1e-4 rad = 0.006 deg covers the one-sided differences at both ends
    np.testing.assert_allclose(south, -normal, atol=1e-4)


def test_frames_are_rotations() -> None:
    frames = drawn(5).orbital_from_earth(EPOCHS_US)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-14)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0, atol=1e-14)  # rounding


def test_predicted_track_is_close_and_not_exact() -> None:
    orbit = drawn(4)
    track = predicted_track(orbit, 4, START_US, START_US + DAYS * US_PER_DAY)
    latitude, longitude = orbit.sub_satellite_deg(track.epochs_us)
    error = np.abs([track.latitude_deg - latitude, track.longitude_deg - longitude])
    assert 1e-5 < error.max() < 0.006  # four sigmas of bias and wave together
    assert track.epochs_us[-1] >= START_US + DAYS * US_PER_DAY
