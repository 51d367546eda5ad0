"""Ephemerides: node passages, two-line elements, members of an OMM, OEM."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from sgp4.io import compute_checksum

from service.errors import InvalidInputError
from service.formats.ccsds import calendar_us, is_useable, read_segments
from service.records.catalogue import Ephemeris, Track
from service.records.levels.attitude import FloatArray, IntArray

_DAY_US = 86_400_000_000
_KM_PER_AU = 149_597_870.7


@lru_cache(maxsize=1)
def timescale() -> Any:  # skyfield has no types
    """Return the time scale with built-in leap seconds and Earth rotation."""
    from skyfield.api import load

    return load.timescale(builtin=True)


def times_of(epochs_us: IntArray) -> Any:
    """Return skyfield times.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    """
    days, rest_us = np.divmod(epochs_us, _DAY_US)
    # whole days as days of January 1970 and seconds within the day: leap seconds are counted by the day
    return timescale().utc(1970, 1, 1 + days, 0, 0, rest_us / 1e6)


def earth_fixed_km(position: Any) -> FloatArray:
    """Return the Earth-fixed (ITRS) coordinates of a skyfield position, shape (3, T), km."""
    from skyfield.framelib import itrs

    return np.asarray(position.frame_xyz(itrs).km, dtype=np.float64)


def inertial_to_earth_fixed_km(epochs_us: IntArray, position_km: FloatArray) -> FloatArray:
    """Return Earth-fixed coordinates of ICRF positions.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds UTC.
    position_km : ndarray, shape (3, T), km
        Geocentric, ICRF or EME2000 (they differ by 0.02 arc seconds).
    """
    from skyfield.positionlib import Geocentric

    return earth_fixed_km(Geocentric(position_km / _KM_PER_AU, t=times_of(epochs_us)))


def utc_us(epochs_us: IntArray, system: str) -> IntArray:
    """Return microseconds UTC of epochs in a time system, shape (T,).

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Microseconds of the system's own calendar.
    system : str
        UTC, TAI, TT or GPS; InvalidInputError ``oem.unsupported`` for any other.
    """
    if system == "UTC" or not len(epochs_us):
        return epochs_us
    if system not in _OFFSET_FROM_TAI_S:
        raise _unsupported("TIME_SYSTEM", [system], ["UTC", *sorted(_OFFSET_FROM_TAI_S)])
    tai_us = epochs_us - round(_OFFSET_FROM_TAI_S[system] * US_PER_S)
    ends = {leap_seconds_at(int(tai_us.min())), leap_seconds_at(int(tai_us.max()))}
    if len(ends) == 1:
        return np.asarray(tai_us - ends.pop() * US_PER_S, dtype=np.int64)
    return np.array([each - leap_seconds_at(each) * US_PER_S for each in tai_us.tolist()], dtype=np.int64)


def leap_seconds_at(epoch_us: int) -> int:
    """Return TAI - UTC in whole seconds at an instant."""
    moment = times_of(np.array([epoch_us], dtype=np.int64))
    tai_days = float(moment.tai[0])
    utc_days = 2_440_587.5 + epoch_us / _DAY_US
    return round((tai_days - utc_days) * 86_400)


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


_INERTIAL = frozenset({"EME2000", "ICRF", "GCRF", "J2000"})
_EARTH_FIXED = frozenset(
    {"ITRF", "ITRF93", "ITRF97", "ITRF2000", "ITRF-93", "ITRF-97", "ITRF2005", "ITRF2008", "ITRF2014", "ITRF2020"}
)
#: time system minus TAI, s
_OFFSET_FROM_TAI_S = {"TAI": 0.0, "TT": 32.184, "GPS": -19.0}
#: states further apart are not joined
MAX_STEP_S = 3600
_STATE_COLUMNS = (7, 10)
#: the cubic through states and rates is at least as exact as these where the rates are those of the positions
_INTERPOLATIONS = frozenset({"", "HERMITE", "LAGRANGE", "LINEAR"})
#: states from whose positions a rate is found; its error an hour apart is 2e-4 of the rate
_WINDOW = 5
#: greatest difference of a stated rate: share of the rate, and what rounded positions leave, km/s
_VELOCITY_SHARE, _VELOCITY_NOISE_KM_S = 0.01, 1e-4
_MARKS = {
    "META_START": (("header", "data"), "meta"),
    "META_STOP": (("meta",), "data"),
    "COVARIANCE_START": (("data",), "covariance"),
    "COVARIANCE_STOP": (("covariance",), "data"),
}


@dataclass(slots=True)
class _Segment:
    """One block of metadata and its states."""

    meta: dict[str, str]
    epochs_us: list[int] = field(default_factory=list)
    #: x, y, z in km, then their rates in km/s
    states: list[list[float]] = field(default_factory=list)


def read_oem(text: str) -> Ephemeris:
    """Return the ephemeris of a message.

    Parameters
    ----------
    text : str
        The whole message.

    Raises
    ------
    InvalidInputError
        ``oem.malformed`` with the line, ``oem.unsupported`` with the keyword, ``oem.gap``; those of
        ``ephemeris_from_positions``.
    """
    segments = _parse(text)
    is_inertial = _frame_of(segments)
    objects = dict.fromkeys(each.meta.get("OBJECT_ID", "") for each in segments)
    if len(objects) > 1:
        raise _unsupported("OBJECT_ID", list(objects), ["one object: keep the segments of this spacecraft"])
    epochs_us, states = _joined(segments)
    span_s = float(epochs_us[-1] - epochs_us[0]) / US_PER_S
    step_us = max(STEP_S, int(span_s // MAX_POINTS) + 1) * US_PER_S
    grid_us = np.arange(epochs_us[0], epochs_us[-1] + 1, step_us, dtype=np.int64)
    position_km = _hermite(epochs_us, states, grid_us)
    return ephemeris_from_positions(
        "oem", grid_us, inertial_to_earth_fixed_km(grid_us, position_km) if is_inertial else position_km
    )


def _parse(text: str) -> list[_Segment]:
    try:
        found = read_segments(text, "CCSDS_OEM_VERS", _MARKS, end=None)
    except InvalidInputError as error:
        raise InvalidInputError("oem.malformed", error.detail) from None
    segments = [_Segment(each.meta) for each in found]
    for segment, each in zip(segments, found, strict=True):
        for number, content in each.data:
            _read_state(content.split(), number, segment)
    return segments


def _read_state(cells: list[str], number: int, segment: _Segment) -> None:
    if len(cells) not in _STATE_COLUMNS:
        raise _malformed(number, "a state is an epoch, three coordinates in km and three rates in km/s")
    try:
        epoch_us = calendar_us(cells[0])
        numbers = [float(cell) for cell in cells[1:7]]
    except (ValueError, OverflowError):
        raise _malformed(number, "the line holds something that is no epoch or number") from None
    if not np.all(np.abs(numbers) < 1e9):  # false for NaN as well
        raise _malformed(number, "a coordinate is not a finite number of km")
    if segment.epochs_us and epoch_us <= segment.epochs_us[-1]:
        raise _malformed(number, "the epochs of a segment must be strictly ascending")
    segment.epochs_us.append(epoch_us)
    segment.states.append(numbers)


def _frame_of(segments: list[_Segment]) -> bool:
    """Return whether the frame is inertial; refuse what is not understood."""
    if not segments:
        raise InvalidInputError("oem.malformed", "the message holds no segment")
    frames = {segment.meta.get("REF_FRAME", "").upper() for segment in segments}
    if len(frames) > 1 or not frames <= _INERTIAL | _EARTH_FIXED:
        raise _unsupported("REF_FRAME", sorted(frames), sorted(_INERTIAL | _EARTH_FIXED))
    centres = {segment.meta.get("CENTER_NAME", "").upper() for segment in segments}
    if centres != {"EARTH"}:
        raise _unsupported("CENTER_NAME", sorted(centres), ["EARTH"])
    return frames <= _INERTIAL


def _joined(segments: list[_Segment]) -> tuple[IntArray, FloatArray]:
    """Return epochs in UTC (T,) and states (T, 6) of all useable spans; of a repeated span the first holds."""
    epochs_us: list[int] = []
    states: list[list[float]] = []
    parts = [_useable(segment) for segment in segments]
    for own_us, own_states in parts:
        is_new = own_us > epochs_us[-1] if epochs_us else np.ones(len(own_us), dtype=np.bool_)
        epochs_us += own_us[is_new].tolist()
        states += own_states[is_new].tolist()
    steps_us = np.diff(np.array(epochs_us, dtype=np.int64))
    if not len(steps_us) or int(steps_us.max()) > MAX_STEP_S * US_PER_S:
        detail = f"states must follow one another within {MAX_STEP_S} s"
        raise InvalidInputError("oem.gap", detail)
    for part in parts:
        _check_velocities(*part)
    return np.array(epochs_us, dtype=np.int64), np.array(states, dtype=np.float64)


def _useable(segment: _Segment) -> tuple[IntArray, FloatArray]:
    """Return epochs in UTC and states of a segment within the span that its metadata call useable."""
    method = segment.meta.get("INTERPOLATION", "").upper()
    if method not in _INTERPOLATIONS:
        raise _unsupported("INTERPOLATION", [method], sorted(_INTERPOLATIONS - {""}))
    epochs_us = np.array(segment.epochs_us, dtype=np.int64)
    try:
        inside = is_useable(segment.meta, epochs_us)
    except ValueError as error:
        raise InvalidInputError("oem.malformed", f"useable span: {error}") from None
    states = np.array(segment.states, dtype=np.float64).reshape(-1, 6)
    system = segment.meta.get("TIME_SYSTEM", "").upper()
    return utc_us(epochs_us[inside], system), states[inside]


def _check_velocities(epochs_us: IntArray, states: FloatArray) -> None:
    """Refuse velocities that are not the rates of change of the positions: the track would bend between states."""
    if len(epochs_us) < _WINDOW:
        return
    windows = np.lib.stride_tricks.sliding_window_view(epochs_us, _WINDOW)
    middle = _WINDOW // 2
    time_s = (windows - windows[:, middle, np.newaxis]) / US_PER_S
    span_s = np.abs(time_s).max(axis=1, keepdims=True)
    # the coefficient of the first power of the polynomial through five positions is their rate
    powers = (time_s / span_s)[:, :, np.newaxis] ** np.arange(_WINDOW)
    weights = np.linalg.inv(powers)[:, 1] / span_s
    positions = np.lib.stride_tricks.sliding_window_view(states[:, :3], _WINDOW, axis=0)
    rates = np.einsum("twk,tk->tw", positions, weights)
    stated = states[middle : len(states) - middle, 3:]
    apart, size = np.linalg.norm(stated - rates, axis=1), np.linalg.norm(rates, axis=1)
    wrong = np.flatnonzero(apart > _VELOCITY_SHARE * size + _VELOCITY_NOISE_KM_S)
    if len(wrong):
        k = int(wrong[np.argmax(apart[wrong])])
        line = (
            f"the velocity at {np.datetime64(int(epochs_us[k + middle]), 'us')} is {np.linalg.norm(stated[k]):.6f} km/s"
            f" where the positions change by {size[k]:.6f} km/s, {apart[k]:.6f} km/s apart; {len(wrong)} of"
            f" {len(stated)} states contradict their positions: export the message again, rates in km/s"
        )
        raise InvalidInputError("oem.malformed", line)


def _hermite(epochs_us: IntArray, states: FloatArray, grid_us: IntArray) -> FloatArray:
    """Return positions on a grid, shape (3, G), km."""
    left = np.clip(np.searchsorted(epochs_us, grid_us, side="right") - 1, 0, len(epochs_us) - 2)
    step_s = (epochs_us[left + 1] - epochs_us[left]) / US_PER_S
    u = (grid_us - epochs_us[left]) / US_PER_S / step_s
    before, after = states[left].T, states[left + 1].T
    return np.asarray(
        before[:3] * (1 + 2 * u) * (1 - u) ** 2
        + before[3:] * step_s * u * (1 - u) ** 2
        + after[:3] * u**2 * (3 - 2 * u)
        + after[3:] * step_s * u**2 * (u - 1),
        dtype=np.float64,
    )


def _malformed(number: int, detail: str) -> InvalidInputError:
    return InvalidInputError("oem.malformed", f"line {number}: {detail}")


def _unsupported(keyword: str, found: list[str], understood: list[str]) -> InvalidInputError:
    """Return the error of a keyword's value."""
    shown = ", ".join(value[:40] or "nothing" for value in found[:3]) or "nothing"
    return InvalidInputError("oem.unsupported", f"{keyword} is {shown}; understood are {', '.join(understood)}")


#: members of an OMM that a provider may leave out, with what SGP4 takes for them
_OPTIONAL_MEMBERS = {"EPHEMERIS_TYPE": "0", "MEAN_MOTION_DDOT": "0", "MEAN_MOTION_DOT": "0"}
#: members that would make another orbit of the same numbers
_REQUIRED_MEMBERS = {
    "MEAN_ELEMENT_THEORY": ("SGP4", "SGP/SGP4"),
    "CENTER_NAME": ("EARTH",),
    "REF_FRAME": ("TEME",),
    "TIME_SYSTEM": ("UTC",),
    "EPHEMERIS_TYPE": ("0", "2", "3"),
}
_XP = "; type 4 is SGP4-XP, whose elements SGP4 propagates wrongly: ask for SGP4 elements"
#: span of the ephemeris around the epoch of the elements
DAYS_BEFORE = 7
DAYS_AFTER = 30
_LENGTH = 69
_ANGLE = r"[ \d]{3}\.\d{4}"
_SMALL = r"[ +-]\d{5}[ +-]\d"
_LINES = (
    re.compile(
        rf"1 [ 0-9A-Z]\d{{4}}[A-Z ] [\d ]{{5}}[A-Z ]{{3}} \d\d[ \d]{{3}}\.\d{{8}} [ +-][ \d]?\.\d{{8}} "
        rf"{_SMALL} {_SMALL} [\d ] [ \d]{{4}}\d",
        re.ASCII,
    ),
    re.compile(
        rf"2 [ 0-9A-Z]\d{{4}} {_ANGLE} {_ANGLE} \d{{7}} {_ANGLE} {_ANGLE} [ \d]{{2}}\.\d{{8}}[ \d]{{5}}\d", re.ASCII
    ),
)


def read_tle(lines: Sequence[str]) -> Ephemeris:
    """Return the ephemeris of two-line elements.

    Parameters
    ----------
    lines : sequence of str
        The two lines.

    Raises
    ------
    InvalidInputError
        ``tle.malformed`` or ``tle.checksum``; ``tle.propagation`` when SGP4 gives up; those of
        ``ephemeris_from_positions``.
    """
    first, second = _checked(lines)
    from skyfield.api import EarthSatellite

    try:
        satellite = EarthSatellite(first, second, None, timescale())
    except ValueError as error:
        raise InvalidInputError("tle.malformed", f"the elements cannot be read: {error}") from None
    return _of_elements(satellite)


def read_mean_elements(members: Mapping[str, str]) -> Ephemeris:
    """Return the ephemeris of the members of an OMM, which go to SGP4 as they are.

    Raises
    ------
    InvalidInputError
        ``tle.malformed``: a member is missing, is no number or epoch, or means another theory; ``tle.propagation``;
        those of ``ephemeris_from_positions``.
    """
    from skyfield.api import EarthSatellite

    stated = _OPTIONAL_MEMBERS | {name: value for name, value in members.items() if value}
    for name, understood in _REQUIRED_MEMBERS.items():
        if name in stated and stated[name].upper() not in understood:
            shown = f"{name} = {stated[name][:40]}; understood: {', '.join(understood)}"
            raise InvalidInputError("tle.malformed", shown + (_XP if stated[name] == "4" else ""))
    try:
        epoch = np.datetime64(calendar_us(stated["EPOCH"]), "us").item()
        # a letter, a catalogue number and a count say nothing about the orbit, and each has forms that SGP4 refuses
        stated |= {"CLASSIFICATION_TYPE": "U", "NORAD_CAT_ID": "0", "ELEMENT_SET_NO": "0", "REV_AT_EPOCH": "0"}
        stated |= {"EPOCH": epoch.strftime("%Y-%m-%dT%H:%M:%S.%f"), "EPHEMERIS_TYPE": "0", "OBJECT_ID": ""}
        satellite = EarthSatellite.from_omm(timescale(), stated)
    except KeyError as error:
        raise InvalidInputError("tle.malformed", f"the OMM has no {error.args[0]}") from None
    except (ValueError, TypeError, OverflowError) as error:
        detail = f"the OMM holds a member that is no number or epoch: {error}"
        raise InvalidInputError("tle.malformed", detail) from None
    return _of_elements(satellite)


def _of_elements(satellite: Any) -> Ephemeris:
    """Return the ephemeris around the epoch of elements."""
    centre_us = round(float(satellite.epoch.utc_datetime().timestamp())) * US_PER_S
    step_us = STEP_S * US_PER_S
    start_us = -(-(centre_us - DAYS_BEFORE * _DAY_US) // step_us) * step_us
    epochs_us = np.arange(start_us, centre_us + DAYS_AFTER * _DAY_US, step_us, dtype=np.int64)
    position_km = earth_fixed_km(satellite.at(times_of(epochs_us)))
    if not np.all(np.isfinite(position_km)):
        raise InvalidInputError("tle.propagation", "SGP4 cannot propagate these elements over the span of an ephemeris")
    return ephemeris_from_positions("tle", epochs_us, position_km)


def _checked(lines: Sequence[str]) -> tuple[str, str]:
    """Return the two lines when form, checksums and catalogue numbers are right."""
    stripped = [line.rstrip() for line in lines]
    if len(stripped) != len(_LINES):
        raise InvalidInputError("tle.malformed", "two-line elements are two lines")
    for number, (line, form) in enumerate(zip(stripped, _LINES, strict=True), start=1):
        if len(line) != _LENGTH or form.fullmatch(line) is None:
            raise InvalidInputError("tle.malformed", f"line {number} has not the {_LENGTH} columns of the format")
        if (computed := compute_checksum(line)) != int(line[-1]):
            detail = f"line {number} ends with checksum {line[-1]}, its content gives {computed}"
            raise InvalidInputError("tle.checksum", detail)
    if stripped[0][62] not in " 023":
        raise InvalidInputError("tle.malformed", f"ephemeris type {stripped[0][62]} is no SGP4{_XP}")
    if any(a[2:7] != b[2:7] for a, b in pairwise(stripped)):
        raise InvalidInputError("tle.malformed", "the two lines belong to different satellites")
    return stripped[0], stripped[1]
