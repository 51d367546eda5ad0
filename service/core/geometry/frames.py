"""Frames: nadir, body, antenna angles, and where an earth station is seen from the satellite.

Nadir frame at the satellite: x East (flight), y South, z to the centre of the Earth. Body axes coincide with it at zero
attitude; the body is turned by yaw about z, then pitch about the new y, then roll about the new x (3-2-1). Antenna
angles of a direction ``u``: ``tan az = u_x / u_z`` (East positive), ``tan el = -u_y / u_z`` (North positive), so that
to first order (angles in rad) ``daz = -pitch - yaw el`` and ``del = -roll + yaw az``: positive roll moves a station
South, positive pitch moves it West. Attitude arrays are in degrees in the order yaw, roll, pitch; lengths in metres.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

#: m, radius of the geostationary orbit: (GM T^2 / 4 pi^2)^(1/3) with GM of WGS 84 and T the sidereal day.
GEOSTATIONARY_RADIUS_M = 42_164_172.0
#: m, equatorial radius of the Earth, WGS 84.
EARTH_EQUATORIAL_RADIUS_M = 6_378_137.0
#: Flattening of the Earth, WGS 84.
EARTH_FLATTENING = 1.0 / 298.257223563


class AntennaDirection(NamedTuple):
    """Direction in the antenna frame.

    Parameters
    ----------
    azimuth_deg : ndarray, deg
        East positive.
    elevation_deg : ndarray, deg
        North positive.
    """

    azimuth_deg: FloatArray
    elevation_deg: FloatArray


def body_from_nadir(attitude_deg: ArrayLike) -> FloatArray:
    """Return the matrix that turns vectors of the nadir frame into the body frame.

    Parameters
    ----------
    attitude_deg : array_like, shape (..., 3), deg
        Yaw, roll, pitch.

    Returns
    -------
    ndarray, shape (..., 3, 3)
        ``R1(roll) R2(pitch) R3(yaw)``, orthogonal, determinant +1.

    Examples
    --------
    >>> body_from_nadir([90.0, 0.0, 0.0]).round(12) @ np.array([1.0, 0.0, 0.0])
    array([ 0., -1.,  0.])
    """
    yaw, roll, pitch = np.moveaxis(np.radians(np.asarray(attitude_deg, dtype=np.float64)), -1, 0)
    cy, sy, cr, sr, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
    rows = [
        [cp * cy, cp * sy, -sp],
        [sr * sp * cy - cr * sy, sr * sp * sy + cr * cy, sr * cp],
        [cr * sp * cy + sr * sy, cr * sp * sy - sr * cy, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def antenna_direction(vector: FloatArray) -> AntennaDirection:
    """Return the antenna angles of vectors, shape (..., 3), in the frame in which they are given."""
    return AntennaDirection(
        np.degrees(np.arctan2(vector[..., 0], vector[..., 2])),
        np.degrees(np.arctan2(-vector[..., 1], vector[..., 2])),
    )


def station_direction(
    longitude_deg: ArrayLike,
    latitude_deg: ArrayLike,
    height_m: ArrayLike,
    subsatellite_longitude_deg: float,
) -> AntennaDirection:
    """Return where earth stations are seen from a geostationary satellite, in its nadir frame.

    Parameters
    ----------
    longitude_deg, latitude_deg : array_like, shape (N,), deg
        Geodetic coordinates, East and North positive.
    height_m : array_like, shape (N,), m
        Height above the ellipsoid.
    subsatellite_longitude_deg : float, deg
        East longitude of the satellite, which stands on the equator at the nominal radius.

    Returns
    -------
    AntennaDirection
        Shape (N,). NaN for a station that has the satellite below its horizon.

    Examples
    --------
    >>> moscow = station_direction([37.6], [55.75], [150.0], 90.0)
    >>> moscow.azimuth_deg.round(1), moscow.elevation_deg.round(1)
    (array([-4.1]), array([7.5]))
    """
    sight, zenith = _sight_and_zenith(longitude_deg, latitude_deg, height_m, subsatellite_longitude_deg)
    is_seen = np.sum(sight * zenith, axis=-1) < 0.0
    return antenna_direction(np.where(is_seen[..., np.newaxis], sight, math.nan))


def satellite_elevation_deg(
    longitude_deg: ArrayLike,
    latitude_deg: ArrayLike,
    height_m: ArrayLike,
    subsatellite_longitude_deg: float,
) -> FloatArray:
    """Return how high a geostationary satellite stands above the horizon of earth stations; no refraction.

    Parameters
    ----------
    longitude_deg, latitude_deg, height_m, subsatellite_longitude_deg
        As `station_direction` takes them.

    Returns
    -------
    ndarray, shape (N,), deg
        Negative below the horizon.

    Examples
    --------
    >>> satellite_elevation_deg([90.0, 37.6, -90.0], [0.0, 55.75, 0.0], 0.0, 90.0).round(1)
    array([ 90. ,  11.6, -90. ])
    """
    sight, zenith = _sight_and_zenith(longitude_deg, latitude_deg, height_m, subsatellite_longitude_deg)
    sine = -np.sum(sight * zenith, axis=-1) / np.linalg.norm(sight, axis=-1)
    elevation_deg: FloatArray = np.degrees(np.arcsin(np.clip(sine, -1.0, 1.0)))
    return elevation_deg


def _sight_and_zenith(
    longitude_deg: ArrayLike, latitude_deg: ArrayLike, height_m: ArrayLike, subsatellite_longitude_deg: float
) -> tuple[FloatArray, FloatArray]:
    """Return vectors from the satellite to stations, m, and unit vectors to their zenith, nadir frame, (N, 3) each."""
    east_of_satellite = np.radians(np.asarray(longitude_deg, dtype=np.float64) - subsatellite_longitude_deg)
    latitude = np.radians(np.asarray(latitude_deg, dtype=np.float64))
    height = np.asarray(height_m, dtype=np.float64)
    eccentricity_2 = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)
    prime_vertical = EARTH_EQUATORIAL_RADIUS_M / np.sqrt(1.0 - eccentricity_2 * np.sin(latitude) ** 2)
    across = (prime_vertical + height) * np.cos(latitude)
    south = -(prime_vertical * (1.0 - eccentricity_2) + height) * np.sin(latitude)
    sight = np.stack(
        [across * np.sin(east_of_satellite), south, GEOSTATIONARY_RADIUS_M - across * np.cos(east_of_satellite)],
        axis=-1,
    )
    zenith = np.stack(
        [
            np.cos(latitude) * np.sin(east_of_satellite),
            -np.sin(latitude),
            -np.cos(latitude) * np.cos(east_of_satellite),
        ],
        axis=-1,
    )
    return sight, zenith
