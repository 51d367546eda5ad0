"""Columns of foreign tables: what all have in common, and levels of carriers; read whole, judged, or asked about.

What no content proves is a question with a guess. A row is left out with its line and reason; too many of them refuse
the file. A fault that depends on the size or sign of a value is asked about or refused, never left over: what remained
would be biased.
"""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from service.core.arrays import BoolArray, FloatArray, IntArray
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


class TableStatement(Container):
    """Statement of a person about a table; empty = not stated."""

    file: str
    source: str = ""
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
        total = len(self.lines) + len(self.faults)
        if not len(self.lines):
            others = [f"rows of {', '.join(self.other_sources)}: state from_source"] if self.other_sources else []
            raise ForeignTableError(f"no row can be read: {'; '.join([*others, *grouped(self.faults)][:3])}")
        if len(self.faults) > max(MOST_ROWS, MOST_SHARE * total) and not is_partial:
            raise ForeignTableError(
                f"{len(self.faults)} of {total} rows cannot be read, so nothing is stored:"
                f" {'; '.join(grouped(self.faults)[:5])}; correct them, state"
                " missing for a code of no reading, or state partial to store the others"
            )


class Quantity(NamedTuple):
    """Levels or angles: their units, and how these are found and contradicted."""

    units: Mapping[str, Any]
    #: unit that a column's name or the unit row states
    unit_of: Callable[[str, Mapping[str, str]], str | None]
    #: why the numbers of columns are not of their units, and the likely unit; None: they may be
    contradiction: Callable[[FloatArray, Sequence[str | None]], tuple[str, str] | None]
    #: unit of numbers of which nothing says it
    likely: Callable[[FloatArray], str]


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
    """Reader of powers and of readings: clock, decimal sign, numbers, units, questions and the judgement of rows."""

    def __init__(self, table: Table, stated: TableStatement) -> None:
        self.table, self.stated = table, stated
        self.decimal = stated.decimal or decimal_of(table)
        clock = TableClock(stated.time_columns, stated.time_format, stated.tz, stated.date)
        self.clock, self.questions, epochs = find_clock(table, clock, self.decimal)
        self.rest = [name for name in table.header if name not in self.clock.columns]
        self.epochs: Epochs | None = epochs
        self.notes = list(table.notes)
        given = stated.model_dump(include={*Container.model_fields, "missing", "partial", "last_day"})
        self.fields = {name: value for name, value in given.items() if value} | {
            "time_columns": list(self.clock.columns),
            "time_format": self.clock.time_format,
            "tz": self.clock.tz,
            "date": self.clock.date,
            "decimal": self.decimal,
        }

    def ask(self, name: str, text: str, choices: Sequence[str] = (), default: Any = None) -> None:
        """Add a question."""
        self.questions.append(Question(name, text, tuple(choices), default))

    def numeric(self) -> list[str]:
        """Return the columns beside the clock of which nine of ten filled cells are numbers."""
        found = []
        for name in self.rest:
            values, is_bad, _ = number_column(self.table.column(name), self.decimal, self.stated.missing)
            present = np.isfinite(values)
            if present.any() and is_bad.sum() <= 0.1 * (is_bad.sum() + present.sum()):
                found.append(name)
        return found

    def numbers(self, columns: Sequence[str]) -> tuple[FloatArray, list[tuple[str, BoolArray]], list[str | None]]:
        """Return the numbers of columns (T, N), NaN = absent, the faults of cells, and the units that cells state."""
        found = [number_column(self.table.column(name), self.decimal, self.stated.missing) for name in columns]
        faults = []
        for name, (_, is_bad, _) in zip(columns, found, strict=True):
            cell = self.table.column(name)[int(np.argmax(is_bad))].as_py() if is_bad.any() else ""
            faults.append((f"{name!r} holds no number with decimal {self.decimal}, like {str(cell)[:20]!r}", is_bad))
        return np.column_stack([values for values, _, _ in found]), faults, [unit for _, _, unit in found]

    def units(
        self, columns: Sequence[str], raw: FloatArray, in_cells: Sequence[str | None], quantity: Quantity
    ) -> list[str]:
        """Return the unit of each column: of its cells or name, else the stated one; asked where they do not agree."""
        stated = self.stated.unit
        if stated is not None and stated not in quantity.units:
            raise ForeignTableError(f"unit {stated[:20]!r} is unknown; write {', '.join(quantity.units)}")
        named = [cell or quantity.unit_of(name, self.table.units) for cell, name in zip(in_cells, columns, strict=True)]
        contradiction = quantity.contradiction(raw, named) if any(named) else None
        odd = [name for name, unit in zip(columns, named, strict=True) if unit not in (None, stated)]
        unit = stated
        if stated is None and (contradiction is not None or None in named):
            likely = quantity.likely(raw)
            looks_like = contradiction or quantity.contradiction(raw, [likely] * len(columns))
            unit = looks_like[1] if looks_like else likely
            text = contradiction[0] if contradiction else "no column name states the unit"
            span = f"{np.nanmin(raw):g} to {np.nanmax(raw):g}" if np.isfinite(raw).any() else "nothing"
            self.ask("unit", f"{text}; the numbers span {span}", tuple(quantity.units), unit)
        elif stated is not None and odd and contradiction is None:
            raise ForeignTableError(
                f"column {odd[0]!r} states its unit, and unit {stated} is stated; rename or leave it out"
            )
        self.fields["unit"] = unit
        return [str(unit if own is None or (unit and contradiction) else own) for own in named]

    def ask_codes(self, values: FloatArray, names: Sequence[str], least_gap: float, *, has_zero_rows: bool) -> None:
        """Ask about numbers that repeat apart from the others, unless they are stated to be readings."""
        if "none" in self.stated.missing:
            return
        found = suspected_codes(values, least_gap, has_zero_rows=has_zero_rows)
        if found:
            shown = ", ".join(f"{code:g} ({count} times)" for code, count in found.items())
            holds = np.isin(values, next(iter(found))).any(axis=0)
            text = f"numbers repeat apart from all others, in {names[int(np.argmax(holds))]!r}: {shown}"
            codes = [*self.stated.missing, *(f"{code:g}" for code in found)]
            self.ask("missing", f"{text}: codes for no reading? none: they are not", ("none",), codes)
            values[np.isin(values, list(found))] = np.nan

    def rows_of(
        self,
        names: Sequence[str],
        values: FloatArray,
        faults: Sequence[tuple[str, BoolArray]],
        column_of: IntArray | None = None,
    ) -> TableRows | None:
        """Return the rows in order of epoch; those of another epoch, a second one, and faulty ones are left out.

        Of a table with one value a line ``column_of`` states the place of each line's value, -1 = none.
        """
        if self.epochs is None:
            return None
        epochs, lines = self.epochs, self.table.lines
        for reason, rows in faults:
            epochs.refuse(reason, rows)
        footer = self._footer(epochs.is_bad)
        places = np.zeros(len(lines), dtype=np.int64) if column_of is None else column_of
        good = np.flatnonzero(~epochs.is_bad & (places >= 0))
        order = good[np.lexsort((places[good], epochs.us[good]))]
        _refuse_other_times(epochs, order)
        _refuse_second_rows(epochs, order, places, values)
        left_out = list(self.table.faults)
        for reason, rows in epochs.reasons:
            left_out += [(line, reason) for line in lines[rows & ~footer].tolist()]
        kept = order[~epochs.is_bad[order]]
        us, values, lines = epochs.us[kept], values[kept], lines[kept]
        if column_of is not None and len(kept):
            us, first, row_of = np.unique(us, return_index=True, return_inverse=True)
            wide = np.full((len(us), len(names)), np.nan)
            # of equal values of one cell the first stays
            wide[row_of[::-1], places[kept][::-1]] = values[::-1, 0]
            values, lines = wide, np.minimum.reduceat(lines, first)
        return TableRows(tuple(names), us, values, lines, sorted(left_out))

    def _footer(self, is_bad: BoolArray) -> BoolArray:
        """Return the last rows, ten at most, whose epoch holds no digit: words below the table."""
        footer = np.zeros(len(is_bad), dtype=np.bool_)
        column = self.table.column(self.clock.columns[0])
        for k in range(len(is_bad) - 1, max(-1, len(is_bad) - 11), -1):
            if not is_bad[k] or any(sign.isdigit() for sign in column[k].as_py()):
                break
            footer[k] = True
        if footer.any():
            self.notes.append(f"{int(footer.sum())} lines below the table, like {column[-1].as_py()!r}")
        return footer

    def judged(
        self, rows: TableRows | None, now_us: int, *, is_simulated: bool, is_own: bool = False
    ) -> Interpretation:
        """Return the reading of a table whose rows are few enough at fault, with the age of the newest."""
        if rows is not None:
            rows.require_few_faults(is_partial=self.stated.partial)
            if not is_own and not {each.field for each in self.questions} & {"date", "time_format", "time_columns"}:
                question = age_question(rows.epochs_us, now_us, self.stated.last_day, is_simulated=is_simulated)
                self.questions += [] if question is None else [question]
            first, last = (in_words(int(rows.epochs_us[k]), now_us) for k in (0, -1))
            self.notes.append(f"{len(rows.lines)} rows from {first.split(',')[0]} to {last}")
            self.notes += grouped(rows.faults)
        found = {name: value for name, value in self.fields.items() if value not in (None, "", [], {}, ())}
        return Interpretation(found, tuple(self.questions), rows, tuple(self.notes))


def _refuse_other_times(epochs: Epochs, order: IntArray) -> None:
    """Mark the few rows whose epoch lies years apart from all others: a clock that was not set."""
    parts = np.split(order, np.flatnonzero(np.diff(epochs.us[order]) > _APART_US) + 1)
    largest = max(parts, key=len)
    for part in parts:
        if len(part) < len(largest):
            wrong = np.zeros(len(epochs.us), dtype=np.bool_)
            wrong[part] = True
            epochs.refuse(f"epoch is years apart from the others, as {in_words(int(epochs.us[part[0]]))}", wrong)


def _refuse_second_rows(epochs: Epochs, order: IntArray, places: IntArray, values: FloatArray) -> None:
    """Mark rows that repeat an epoch with other values; equal ones are known to the service as such."""
    order = order[~epochs.is_bad[order]]
    same = (np.diff(epochs.us[order]) == 0) & (np.diff(places[order]) == 0)
    before, after = order[:-1][same], order[1:][same]
    differs = ~np.all((values[before] == values[after]) | (np.isnan(values[before]) & np.isnan(values[after])), axis=1)
    is_second = np.zeros(len(epochs.us), dtype=np.bool_)
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
    plan_ids = tuple(dict.fromkeys(filter(None, carriers.values())))
    unknown = set(stated.carriers.values()) - set(plan_ids)
    if unknown:
        odd, plan = min(unknown)[:40], ", ".join(plan_ids)[:300]
        raise ForeignTableError(f"carriers names {odd!r}, which is no carrier of the plan: {plan}")
    reader = TableReader(table, stated)
    fields, names = reader.fields, reader.rest
    matched = _matched(reader, names, carriers) if stated.carrier_column is None else {}
    carrier_column = stated.carrier_column or (None if matched else _carrier_column(reader, carriers))
    if carrier_column is not None:
        names = list(filter(None, dict.fromkeys(table.column(carrier_column).to_pylist())))
        matched = _matched(reader, [*names, *stated.carriers], carriers)
        level_column = stated.level_column or _level_column(reader, carrier_column)
        fields |= {"carrier_column": carrier_column, "level_column": level_column}
    else:
        for name in stated.carriers:
            table.column(name)
    if not matched:
        matched = _ask_carriers(reader, carrier_column, names, carriers)
    fields["carriers"] = matched
    _note_others(reader, [name for name in names if name not in matched and name != "source"])
    level_columns = list(matched) if carrier_column is None else [fields["level_column"]]
    if reader.epochs is None or not matched or None in level_columns:
        return reader.judged(None, now_us, is_simulated=is_simulated)
    sources = _other_sources(reader, stated)
    levels, faults = _levels(reader, level_columns)
    place = {name: plan_ids.index(carrier) for name, carrier in matched.items()}
    column_of = None
    if carrier_column is None:
        values = np.full((len(levels), len(plan_ids)), np.nan)
        values[:, list(place.values())] = levels
    else:
        encoded, values = table.column(carrier_column).dictionary_encode(), levels
        of_texts = [place.get(name, -1) for name in encoded.dictionary.to_pylist()]
        column_of = np.array(of_texts, dtype=np.int64)[encoded.indices.to_numpy()]
    rows = reader.rows_of(plan_ids, values, [*sources.items(), *faults], column_of)
    if rows is not None:
        rows.other_sources = {each: sum(reason == each for _, reason in rows.faults) for each in sources}
        rows.faults = [(line, reason) for line, reason in rows.faults if reason not in sources]
    is_own = "epoch" in table.header and all(name.endswith(("_dbm", "_dbw")) for name in level_columns)
    return reader.judged(rows, now_us, is_simulated=is_simulated, is_own=is_own)


def _note_others(reader: TableReader, names: Sequence[str]) -> None:
    """Note the columns or names that are no carrier; in letters of a guessed encoding they are asked about."""
    if names:
        reader.notes.append(f"no carrier of the plan: {', '.join(names[:12])}")
    odd = next((name for name in names if not name.isascii()), None)
    guess = next((note.split()[1] for note in reader.table.notes if note.startswith("encoding ")), None)
    if odd and guess and reader.stated.encoding is None:
        # a name in the wrong letters would lose its carrier without a word
        reader.ask("encoding", f"in {guess} {odd!r} is no carrier", ("cp1251", "koi8-r", "cp866", "cp1252"), guess)


def _matched(reader: TableReader, names: Sequence[str], carriers: Mapping[str, str]) -> dict[str, str]:
    """Return the carrier of each name: stated, or equal to an id or name of the plan without its unit.

    Two names of one carrier, and a name that two carriers have, are asked.
    """
    stated: dict[str, str] = getattr(reader.stated, "carriers", {})
    known = {name.casefold(): carrier for name, carrier in carriers.items()}
    found = {name: stated.get(name) or known.get(without_unit(name).casefold()) for name in dict.fromkeys(names)}
    matched = {name: carrier for name, carrier in found.items() if carrier is not None}
    count = Counter(matched.values())
    twice = [name for name in matched if not matched[name] or (count[matched[name]] > 1 and name not in stated)]
    if twice and not (stated and all(count[each] == 1 for each in stated.values())):
        shared = ", ".join(sorted({matched[name] for name in twice} - {""}) or twice)
        reader.ask("carriers", f"several columns are one carrier ({shared}): {', '.join(twice)}", twice)
    return {name: carrier for name, carrier in matched.items() if name in stated or name not in twice}


def _carrier_column(reader: TableReader, carriers: Mapping[str, str]) -> str | None:
    """Return the column in which names of carriers stand, where there is one such column."""
    known = {name.casefold() for name in (*carriers, *getattr(reader.stated, "carriers", {}))}
    holding = [name for name in reader.rest if known & texts_of(reader.table.column(name))]
    return holding[0] if len(holding) == 1 else None


def texts_of(column: Any) -> set[str]:
    """Return the different texts of a column, 2000 at most, in lower case."""
    return {each.casefold() for each in column.unique()[:2000].to_pylist()}


def _level_column(reader: TableReader, carrier_column: str) -> str | None:
    """Return the column of levels of a table with one level a line, or ask for it."""
    numbers = [name for name in reader.numeric() if name != carrier_column]
    named = [name for name in numbers if level_unit(name, reader.table.units)] or numbers
    if len(named) != 1:
        reader.ask("level_column", "column of the levels", named, named[0] if named else None)
    return named[0] if named else None


def carriers_named(name: str, carriers: Mapping[str, str]) -> set[str]:
    """Return the carriers whose id or name is a word of a column's name, such as ``Level c00``."""
    words = re.split(r"[^\w.+-]+", name.casefold())
    return {carrier for known, carrier in carriers.items() if known.casefold() in words}


def _ask_carriers(
    reader: TableReader, carrier_column: str | None, names: Sequence[str], carriers: Mapping[str, str]
) -> dict[str, str]:
    """Ask which columns or names are which carriers; the guess goes by words of the names, else by an equal number."""
    if any(each.field == "carriers" for each in reader.questions):
        return {}
    plan_ids = list(dict.fromkeys(filter(None, carriers.values())))
    names = reader.numeric() if carrier_column is None else names
    who = "column has the name of a carrier" if carrier_column is None else f"name in {carrier_column!r} is a carrier"
    words = {name: found for name in names if (found := carriers_named(name, carriers))}
    each_once = sum(map(len, words.values())) == len(set().union(*words.values()) - {""}) == len(words)
    guess = {name: min(found) for name, found in words.items()} if words and each_once else {}
    if not words and len(names) == len(plan_ids):
        guess = dict(zip(names, plan_ids, strict=True))
    reader.ask("carriers", f"no {who}; the plan has {', '.join(plan_ids[:12])}", names, guess or None)
    return guess


def _levels(reader: TableReader, columns: Sequence[str]) -> tuple[FloatArray, list[tuple[str, BoolArray]]]:
    """Return levels in dBm (T, N), and the faults of cells and rows."""
    raw, faults, in_cells = reader.numbers(columns)
    units = reader.units(columns, raw, in_cells, _LEVEL)
    if all(each.startswith("dB") for each in units):
        reader.ask_codes(raw, columns, _CODE_GAP_DB, has_zero_rows=False)
    dbm = levels_dbm(raw, units)
    faults.append(("a power of 0 or less has no level", np.any(np.isfinite(raw) & np.isnan(dbm), axis=1)))
    least, most = PLAUSIBLE_DBM
    is_beyond = np.any((dbm <= least) | (dbm >= most), axis=1)
    if 2 * int(is_beyond.sum()) > len(dbm) and not reader.questions:
        text = f"the middle level is {np.nanmedian(dbm):.1f} dBm, which no analyzer shows for a carrier"
        raise ForeignTableError(f"{text}: is unit right?")
    return dbm, [*faults, (f"a level beyond {least:g} to {most:g} dBm", is_beyond)]


def _likely_level_unit(raw: FloatArray) -> str:
    """Return the first unit under which the middle of some levels is one that an analyzer can show."""
    for unit in LEVEL_UNITS:
        dbm = levels_dbm(raw, [unit] * raw.shape[1])
        if np.isfinite(dbm).any() and PLAUSIBLE_DBM[0] < float(np.nanmedian(dbm)) < PLAUSIBLE_DBM[1]:
            return unit
    return "dBm"


_LEVEL = Quantity(LEVEL_UNITS, level_unit, contradicted_level_unit, _likely_level_unit)


def _other_sources(reader: TableReader, stated: PowersStatement) -> dict[str, BoolArray]:
    """Return the rows of other sources than the wanted one, by source."""
    if "source" not in reader.table.header or not (stated.source or stated.from_source):
        return {}
    wanted = {stated.source, ""} if stated.from_source is None else {stated.from_source}
    sources = np.array(reader.table.column("source").to_pylist(), dtype=object)
    return {each: sources == each for each in dict.fromkeys(sources.tolist()) if each not in wanted}
