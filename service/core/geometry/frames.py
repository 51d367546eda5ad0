"""Frames: nadir, body, antenna angles, where the satellite sees an earth station; quaternions, scalar last."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from service.core.arrays import FloatArray

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


def quaternion_of_matrix(matrix: ArrayLike) -> FloatArray:
    """Return unit quaternions, scalar last, of matrices of frame rotations.

    Parameters
    ----------
    matrix : array_like, shape (..., 3, 3)
        Orthogonal, determinant +1, ``v_B = R v_A``.

    Returns
    -------
    ndarray, shape (..., 4)
        With ``qc >= 0``; accurate to rounding for every rotation: the largest of the four squared components is
        computed from the diagonal, the others from it (Shepperd, J. Guidance 1 (3), 1978).

    Examples
    --------
    >>> quaternion_of_matrix([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).round(6)
    array([0.      , 0.      , 0.707107, 0.707107])
    """
    r = np.asarray(matrix, dtype=np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    # four times the outer product of the quaternion with itself: any of its rows is the quaternion, unscaled
    outer = np.empty((*r.shape[:-2], 4, 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        outer[..., i, i] = 1.0 + 2.0 * r[..., i, i] - trace
        outer[..., i, j] = outer[..., j, i] = r[..., i, j] + r[..., j, i]
        outer[..., i, 3] = outer[..., 3, i] = r[..., j, k] - r[..., k, j]
    outer[..., 3, 3] = 1.0 + trace
    largest = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    row = np.take_along_axis(outer, largest[..., np.newaxis, np.newaxis], axis=-2)[..., 0, :]
    unit = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.asarray(np.where(unit[..., 3:] < 0.0, -unit, unit))


def matrix_of_quaternion(quaternion: ArrayLike) -> FloatArray:
    """Return the matrices of frame rotations, shape (..., 3, 3), of quaternions (..., 4), scalar last, of any length.

    Examples
    --------
    >>> matrix_of_quaternion([0.0, 0.0, 1.0, 1.0]).round(6) @ np.array([1.0, 0.0, 0.0])
    array([ 0., -1.,  0.])
    """
    q = np.asarray(quaternion, dtype=np.float64)
    unit = q / np.linalg.norm(q, axis=-1, keepdims=True)
    vector, scalar = unit[..., :3], unit[..., 3, np.newaxis, np.newaxis]
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    cross = np.stack(
        [np.stack([zero, -z, y], axis=-1), np.stack([z, zero, -x], axis=-1), np.stack([-y, x, zero], axis=-1)], axis=-2
    )
    dyad = vector[..., :, np.newaxis] * vector[..., np.newaxis, :]
    length_2 = np.sum(vector**2, axis=-1)[..., np.newaxis, np.newaxis]
    return np.asarray((scalar**2 - length_2) * np.eye(3) + 2.0 * dyad - 2.0 * scalar * cross)


def quaternion_of_attitude(attitude_deg: ArrayLike) -> FloatArray:
    """Return unit quaternions nadir frame -> body, shape (..., 4), scalar last, of attitudes.

    Parameters
    ----------
    attitude_deg : array_like, shape (..., 3), deg
        Yaw, roll, pitch.

    Examples
    --------
    >>> quaternion_of_attitude([90.0, 0.0, 0.0]).round(6)
    array([0.      , 0.      , 0.707107, 0.707107])
    """
    return quaternion_of_matrix(body_from_nadir(attitude_deg))


def attitude_of_quaternion(quaternion: ArrayLike) -> FloatArray:
    """Return attitudes (yaw, roll, pitch; deg), shape (..., 3), of quaternions nadir frame -> body, scalar last.

    Pitch lies within 90 degrees; at exactly 90 degrees yaw and roll are not told apart.

    Examples
    --------
    >>> attitude_of_quaternion(quaternion_of_attitude([0.2, -0.1, 0.05])).round(9)
    array([ 0.2 , -0.1 ,  0.05])
    """
    r = matrix_of_quaternion(quaternion)
    yaw = np.arctan2(r[..., 0, 1], r[..., 0, 0])
    pitch = -np.arcsin(np.clip(r[..., 0, 2], -1.0, 1.0))
    roll = np.arctan2(r[..., 1, 2], r[..., 2, 2])
    return np.asarray(np.degrees(np.stack([yaw, roll, pitch], axis=-1)))


def with_continuous_sign(quaternion: ArrayLike) -> FloatArray:
    """Return a sequence of quaternions, shape (T, 4), whose neighbours lie on the same half of the sphere.

    Interpolation between neighbours of opposite sign would pass through a rotation that never was.

    Examples
    --------
    >>> with_continuous_sign([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -0.1, -1.0], [0.0, 0.0, 0.1, 1.0]])[:, 3]
    array([1., 1., 1.])
    """
    q = np.asarray(quaternion, dtype=np.float64)
    if len(q) < 2:
        return q.copy()
    step = np.where(np.sum(q[1:] * q[:-1], axis=-1) < 0.0, -1.0, 1.0)
    return np.asarray(q * np.concatenate([[1.0], np.cumprod(step)])[:, np.newaxis])
