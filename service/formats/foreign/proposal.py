"""Proposal for the layout of a foreign table: what its content proves, and what a person must state.

A time zone, the order of day and month, and a unit of level are found only where the table itself states or proves
them; everything else is a question.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from service.formats.foreign.layout import (
    ABSENT,
    ISO,
    OFFSET_DB,
    Decimal,
    EpochReader,
    ForeignTableError,
    StatedLayout,
    TableLayout,
    Unit,
    check_header,
    formats_of,
    has_offsets,
    is_number,
    position_of,
    readable,
    unit_in_name,
    without_unit,
)

#: levels of a carrier at an analyzer, dBm
PLAUSIBLE_DBM = (-170.0, 30.0)
#: share of the rows that a rule must fit
_MOST_ROWS = 0.9
#: more carriers of the plan are not shown
_MOST_NAMES = 12


class Question(NamedTuple):
    """One thing that a person must state."""

    option: str
    text: str
    #: what may be answered; empty = free text
    choices: tuple[str, ...] = ()
    #: answer that the content suggests
    default: str | None = None


class Sample(NamedTuple):
    """Header and first rows of a table."""

    header: Sequence[str]
    rows: Sequence[Sequence[object]]

    def texts(self, columns: Iterable[str]) -> list[str]:
        """Return the cells of some columns of each row, joined by blanks; rows without any are left out."""
        positions = [position_of(self.header, name) for name in columns]
        joined = (" ".join(_text(row[position]) for position in positions).strip() for row in self.rows)
        return [text for text in joined if text]

    def some_texts(self, columns: Iterable[str]) -> list[str]:
        """Return a hundred to two hundred of these texts, from the first row to the last."""
        texts = self.texts(columns)
        return texts[:: max(1, len(texts) // 100)]

    def cells(self, column: str) -> list[object]:
        """Return the cells of a column that hold something."""
        position = position_of(self.header, column)
        return [row[position] for row in self.rows if _text(row[position]).lower() not in ABSENT]


class Proposal(NamedTuple):
    """A layout, or the questions that must be answered first."""

    layout: TableLayout | None
    questions: tuple[Question, ...]
    #: what was understood so far
    found: StatedLayout


def propose(sample: Sample, stated: StatedLayout, carriers: Mapping[str, str]) -> Proposal:
    """Return the layout of a table as far as it is stated or proven.

    Parameters
    ----------
    sample : Sample
        Header and first rows.
    stated : StatedLayout
        What a person stated; it is checked and never replaced.
    carriers : mapping
        Carriers of the plan: id by id and by name.

    Raises
    ------
    ForeignTableError
        Columns that occur twice, decimals of two kinds, a stated thing that the table contradicts.
    """
    check_header(sample.header)
    EpochReader(stated.time_format or ISO, stated.tz)
    questions: list[Question] = []
    found = with_time(sample, stated, questions)
    found = _with_columns(sample, found, carriers, questions)
    units, unit_questions = _units(sample, found)
    questions += unit_questions
    if questions or found.time_format is None or found.decimal is None:
        return Proposal(None, tuple(questions), found)
    layout = TableLayout(
        found.time_columns,
        found.time_format,
        found.tz,
        found.decimal,
        units,
        found.carriers,
        found.carrier_column,
        found.level_column,
    )
    return Proposal(layout, (), found)


def with_time(sample: Sample, stated: StatedLayout, questions: list[Question]) -> StatedLayout:
    """Return the layout with the columns, format and zone of the epochs; what they leave open joins the questions."""
    columns = stated.time_columns
    if not columns:
        candidates = _time_candidates(sample)
        if len(candidates) != 1:
            names = tuple(" + ".join(each) for each in candidates) or tuple(sample.header)
            text = "several columns hold epochs" if candidates else "no column holds epochs of a known format"
            questions.append(Question("--time-column", text, names))
            return stated
        columns = candidates[0]
    texts = sample.texts(columns)
    first = repr(texts[0]) if texts else "nothing"
    time_format = stated.time_format
    if time_format is None:
        formats = formats_of(texts)
        if len(formats) != 1:
            text = f"day and month may be exchanged: {first}" if formats else f"format of the epochs, like {first}"
            questions.append(Question("--time-format", text, tuple(formats)))
            return replace(stated, time_columns=columns)
        time_format = formats[0]
    elif readable(time_format, texts) < _MOST_ROWS * len(texts):
        raise ForeignTableError(f"--time-format {time_format!r} does not read the epochs, like {first}")
    tz = stated.tz
    if tz is None and not has_offsets(time_format, texts):
        tz = "UTC" if any("utc" in name.lower() for name in columns) else None
        if tz is None:
            questions.append(Question("--tz", f"time zone of the epochs: {first} has no offset"))
    return replace(stated, time_columns=columns, time_format=time_format, tz=tz)


def _time_candidates(sample: Sample) -> list[tuple[str, ...]]:
    """Return the columns, or pairs of a date and a time, that hold epochs; calendar epochs go before numbers."""
    formats = {name: formats_of(sample.some_texts([name])) for name in sample.header}
    single: list[tuple[str, ...]] = [(name,) for name, found in formats.items() if found]
    calendar = [each for each in single if not formats[each[0]][0].startswith("unix")]
    if calendar or single:
        return calendar or single
    clocks = [name for name in sample.header if _is_clock(sample, name)]
    pairs = [(day, clock) for day in sample.header for clock in clocks if day != clock]
    return [pair for pair in pairs if formats_of(sample.some_texts(pair))]


def _is_clock(sample: Sample, name: str) -> bool:
    """Return whether a column holds times of day."""
    texts = sample.some_texts([name])
    return bool(texts) and all(":" in text for text in texts)


def _with_columns(
    sample: Sample, found: StatedLayout, carriers: Mapping[str, str], questions: list[Question]
) -> StatedLayout:
    """Return the layout with decimals and with the carriers of columns or names."""
    rest = [name for name in sample.header if name not in found.time_columns]
    _check_stated(found, carriers)
    found = replace(found, decimal=found.decimal or decimal_of(sample, rest))
    numbers = [name for name in rest if _is_numeric(sample, name, found.decimal or "point")]
    if found.carrier_column is None:
        wide = _matched(rest, carriers, found.carriers)
        if wide and found.level_column is None:
            for name in found.carriers:
                position_of(sample.header, name)
            return replace(found, carriers=wide)
        found = _with_carrier_column(sample, found, [name for name in rest if name not in numbers], carriers)
        if found.carrier_column is None:
            plan = tuple(dict.fromkeys(carriers.values()))
            text = f"no column has the name of a carrier; the plan has {', '.join(plan[:_MOST_NAMES])}"
            questions.append(Question("--map", text, tuple(numbers)))
            return found
    return _with_long_columns(sample, found, numbers, carriers, questions)


def _check_stated(found: StatedLayout, carriers: Mapping[str, str]) -> None:
    """Refuse stated carriers that the plan does not have, and two names of one carrier."""
    unknown = [carrier for carrier in found.carriers.values() if carrier not in carriers]
    if unknown:
        plan = ", ".join(dict.fromkeys(carriers.values()))
        raise ForeignTableError(f"--map names {unknown[0][:40]!r}, which is no carrier of the plan: {plan[:300]}")


def _matched(names: Iterable[str], carriers: Mapping[str, str], stated: Mapping[str, str]) -> dict[str, str]:
    """Return the carrier of each name: stated, or equal to an id or name of the plan without its unit."""
    known = {name.casefold(): carrier for name, carrier in carriers.items()}
    found = {name: stated.get(name) or known.get(without_unit(name).casefold()) for name in names}
    matched = {name: carriers[carrier] for name, carrier in found.items() if carrier is not None}
    twice = sorted(name for name in matched if list(matched.values()).count(matched[name]) > 1)
    if twice:
        raise ForeignTableError(f"several columns are carrier {matched[twice[0]]}: {', '.join(twice)}; state --map")
    return matched


def _with_carrier_column(
    sample: Sample, found: StatedLayout, texts: Sequence[str], carriers: Mapping[str, str]
) -> StatedLayout:
    """Return the layout with the text column in which names of carriers stand, where there is one such column."""
    known = {name.casefold() for name in carriers} | {name.casefold() for name in found.carriers}
    holding = [name for name in texts if {_text(cell).casefold() for cell in sample.cells(name)} & known]
    return replace(found, carrier_column=holding[0]) if len(holding) == 1 else found


def _with_long_columns(
    sample: Sample,
    found: StatedLayout,
    numbers: Sequence[str],
    carriers: Mapping[str, str],
    questions: list[Question],
) -> StatedLayout:
    """Return the layout of a long table."""
    names = list(dict.fromkeys(_text(cell) for cell in sample.cells(found.carrier_column or "")))
    matched = _matched({*names, *found.carriers}, carriers, found.carriers)
    if not matched:
        questions.append(Question("--map", f"no name in {found.carrier_column!r} is a carrier", tuple(names)))
    column = found.level_column
    if column is None:
        named = [name for name in numbers if unit_in_name(name)] or list(numbers)
        if len(named) != 1:
            questions.append(Question("--level-column", "column of the levels", tuple(named)))
        else:
            column = named[0]
    else:
        position_of(sample.header, column)
    return replace(found, carriers=matched, level_column=column)


def _units(sample: Sample, found: StatedLayout) -> tuple[dict[str, Unit], list[Question]]:
    """Return the unit of each level column, and the question for those that state none."""
    columns = list(found.carriers) if found.carrier_column is None else [found.level_column or ""]
    columns = [name for name in columns if name in sample.header]
    units: dict[str, Unit] = {}
    for name in columns:
        own = unit_in_name(name)
        if own is not None and found.unit is not None and own != found.unit:
            raise ForeignTableError(f"column {name!r} states {own}, --unit states {found.unit}; rename or leave it out")
        if (unit := own or found.unit) is not None:
            units[name] = unit
    silent = [name for name in columns if name not in units]
    if not silent:
        return units, []
    levels = _levels(sample, silent, found.decimal or "point")
    if not len(levels):
        return units, [Question("--unit", "unit of the levels", tuple(OFFSET_DB))]
    plausible = [unit for unit, offset_db in OFFSET_DB.items() if is_plausible(levels + offset_db)]
    text = f"no column name states the unit; levels span {levels.min():g} to {levels.max():g}"
    return units, [Question("--unit", text, tuple(OFFSET_DB), plausible[0] if len(plausible) == 1 else None)]


def is_plausible(levels_dbm: np.ndarray) -> bool:
    """Return whether the middle of some levels is one that an analyzer can show."""
    return bool(PLAUSIBLE_DBM[0] < float(np.median(levels_dbm)) < PLAUSIBLE_DBM[1])


def _levels(sample: Sample, columns: Sequence[str], decimal: Decimal) -> np.ndarray:
    """Return the numbers of some columns."""
    cells = [cell for name in columns for cell in sample.cells(name) if is_number(cell, decimal)]
    return np.array([float(str(cell).replace(",", ".")) for cell in cells])


def decimal_of(sample: Sample, columns: Sequence[str]) -> Decimal:
    """Return the decimal sign of the numbers; ForeignTableError when there are two."""
    signs: dict[Decimal, str] = {}
    for name in columns:
        cells = [_text(cell) for cell in sample.cells(name) if isinstance(cell, str)]
        for decimal, mark in (("comma", ","), ("point", ".")):
            if cells and sum(mark in cell and is_number(cell, decimal) for cell in cells) > 0.1 * len(cells):  # type: ignore[arg-type] # one of both
                signs.setdefault(decimal, name)  # type: ignore[arg-type] # one of both
    if len(signs) > 1:
        shown = " and ".join(f"{decimal} in {name!r}" for decimal, name in signs.items())
        raise ForeignTableError(f"decimals of two kinds: {shown}; write all numbers alike, or state --decimal")
    return next(iter(signs), "point")


def _is_numeric(sample: Sample, name: str, decimal: Decimal) -> bool:
    """Return whether nine of ten cells of a column are numbers."""
    cells = sample.cells(name)
    return bool(cells) and sum(is_number(cell, decimal) for cell in cells) >= _MOST_ROWS * len(cells)


def _text(cell: object) -> str:
    """Return a cell as text; None is empty."""
    return "" if cell is None else str(cell).strip()
