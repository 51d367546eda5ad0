"""Motion of the satellite in the sky of each station, of each station in the antenna frame, and along the orbit."""

import math
from bisect import bisect_right
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.geometry.frames import (
    EARTH_EQUATORIAL_RADIUS_M,
    EARTH_FLATTENING,
    GEOSTATIONARY_RADIUS_M,
    antenna_direction,
)

#: rad/s, rotation of the Earth (IERS conventions 2010).
EARTH_RATE_RAD_S = 7.292115e-5
#: us, half the stretch over which the rate of the track is taken.
_RATE_STEP_US = 300_000_000


class PredictedTrack(NamedTuple):
    """Predicted sub-satellite point at M >= 4 epochs in ascending order.

    Parameters
    ----------
    epoch_us : ndarray of int, shape (M,), microseconds UTC
        Epochs.
    latitude_deg, longitude_deg : ndarray, shape (M,), deg
        Geocentric latitude and absolute East longitude.
    """

    epoch_us: IntArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray


class Positions(NamedTuple):
    """Geodetic coordinates of N stations: latitude_deg, longitude_deg in deg, height_m in m, each of shape (N,)."""

    latitude_deg: FloatArray
    longitude_deg: FloatArray
    height_m: FloatArray


def track_position_deg(track: PredictedTrack, epoch_us: IntArray) -> FloatArray:
    """Return latitude and longitude of the sub-satellite point, shape (T, 2), deg.

    Parameters
    ----------
    track : PredictedTrack
        Prediction of ballistics.
    epoch_us : ndarray of int, shape (T,), microseconds UTC
        Epochs in any order.

    Returns
    -------
    ndarray, shape (T, 2), deg
        Cubic through the four nearest points. NaN outside the track, and everywhere with fewer than four points.

    Notes
    -----
    With points 30 min apart the error is below 1e-6 deg for daily motion of 0.05 deg.

    Examples
    --------
    >>> track = PredictedTrack(np.arange(5) * 10, np.arange(5.0) ** 2, np.full(5, 90.0))
    >>> track_position_deg(track, np.array([25, 99]))
    array([[ 6.25, 90.  ],
           [  nan,   nan]])
    """
    count = len(track.epoch_us)
    if count < 4:
        return np.full((len(epoch_us), 2), math.nan)
    points = np.stack([track.latitude_deg, track.longitude_deg], axis=1)
    behind = np.searchsorted(track.epoch_us, epoch_us, side="right") - 2
    first = np.minimum(np.maximum(behind, 0), count - 4)
    nodes = first[:, np.newaxis] + np.arange(4)
    # microseconds are subtracted as integers; seconds since the first node are exact enough for a cubic
    offset = (track.epoch_us[nodes] - epoch_us[:, np.newaxis]) / 1e6
    position = np.zeros((len(epoch_us), 2))
    for k in range(4):
        one, two, three = (-offset[:, j] / (offset[:, k] - offset[:, j]) for j in range(4) if j != k)
        position += (one * two * three)[:, np.newaxis] * points[nodes[:, k]]
    is_covered = (epoch_us >= track.epoch_us[0]) & (epoch_us <= track.epoch_us[-1])
    return np.where(is_covered[:, np.newaxis], position, math.nan)


def sight_motion_deg(position_deg: FloatArray, stations: Positions, nominal_longitude_deg: float) -> FloatArray:
    """Return where the satellite stands in the sky of each station, counted from its nominal place.

    Parameters
    ----------
    position_deg : ndarray, shape (T, 2), deg
        Latitude and longitude of the sub-satellite point.
    stations : Positions
        N stations.
    nominal_longitude_deg : float, deg
        East longitude at which the dishes were pointed.

    Returns
    -------
    ndarray, shape (T, N, 2), deg
        m1 along the station's horizontal, East positive, and m2 across it, up positive.

    Examples
    --------
    >>> below = Positions(np.zeros(1), np.array([90.0]), np.zeros(1))
    >>> sight_motion_deg(np.array([[0.0, 90.05]]), below, 90.0).round(4)
    array([[[0.0589, 0.    ]]])
    """
    positions_m = _station_vectors(stations)
    nominal_m = _satellite_vectors(np.array([[0.0, nominal_longitude_deg]]))[0]
    boresight = _unit(nominal_m - positions_m)
    # the nominal place is on the equator, so the pole is never along a boresight
    along = _unit(_cross(np.array([0.0, 0.0, 1.0]), boresight))
    across = _cross(boresight, along)
    sight = _satellite_vectors(position_deg)[:, np.newaxis] - positions_m
    depth = np.vecdot(sight, boresight)
    angles = [np.arctan2(np.vecdot(sight, axis), depth) for axis in (along, across)]
    return np.asarray(np.degrees(np.stack(angles, axis=-1)))


def antenna_motion_deg(
    track: PredictedTrack, epoch_us: IntArray, stations: Positions, nominal_longitude_deg: float
) -> FloatArray:
    """Return by how much each station moves in the antenna frame of a body held to the nadir frame.

    Parameters
    ----------
    track : PredictedTrack
        Prediction of ballistics.
    epoch_us : ndarray of int, shape (T,), microseconds UTC
        Epochs.
    stations : Positions
        N stations.
    nominal_longitude_deg : float, deg
        East longitude of the nominal place.

    Returns
    -------
    ndarray, shape (T, N, 2), deg
        Change of azimuth and elevation against the nominal place; NaN within 5 minutes of the ends of the track.
    """
    positions_m = _station_vectors(stations)
    moving, nominal = _moving(track, epoch_us), _at_rest(nominal_longitude_deg)
    return _antenna_angles_deg(*moving, positions_m) - _antenna_angles_deg(*nominal, positions_m)


def frame_turn_deg(track: PredictedTrack, epoch_us: IntArray, nominal_longitude_deg: float) -> FloatArray:
    """Return by how much a body held to the nadir frame turns against the Earth, counted from the nominal place.

    Parameters
    ----------
    track : PredictedTrack
        Prediction of ballistics.
    epoch_us : ndarray of int, shape (T,), microseconds UTC
        Epochs.
    nominal_longitude_deg : float, deg
        East longitude of the nominal place.

    Returns
    -------
    ndarray, shape (T, 3), deg
        Small turns about z, x, y of the frame, as yaw, roll, pitch turn the body; NaN within 5 minutes of the ends of
        the track.
    """
    frame, nominal = _nadir_frame(*_moving(track, epoch_us)), _nominal_frame(nominal_longitude_deg)
    turn = nominal @ np.swapaxes(frame, 1, 2)
    pairs = ((1, 0), (2, 1), (0, 2))
    return np.degrees(0.5 * np.stack([turn[:, j, k] - turn[:, k, j] for j, k in pairs], axis=1))


def _moving(track: PredictedTrack, epoch_us: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return place and inertial velocity (T, 3) of the satellite, m and m/s."""
    steps_us = np.array([[-_RATE_STEP_US], [0], [_RATE_STEP_US]])
    positions_deg = track_position_deg(track, (epoch_us + steps_us).ravel())
    behind, here, ahead = _satellite_vectors(positions_deg).reshape(3, -1, 3)
    seconds = 2.0 * _RATE_STEP_US / 1e6
    return here, (ahead - behind) / seconds + EARTH_RATE_RAD_S * _cross(np.array([0.0, 0.0, 1.0]), here)


def _at_rest(longitude_deg: float) -> tuple[FloatArray, FloatArray]:
    """Return place and inertial velocity (1, 3) of a satellite that stands still over the equator, m and m/s."""
    nominal = _satellite_vectors(np.array([[0.0, longitude_deg]]))
    return nominal, EARTH_RATE_RAD_S * _cross(np.array([0.0, 0.0, 1.0]), nominal)


@lru_cache(maxsize=64)
def _nominal_frame(longitude_deg: float) -> FloatArray:
    """Return the axes (3, 3), one a row, of the nadir frame of a satellite that stands still over the equator."""
    frame: FloatArray = _nadir_frame(*_at_rest(longitude_deg))[0]
    return frame


def _nadir_frame(satellite_m: FloatArray, velocity_m_s: FloatArray) -> FloatArray:
    """Return the axes (T, 3, 3), one a row, of the nadir frame of a moving satellite."""
    nadir = -_unit(satellite_m)
    south = -_unit(_cross(satellite_m, velocity_m_s))
    return np.stack([_cross(south, nadir), south, nadir], axis=1)


def _antenna_angles_deg(satellite_m: FloatArray, velocity_m_s: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return azimuth and elevation (T, N, 2) of places seen in the nadir frame of a moving satellite."""
    frame = _nadir_frame(satellite_m, velocity_m_s)
    sight = positions_m - satellite_m[:, np.newaxis]
    return np.asarray(np.stack(antenna_direction(np.einsum("tij,tnj->tni", frame, sight)), axis=-1))


def _satellite_vectors(position_deg: FloatArray) -> FloatArray:
    """Return Earth-fixed vectors (T, 3) at the nominal radius, m."""
    latitude, longitude = np.radians(position_deg).T
    directions = [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
    return np.asarray(GEOSTATIONARY_RADIUS_M * np.stack(directions, axis=-1))


def _station_vectors(stations: Positions) -> FloatArray:
    """Return Earth-fixed vectors (N, 3) of geodetic places, m."""
    latitude, longitude = np.radians(stations.latitude_deg), np.radians(stations.longitude_deg)
    eccentricity_2 = EARTH_FLATTENING * (2.0 - EARTH_FLATTENING)
    prime_vertical = EARTH_EQUATORIAL_RADIUS_M / np.sqrt(1.0 - eccentricity_2 * np.sin(latitude) ** 2)
    across = (prime_vertical + stations.height_m) * np.cos(latitude)
    north = (prime_vertical * (1.0 - eccentricity_2) + stations.height_m) * np.sin(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), north], axis=-1)


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the cross product of vectors (3,) or (n, 3); for a few of them numpy's own takes thrice the time."""
    (a, b, c), (x, y, z) = one.T, other.T
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)


def _unit(vectors: FloatArray) -> FloatArray:
    """Scale vectors (..., 3) to length one."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))


def latest_node_us(epoch_us: IntArray, nodes_us: IntArray, nodal_period_s: float) -> IntArray:
    """Return the latest ascending node that is not after each epoch.

    Parameters
    ----------
    epoch_us : ndarray, shape (T,), microseconds UTC
        Epochs in any order.
    nodes_us : ndarray, shape (M,), microseconds UTC
        Known ascending nodes in any order, M >= 1.
    nodal_period_s : float, s
        Node-to-node period from ballistics, > 0; used rounded to one microsecond.

    Returns
    -------
    ndarray, shape (T,), microseconds UTC
        Listed nodes where they are known. Before the first node, after the last one, and inside a hole of the list that
        is longer than one and a half periods, nodes are extrapolated by whole nodal periods from the nearest listed
        node before (before the first: from the first).

    Raises
    ------
    ValueError
        No node is given, or the period is not positive and finite.

    Examples
    --------
    >>> day = 86_400_000_000
    >>> latest_node_us(np.array([-1, 5, day + 5, 3 * day]), np.array([0, day]), 86_400.0) // day
    array([-1,  0,  1,  3])
    """
    period_us = _period_us(nodal_period_s)
    if nodes_us.size == 0 or period_us == 0:
        msg = "the latest node needs at least one listed node and a positive, finite nodal period"
        raise ValueError(msg)
    nodes = np.sort(nodes_us)
    index = np.searchsorted(nodes, epoch_us, side="right") - 1
    base = nodes[np.maximum(index, 0)]
    periods = np.floor_divide(epoch_us - base, period_us)
    return np.asarray(
        base + np.minimum(periods, _periods_until_next(nodes, period_us)[index]) * period_us, dtype=np.int64
    )


def node_phase_rad(epoch_us: IntArray, nodes_us: IntArray, nodal_period_s: float) -> FloatArray:
    """Return the phase of each epoch since the latest ascending node.

    Parameters
    ----------
    epoch_us : ndarray, shape (T,), microseconds UTC
        Epochs in any order.
    nodes_us : ndarray, shape (M,), microseconds UTC
        Known ascending nodes in any order.
    nodal_period_s : float, s
        Node-to-node period from ballistics.

    Returns
    -------
    ndarray, shape (T,), rad
        In [0, 2 pi). All NaN without nodes or without a positive period: a phase that is not known is absent. Where the
        interval between two listed nodes is longer than the period, the phase starts again at the end of the period.

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, equation (3) and the paragraph below equation (6).

    Examples
    --------
    >>> node_phase_rad(np.array([0, 21_600_000_000]), np.array([0]), 86_400.0).round(6)
    array([0.      , 1.570796])
    """
    period_us = _period_us(nodal_period_s)
    if nodes_us.size == 0 or period_us == 0:
        return np.full(epoch_us.shape, np.nan)
    elapsed_us = np.mod(epoch_us - latest_node_us(epoch_us, nodes_us, nodal_period_s), period_us)
    return np.asarray(2.0 * math.pi * (elapsed_us / period_us), dtype=np.float64)


def node_phase_at_rad(epoch_us: int, nodes_us: tuple[int, ...], nodal_period_s: float) -> float:
    """Return the phase of one epoch, bit for bit that of :func:`node_phase_rad`, in plain numbers: a row has only one.

    Parameters
    ----------
    epoch_us : int, microseconds UTC
        Epoch.
    nodes_us : tuple of int, microseconds UTC
        Known ascending nodes in any order.
    nodal_period_s : float, s
        Node-to-node period from ballistics.

    Returns
    -------
    float, rad
        In [0, 2 pi), NaN without nodes or without a positive period.

    Examples
    --------
    >>> node_phase_at_rad(43_200_000_000, (0,), 86_400.0) == math.pi
    True
    """
    period_us = _period_us(nodal_period_s)
    if not nodes_us or period_us == 0:
        return math.nan
    nodes, spare = _node_table(nodes_us, period_us)
    index = bisect_right(nodes, epoch_us) - 1
    since_us = epoch_us - nodes[max(index, 0)]
    elapsed_us = (since_us - min(since_us // period_us, spare[index]) * period_us) % period_us
    return 2.0 * math.pi * (elapsed_us / period_us)


@lru_cache(maxsize=256)
def _node_table(nodes_us: tuple[int, ...], period_us: int) -> tuple[list[int], list[int]]:
    """Return the nodes in order, and after each one the whole periods until the next takes over."""
    nodes = np.sort(np.array(nodes_us, dtype=np.int64))
    return nodes.tolist(), _periods_until_next(nodes, period_us).tolist()


def _period_us(nodal_period_s: float) -> int:
    """Return the period in whole microseconds; 0 stands for one that is unusable."""
    if not math.isfinite(nodal_period_s) or nodal_period_s <= 0.0:
        return 0
    return round(nodal_period_s * 1e6)


def _periods_until_next(nodes: IntArray, period_us: int) -> IntArray:
    """Return how many whole periods may be added to each node before the next listed one takes over.

    The true node-to-node time differs from the mean period by up to one per cent, so an interval counts as one period
    until it exceeds one and a half. The extra last element has no limit: it serves the last node and, by index -1, the
    epochs before the first.
    """
    unlimited = np.array([np.iinfo(np.int64).max], dtype=np.int64)
    whole = (np.diff(nodes) + period_us // 2) // period_us
    return np.concatenate([np.maximum(whole - 1, 0), unlimited])
