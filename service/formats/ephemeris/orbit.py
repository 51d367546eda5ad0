"""Orbit: what every form of ephemeris is turned into, node passages, nodal period and the sub-satellite track.

The latitude of the track is geocentric, the direction of the radius vector, because lines of sight are what it is for;
at six degrees it differs from the geodetic one by 0.006 deg. An ascending node is the instant at which the satellite
crosses the true equator northward, found by a cubic through four samples: with samples 600 s apart the instant is
within 2 ms of the sampled orbit's own.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from service.errors import InvalidInputError
from service.records.catalogue import Ephemeris, Track

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

US_PER_S = 1_000_000
#: a geosynchronous satellite returns to its node within these; a sidereal day has 86 164 s
MIN_PERIOD_S = 80_000.0
MAX_PERIOD_S = 92_000.0
#: spacing of tracks made here; a straight line between two points of one inclined by 7 deg errs by 0.002 deg
STEP_S = 600
#: greatest number of points of a track
MAX_POINTS = 20_000
#: km, between which the radius of a geosynchronous orbit lies
MIN_RADIUS_KM = 38_000.0
MAX_RADIUS_KM = 47_000.0
#: below it the crossings of the equator are a matter of millimetres a second, not of geometry
_MIN_LATITUDE_SPAN_DEG = 0.004


def ephemeris_from_nodes(
    nodes_us: Sequence[int], nodal_period_s: float | None, track: Track | None = None
) -> Ephemeris:
    """Return the ephemeris that node passages state.

    Parameters
    ----------
    nodes_us : sequence of int
        Northward crossings of the equator, microseconds UTC, strictly ascending; some may be left out.
    nodal_period_s : float or None
        None: found from the nodes, of which there must be two.
    track : Track, optional
        Predicted sub-satellite point; its span is then the span of validity. Otherwise validity reaches one period
        before the first node and after the last.

    Raises
    ------
    InvalidInputError
        ``ephemeris.nodes``, ``ephemeris.period``, ``ephemeris.period_missing`` or ``ephemeris.track``.
    """
    if not nodes_us or any(later <= earlier for earlier, later in pairwise(nodes_us)):
        raise InvalidInputError("ephemeris.nodes", "ascending_nodes must hold at least one epoch, strictly ascending")
    period_s = _period_of(nodes_us) if nodal_period_s is None else nodal_period_s
    check_period(period_s)
    if any(later - earlier < period_s * US_PER_S / 2 for earlier, later in pairwise(nodes_us)):
        raise InvalidInputError("ephemeris.nodes", "two ascending nodes lie closer than half a nodal period")
    period_us = round(period_s * US_PER_S)
    start_us, stop_us = nodes_us[0] - period_us, nodes_us[-1] + period_us
    if track is not None:
        check_track(track)
        start_us, stop_us = track.epochs_us[0], track.epochs_us[-1]
    return Ephemeris(0, tuple(nodes_us), period_s, start_us, stop_us, "nodes", track)


def ephemeris_from_positions(form: str, epochs_us: IntArray, position_km: FloatArray) -> Ephemeris:
    """Return the ephemeris that sampled Earth-fixed positions state.

    Parameters
    ----------
    form : str
        Where they came from: tle or oem.
    epochs_us : ndarray, shape (T,)
        Microseconds UTC, evenly spaced.
    position_km : ndarray, shape (3, T), km
        Earth-fixed (ITRS).

    Raises
    ------
    InvalidInputError
        ``ephemeris.not_geosynchronous`` or ``ephemeris.no_nodes``.
    """
    radius_km = np.linalg.norm(position_km, axis=0)
    if not np.all((radius_km > MIN_RADIUS_KM) & (radius_km < MAX_RADIUS_KM)):
        detail = f"the orbit leaves the radii {MIN_RADIUS_KM:g}..{MAX_RADIUS_KM:g} km; it is not geosynchronous"
        raise InvalidInputError("ephemeris.not_geosynchronous", detail)
    latitude_deg = np.degrees(np.arcsin(position_km[2] / radius_km))
    longitude_deg = np.unwrap(np.degrees(np.arctan2(position_km[1], position_km[0])), period=360.0)
    nodes_us = find_nodes(epochs_us, position_km[2])
    if len(nodes_us) < 2 or float(np.ptp(latitude_deg)) < _MIN_LATITUDE_SPAN_DEG:
        detail = "the span holds fewer than two clear northward crossings of the equator"
        raise InvalidInputError("ephemeris.no_nodes", detail)
    period_s = (nodes_us[-1] - nodes_us[0]) / (len(nodes_us) - 1) / US_PER_S
    check_period(period_s)
    track = Track(
        tuple(epochs_us.tolist()),
        tuple(np.round(latitude_deg, 7).tolist()),
        tuple(np.round(longitude_deg, 7).tolist()),
    )
    return Ephemeris(0, tuple(nodes_us), period_s, int(epochs_us[0]), int(epochs_us[-1]), form, track)


def find_nodes(epochs_us: IntArray, north_km: FloatArray) -> list[int]:
    """Return the instants at which a sampled coordinate rises through zero.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC, evenly spaced.
    north_km : ndarray, shape (T,), km
        Coordinate along the Earth's axis.
    """
    rises = np.flatnonzero((north_km[:-1] < 0) & (north_km[1:] >= 0))
    # the cubic needs a sample on either side
    inner = rises[(rises >= 1) & (rises + 2 < len(north_km))]
    step_us = float(epochs_us[1] - epochs_us[0])
    return [int(epochs_us[k]) + round(_cubic_root(north_km[k - 1 : k + 3]) * step_us) for k in inner.tolist()]


def check_period(period_s: float) -> None:
    """Refuse a nodal period that no geosynchronous orbit has."""
    if not MIN_PERIOD_S <= period_s <= MAX_PERIOD_S:
        detail = f"a nodal period of {period_s:.3f} s is not geosynchronous ({MIN_PERIOD_S:g}..{MAX_PERIOD_S:g} s)"
        raise InvalidInputError("ephemeris.period", detail)


def check_track(track: Track) -> None:
    """Refuse a track whose columns do not belong together."""
    if not len(track.epochs_us) == len(track.latitude_deg) == len(track.longitude_deg):
        raise InvalidInputError("ephemeris.track", "epochs, latitude_deg and longitude_deg must be equally long")
    if len(track.epochs_us) < 2 or np.any(np.diff(np.array(track.epochs_us)) <= 0):
        raise InvalidInputError("ephemeris.track", "the epochs of a track must be at least two, strictly ascending")


def _period_of(nodes_us: Sequence[int]) -> float:
    """Return the mean period between nodes, of which whole revolutions may be left out."""
    if len(nodes_us) < 2:
        raise InvalidInputError("ephemeris.period_missing", "nodal_period_s is needed where there is one node only")
    shortest_us = min(later - earlier for earlier, later in pairwise(nodes_us))
    revolutions = sum(round((later - earlier) / shortest_us) for earlier, later in pairwise(nodes_us))
    return (nodes_us[-1] - nodes_us[0]) / revolutions / US_PER_S


def _cubic_root(samples: FloatArray) -> float:
    """Return where in 0..1 the cubic through samples at -1, 0, 1, 2 is zero, by bisection."""
    coefficients = np.polyfit([-1.0, 0.0, 1.0, 2.0], samples, 3)
    low, high = 0.0, 1.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if np.polyval(coefficients, middle) < 0 else (low, middle)
    return (low + high) / 2
