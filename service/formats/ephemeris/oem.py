"""Orbit Ephemeris Messages (CCSDS 502.0, OEM 1.0 to 3.0, keyword = value notation): read and resampled.

States are joined by cubic Hermite polynomials through positions and velocities: 30 m at one hour between states, a
millimetre at ten minutes, on a geosynchronous orbit. What is not understood (another centre, frame or time system) is
refused by name; covariances and accelerations are passed over.
"""

from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np

from service.errors import InvalidInputError
from service.formats.ephemeris.earth_fixed import inertial_to_earth_fixed_km, leap_seconds_at
from service.formats.ephemeris.orbit import (
    MAX_POINTS,
    STEP_S,
    US_PER_S,
    FloatArray,
    IntArray,
    ephemeris_from_positions,
)
from service.records.catalogue import Ephemeris
from service.records.epoch import parse_epoch

_INERTIAL = frozenset({"EME2000", "ICRF", "GCRF", "J2000"})
_EARTH_FIXED = frozenset(
    {"ITRF", "ITRF93", "ITRF97", "ITRF2000", "ITRF-93", "ITRF-97", "ITRF2005", "ITRF2008", "ITRF2014", "ITRF2020"}
)
#: time system minus TAI, s
_OFFSET_FROM_TAI_S = {"TAI": 0.0, "TT": 32.184, "GPS": -19.0}
#: states further apart are not joined
MAX_STEP_S = 3600
_STATE_COLUMNS = (7, 10)
_MARKS = {"META_START": "meta", "META_STOP": "data", "COVARIANCE_START": "covariance", "COVARIANCE_STOP": "data"}


@dataclass(slots=True)
class _Segment:
    """One block of metadata and its states."""

    meta: dict[str, str] = field(default_factory=dict)
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
    epochs_us, states = _joined(segments)
    span_s = float(epochs_us[-1] - epochs_us[0]) / US_PER_S
    step_us = max(STEP_S, int(span_s // MAX_POINTS) + 1) * US_PER_S
    grid_us = np.arange(epochs_us[0], epochs_us[-1] + 1, step_us, dtype=np.int64)
    position_km = _hermite(epochs_us, states, grid_us)
    return ephemeris_from_positions(
        "oem", grid_us, inertial_to_earth_fixed_km(grid_us, position_km) if is_inertial else position_km
    )


def _parse(text: str) -> list[_Segment]:
    """Return the segments of a message."""
    lines = text.splitlines()
    if not lines or not lines[0].strip().startswith("CCSDS_OEM_VERS"):
        raise InvalidInputError("oem.malformed", "the message must begin with CCSDS_OEM_VERS")
    segments: list[_Segment] = []
    position = "header"
    for number, line in enumerate(lines, start=1):
        content = line.strip()
        if content in _MARKS:
            position = _MARKS[content]
            segments += [_Segment()] if content == "META_START" else []
        elif content and not content.startswith("COMMENT"):
            _consume(position, content, number, segments)
    return segments


def _consume(position: str, content: str, number: int, segments: list[_Segment]) -> None:
    """Take in one line at its place."""
    if position == "meta":
        keyword, is_assigned, value = content.partition("=")
        if not is_assigned:
            raise _malformed(number, "metadata must be written KEYWORD = value")
        segments[-1].meta[keyword.strip()] = value.strip()
    elif position == "data":
        if not segments:
            raise _malformed(number, "states must follow a META_START ... META_STOP block")
        _read_state(content.split(), number, segments[-1])


def _read_state(cells: list[str], number: int, segment: _Segment) -> None:
    """Take in one state."""
    if len(cells) not in _STATE_COLUMNS:
        raise _malformed(number, "a state is an epoch, three coordinates in km and three rates in km/s")
    try:
        epoch_us = _epoch_us(cells[0])
        numbers = [float(cell) for cell in cells[1:7]]
    except (ValueError, OverflowError):
        raise _malformed(number, "the line holds something that is no epoch or number") from None
    if not np.all(np.abs(numbers) < 1e9):  # false for NaN as well
        raise _malformed(number, "a coordinate is not a finite number of km")
    if segment.epochs_us and epoch_us <= segment.epochs_us[-1]:
        raise _malformed(number, "the epochs of a segment must be strictly ascending")
    segment.epochs_us.append(epoch_us)
    segment.states.append(numbers)


def _epoch_us(text: str) -> int:
    """Return microseconds of an epoch in the message's own time system, with month and day or with the day of year."""
    plain = text.removesuffix("Z")
    date, _, clock = plain.partition("T")
    if len(date) == len("2026-325"):
        day = datetime(int(date[:4]), 1, 1, tzinfo=UTC) + timedelta(days=int(date[5:]) - 1)
        if day.year != int(date[:4]):
            message = f"{date} is no day of its year"
            raise ValueError(message)
        date = day.strftime("%Y-%m-%d")
    return parse_epoch(f"{date}T{clock}Z")


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
    """Return epochs in UTC (T,) and states (T, 6) of all segments; of a repeated span the first holds."""
    epochs_us: list[int] = []
    states: list[list[float]] = []
    for segment in segments:
        shift_us = _shift_us(segment)
        for epoch_us, state in zip(segment.epochs_us, segment.states, strict=True):
            if not epochs_us or epoch_us + shift_us > epochs_us[-1]:
                epochs_us.append(epoch_us + shift_us)
                states.append(state)
    steps_us = np.diff(np.array(epochs_us, dtype=np.int64))
    if not len(steps_us) or int(steps_us.max()) > MAX_STEP_S * US_PER_S:
        detail = f"states must follow one another within {MAX_STEP_S} s"
        raise InvalidInputError("oem.gap", detail)
    return np.array(epochs_us, dtype=np.int64), np.array(states, dtype=np.float64)


def _shift_us(segment: _Segment) -> int:
    """Return UTC minus the segment's time system."""
    system = segment.meta.get("TIME_SYSTEM", "").upper()
    if system == "UTC" or not segment.epochs_us:
        return 0
    if system not in _OFFSET_FROM_TAI_S:
        raise _unsupported("TIME_SYSTEM", [system], ["UTC", *sorted(_OFFSET_FROM_TAI_S)])
    return -round((leap_seconds_at(segment.epochs_us[0]) + _OFFSET_FROM_TAI_S[system]) * US_PER_S)


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
    """Return the error of a line."""
    return InvalidInputError("oem.malformed", f"line {number}: {detail}")


def _unsupported(keyword: str, found: list[str], understood: list[str]) -> InvalidInputError:
    """Return the error of a keyword's value."""
    shown = ", ".join(value[:40] or "nothing" for value in found[:3]) or "nothing"
    return InvalidInputError("oem.unsupported", f"{keyword} is {shown}; understood are {', '.join(understood)}")
