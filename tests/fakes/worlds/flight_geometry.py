"""Where the satellite of a flight stands, how its body is turned, and where it sees places: by rotation matrices.

Direction vectors are turned and angles read from them, where the product multiplies a displacement matrix. What the
two have apart is of second order: below 0.002 deg of displacement at 0.4 deg.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from service.core.geometry.frames import AntennaDirection, antenna_direction, body_from_nadir
from service.records.catalogue import Site
from service.records.levels.attitude import FloatArray

S = 1_000_000
MINUTE = 60 * S
HOUR = 3600 * S
START_US = 1_800_000_000 * S
PERIOD_S = 86_328.0
LONGITUDE_DEG = 90.0
INCLINATION_DEG = 0.05
SC = "yamal-test"
INERTIA = ((2600.0, 0.0, 0.0), (0.0, 1400.0, 0.0), (0.0, 0.0, 2600.0))
#: latitude and longitude, deg
CITIES = {
    "Moscow": (55.75, 37.62),
    "Murmansk": (68.97, 33.08),
    "Rostov": (47.23, 39.72),
    "Kazan": (55.79, 49.12),
    "Yekaterinburg": (56.84, 60.61),
    "Salekhard": (66.53, 66.60),
    "Omsk": (54.99, 73.37),
    "Novosibirsk": (55.03, 82.92),
    "Norilsk": (69.35, 88.20),
    "Kyzyl": (51.72, 94.44),
    "Irkutsk": (52.29, 104.28),
    "Chita": (52.03, 113.50),
    "Yakutsk": (62.03, 129.73),
    "Vladivostok": (43.12, 131.89),
    "Khabarovsk": (48.48, 135.07),
    "Magadan": (59.56, 150.80),
}
SITE = Site(55.75, 37.62, "Moscow")
TRANSPONDERS = ("C1", "Ku1", "Ku2", "Ku3")
BANDS = ("C", "Ku")
_EQUATOR_M, _FLATTENING, _ORBIT_M = 6_378_137.0, 1.0 / 298.257223563, 42_164_172.0
_EARTH_RATE = 7.292115e-5
NODE_US = START_US - 3 * HOUR


def positions_m(latitude_deg: FloatArray, longitude_deg: FloatArray) -> FloatArray:
    """Return Earth-fixed vectors of places on the ellipsoid, by their parametric latitude."""
    longitude, polar_m = np.radians(longitude_deg), _EQUATOR_M * (1.0 - _FLATTENING)
    reduced = np.arctan(polar_m / _EQUATOR_M * np.tan(np.radians(latitude_deg)))
    ring = _EQUATOR_M * np.cos(reduced)
    return np.stack([ring * np.cos(longitude), ring * np.sin(longitude), polar_m * np.sin(reduced)], axis=-1)


def turned(angle_rad: float, axis: int) -> FloatArray:
    """Return the matrix of a turn of the frame about one axis."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    one, two = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[one, one] = matrix[two, two] = c
    matrix[one, two], matrix[two, one] = s, -s
    return matrix


def turn_rad(epochs_us: Any) -> FloatArray:
    """Return the phase since the ascending node."""
    return np.asarray(2.0 * np.pi * (np.asarray(epochs_us, dtype=np.float64) - NODE_US) / (PERIOD_S * S))


def orbit_deg(epochs_us: Any) -> FloatArray:
    """Return latitude and longitude (T, 2) of the sub-satellite point."""
    turn = turn_rad(epochs_us)
    return np.stack([INCLINATION_DEG * np.sin(turn), LONGITUDE_DEG + 0.015 * np.sin(turn + 1.0)], axis=-1)


def satellite_m(place_deg: FloatArray) -> FloatArray:
    latitude, longitude = np.radians(place_deg[..., 0]), np.radians(place_deg[..., 1])
    ring = np.cos(latitude)
    vector = np.stack([ring * np.cos(longitude), ring * np.sin(longitude), np.sin(latitude)], axis=-1)
    return np.asarray(_ORBIT_M * vector)


def body_axes(here_m: FloatArray, velocity_m_s: FloatArray, angles_deg: FloatArray) -> FloatArray:
    """Return the body's axes as rows (T, 3, 3), Earth-fixed, of a body held to the nadir frame but for its angles."""
    velocity = velocity_m_s + np.cross(np.array([0.0, 0.0, _EARTH_RATE]), here_m)
    nadir = -here_m / np.linalg.norm(here_m, axis=-1, keepdims=True)
    south = np.cross(nadir, velocity)
    south /= np.linalg.norm(south, axis=-1, keepdims=True)
    frame = np.stack([np.cross(south, nadir), south, nadir], axis=-2)
    yaw, roll, pitch = np.radians(angles_deg).T
    turns = [turned(r, 0) @ turned(p, 1) @ turned(y, 2) for y, r, p in zip(yaw, roll, pitch, strict=True)]
    return np.asarray(np.array(turns).reshape(-1, 3, 3) @ frame)


def antenna_deg(here_m: FloatArray, axes: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return azimuth and elevation (T, N, 2) of places in the body frame."""
    sight = np.einsum("tij,tnj->tni", axes, positions_m - here_m[:, None])
    angles = [np.arctan(sight[..., 0] / sight[..., 2]), np.arctan(-sight[..., 1] / sight[..., 2])]
    return np.asarray(np.degrees(np.stack(angles, axis=-1)))


def turned_direction(direction: AntennaDirection, attitude_deg: ArrayLike) -> AntennaDirection:
    """Return where directions known at zero attitude are seen by the turned body.

    Parameters
    ----------
    direction : AntennaDirection
        Angles at zero attitude, shape (N,).
    attitude_deg : array_like, shape (..., 3), deg
        Yaw, roll, pitch.

    Returns
    -------
    AntennaDirection
        Angles in the body, shape (..., N); exact, not to first order.
    """
    return antenna_direction(direction_vector(direction) @ np.swapaxes(body_from_nadir(attitude_deg), -1, -2))


def direction_vector(direction: AntennaDirection) -> FloatArray:
    """Return unit vectors, shape (..., 3), of antenna angles that lie within 90 degrees of the axis."""
    east = np.tan(np.radians(direction.azimuth_deg))
    north = np.tan(np.radians(direction.elevation_deg))
    vector = np.stack([east, -north, np.ones_like(east)], axis=-1)
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))
