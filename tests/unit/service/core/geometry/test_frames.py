"""Frames, quaternions, the line of sight and the phase from the node."""

import math

import numpy as np
import pytest
from flight_geometry import turned_direction
from hypothesis import given
from hypothesis import strategies as st

from analyzer_sim.world.orbit import Orbit, antenna_frame_deg
from analyzer_sim.world.payload.carriers import PLANS
from analyzer_sim.world.payload.level_terms import plan_positions_km
from service.core.geometry.frames import (
    EARTH_EQUATORIAL_RADIUS_M,
    GEOSTATIONARY_RADIUS_M,
    AntennaDirection,
    attitude_of_quaternion,
    body_from_nadir,
    matrix_of_quaternion,
    quaternion_of_attitude,
    quaternion_of_matrix,
    station_direction,
    with_continuous_sign,
)
from service.core.geometry.line_of_sight import (
    Positions,
    PredictedTrack,
    antenna_motion_deg,
    frame_turn_deg,
    latest_node_us,
    node_phase_at_rad,
    node_phase_rad,
    sight_motion_deg,
    track_position_deg,
)

STATION = AntennaDirection(np.array([-4.0, 0.0, 4.5]), np.array([7.5, 6.3, 8.4]))


def change_deg(attitude_deg):
    turned = turned_direction(STATION, attitude_deg)
    return turned.azimuth_deg - STATION.azimuth_deg, turned.elevation_deg - STATION.elevation_deg


def test_positive_roll_moves_a_station_south_by_as_much():
    _, south = change_deg([0.0, 0.1, 0.0])
    np.testing.assert_allclose(south, -0.1, rtol=0.0, atol=1e-4)  # second order: 0.1 deg * 0.1 deg in rad


def test_positive_pitch_moves_a_station_west_by_as_much():
    west, _ = change_deg([0.0, 0.0, 0.1])
    np.testing.assert_allclose(west, -0.1, rtol=0.0, atol=1e-4)  # second order


def test_positive_yaw_turns_the_field_as_the_design_says():
    east, north = change_deg([0.1, 0.0, 0.0])
    elevation_rad, azimuth_rad = np.radians(STATION.elevation_deg), np.radians(STATION.azimuth_deg)
    # the design's law is first order in the antenna angles; at 8.4 deg it is 1-2 per cent short
    np.testing.assert_allclose(east, -0.1 * elevation_rad, rtol=0.03, atol=0.0)
    np.testing.assert_allclose(north, 0.1 * azimuth_rad, rtol=0.03, atol=2e-5)  # second order of 0.1 deg


def test_small_turns_follow_the_law_with_its_cosines():
    yaw, roll, pitch = 0.02, -0.03, 0.04
    east, north = change_deg([yaw, roll, pitch])
    ta, te = np.tan(np.radians(STATION.azimuth_deg)), np.tan(np.radians(STATION.elevation_deg))
    expected_east = -pitch - (yaw * te + roll * ta * te) / (1.0 + ta**2)
    expected_north = -roll + (yaw * ta - pitch * ta * te) / (1.0 + te**2)
    np.testing.assert_allclose(east, expected_east, rtol=0.0, atol=5e-5)  # second order of 0.04 deg
    np.testing.assert_allclose(north, expected_north, rtol=0.0, atol=5e-5)  # second order of 0.04 deg


def test_the_rotation_is_yaw_then_pitch_then_roll():
    yaw, roll, pitch = np.eye(3) * 30.0
    expected = body_from_nadir(roll) @ body_from_nadir(pitch) @ body_from_nadir(yaw)
    np.testing.assert_allclose(body_from_nadir([30.0, 30.0, 30.0]), expected, rtol=0.0, atol=1e-15)  # rounding


def test_the_sub_satellite_point_lies_on_the_axis():
    below = station_direction([90.0], [0.0], [0.0], 90.0)
    np.testing.assert_allclose(below, 0.0, rtol=0.0, atol=1e-12)  # rounding


def test_a_northern_eastern_station_has_positive_angles():
    seen = station_direction([100.0], [50.0], [0.0], 90.0)
    assert seen.azimuth_deg[0] > 0.5
    assert seen.elevation_deg[0] > 5.0


def test_the_limb_on_the_equator_is_where_the_triangle_says():
    limb_deg = math.degrees(math.acos(EARTH_EQUATORIAL_RADIUS_M / GEOSTATIONARY_RADIUS_M))
    seen = station_direction([limb_deg - 1e-6, limb_deg + 1e-6], [0.0, 0.0], [0.0, 0.0], 0.0)
    half_angle_deg = math.degrees(math.asin(EARTH_EQUATORIAL_RADIUS_M / GEOSTATIONARY_RADIUS_M))
    assert seen.azimuth_deg[0] == pytest.approx(half_angle_deg, abs=1e-9)  # the tangent point is an extremum
    assert np.isnan(seen.azimuth_deg[1])
    assert np.isnan(seen.elevation_deg[1])


def test_russia_from_90_east_fills_the_published_box():
    cities_deg = {
        "Kaliningrad": (20.5, 54.7),
        "Sochi": (39.7, 43.6),
        "Vladivostok": (131.9, 43.1),
        "Norilsk": (88.2, 69.3),
    }
    longitude_deg, latitude_deg = np.array(list(cities_deg.values())).T
    seen = station_direction(longitude_deg, latitude_deg, np.zeros(4), 90.0)
    # spec: elevation 6.3 to 8.5 deg, azimuth -5.2 to +5.0 deg, printed to a tenth
    assert np.all((seen.elevation_deg > 6.2) & (seen.elevation_deg < 8.6))
    assert np.all((seen.azimuth_deg > -5.3) & (seen.azimuth_deg < 5.1))


def test_flattening_moves_moscow_by_the_difference_of_the_latitudes():
    moscow = station_direction([37.6], [55.75], [150.0], 90.0)
    geocentric = math.atan((1.0 - 1.0 / 298.257223563) ** 2 * math.tan(math.radians(55.75)))
    radius_m = math.hypot(math.cos(geocentric), math.sin(geocentric)) * 6_363_750.0  # local radius within 2 km
    east = radius_m * math.cos(geocentric) * math.sin(math.radians(37.6 - 90.0))
    down = GEOSTATIONARY_RADIUS_M - radius_m * math.cos(geocentric) * math.cos(math.radians(37.6 - 90.0))
    assert moscow.azimuth_deg[0] == pytest.approx(math.degrees(math.atan2(east, down)), abs=0.003)  # 2 km of 40 000
    north = radius_m * math.sin(geocentric)
    assert moscow.elevation_deg[0] == pytest.approx(math.degrees(math.atan2(north, down)), abs=0.003)  # the same


def _frame_rotation(axis, angle_deg):
    """Return the matrix that changes vectors into a frame turned about one of its axes."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix[j, j] = matrix[k, k] = cosine
    matrix[j, k], matrix[k, j] = sine, -sine
    return matrix


def test_golden_vector_of_a_flown_message():
    # A message of the Magnetospheric Multiscale mission gives the same attitude as ZXZ angles and as a quaternion.
    matrix = _frame_rotation(2, -144.066452) @ _frame_rotation(0, 25.098268) @ _frame_rotation(2, 5.798977)
    golden = np.array([0.056482, 0.209807, -0.912091, 0.347679])
    assert quaternion_of_matrix(matrix) == pytest.approx(golden, abs=2e-6)
    assert np.abs(matrix_of_quaternion(golden) - matrix).max() < 5e-6
    # the conjugate, which a mistaken sense of rotation gives, is far away
    assert np.abs(quaternion_of_matrix(matrix.T) - golden).max() > 0.1


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_matrix_and_quaternion_are_inverse(parts):
    quaternion = np.array(parts) / np.linalg.norm(parts)
    matrix = matrix_of_quaternion(quaternion)
    assert np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-14
    again = quaternion_of_matrix(matrix)
    assert min(np.abs(again - quaternion).max(), np.abs(again + quaternion).max()) < 1e-14
    assert again[3] >= 0.0


@given(st.floats(-179.0, 179.0), st.floats(-179.0, 179.0), st.floats(-89.0, 89.0))
def test_attitude_there_and_back(yaw, roll, pitch):
    attitude_deg = np.array([yaw, roll, pitch])
    quaternion = quaternion_of_attitude(attitude_deg)
    assert np.abs(matrix_of_quaternion(quaternion) - body_from_nadir(attitude_deg)).max() < 1e-14
    assert attitude_of_quaternion(quaternion) == pytest.approx(attitude_deg, abs=1e-11)


@pytest.mark.parametrize(("axis", "position"), [(0, 1), (1, 2), (2, 0)], ids=["roll", "pitch", "yaw"])
def test_small_angles_stand_at_the_place_of_their_axis(axis, position):
    attitude_deg = np.zeros(3)
    attitude_deg[position] = 0.4
    quaternion = quaternion_of_attitude(attitude_deg)
    assert quaternion[axis] == pytest.approx(np.sin(np.radians(0.2)), abs=1e-15)
    assert np.delete(quaternion, axis) == pytest.approx([0.0, 0.0, np.cos(np.radians(0.2))], abs=1e-15)


def test_sign_is_continuous_through_a_full_turn():
    attitude_deg = np.zeros((721, 3))
    attitude_deg[:, 0] = np.linspace(0.0, 720.0, 721)
    plain = quaternion_of_attitude(attitude_deg)
    smooth = with_continuous_sign(plain)
    assert np.abs(np.diff(plain, axis=0)).max() > 1.0
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.01
    assert smooth[360] == pytest.approx(-smooth[0], abs=1e-12)


def test_one_row_has_nothing_to_be_continuous_with():
    assert with_continuous_sign([[0.0, 0.0, 0.0, -1.0]])[0, 3] == -1.0


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


PERIOD_S = 86_328.0  # 23.98 h, the paper's
PERIOD_US = 86_328_000_000
NODES_US = np.array([1_000_000, 1_000_000 + PERIOD_US, 1_000_000 + 2 * PERIOD_US])


LATE_US = NODES_US[0] + PERIOD_US + 60_000_000


@pytest.mark.parametrize(
    ("epoch_us", "nodes_us", "expected_us"),
    [
        pytest.param(NODES_US, NODES_US, NODES_US, id="its own"),
        pytest.param(NODES_US - 1, NODES_US, NODES_US - PERIOD_US, id="one microsecond before it is the one before"),
        pytest.param(NODES_US - 3 * PERIOD_US - 1, NODES_US, NODES_US - 4 * PERIOD_US, id="long before the list"),
        pytest.param(NODES_US + 5 * PERIOD_US + 7, NODES_US, NODES_US + 5 * PERIOD_US, id="long after the list"),
        pytest.param(
            [LATE_US - 1, LATE_US], [NODES_US[0], LATE_US], [NODES_US[0], LATE_US], id="late, not anticipated"
        ),
        pytest.param(NODES_US[1:2] + 5, NODES_US[[0, 2]], NODES_US[1:2], id="in a hole of the list"),
    ],
)
def test_the_latest_node(epoch_us, nodes_us, expected_us):
    assert latest_node_us(np.array(epoch_us), np.array(nodes_us), PERIOD_S).tolist() == list(expected_us)


def test_the_phase_stays_below_one_turn_when_a_node_comes_late():
    nodes_us = np.array([0, PERIOD_US + 60_000_000])
    phase_rad = node_phase_rad(np.array([PERIOD_US, PERIOD_US + 30_000_000]), nodes_us, PERIOD_S)
    # 30 s of 23.98 h is 2.2e-3 rad; float64 keeps 1e-12 of it
    np.testing.assert_allclose(phase_rad, [0.0, 2.0 * math.pi * 30.0 / PERIOD_S], rtol=0.0, atol=1e-12)


def test_the_phase_covers_the_turn_and_never_reaches_it():
    phase_rad = node_phase_rad(np.array([0, PERIOD_US // 4, PERIOD_US - 1]), np.array([0]), PERIOD_S)
    np.testing.assert_allclose(phase_rad[:2], [0.0, math.pi / 2.0], rtol=0.0, atol=1e-12)  # rounding of float64
    assert math.pi < phase_rad[2] < 2.0 * math.pi


@pytest.mark.parametrize("period_s", [0.0, -1.0, math.nan, math.inf])
def test_without_a_usable_period_the_phase_is_absent_and_a_node_is_an_error(period_s):
    assert np.isnan(node_phase_rad(NODES_US, NODES_US, period_s)).all()
    assert math.isnan(node_phase_at_rad(0, (0,), period_s))
    with pytest.raises(ValueError, match="period"):
        latest_node_us(NODES_US, NODES_US, period_s)


def test_without_nodes_the_phase_is_absent_and_a_node_is_an_error():
    none = np.array([], dtype=np.int64)
    assert np.isnan(node_phase_rad(NODES_US, none, PERIOD_S)).all()
    assert math.isnan(node_phase_at_rad(0, (), PERIOD_S))
    with pytest.raises(ValueError, match="listed node"):
        latest_node_us(NODES_US, none, PERIOD_S)
