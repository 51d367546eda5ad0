"""Signs and sizes of the antenna frame against the first-order formulas."""

import numpy as np
import pytest

from analyzer_sim.world.orbit.geometry import (
    GEO_RADIUS_KM,
    antenna_angles_deg,
    antenna_frame_deg,
    body_from_orbital,
    dish_motion_deg,
    orbital_from_earth,
    station_position_km,
)

SATELLITE_KM = np.array([[0.0, GEO_RADIUS_KM, 0.0]])  # 90 deg East
NORMAL = np.array([[0.0, 0.0, 1.0]])
MOSCOW_KM = station_position_km(55.75, 37.62)[None, :]


def displaced_deg(yaw: float, roll: float, pitch: float, station_km: np.ndarray = MOSCOW_KM) -> tuple[float, float]:
    """Return how a station moves in the antenna frame."""
    orbital = orbital_from_earth(SATELLITE_KM, NORMAL)
    az0, el0 = antenna_frame_deg(orbital, SATELLITE_KM, station_km)
    turned = body_from_orbital(np.array([[yaw, roll, pitch]])) @ orbital
    az, el = antenna_frame_deg(turned, SATELLITE_KM, station_km)
    return float((az - az0)[0, 0]), float((el - el0)[0, 0])


def test_russia_lies_north_and_moscow_west_of_the_nadir_from_90_east() -> None:
    az, el = antenna_frame_deg(orbital_from_earth(SATELLITE_KM, NORMAL), SATELLITE_KM, MOSCOW_KM)
    # figures of the geometry to two decimals: -4.08 and 7.48 deg
    assert az[0, 0] == pytest.approx(-4.08, abs=0.01)
    assert el[0, 0] == pytest.approx(7.48, abs=0.01)


@pytest.mark.parametrize(
    ("attitude", "expected"),
    [
        ((0.0, 0.1, 0.0), (0.0, -0.1)),  # +roll moves a station South
        ((0.0, 0.0, 0.1), (-0.1, 0.0)),  # +pitch moves it West
        ((0.1, 0.0, 0.0), (-0.1 * np.radians(7.48), 0.1 * np.radians(-4.08))),  # yaw: -yaw el, +yaw az
    ],
)
def test_small_turns_follow_the_signs(attitude: tuple[float, float, float], expected: tuple[float, float]) -> None:
    # 2 % of 0.1 deg: the first-order formulas are 1 % short at 8 deg from nadir
    assert displaced_deg(*attitude) == pytest.approx(expected, abs=0.002)


def test_exact_turns_agree_with_the_better_formulas_to_second_order() -> None:
    yaw, roll, pitch = 0.3, -0.2, 0.25
    az, el = (
        np.radians(a[0, 0])
        for a in antenna_frame_deg(orbital_from_earth(SATELLITE_KM, NORMAL), SATELLITE_KM, MOSCOW_KM)
    )
    ta, te = np.tan(az), np.tan(el)
    daz = -pitch * 1.0 - (yaw * te + roll * ta * te) * np.cos(az) ** 2
    d_el = -roll + (yaw * ta - pitch * ta * te) * np.cos(el) ** 2
    # second order of 0.3 deg turns: 0.3^2 pi/180 = 0.0016 deg
    assert displaced_deg(yaw, roll, pitch) == pytest.approx((daz, d_el), abs=0.0025)


def test_rotation_is_the_321_turn() -> None:
    def about(axis: int, angle_deg: float) -> np.ndarray:
        c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        turn = np.eye(3)
        turn[i, i] = turn[j, j] = c
        turn[i, j], turn[j, i] = s, -s
        return turn

    expected = about(0, 11.0) @ about(1, -7.0) @ about(2, 23.0)
    # rounding of products of cosines
    np.testing.assert_allclose(body_from_orbital(np.array([[23.0, 11.0, -7.0]]))[0], expected, atol=1e-15)


def test_antenna_angles_of_the_axes() -> None:
    az, el = antenna_angles_deg(np.array([[1.0, 0.0, 1.0], [0.0, -1.0, 1.0]]))
    np.testing.assert_allclose([az, el], [[45.0, 0.0], [0.0, 45.0]], atol=1e-12)  # East and North positive


def test_orbital_frame_looks_east_south_and_down() -> None:
    frame = orbital_from_earth(SATELLITE_KM, NORMAL)[0]
    # at 90 deg East: East = -x, South = -z, down = -y
    np.testing.assert_allclose(frame, [[-1, 0, 0], [0, 0, -1], [0, -1, 0]], atol=1e-15)


def test_station_position_stands_on_the_ellipsoid() -> None:
    # WGS-84 polar radius 6356.752 km, to a metre
    np.testing.assert_allclose(station_position_km(90.0, 0.0), [0.0, 0.0, 6356.752], atol=1e-3)
    np.testing.assert_allclose(station_position_km(0.0, 90.0, 1000.0), [0.0, 6379.137, 0.0], atol=1e-3)


def test_dish_sees_the_satellite_move_east_and_up() -> None:
    nominal = SATELLITE_KM[0]
    east = nominal + np.array([-42.0, 0.0, 0.0])
    north = nominal + np.array([0.0, 0.0, 42.0])
    motion = dish_motion_deg(station_position_km(55.0, 90.0), nominal, np.array([east, north]))
    # 42 km at some 39 300 km is 0.061 deg; a dish at 55 deg North sees the North as up
    assert motion[0, 0] == pytest.approx(0.061, abs=0.001)
    assert motion[1, 1] > 0.04
    assert abs(motion[1, 0]) < 1e-9
