"""Columns of foreign tables: what all have in common, and levels of carriers; read whole, judged, or asked about.

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

from service.formats.foreign.clocks import find_clock
from service.formats.foreign.table import Container, ForeignTableError, Question, Table
from service.formats.foreign.times import Epochs, TableClock, age_question, in_words
from service.formats.foreign.units import (
    LEVEL_UNITS,
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
#: rows that may be left out: a number, and a share
MOST_ROWS, MOST_SHARE = 3, 0.02
#: least distance of a code for no reading to the levels, dB
_CODE_GAP_DB = 10.0
#: a step of sorted epochs beyond it parts rows of another time
_APART_US = 400 * DAY_US


class TableStatement(BaseModel):
    """Statement of a person about a table; empty = not stated."""

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
    """Reading of a table: fields of its entry, guesses among them, and the rows under these."""

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


class TableReader:
    """Reader of powers and of readings: clock, decimal sign, numbers, questions and the judgement of rows."""

    def __init__(self, table: Table, stated: TableStatement) -> None:
        self.table, self.stated = table, stated
        self.decimal = stated.decimal or decimal_of(table)
        clock = TableClock(stated.time_columns, stated.time_format, stated.tz, stated.date)
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
    reader = TableReader(table, stated)
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
    odd = [name for name in left_out if not name.isascii()]
    guess = next((note for note in table.notes if note.startswith("encoding ")), None)
    if odd and guess is not None and stated.encoding is None:
        # a name in the wrong letters would lose its carrier without a word
        found = guess.removeprefix("encoding ")
        reader.ask("encoding", f"in {found} {odd[0]!r} is no carrier", ("cp1251", "koi8-r", "cp866", "cp1252"), found)
    level_columns = list(matched) if carrier_column is None else [fields["level_column"]]
    rows = None
    if reader.epochs is not None and matched and None not in level_columns:
        levels, faults, fields["unit"] = _levels(reader, level_columns)
        rows = _rows_of_one_source(reader, stated, carrier_column, matched, (levels, faults))
    if rows is None:
        return Interpretation(without_empty(fields), tuple(reader.questions), None, tuple(reader.notes))
    ordered = np.full((len(rows.lines), len(plan_ids)), np.nan)
    ordered[:, [plan_ids.index(each) for each in rows.names]] = rows.values
    rows.names, rows.values = plan_ids, ordered
    is_own = "epoch" in table.header and all(name.endswith(("_dbm", "_dbw")) for name in level_columns)
    return judged(reader, rows, fields, now_us, is_simulated=is_simulated, is_own=is_own)


def _check_stated_carriers(table: Table, stated: PowersStatement, carriers: Mapping[str, str]) -> None:
    """Refuse stated carriers that the plan does not have, and columns that the table does not have."""
    unknown = [each for each in stated.carriers.values() if each not in set(carriers.values()) - {""}]
    if unknown:
        plan = ", ".join(dict.fromkeys(filter(None, carriers.values())))
        raise ForeignTableError(f"carriers names {unknown[0][:40]!r}, which is no carrier of the plan: {plan[:300]}")
    for name in stated.carriers if stated.carrier_column is None else ():
        if name not in table.header and _carrier_column(TableReader(table, stated), carriers) is None:
            table.column(name)


def _rows_of_one_source(
    reader: TableReader,
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


def judged(
    reader: TableReader, rows: TableRows, fields: dict[str, Any], now_us: int, *, is_simulated: bool, is_own: bool
) -> Interpretation:
    """Return the reading of a table whose rows are few enough at fault, with the age of the newest."""
    rows.require_few_faults(is_partial=reader.stated.partial)
    if not is_own and not {each.field for each in reader.questions} & {"date", "time_format", "time_columns"}:
        question = age_question(rows.epochs_us, now_us, reader.stated.last_day, is_simulated=is_simulated)
        reader.questions += [] if question is None else [question]
    first, last = (in_words(int(rows.epochs_us[k]), now_us) for k in (0, -1))
    notes = (*reader.notes, f"{len(rows.lines)} rows from {first.split(',')[0]} to {last}", *grouped(rows.faults))
    return Interpretation(without_empty(fields), tuple(reader.questions), rows, notes)


def without_empty(fields: dict[str, Any]) -> dict[str, Any]:
    """Return the fields that hold something."""
    return {name: value for name, value in fields.items() if value not in (None, "", [], {}, ())}


def _matched(
    reader: TableReader, names: Sequence[str], carriers: Mapping[str, str], stated: Mapping[str, str]
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


def _carrier_column(reader: TableReader, carriers: Mapping[str, str]) -> str | None:
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


def _level_column(reader: TableReader, carrier_column: str) -> str | None:
    """Return the column of levels of a table with one level a line, or ask for it."""
    numbers = [name for name in reader.numeric() if name != carrier_column]
    named = [name for name in numbers if level_unit(name, reader.table.units)] or numbers
    if len(named) != 1:
        reader.ask("level_column", "column of the levels", named, named[0] if named else None)
    return named[0] if named else None


def _ask_carriers(reader: TableReader, carrier_column: str | None, plan_ids: Sequence[str]) -> dict[str, str]:
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


def _levels(reader: TableReader, columns: Sequence[str]) -> tuple[FloatArray, list[tuple[str, BoolArray]], str | None]:
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
        looks_like = contradicted or contradicted_level_unit(raw, ["dBm"] * raw.shape[1])
        default = looks_like[1] if looks_like else (plausible or ["dBm"])[0]
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


def _other_sources(reader: TableReader, stated: PowersStatement) -> dict[str, BoolArray]:
    """Return the rows of other sources than the wanted one, by source."""
    if "source" not in reader.table.header or not (stated.source or stated.from_source):
        return {}
    wanted = {stated.from_source} if stated.from_source is not None else {stated.source, ""}
    sources = np.array(reader.table.column("source").to_pylist(), dtype=object)
    return {each: sources == each for each in dict.fromkeys(sources.tolist()) if each not in wanted}


def _gathered(
    reader: TableReader,
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
