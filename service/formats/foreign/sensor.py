"""Readings of an attitude sensor in a table."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from service.core.geometry.frames import attitude_of_quaternion
from service.formats.foreign.layout import (
    ABSENT,
    Decimal,
    EpochReader,
    ForeignCellError,
    ForeignTableError,
    StatedLayout,
    is_number,
    position_of,
)
from service.formats.foreign.messages import scalar_of, wrong_length
from service.formats.foreign.proposal import Question, Sample, decimal_of, with_time

AXES = ("yaw", "roll", "pitch")
Scalar = Literal["first", "last"]
#: degrees in one unit of angle
DEG_OF: dict[str, float] = {
    "deg": 1.0,
    "rad": 180.0 / np.pi,
    "mrad": 0.18 / np.pi,
    "arcmin": 1 / 60,
    "arcsec": 1 / 3600,
}
#: words of names, by axis and by unit
_AXIS_WORDS = {"yaw": {"yaw", "рыскание"}, "roll": {"roll", "крен"}, "pitch": {"pitch", "тангаж"}}
_UNIT_WORDS = {"deg": "deg", "degree": "deg", "degrees": "deg", "°": "deg", **{unit: unit for unit in DEG_OF}}
_OTHER_WORDS = frozenset({"angle", "attitude", "att"})
_WORD = re.compile(r"[^\W_]+|°")
_QUATERNIONS: tuple[tuple[tuple[str, str, str, str], Scalar | None], ...] = (
    (("q1", "q2", "q3", "q4"), None),
    (("q0", "q1", "q2", "q3"), None),
    (("q1", "q2", "q3", "qc"), "last"),
    (("qx", "qy", "qz", "qw"), "last"),
    (("qx", "qy", "qz", "qs"), "last"),
)
#: beyond it roll or pitch do not point to the Earth from geosynchronous height
EARTH_DISC_DEG = 8.7


@dataclass(frozen=True, slots=True)
class StatedSensor:
    """Layout of a sensor's table as far as a person stated it; None and empty = not stated."""

    time: StatedLayout = field(default_factory=StatedLayout)
    unit: str | None = None
    scalar: Scalar | None = None
    #: axis by column
    columns: Mapping[str, str] = field(default_factory=dict)


class SensorProposal(NamedTuple):
    """Reader of a table, or the questions that must be answered first."""

    reader: "SensorReader | None"
    questions: tuple[Question, ...]
    #: what was understood, by name
    understood: dict[str, str]


class SensorReader:
    """Reader of epochs and angles of one table.

    Parameters
    ----------
    clock : EpochReader
        Of the epochs.
    times : sequence of int
        Positions of the columns of the epoch.
    values : sequence of int or None
        Positions of yaw, roll and pitch, or of a quaternion, scalar last; None = no such column.
    deg_per_unit : float or None
        Degrees in one unit of angle; None: the values are a quaternion.
    decimal : str
        Decimal sign of texts.
    """

    def __init__(
        self,
        clock: EpochReader,
        times: Sequence[int],
        values: Sequence[int | None],
        deg_per_unit: float | None,
        decimal: Decimal,
    ) -> None:
        self._clock, self._times, self._values = clock, times, values
        self._deg_per_unit, self._decimal = deg_per_unit, decimal

    def read(self, cells: Sequence[object]) -> tuple[int, list[float | None]]:
        """Return the epoch, microseconds UTC, and yaw, roll and pitch, deg, None = absent.

        Raises
        ------
        ForeignCellError
            An epoch or a number that is none, a quaternion of another length than one, an angle beyond 180 deg.
        """
        epoch_us = self._clock.read(" ".join(str(cells[position]).strip() for position in self._times))
        numbers = [None if position is None else self._number(cells[position]) for position in self._values]
        if self._deg_per_unit is None:
            return epoch_us, _angles_of(numbers)
        angles = [None if number is None else number * self._deg_per_unit for number in numbers]
        if any(angle is not None and not abs(angle) <= 180.0 for angle in angles):
            raise ForeignCellError("angle beyond 180 deg; is --unit right?", angles)
        return epoch_us, angles

    def _number(self, cell: object) -> float | None:
        """Return the number of a cell; None = absent."""
        if cell is None or str(cell).strip().lower() in ABSENT:
            return None
        if not is_number(cell, self._decimal):
            raise ForeignCellError(f"no number with decimal {self._decimal}", cell)
        return float(str(cell).strip().replace(",", "."))


def _angles_of(quaternion: Sequence[float | None]) -> list[float | None]:
    """Return yaw, roll and pitch of a quaternion, scalar last; all absent where a part is."""
    if any(part is None for part in quaternion):
        return [None, None, None]
    parts = np.array(quaternion, dtype=np.float64)
    if wrong_length(parts[np.newaxis])[0]:
        raise ForeignCellError("quaternion is not of unit length", parts.tolist())
    angles: list[float | None] = attitude_of_quaternion(parts).tolist()
    return angles


def propose_sensor(sample: Sample, stated: StatedSensor) -> SensorProposal:
    """Return the reader of a sensor's table as far as its layout is stated or proven.

    Raises
    ------
    ForeignTableError
        Two columns of one axis, a stated thing that the table contradicts, or quaternions that are not those from the
        nadir frame to the body.
    """
    questions: list[Question] = []
    found = with_time(sample, stated.time, questions)
    rest = [name for name in sample.header if name not in found.time_columns]
    decimal = found.decimal or decimal_of(sample, rest)
    columns, scalar = _columns(rest, stated)
    if not columns:
        text = "no column is named yaw, roll, pitch or q1 to q4; NAME=yaw, NAME=roll, NAME=pitch"
        questions.append(Question("--map", text, tuple(rest)))
    is_quaternion = "q4" in columns
    unit = None if is_quaternion else _unit(columns, stated, questions)
    understood = dict(columns) | ({"unit": unit} if unit else {})
    if is_quaternion:
        scalar = _proven_scalar(sample, columns, stated.scalar or scalar, decimal)
        understood |= {"scalar": scalar, "rotation": "nadir frame to body"}
    if questions or found.time_format is None or not columns:
        return SensorProposal(None, tuple(questions), understood)
    order = _quaternion_order(columns, scalar) if is_quaternion else [columns.get(axis) for axis in AXES]
    reader = SensorReader(
        EpochReader(found.time_format, found.tz),
        [position_of(sample.header, name) for name in found.time_columns],
        [None if name is None else position_of(sample.header, name) for name in order],
        None if unit is None else DEG_OF[unit],
        decimal,
    )
    time = {"time": " + ".join(found.time_columns), "time_format": found.time_format, "tz": found.tz or "in the epochs"}
    return SensorProposal(reader, (), time | understood)


def _columns(names: Sequence[str], stated: StatedSensor) -> tuple[dict[str, str], Scalar | None]:
    """Return the columns by axis, or by part of a quaternion in its order, and where the scalar stands by its name."""
    for name in stated.columns:
        position_of(names, name)
    for parts, scalar in _QUATERNIONS:
        by_part = {_bare(name): name for name in names}
        if not stated.columns and all(part in by_part for part in parts):
            return dict(zip(("q1", "q2", "q3", "q4"), (by_part[part] for part in parts), strict=True)), scalar
    found: dict[str, str] = {}
    for name in names:
        axis = stated.columns.get(name) if stated.columns else _axis_of(name)
        if axis is None:
            continue
        if axis not in AXES:
            raise ForeignTableError(f"--map names {axis[:40]!r}; the axes are {', '.join(AXES)}")
        if axis in found:
            raise ForeignTableError(f"columns {found[axis]!r} and {name!r} are both {axis}; state --map")
        found[axis] = name
    return {axis: found[axis] for axis in AXES if axis in found}, None


def _bare(name: str) -> str:
    """Return a name without signs and case."""
    return "".join(_WORD.findall(name)).casefold()


def _axis_of(name: str) -> str | None:
    """Return the axis that a column's name states; None for one that holds anything else, as a rate or a sigma."""
    words = {word.casefold() for word in _WORD.findall(name)}
    axes = [axis for axis, known in _AXIS_WORDS.items() if words & known]
    if len(axes) != 1 or words - _AXIS_WORDS[axes[0]] - set(_UNIT_WORDS) - _OTHER_WORDS:
        return None
    return axes[0]


def _unit(columns: Mapping[str, str], stated: StatedSensor, questions: list[Question]) -> str | None:
    """Return the unit of the angles, or ask for it."""
    named = {
        _UNIT_WORDS[word.casefold()]
        for name in columns.values()
        for word in _WORD.findall(name)
        if word.casefold() in _UNIT_WORDS
    }
    if len(named | ({stated.unit} if stated.unit else set())) > 1:
        raise ForeignTableError(f"angles have several units: {', '.join(sorted(named | {stated.unit or ''}))}")
    unit = stated.unit or next(iter(named), None)
    if unit is not None and unit not in DEG_OF:
        raise ForeignTableError(f"--unit {unit[:20]!r} is unknown; write {', '.join(DEG_OF)}")
    if unit is None and columns:
        questions.append(Question("--unit", "unit of the angles; no column names it", tuple(DEG_OF)))
    return unit


def _proven_scalar(sample: Sample, columns: Mapping[str, str], stated: Scalar | None, decimal: Decimal) -> Scalar:
    """Return where the scalar stands; ForeignTableError when the content contradicts what is stated, or proves none."""
    positions = [position_of(sample.header, name) for name in columns.values()]
    rows = [[row[position] for position in positions] for row in sample.rows]
    numbers = [[float(str(cell).replace(",", ".")) for cell in row] for row in rows if _is_complete(row, decimal)]
    proven = scalar_of(np.array(numbers, dtype=np.float64).reshape(-1, 4)) if numbers else None
    if proven is None:
        raise ForeignTableError(
            "neither the first nor the last part of the quaternions stays near one: columns are exchanged, or they do"
            " not turn the nadir frame to the body of a satellite that points to the Earth; inertial quaternions must"
            " be turned into the orbital frame first"
        )
    if stated is not None and stated != proven:
        raise ForeignTableError(f"the scalar is {stated} by statement or name, the numbers show it {proven}")
    return proven


def _is_complete(row: Sequence[object], decimal: Decimal) -> bool:
    """Return whether all parts of a quaternion are numbers."""
    return all(is_number(cell, decimal) for cell in row)


def _quaternion_order(columns: Mapping[str, str], scalar: Scalar | None) -> list[str | None]:
    """Return the columns of a quaternion, scalar last."""
    names: list[str | None] = list(columns.values())
    return [*names[1:], names[0]] if scalar == "first" else names
