"""Columns of an archive and the carriers of a plan: which cell is the level of which carrier, in which unit.

::

    epoch            RFC 3339 with an offset, or whole microseconds UTC
    source           optional: name of the source that measured the row
    <carrier>_dbm    level, dBm; empty = absent
    <carrier>_dbw    level, dBW; 30 dB are added
"""

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

from service.records.epoch import parse_epoch

#: unit's suffix -> what makes a level in it one in dBm
_UNITS = {"_dbm": 0.0, "_dbw": 30.0}
#: what stands for an absent level
_ABSENT = frozenset({"", "nan", "null", "none"})
#: a calendar epoch of our own order of fields, but in nobody's zone
_WITHOUT_OFFSET = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}(:\d{2}([.,]\d+)?)?")
_WHOLE = re.compile(r"[+-]?\d{1,18}")
#: keeps the sum of 30 and a decimal a decimal, dB
_SUM_DECIMALS = 9


class ArchiveError(Exception):
    """The file cannot be sent as it is."""


class CellError(ValueError):
    """A cell of a row means nothing.

    Parameters
    ----------
    detail : str
        What is wrong with this cell.
    kind : str
        Reason, equal for all cells with the same fault.
    """

    def __init__(self, detail: str, kind: str) -> None:
        super().__init__(detail)
        self.kind = kind


class CarrierColumn(NamedTuple):
    """A column of levels."""

    name: str
    #: place among the columns of the file, and among the carriers of the plan
    position: int
    plan_position: int
    offset_db: float


class FileColumns(NamedTuple):
    """Columns of a file: epoch, source and carriers."""

    header: tuple[str, ...]
    epoch: int
    source: int | None
    carriers: tuple[CarrierColumn, ...]
    #: columns that are no carrier of the plan
    left_out: tuple[str, ...]
    #: carriers of the plan without a column; their levels are sent as absent
    absent: tuple[str, ...]
    #: carriers of the plan, in its order
    plan_ids: tuple[str, ...]


def match_columns(header: Sequence[str], plan_ids: Sequence[str]) -> FileColumns:
    """Return the columns of a header under a plan.

    Raises
    ------
    ArchiveError
        No epoch, a name twice, a carrier in two units, or no carrier of the plan at all.
    """
    names = tuple(name.strip() for name in header)
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise ArchiveError(f"columns occur twice: {', '.join(repeated)}")
    if "epoch" not in names:
        raise ArchiveError(f"no column 'epoch' among {', '.join(names[:8])}")
    positions = {carrier_id: position for position, carrier_id in enumerate(plan_ids)}
    carriers = [
        CarrierColumn(name, position, positions[name[: -len(unit)]], offset_db)
        for position, name in enumerate(names)
        for unit, offset_db in _UNITS.items()
        if name.endswith(unit) and name[: -len(unit)] in positions
    ]
    twice = [
        plan_ids[position] for position, count in Counter(each.plan_position for each in carriers).items() if count > 1
    ]
    if twice:
        raise ArchiveError(f"carriers have two columns: {', '.join(twice)}")
    if not carriers:
        raise ArchiveError(
            f"no column is a carrier of the plan: it has {', '.join(plan_ids[:8])}, wanted as c00_dbm or c00_dbw"
        )
    known = {"epoch", "source", *(each.name for each in carriers)}
    found = {each.plan_position for each in carriers}
    return FileColumns(
        names,
        names.index("epoch"),
        names.index("source") if "source" in names else None,
        tuple(carriers),
        tuple(name for name in names if name not in known),
        tuple(carrier_id for position, carrier_id in enumerate(plan_ids) if position not in found),
        tuple(plan_ids),
    )


def read_epoch(cell: Any) -> int:
    """Return the microseconds UTC that a cell tells; CellError when it tells none.

    Examples
    --------
    >>> read_epoch("2026-11-21T00:00:00Z"), read_epoch("1795219200000000")
    (1795219200000000, 1795219200000000)
    """
    if isinstance(cell, int):
        return cell
    text = str(cell).strip()
    if _WHOLE.fullmatch(text):
        return int(text)
    try:
        return parse_epoch(text)
    except ValueError as error:
        kind = "epoch without offset; state --tz" if _WITHOUT_OFFSET.fullmatch(text) else "epoch is not RFC 3339"
        raise CellError(f"epoch: {error}", kind) from None


def read_levels(cells: Sequence[Any], columns: FileColumns) -> list[float | None]:
    """Return the levels of a row in the order of the plan, dBm, None = absent; CellError names the first bad cell."""
    levels: list[float | None] = [None] * len(columns.plan_ids)
    for column in columns.carriers:
        cell = cells[column.position]
        if cell is None or (isinstance(cell, str) and cell.strip().lower() in _ABSENT):
            continue
        try:
            level = float(cell)
        except (TypeError, ValueError):
            raise CellError(f"{column.name}: {str(cell)[:40]!r} is no number", "level is no number") from None
        if math.isinf(level):
            raise CellError(f"{column.name}: a level is not infinite", "level is infinite")
        if not math.isnan(level):
            shift_db = column.offset_db
            levels[column.plan_position] = round(level + shift_db, _SUM_DECIMALS) if shift_db else level
    return levels
