"""Claims about frames: the sign conventions of the design, exactness of the rotation, station angles."""

import math

import numpy as np
import pytest
from flight_geometry import direction_vector, turned_direction

from service.core.geometry.frames import (
    EARTH_EQUATORIAL_RADIUS_M,
    GEOSTATIONARY_RADIUS_M,
    AntennaDirection,
    antenna_direction,
    body_from_nadir,
    station_direction,
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


def test_each_single_turn_is_about_its_own_axis():
    for angles, axis in ((0, 2), (1, 0), (2, 1)):  # yaw about z, roll about x, pitch about y
        matrix = body_from_nadir(np.eye(3)[angles] * 20.0)
        np.testing.assert_allclose(matrix @ np.eye(3)[axis], np.eye(3)[axis], rtol=0.0, atol=1e-15)  # rounding


def test_a_stack_of_attitudes_gives_a_stack_of_matrices():
    attitudes = np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 0.0]])
    stack = body_from_nadir(attitudes)
    assert np.array_equal(stack[1], body_from_nadir(attitudes[1]))
    turned = turned_direction(STATION, attitudes)
    assert turned.azimuth_deg.shape == (2, 3)


def test_angles_survive_the_way_through_a_vector():
    back = antenna_direction(direction_vector(STATION))
    np.testing.assert_allclose(back, STATION, rtol=0.0, atol=1e-13)  # rounding of tan and atan2


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
