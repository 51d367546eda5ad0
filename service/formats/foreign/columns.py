"""Columns of foreign tables: levels of carriers and angles of a sensor, read whole, judged, or asked about.

What no content proves is a question with a guess. A row is left out with its line and reason; too many of them refuse
the file. A fault that depends on the size or sign of a value is asked about or refused, never left over: what remained
would be biased.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from service.core.geometry.frames import attitude_of_quaternion
from service.formats.foreign.messages import scalar_of, wrong_length
from service.formats.foreign.table import Container, ForeignTableError, Question, Table
from service.formats.foreign.times import Clock, Epochs, age_question, find_clock, in_words, words_of
from service.formats.foreign.units import (
    ANGLE_UNITS,
    LEVEL_UNITS,
    angle_unit,
    contradicted_angle_unit,
    contradicted_level_unit,
    decimal_of,
    level_unit,
    levels_dbm,
    number_column,
    suspected_codes,
    without_unit,
)
from service.records.epoch import DAY_US

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Axis = Literal["yaw", "roll", "pitch"]
AXES: tuple[Axis, ...] = ("yaw", "roll", "pitch")
#: levels of a carrier at an analyzer, dBm
PLAUSIBLE_DBM = (-170.0, 30.0)
#: beyond it roll or pitch do not point to the Earth from geosynchronous height
EARTH_DISC_DEG = 8.7
#: rows that may be left out: a number, and a share
MOST_ROWS, MOST_SHARE = 3, 0.02
#: words of names by axis, and words that say nothing more
_AXIS_WORDS: dict[Axis, set[str]] = {
    "yaw": {"yaw", "рыскание", "рысканье", "gier", "gieren"},
    "roll": {"roll", "крен", "rollen"},
    "pitch": {"pitch", "тангаж", "nick", "nicken"},
}
_OTHER_WORDS = frozenset({"angle", "attitude", "att", "угол", "est", "meas", "measured"})
_QUATERNIONS: tuple[tuple[tuple[str, str, str, str], str | None], ...] = (
    (("q1", "q2", "q3", "q4"), None),
    (("q0", "q1", "q2", "q3"), None),
    (("q1", "q2", "q3", "qc"), "last"),
    (("qx", "qy", "qz", "qw"), "last"),
    (("qx", "qy", "qz", "qs"), "last"),
    (("qw", "qx", "qy", "qz"), "first"),
)
#: least distance of a code for no reading to the levels, dB, and to the angles, deg
_CODE_GAP_DB, _CODE_GAP_DEG = 10.0, 1.0
#: a step of sorted epochs beyond it parts rows of another time
_APART_US = 400 * DAY_US


class TableStatement(BaseModel):
    """What a person stated of a table; empty = not stated."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    file: str
    source: str = ""
    sheet: str | None = None
    encoding: str | None = None
    separator: str | None = None
    skip_lines: Annotated[int, Field(ge=0)] = 0
    #: texts and numbers that stand for no reading; ``none``: what repeats are readings
    missing: tuple[str, ...] = ()
    time_columns: tuple[str, ...] = ()
    time_format: str | None = None
    tz: str | None = None
    #: day of the first row of a table with times of day only, and of the newest row of any
    date: str | None = None
    last_day: str | None = None
    decimal: Literal["point", "comma"] | None = None
    unit: str | None = None
    #: rows that cannot be read are left out, however many they are
    partial: bool = False

    @field_validator("time_columns", "missing", mode="before")
    @classmethod
    def _of_text(cls, given: Any) -> Any:
        """Return the parts of a text: ``Date + Time``."""
        return tuple(given.split(" + ")) if isinstance(given, str) else given

    @property
    def container(self) -> Container:
        """Return what is stated of the container."""
        return Container(self.sheet, self.encoding, self.separator, self.skip_lines)


class PowersStatement(TableStatement):
    """Powers of carriers."""

    carrier_column: str | None = None
    level_column: str | None = None
    #: carrier of the plan by column, or by name in the carrier column
    carriers: dict[str, str] = Field(default_factory=dict)
    #: rows that the file gives to this source; None: those of ``source``, and those without one
    from_source: str | None = None


class ReadingsStatement(TableStatement):
    """Readings of a sensor."""

    scalar: Literal["first", "last"] | None = None
    #: axis by column
    columns: dict[str, Axis] = Field(default_factory=dict)
    sigma_deg: dict[Axis, Annotated[float, Field(gt=0.0, le=180.0)]] = Field(default_factory=dict)


@dataclass(slots=True)
class TableRows:
    """Rows of a table in order of epoch, and those that are left out."""

    #: carriers of the plan, or axes
    names: tuple[str, ...]
    epochs_us: IntArray
    #: (T, N), dBm or deg, NaN = absent
    values: FloatArray
    lines: IntArray
    #: line and reason of each row that is left out
    faults: list[tuple[int, str]] = field(default_factory=list)
    #: rows of other sources, by source
    other_sources: dict[str, int] = field(default_factory=dict)
    #: one standard deviation by row and axis, deg, NaN = not stated; None: the file states none
    sigma_deg: FloatArray | None = None

    def require_few_faults(self, *, is_partial: bool) -> None:
        """Refuse a table of which too many rows cannot be read: ForeignTableError with the reasons."""
        most = max(MOST_ROWS, MOST_SHARE * (len(self.lines) + len(self.faults)))
        if not len(self.lines):
            raise ForeignTableError(f"no row can be read: {'; '.join(grouped(self.faults)[:3]) or 'there is none'}")
        if len(self.faults) > most and not is_partial:
            total = len(self.lines) + len(self.faults)
            raise ForeignTableError(
                f"{len(self.faults)} of {total} rows cannot be read, so nothing is stored:"
                f" {'; '.join(grouped(self.faults)[:5])}; correct them, or state partial to store the others"
            )


class Interpretation(NamedTuple):
    """How a table is read: fields of its entry, guesses among them, and the rows under these."""

    found: dict[str, Any]
    questions: tuple[Question, ...]
    #: None: the questions must be answered first
    rows: TableRows | None
    notes: tuple[str, ...]


def grouped(faults: Sequence[tuple[int, str]]) -> list[str]:
    """Return faults by reason, the most frequent first, each with its number and first line."""
    groups: dict[str, list[int]] = {}
    for line, reason in faults:
        groups.setdefault(reason, []).append(line)
    ordered = sorted(groups.items(), key=lambda item: -len(item[1]))
    return [f"{len(lines)} rows: {reason} (first: line {min(lines)})" for reason, lines in ordered]


class _Reader:
    """What powers and readings have in common: clock, decimal sign, numbers, questions and the judgement of rows."""

    def __init__(self, table: Table, stated: TableStatement) -> None:
        self.table, self.stated = table, stated
        self.decimal = stated.decimal or decimal_of(table)
        clock = Clock(stated.time_columns, stated.time_format, stated.tz, stated.date)
        self.clock, self.questions, epochs = find_clock(table, clock, self.decimal)
        self.rest = [name for name in table.header if name not in self.clock.columns]
        self.epochs: Epochs | None = epochs
        self.notes = list(table.notes)

    def ask(self, name: str, text: str, choices: Sequence[str] = (), default: Any = None) -> None:
        """Add a question."""
        self.questions.append(Question(name, text, tuple(choices), default))

    def numbers(self, name: str) -> tuple[FloatArray, BoolArray, str | None]:
        """Return the numbers of a column, NaN = absent, which cells are none, and the unit that the cells state."""
        return number_column(self.table.column(name), self.decimal, self.stated.missing)

    def numeric(self) -> list[str]:
        """Return the columns beside the clock of which nine of ten filled cells are numbers."""
        found = []
        for name in self.rest:
            values, is_bad, _ = self.numbers(name)
            present = np.isfinite(values)
            if present.any() and is_bad.sum() <= 0.1 * (is_bad.sum() + present.sum()):
                found.append(name)
        return found

    def ask_codes(self, values: FloatArray, names: Sequence[str], least_gap: float, *, has_zero_rows: bool) -> None:
        """Ask about numbers that repeat apart from the others, unless they are stated to be readings."""
        if "none" in self.stated.missing:
            return
        found = suspected_codes(values, least_gap, has_zero_rows=has_zero_rows)
        if found:
            shown = ", ".join(f"{code:g} ({count} times)" for code, count in found.items())
            where = next(
                (n for n, column in zip(names, values.T, strict=True) if next(iter(found)) in column), names[0]
            )
            text = (
                f"numbers repeat apart from all others, in {where!r}: {shown}: codes for no reading? none: they are not"
            )
            self.ask("missing", text, ("none",), [*self.stated.missing, *(f"{code:g}" for code in found)])
            values[np.isin(values, list(found))] = np.nan

    def fields(self) -> dict[str, Any]:
        """Return the fields of the clock and the container."""
        clock = self.clock
        stated = self.stated.model_dump(include={"sheet", "encoding", "separator", "skip_lines", "missing", "partial"})
        found = {name: value for name, value in stated.items() if value}
        found |= {"time_columns": list(clock.columns), "time_format": clock.time_format, "tz": clock.tz}
        return found | {"date": clock.date, "last_day": self.stated.last_day, "decimal": self.decimal}

    def rows_of(
        self, names: Sequence[str], values: FloatArray, faults: Sequence[tuple[str, BoolArray]]
    ) -> TableRows | None:
        """Return the rows in order of epoch; those of another epoch, a second one, and faulty ones are left out."""
        if self.epochs is None:
            return None
        epochs, lines = self.epochs, self.table.lines
        for reason, rows in faults:
            epochs.refuse(reason, rows)
        footer = self._footer(epochs.is_bad)
        _refuse_other_times(epochs)
        _refuse_second_rows(epochs, values)
        left_out = list(self.table.faults)
        for reason, rows in epochs.reasons:
            left_out += [(line, reason) for line in lines[rows & ~footer].tolist()]
        kept = np.flatnonzero(~epochs.is_bad)
        kept = kept[np.argsort(epochs.us[kept], kind="stable")]
        return TableRows(tuple(names), epochs.us[kept], values[kept], lines[kept], sorted(left_out))

    def _footer(self, is_bad: BoolArray) -> BoolArray:
        """Return the last rows, ten at most, whose epoch holds no digit: words below the table."""
        import pyarrow.compute as pc

        footer = np.zeros(len(is_bad), dtype=np.bool_)
        column = self.table.column(self.clock.columns[0])
        for k in range(len(is_bad) - 1, max(-1, len(is_bad) - 11), -1):
            if not is_bad[k] or any(sign.isdigit() for sign in column[k].as_py()):
                break
            footer[k] = True
        if footer.any():
            self.notes.append(
                f"{int(footer.sum())} lines below the table, like {pc.utf8_trim_whitespace(column[-1]).as_py()!r}"
            )
        return footer


def _refuse_other_times(epochs: Epochs) -> None:
    """Mark the few rows whose epoch lies years apart from all others: a clock that was not set."""
    rows = np.flatnonzero(~epochs.is_bad)
    order = rows[np.argsort(epochs.us[rows], kind="stable")]
    parts = np.split(order, np.flatnonzero(np.diff(epochs.us[order]) > _APART_US) + 1)
    largest = max(parts, key=len)
    for part in parts:
        if len(part) < len(largest):
            wrong = np.zeros(len(epochs.us), dtype=np.bool_)
            wrong[part] = True
            epochs.refuse(f"epoch is years apart from the others, as {in_words(int(epochs.us[part[0]]))}", wrong)


def _refuse_second_rows(epochs: Epochs, values: FloatArray) -> None:
    """Mark rows that repeat an epoch with other values; equal ones are known to the service as such."""
    rows = np.flatnonzero(~epochs.is_bad)
    order = rows[np.argsort(epochs.us[rows], kind="stable")]
    is_second = np.zeros(len(epochs.us), dtype=np.bool_)
    same = np.diff(epochs.us[order]) == 0
    before, after = order[:-1][same], order[1:][same]
    differs = ~np.all((values[before] == values[after]) | (np.isnan(values[before]) & np.isnan(values[after])), axis=1)
    is_second[after[differs]] = True
    epochs.refuse("a second row of one epoch with other values: are the seconds cut off?", is_second)


def holds_angles(table: Table) -> bool:
    """Return whether names of columns are those of angles or of a quaternion."""
    parts = {"".join(each for each in name.casefold() if each.isalnum()) for name in table.header}
    axes = {_axis_of(name) for name in table.header} - {None}
    return len(axes) > 1 or any(parts.issuperset(names) for names, _ in _QUATERNIONS)


def interpret_powers(
    table: Table, stated: PowersStatement, carriers: Mapping[str, str], now_us: int, *, is_simulated: bool = False
) -> Interpretation:
    """Return how a table of powers is read.

    Parameters
    ----------
    table : Table
        The whole table.
    stated : PowersStatement
        What a person stated; it is checked and never replaced.
    carriers : mapping
        Ids of the plan by id and by name; an empty id: two carriers have this name.
    now_us : int
        Present, microseconds UTC.
    is_simulated : bool
        Epochs of a simulated spacecraft may lie in the future.

    Raises
    ------
    ForeignTableError
        A stated thing that the table contradicts, or a table of which nothing can be read.
    """
    _check_stated_carriers(table, stated, carriers)
    reader = _Reader(table, stated)
    plan_ids = tuple(dict.fromkeys(filter(None, carriers.values())))
    matched = _matched(reader, reader.rest, carriers, stated.carriers) if stated.carrier_column is None else {}
    carrier_column = stated.carrier_column or (None if matched else _carrier_column(reader, carriers))
    fields, names = reader.fields(), reader.rest
    if carrier_column is not None:
        names = list(filter(None, dict.fromkeys(table.column(carrier_column).to_pylist())))
        matched = _matched(reader, [*names, *stated.carriers], carriers, stated.carriers)
        level_column = stated.level_column or _level_column(reader, carrier_column)
        fields |= {"carrier_column": carrier_column, "level_column": level_column}
    if not matched:
        matched = _ask_carriers(reader, carrier_column, plan_ids)
    fields["carriers"] = matched
    left_out = [name for name in names if name not in matched and name != "source"]
    reader.notes += [f"no carrier of the plan: {', '.join(left_out[:12])}"] if left_out else []
    level_columns = list(matched) if carrier_column is None else [fields["level_column"]]
    rows = None
    if reader.epochs is not None and matched and None not in level_columns:
        levels, faults, fields["unit"] = _levels(reader, level_columns)
        rows = _rows_of_one_source(reader, stated, carrier_column, matched, (levels, faults))
    if rows is None:
        return Interpretation(_without_empty(fields), tuple(reader.questions), None, tuple(reader.notes))
    ordered = np.full((len(rows.lines), len(plan_ids)), np.nan)
    ordered[:, [plan_ids.index(each) for each in rows.names]] = rows.values
    rows.names, rows.values = plan_ids, ordered
    is_own = "epoch" in table.header and all(name.endswith(("_dbm", "_dbw")) for name in level_columns)
    return _judged(reader, rows, fields, now_us, is_simulated=is_simulated, is_own=is_own)


def _check_stated_carriers(table: Table, stated: PowersStatement, carriers: Mapping[str, str]) -> None:
    """Refuse stated carriers that the plan does not have, and columns that the table does not have."""
    unknown = [each for each in stated.carriers.values() if each not in set(carriers.values()) - {""}]
    if unknown:
        plan = ", ".join(dict.fromkeys(filter(None, carriers.values())))
        raise ForeignTableError(f"carriers names {unknown[0][:40]!r}, which is no carrier of the plan: {plan[:300]}")
    for name in stated.carriers if stated.carrier_column is None else ():
        if name not in table.header and _carrier_column(_Reader(table, stated), carriers) is None:
            table.column(name)


def _rows_of_one_source(
    reader: _Reader,
    stated: PowersStatement,
    carrier_column: str | None,
    matched: Mapping[str, str],
    judged: tuple[FloatArray, list[tuple[str, BoolArray]]],
) -> TableRows | None:
    """Return the rows of the wanted source; those of others are counted apart."""
    levels, faults = judged
    sources = _other_sources(reader, stated)
    reasons = [*sources.items(), *faults]
    if carrier_column is None:
        rows = reader.rows_of(tuple(matched.values()), levels, reasons)
    else:
        rows = _gathered(reader, carrier_column, matched, levels[:, 0], reasons)
    if rows is not None:
        rows.other_sources = {each: sum(reason == each for _, reason in rows.faults) for each in sources}
        rows.faults = [(line, reason) for line, reason in rows.faults if reason not in sources]
    return rows


def _judged(
    reader: _Reader, rows: TableRows, fields: dict[str, Any], now_us: int, *, is_simulated: bool, is_own: bool
) -> Interpretation:
    """Return the reading of a table whose rows are few enough at fault, with the age of the newest."""
    rows.require_few_faults(is_partial=reader.stated.partial)
    if not is_own and not {each.field for each in reader.questions} & {"date", "time_format", "time_columns"}:
        question = age_question(rows.epochs_us, now_us, reader.stated.last_day, is_simulated=is_simulated)
        reader.questions += [] if question is None else [question]
    first, last = (in_words(int(rows.epochs_us[k]), now_us) for k in (0, -1))
    notes = (*reader.notes, f"{len(rows.lines)} rows from {first.split(',')[0]} to {last}", *grouped(rows.faults))
    return Interpretation(_without_empty(fields), tuple(reader.questions), rows, notes)


def _without_empty(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that hold something."""
    return {name: value for name, value in fields.items() if value not in (None, "", [], {}, ())}


def _matched(
    reader: _Reader, names: Sequence[str], carriers: Mapping[str, str], stated: Mapping[str, str]
) -> dict[str, str]:
    """Return the carrier of each name: stated, or equal to an id or name of the plan without its unit.

    Two names of one carrier, and a name that two carriers have, are asked.
    """
    known = {name.casefold(): carrier for name, carrier in carriers.items()}
    found = {name: stated.get(name) or known.get(without_unit(name).casefold()) for name in dict.fromkeys(names)}
    matched = {name: carrier for name, carrier in found.items() if carrier is not None}
    values = list(matched.values())
    twice = [
        name for name in matched if matched[name] == "" or (values.count(matched[name]) > 1 and name not in stated)
    ]
    if twice and not (stated and all(values.count(each) == 1 for each in stated.values())):
        shared = ", ".join(sorted({matched[name] for name in twice} - {""}) or twice)
        reader.ask("carriers", f"several columns are one carrier ({shared}): {', '.join(twice)}", twice)
    return {name: carrier for name, carrier in matched.items() if name in stated or (name not in twice)}


def _carrier_column(reader: _Reader, carriers: Mapping[str, str]) -> str | None:
    """Return the column in which names of carriers stand, where there is one such column."""
    import pyarrow.compute as pc

    known = {name.casefold() for name in carriers} | {
        name.casefold() for name in getattr(reader.stated, "carriers", {})
    }
    holding = []
    for name in reader.rest:
        distinct = pc.unique(reader.table.column(name)).to_pylist()
        if {each.casefold() for each in distinct[:2000]} & known:
            holding.append(name)
    return holding[0] if len(holding) == 1 else None


def _level_column(reader: _Reader, carrier_column: str) -> str | None:
    """Return the column of levels of a table with one level a line, or ask for it."""
    numbers = [name for name in reader.numeric() if name != carrier_column]
    named = [name for name in numbers if level_unit(name, reader.table.units)] or numbers
    if len(named) != 1:
        reader.ask("level_column", "column of the levels", named, named[0] if named else None)
    return named[0] if named else None


def _ask_carriers(reader: _Reader, carrier_column: str | None, plan_ids: Sequence[str]) -> dict[str, str]:
    """Ask which columns or names are which carriers, and return the guess: equally many suggest their order."""
    if any(each.field == "carriers" for each in reader.questions):
        return {}
    if carrier_column is None:
        names = reader.numeric()
        text = f"no column has the name of a carrier; the plan has {', '.join(plan_ids[:12])}"
    else:
        names = list(dict.fromkeys(filter(None, reader.table.column(carrier_column).to_pylist())))
        text = f"no name in {carrier_column!r} is a carrier of the plan: {', '.join(plan_ids[:12])}"
    in_order = dict(zip(names, plan_ids, strict=True)) if len(names) == len(plan_ids) else {}
    reader.ask("carriers", text, names, in_order or None)
    return in_order


def _levels(reader: _Reader, columns: Sequence[str]) -> tuple[FloatArray, list[tuple[str, BoolArray]], str | None]:
    """Return levels in dBm (T, N), the faults of cells, and the unit to state for columns that name none."""
    stated, table = reader.stated, reader.table
    if stated.unit is not None and stated.unit not in LEVEL_UNITS:
        raise ForeignTableError(f"unit {stated.unit[:20]!r} is unknown; write {', '.join(LEVEL_UNITS)}")
    numbers, faults, units = [], [], []
    for name in columns:
        values, is_bad, in_cells = reader.numbers(name)
        numbers.append(values)
        faults.append((f"{name!r} holds no number with decimal {reader.decimal}", is_bad))
        units.append(in_cells or level_unit(name, table.units))
    raw = np.column_stack(numbers)
    contradicted = contradicted_level_unit(raw, units)
    silent = [name for name, unit in zip(columns, units, strict=True) if unit is None]
    unit = stated.unit
    if unit is None and (contradicted is not None or silent):
        span = f"{np.nanmin(raw):g} to {np.nanmax(raw):g}" if np.isfinite(raw).any() else "nothing"
        who = contradicted[0] if contradicted else "no column name states the unit"
        plausible = [each for each in LEVEL_UNITS if _is_plausible(levels_dbm(raw, [each] * raw.shape[1]))]
        default = contradicted[1] if contradicted else (plausible or ["dBm"])[0]
        reader.ask("unit", f"{who}; levels span {span}", tuple(LEVEL_UNITS), default)
        unit = default
    elif unit is not None and contradicted is None and set(units) - {unit, None}:
        odd = next(name for name, each in zip(columns, units, strict=True) if each not in (None, unit))
        raise ForeignTableError(f"column {odd!r} states its unit, and unit {unit} is stated; rename or leave it out")
    units = [unit if unit is not None and (own is None or contradicted) else own for own in units]
    if all(each is None or each.startswith("dB") for each in units):
        reader.ask_codes(raw, columns, _CODE_GAP_DB, has_zero_rows=False)
    dbm = levels_dbm(raw, [each or "dBm" for each in units])
    faults.append(("a power of 0 or less has no level", np.any(np.isfinite(raw) & np.isnan(dbm), axis=1)))
    with np.errstate(invalid="ignore"):
        is_beyond = np.any((dbm <= PLAUSIBLE_DBM[0]) | (dbm >= PLAUSIBLE_DBM[1]), axis=1)
    if 2 * int(is_beyond.sum()) > len(dbm) and not reader.questions:
        middle = float(np.nanmedian(dbm))
        raise ForeignTableError(
            f"the middle level is {middle:.1f} dBm, which no analyzer shows for a carrier: is unit right?"
        )
    faults.append((f"a level beyond {PLAUSIBLE_DBM[0]:g} to {PLAUSIBLE_DBM[1]:g} dBm", is_beyond))
    return dbm, faults, unit


def _is_plausible(dbm: FloatArray) -> bool:
    """Return whether the middle of some levels is one that an analyzer can show."""
    return bool(np.isfinite(dbm).any() and PLAUSIBLE_DBM[0] < float(np.nanmedian(dbm)) < PLAUSIBLE_DBM[1])


def _other_sources(reader: _Reader, stated: PowersStatement) -> dict[str, BoolArray]:
    """Return the rows of other sources than the wanted one, by source."""
    if "source" not in reader.table.header or not (stated.source or stated.from_source):
        return {}
    wanted = {stated.from_source} if stated.from_source is not None else {stated.source, ""}
    sources = np.array(reader.table.column("source").to_pylist(), dtype=object)
    return {each: sources == each for each in dict.fromkeys(sources.tolist()) if each not in wanted}


def _gathered(
    reader: _Reader,
    carrier_column: str,
    matched: Mapping[str, str],
    levels: FloatArray,
    faults: Sequence[tuple[str, BoolArray]],
) -> TableRows | None:
    """Return a row for each epoch of a table with one level a line; a second level of a carrier is a fault."""
    if reader.epochs is None:
        return None
    epochs, lines = reader.epochs, reader.table.lines
    for reason, rows in faults:
        epochs.refuse(reason, rows)
    _refuse_other_times(epochs)
    used = tuple(dict.fromkeys(matched.values()))
    encoded = reader.table.column(carrier_column).dictionary_encode()
    position = np.array([used.index(matched[n]) if n in matched else -1 for n in encoded.dictionary.to_pylist()])
    of_rows = position[encoded.indices.to_numpy()]
    kept = np.flatnonzero(~epochs.is_bad & (of_rows >= 0))
    us, row_of = np.unique(epochs.us[kept], return_inverse=True)
    cells = row_of * len(used) + of_rows[kept]
    _, first, cell_of = np.unique(cells, return_index=True, return_inverse=True)
    is_second = np.zeros(len(lines), dtype=np.bool_)
    other = levels[kept] != levels[kept[first]][cell_of]
    is_second[kept[other & ~np.isnan(levels[kept])]] = True
    epochs.refuse("second level of one carrier at one epoch", is_second)
    values = np.full((len(us), len(used)), np.nan)
    values.ravel()[cells[first]] = levels[kept[first]]
    line_of = np.full(len(us), np.iinfo(np.int64).max)
    np.minimum.at(line_of, row_of, lines[kept])
    left_out = list(reader.table.faults)
    for reason, rows in epochs.reasons:
        left_out += [(line, reason) for line in lines[rows].tolist()]
    return TableRows(used, us, values, line_of, sorted(left_out))


def interpret_readings(
    table: Table, stated: ReadingsStatement, now_us: int, *, is_simulated: bool = False
) -> Interpretation:
    """Return how a table of a sensor's readings is read; the parameters are those of `interpret_powers`."""
    reader = _Reader(table, stated)
    columns, scalar = _axes_of(reader, stated)
    fields = reader.fields() | {"columns": {name: axis for axis, name in columns.items() if axis in AXES}}
    if not columns:
        text = "no column is named yaw, roll, pitch or q1 to q4; state NAME: yaw, NAME: roll, NAME: pitch"
        reader.ask("columns", text, reader.rest)
        return Interpretation(_without_empty(fields), tuple(reader.questions), None, tuple(reader.notes))
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
        return Interpretation(_without_empty(fields), tuple(reader.questions), None, tuple(reader.notes))
    return _judged(reader, rows, fields, now_us, is_simulated=is_simulated, is_own=False)


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
    return Interpretation(_without_empty(found), () if question is None else (question,), rows, notes)


def _axes_of(reader: _Reader, stated: ReadingsStatement) -> tuple[dict[str, str], str | None]:
    """Return the columns by axis, or by part of a quaternion in its order, and where the scalar stands by its name."""
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
    reader: _Reader, columns: Mapping[str, str], raw: FloatArray, in_cells: Mapping[str, str | None]
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
    """Return the angles of quaternions, the faults, and where their scalar stands, which the numbers prove."""
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
