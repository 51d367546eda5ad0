"""Readings of a sensor in a foreign table or message: angles or quaternions, read whole, judged, or asked about."""

from collections.abc import Mapping

import numpy as np

from service.core.geometry.frames import attitude_of_quaternion
from service.formats.foreign.clocks import words_of
from service.formats.foreign.columns import (
    AXES,
    Axis,
    BoolArray,
    FloatArray,
    IntArray,
    Interpretation,
    ReadingsStatement,
    TableReader,
    TableRows,
    grouped,
    judged,
    without_empty,
)
from service.formats.foreign.messages import scalar_of, wrong_length
from service.formats.foreign.table import ForeignTableError, Table
from service.formats.foreign.times import age_question, in_words
from service.formats.foreign.units import ANGLE_UNITS, angle_unit, contradicted_angle_unit

#: least distance of a code for no reading to the angles, deg
_CODE_GAP_DEG = 1.0
#: beyond it roll or pitch do not point to the Earth from geosynchronous height
EARTH_DISC_DEG = 8.7
_OTHER_WORDS = frozenset({"angle", "attitude", "att", "угол", "est", "meas", "measured"})
_QUATERNIONS: tuple[tuple[tuple[str, str, str, str], str | None], ...] = (
    (("q1", "q2", "q3", "q4"), None),
    (("q0", "q1", "q2", "q3"), None),
    (("q1", "q2", "q3", "qc"), "last"),
    (("qx", "qy", "qz", "qw"), "last"),
    (("qx", "qy", "qz", "qs"), "last"),
    (("qw", "qx", "qy", "qz"), "first"),
)
#: words of names by axis, and words that say nothing more
_AXIS_WORDS: dict[Axis, set[str]] = {
    "yaw": {"yaw", "рыскание", "рысканье", "gier", "gieren"},
    "roll": {"roll", "крен", "rollen"},
    "pitch": {"pitch", "тангаж", "nick", "nicken"},
}


def holds_angles(table: Table) -> bool:
    """Return whether names of columns are those of angles or of a quaternion."""
    parts = {"".join(each for each in name.casefold() if each.isalnum()) for name in table.header}
    axes = {_axis_of(name) for name in table.header} - {None}
    return len(axes) > 1 or any(parts.issuperset(names) for names, _ in _QUATERNIONS)


def interpret_readings(
    table: Table, stated: ReadingsStatement, now_us: int, *, is_simulated: bool = False
) -> Interpretation:
    """Return how a table of a sensor's readings is read; the parameters are those of `interpret_powers`."""
    reader = TableReader(table, stated)
    columns, scalar = _axes_of(reader, stated)
    fields = reader.fields() | {"columns": {name: axis for axis, name in columns.items() if axis in AXES}}
    if not columns:
        text = "no column is named yaw, roll, pitch or q1 to q4; state NAME: yaw, NAME: roll, NAME: pitch"
        reader.ask("columns", text, reader.rest)
        return Interpretation(without_empty(fields), tuple(reader.questions), None, tuple(reader.notes))
    numbers = {axis: reader.numbers(name) for axis, name in columns.items()}
    faults = [
        (f"{columns[axis]!r} holds no number with decimal {reader.decimal}", bad)
        for axis, (_, bad, _) in numbers.items()
    ]
    raw = np.column_stack([values for values, _, _ in numbers.values()])
    if "q4" in columns:
        angles, more, fields["scalar"] = _quaternion_angles(raw, stated.scalar, scalar)
    else:
        in_cells = {columns[axis]: unit for axis, (_, _, unit) in numbers.items()}
        angles, more, fields["unit"] = _angles(reader, columns, raw, in_cells)
    values = np.full((len(raw), 3), np.nan)
    present = [AXES.index(axis) for axis in columns] if "q4" not in columns else [0, 1, 2]
    values[:, present] = angles
    with np.errstate(invalid="ignore"):
        is_beyond = np.any(np.abs(values[:, 1:]) > EARTH_DISC_DEG, axis=1) | (np.abs(values[:, 0]) > 180.0)
    if 2 * int(is_beyond.sum()) > len(values) and not reader.questions:
        shown = ", ".join(
            f"{axis} {np.nanmedian(np.abs(values[:, k])):.2f}" for k, axis in enumerate(AXES) if k in present
        )
        raise ForeignTableError(
            f"the angles, in the middle {shown} deg, lie beyond the Earth's disc of {EARTH_DISC_DEG} deg: check unit,"
            " axes and frame (angles from the nadir frame to the body are wanted)"
        )
    beyond = f"roll or pitch beyond the Earth's disc ({EARTH_DISC_DEG} deg), or an angle beyond 360 deg"
    rows = reader.rows_of(AXES, values, [*faults, *more, (beyond, is_beyond)])
    if rows is None:
        return Interpretation(without_empty(fields), tuple(reader.questions), None, tuple(reader.notes))
    return judged(reader, rows, fields, now_us, is_simulated=is_simulated, is_own=False)


def judged_readings(
    epochs_us: IntArray,
    angles_deg: FloatArray,
    stated: ReadingsStatement,
    now_us: int,
    *,
    is_simulated: bool,
    sigma_deg: FloatArray | None = None,
) -> Interpretation:
    """Return the readings of a message, whose columns and units its standard states, under the rules of tables."""
    is_beyond = np.any(np.abs(np.nan_to_num(angles_deg)) > [180.0, EARTH_DISC_DEG, EARTH_DISC_DEG], axis=1)
    order = np.argsort(epochs_us, kind="stable")
    kept = order[~is_beyond[order]]
    faults = [
        (int(k) + 1, f"roll or pitch beyond the Earth's disc ({EARTH_DISC_DEG} deg)") for k in np.flatnonzero(is_beyond)
    ]
    rows = TableRows(AXES, epochs_us[kept], angles_deg[kept], kept + 1, faults)
    rows.sigma_deg = None if sigma_deg is None else sigma_deg[kept]
    rows.require_few_faults(is_partial=stated.partial)
    question = age_question(rows.epochs_us, now_us, stated.last_day, is_simulated=is_simulated)
    first, last = (in_words(int(rows.epochs_us[k]), now_us) for k in (0, -1))
    notes = (f"{len(rows.lines)} rows from {first.split(',')[0]} to {last}", *grouped(faults))
    found = {"last_day": stated.last_day, "partial": stated.partial}
    return Interpretation(without_empty(found), () if question is None else (question,), rows, notes)


def _axes_of(reader: TableReader, stated: ReadingsStatement) -> tuple[dict[str, str], str | None]:
    """Return the columns by axis, or by part of a quaternion in its order, and the place of the scalar by its name."""
    for name in stated.columns:
        reader.table.column(name)
    by_part = {"".join(each for each in name.casefold() if each.isalnum()): name for name in reader.rest}
    for parts, scalar in _QUATERNIONS:
        if not stated.columns and all(part in by_part for part in parts):
            return dict(zip(("q1", "q2", "q3", "q4"), (by_part[part] for part in parts), strict=True)), scalar
    found: dict[str, list[str]] = {}
    for name in reader.rest:
        axis = stated.columns.get(name) if stated.columns else _axis_of(name)
        if axis is not None:
            found.setdefault(axis, []).append(name)
    twice = [names for names in found.values() if len(names) > 1]
    if twice:
        reader.ask("columns", f"columns {' and '.join(map(repr, twice[0]))} are one axis", twice[0])
    return {axis: found[axis][0] for axis in AXES if axis in found}, None


def _axis_of(name: str) -> Axis | None:
    """Return the axis that a column's name states; None for one that holds anything else, as a rate or a sigma."""
    words = words_of(name)
    axes = [axis for axis, known in _AXIS_WORDS.items() if words & known]
    if (
        len(axes) != 1
        or words - _AXIS_WORDS[axes[0]] - {word for unit in ANGLE_UNITS.values() for word in unit[1]} - _OTHER_WORDS
    ):
        return None
    return axes[0]


def _angles(
    reader: TableReader, columns: Mapping[str, str], raw: FloatArray, in_cells: Mapping[str, str | None]
) -> tuple[FloatArray, list[tuple[str, BoolArray]], str | None]:
    """Return angles in deg, wrapped to half a turn, the faults of cells, and the unit to state."""
    stated = reader.stated.unit
    if stated is not None and stated not in ANGLE_UNITS:
        raise ForeignTableError(f"unit {stated[:20]!r} is unknown; write {', '.join(ANGLE_UNITS)}")
    named = [in_cells[name] or angle_unit(name, reader.table.units) for name in columns.values()]
    if stated is not None and any(each not in (None, stated) for each in named):
        if contradicted_angle_unit(raw, list(columns), named, EARTH_DISC_DEG) is None:
            raise ForeignTableError(
                f"the columns name {', '.join(sorted(set(filter(None, named))))}, unit {stated} is stated"
            )
        named = [stated] * len(named)
    units = [each or stated for each in named]
    unit = stated
    if None in units:
        reader.ask("unit", "unit of the angles; no column names it", tuple(ANGLE_UNITS), "deg")
        units, unit = [each or "deg" for each in units], "deg"
    elif stated is None and (odd := contradicted_angle_unit(raw, list(columns), units, EARTH_DISC_DEG)) is not None:
        reader.ask("unit", odd[0], tuple(ANGLE_UNITS), odd[1])
        units, unit = [odd[1]] * len(units), odd[1]
    scale = np.array([ANGLE_UNITS[each or "deg"][0] for each in units])
    reader.ask_codes(raw, list(columns.values()), float(_CODE_GAP_DEG / scale.max()), has_zero_rows=True)
    angles = raw * scale
    with np.errstate(invalid="ignore"):
        angles = np.where((angles > 180.0) & (angles <= 360.0), angles - 360.0, angles)
        angles = np.where((angles < -180.0) & (angles >= -360.0), angles + 360.0, angles)
    return angles, [], unit


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
    is_wrong = np.zeros(len(raw), dtype=np.bool_)
    is_wrong[whole] = wrong_length(raw[whole])
    angles = np.full((len(raw), 3), np.nan)
    right = whole & ~is_wrong
    ordered = np.roll(raw[right], -1, axis=1) if proven == "first" else raw[right]
    angles[right] = attitude_of_quaternion(ordered)
    return angles, [("quaternion is not of unit length", is_wrong)], proven
