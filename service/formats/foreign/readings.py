"""Readings of a sensor in a foreign table or message: angles or quaternions, read whole, judged, or asked about."""

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.geometry.frames import attitude_of_quaternion
from service.formats.foreign.clocks import words_of
from service.formats.foreign.columns import (
    AXES,
    Axis,
    Interpretation,
    Quantity,
    ReadingsStatement,
    TableReader,
)
from service.formats.foreign.messages import scalar_of, wrong_length
from service.formats.foreign.table import ForeignTableError, Table
from service.formats.foreign.units import ANGLE_UNITS, angle_unit, contradicted_angle_unit

#: least distance of a code for no reading to the angles, deg
_CODE_GAP_DEG = 1.0
#: beyond it roll or pitch do not point to the Earth from geosynchronous height
EARTH_DISC_DEG = 8.7
_OTHER_WORDS = frozenset({"angle", "attitude", "att", "угол", "est", "meas", "measured"})
_QUATERNIONS = {
    ("q1", "q2", "q3", "q4"): None,
    ("q0", "q1", "q2", "q3"): None,
    ("q1", "q2", "q3", "qc"): "last",
    ("qx", "qy", "qz", "qw"): "last",
    ("qx", "qy", "qz", "qs"): "last",
    ("qw", "qx", "qy", "qz"): "first",
}
#: words of names by axis, and words that say nothing more
_AXIS_WORDS: dict[Axis, set[str]] = {
    "yaw": {"yaw", "рыскание", "рысканье", "gier", "gieren"},
    "roll": {"roll", "крен", "rollen"},
    "pitch": {"pitch", "тангаж", "nick", "nicken"},
}
#: columns of one standard deviation by row
SIGMA_COLUMNS = tuple(f"sigma_{axis}_deg" for axis in AXES)


def holds_angles(table: Table) -> bool:
    """Return whether names of columns are those of angles or of a quaternion."""
    axes = {_axis_of(name) for name in table.header} - {None}
    return len(axes) > 1 or any(_parts(table.header).keys() >= set(names) for names in _QUATERNIONS)


def interpret_readings(
    table: Table, stated: ReadingsStatement, now_us: int, *, is_simulated: bool = False
) -> Interpretation:
    """Return how a table of a sensor's readings is read; the parameters are those of `interpret_powers`."""
    if table.is_standard:
        stated = stated.model_copy(update={"unit": "deg", "missing": ("none",)})
    reader = TableReader(table, stated)
    by_part = {} if stated.columns else _parts(reader.rest)
    parts = next((names for names in _QUATERNIONS if by_part.keys() >= set(names)), None)
    columns = {} if parts else _axes_of(reader, stated)
    reader.fields["columns"] = {name: axis for axis, name in columns.items()}
    values = np.full((len(table.lines), 6), np.nan)
    if parts:
        raw, faults, _ = reader.numbers([by_part[part] for part in parts])
        values[:, :3], more, reader.fields["scalar"] = _quaternion_angles(raw, stated.scalar, _QUATERNIONS[parts])
        faults += more
    elif columns:
        angles, faults = _angles(reader, list(columns.values()), list(columns))
        values[:, [AXES.index(axis) for axis in columns]] = angles
    else:
        text = "no column is named yaw, roll, pitch or q1 to q4; state NAME: yaw, NAME: roll, NAME: pitch"
        reader.ask("columns", text, reader.rest)
        return reader.judged(None, now_us, is_simulated=is_simulated)
    has_sigma = set(SIGMA_COLUMNS) <= set(table.header)
    if has_sigma:
        values[:, 3:] = reader.numbers(SIGMA_COLUMNS)[0]
    is_beyond = np.any(np.abs(values[:, :3]) > [180.0, EARTH_DISC_DEG, EARTH_DISC_DEG], axis=1)
    if 2 * int(is_beyond.sum()) > len(values) and not reader.questions:
        middle = [float(np.median(held)) if len(held := np.abs(each[~np.isnan(each)])) else 0.0 for each in values.T]
        shown = ", ".join(f"{axis} {size:.2f}" for axis, size in zip(AXES, middle, strict=False))
        raise ForeignTableError(
            f"the angles, in the middle {shown} deg, lie beyond the Earth's disc of {EARTH_DISC_DEG} deg: check unit,"
            " axes and frame (angles from the nadir frame to the body are wanted)"
        )
    beyond = f"roll or pitch beyond the Earth's disc ({EARTH_DISC_DEG} deg), or an angle beyond 360 deg"
    rows = reader.rows_of(AXES, values, [*faults, (beyond, is_beyond)])
    if rows is not None:
        rows.values, rows.sigma_deg = rows.values[:, :3], rows.values[:, 3:] if has_sigma else None
    return reader.judged(rows, now_us, is_simulated=is_simulated)


def _parts(names: list[str]) -> dict[str, str]:
    """Return names by their letters and digits, lower case."""
    return {"".join(filter(str.isalnum, name.casefold())): name for name in names}


def _axes_of(reader: TableReader, stated: ReadingsStatement) -> dict[Axis, str]:
    found: dict[Axis, list[str]] = {axis: [] for axis in AXES}
    for name in reader.rest:
        axis = stated.columns.get(name) if stated.columns else _axis_of(name)
        if axis is not None:
            found[axis].append(name)
    for names in found.values():
        if len(names) > 1:
            reader.ask("columns", f"columns {' and '.join(map(repr, names))} are one axis", names)
    return {axis: names[0] for axis, names in found.items() if names}


def _axis_of(name: str) -> Axis | None:
    """Return the axis that a column's name states; None for one that holds anything else, as a rate or a sigma."""
    words = words_of(name).difference(_OTHER_WORDS, *(known for _, known in ANGLE_UNITS.values()))
    return next((axis for axis, known in _AXIS_WORDS.items() if words and words <= known), None)


def _angles(
    reader: TableReader, columns: list[str], axes: list[Axis]
) -> tuple[FloatArray, list[tuple[str, BoolArray]]]:
    """Return angles in deg, wrapped to half a turn, and the faults of cells."""
    raw, faults, in_cells = reader.numbers(columns)
    angle = Quantity(
        ANGLE_UNITS,
        angle_unit,
        lambda raw, units: contradicted_angle_unit(raw, axes, units, EARTH_DISC_DEG),
        lambda _: "deg",
    )
    scale = np.array([ANGLE_UNITS[unit][0] for unit in reader.units(columns, raw, in_cells, angle)])
    reader.ask_codes(raw, columns, float(_CODE_GAP_DEG / scale.max()), has_zero_rows=True)
    angles = raw * scale
    is_turn = (np.abs(angles) > 180.0) & (np.abs(angles) <= 360.0)
    return np.where(is_turn, angles - np.copysign(360.0, angles), angles), faults


def _quaternion_angles(
    raw: FloatArray, stated: str | None, named: str | None
) -> tuple[FloatArray, list[tuple[str, BoolArray]], str]:
    """Return the angles of quaternions, the faults, and the place of their scalar, which the numbers prove."""
    whole = np.isfinite(raw).all(axis=1)
    if not whole.any():
        raise ForeignTableError("no row holds the four parts of a quaternion")
    proven = scalar_of(raw[whole])
    if proven is None:
        raise ForeignTableError(
            "neither the first nor the last part of the quaternions stays near one: columns are exchanged, or they do"
            " not turn the nadir frame to the body of a satellite that points to the Earth; inertial quaternions must"
            " be turned into the orbital frame first"
        )
    if (stated or named or proven) != proven:
        raise ForeignTableError(f"the scalar is {stated or named} by statement or name, the numbers show it {proven}")
    is_wrong = whole & wrong_length(raw)
    angles = np.full((len(raw), 3), np.nan)
    right = whole & ~is_wrong
    angles[right] = attitude_of_quaternion(np.roll(raw[right], -1, axis=1) if proven == "first" else raw[right])
    return angles, [("quaternion is not of unit length", is_wrong)], proven
