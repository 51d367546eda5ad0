"""Phase of the satellite on its orbit, counted from the ascending node.

``phase = 2 pi (t - t0) / P``, with ``t`` the epoch and ``t0`` the latest northward crossing of the equator, both int64
microseconds UTC, and ``P`` the nodal period in seconds. The law of this file: all arithmetic of time is done in whole
microseconds, the period included, so that moving epochs or nodes by whole periods changes nothing at all; only the last
division is done in floating point.
"""

import math
from bisect import bisect_right
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
