"""Layout of a foreign table: which columns are epochs and levels, in which format, zone, decimals and unit."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal, NamedTuple

from service.formats.foreign.clock import EpochReader
from service.formats.foreign.fault import ForeignCellError, ForeignTableError

Unit = Literal["dBm", "dBW"]
Decimal = Literal["point", "comma"]
#: what makes a level in a unit one in dBm, dB
OFFSET_DB: dict[str, float] = {"dBm": 0.0, "dBW": 30.0}
#: cells without a level
ABSENT = frozenset({"", "nan", "null", "none", "na", "n/a", "-", "--", "---"})
_UNIT_IN_NAME = re.compile(r"[\s_\-,]*[\[(]?\s*(dBm|dBW)\s*[\])]?\s*$", re.IGNORECASE)
_NUMBERS: dict[str, re.Pattern[str]] = {
    "point": re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?"),
    "comma": re.compile(r"[+-]?(\d+,?\d*|,\d+)([eE][+-]?\d+)?"),
}
#: keeps the sum of 30 and a decimal a decimal, dB
_SUM_DECIMALS = 9


@dataclass(frozen=True, slots=True)
class StatedLayout:
    """Layout as far as a person stated it; None and empty = not stated."""

    time_columns: tuple[str, ...] = ()
    time_format: str | None = None
    tz: str | None = None
    decimal: Decimal | None = None
    unit: Unit | None = None
    #: of a long table: the columns that hold the carrier's name and its level
    carrier_column: str | None = None
    level_column: str | None = None
    #: carrier of the plan by column of a wide table, or by name in the carrier column of a long one
    carriers: Mapping[str, str] = field(default_factory=dict)

    @property
    def is_empty(self) -> bool:
        """Return whether nothing was stated."""
        return self == StatedLayout()

    def options(self, carriers: Mapping[str, str]) -> list[str]:
        """Return the words of a command line that states this layout and these carriers."""
        words = [word for name in self.time_columns for word in ("--time-column", name)]
        single = {
            "--time-format": self.time_format,
            "--tz": self.tz,
            "--decimal": self.decimal,
            "--unit": self.unit,
            "--carrier-column": self.carrier_column,
            "--level-column": self.level_column,
        }
        words += [word for option, value in single.items() if value is not None for word in (option, value)]
        return words + [word for name, carrier in carriers.items() for word in ("--map", f"{name}={carrier}")]


@dataclass(frozen=True, slots=True)
class TableLayout:
    """Complete layout of a table."""

    time_columns: tuple[str, ...]
    time_format: str
    #: None: each epoch carries its offset, or counts seconds since 1970
    tz: str | None
    decimal: Decimal
    #: unit of each level column
    units: Mapping[str, Unit]
    carriers: Mapping[str, str]
    carrier_column: str | None = None
    level_column: str | None = None

    def as_document(self) -> dict[str, object]:
        """Return the layout for a report."""
        long = {} if self.carrier_column is None else {"carrier": self.carrier_column, "level": self.level_column}
        return {
            "time": " + ".join(self.time_columns),
            "time_format": self.time_format,
            "tz": self.tz or "in the epochs",
            "decimal": self.decimal,
            "unit": ", ".join(sorted(set(self.units.values()))),
            **long,
            "carriers": dict(self.carriers),
        }


class LevelCell(NamedTuple):
    """Position of a level column, its carrier and the offset to dBm."""

    position: int
    carrier: str
    offset_db: float


class TableRowReader:
    """Reader of the cells of one table under its layout.

    Parameters
    ----------
    header : sequence of str
        Columns of the table.
    layout : TableLayout
        What they hold.
    """

    def __init__(self, header: Sequence[str], layout: TableLayout) -> None:
        self._clock = EpochReader(layout.time_format, layout.tz)
        self._times = [position_of(header, name) for name in layout.time_columns]
        self._decimal = layout.decimal
        if layout.carrier_column is None or layout.level_column is None:
            self._name_position, self._carriers = None, {}
            self.levels = [
                LevelCell(position_of(header, name), carrier, OFFSET_DB[layout.units[name]])
                for name, carrier in layout.carriers.items()
            ]
        else:
            self._name_position, self._carriers = position_of(header, layout.carrier_column), dict(layout.carriers)
            offset_db = OFFSET_DB[layout.units[layout.level_column]]
            self.levels = [LevelCell(position_of(header, layout.level_column), "", offset_db)]

    def epoch_us(self, cells: Sequence[object]) -> int:
        """Return the epoch of a row, microseconds UTC; ForeignCellError when it has none."""
        return self._clock.read(self.epoch_text(cells))

    def epoch_text(self, cells: Sequence[object]) -> str:
        """Return the epoch of a row as it stands in the table."""
        return " ".join(str(cells[position]).strip() for position in self._times)

    def carrier(self, cells: Sequence[object]) -> str | None:
        """Return the carrier of a row of a long table; None where the name is none of the layout."""
        return self._carriers.get(str(cells[self._name_position or 0]).strip())

    def level_dbm(self, cells: Sequence[object], column: LevelCell) -> float | None:
        """Return a level in dBm, None = absent; ForeignCellError when the cell holds anything else."""
        cell = cells[column.position]
        if isinstance(cell, str):
            text = cell.strip()
            if text.lower() in ABSENT:
                return None
            if _NUMBERS[self._decimal].fullmatch(text) is None:
                raise ForeignCellError(f"level is no number with decimal {self._decimal}", text)
            level = float(text.replace(",", "."))
        elif cell is None:
            return None
        else:
            level = float(cell)  # type: ignore[arg-type] # of Parquet; what is no number raises
        if not isfinite(level):
            if level != level:
                return None
            raise ForeignCellError("level is infinite", cell)
        return round(level + column.offset_db, _SUM_DECIMALS) if column.offset_db else level


def position_of(header: Sequence[str], name: str) -> int:
    """Return the position of a column; ForeignTableError when there is none of this name."""
    if name not in header:
        raise ForeignTableError(f"no column {name[:60]!r}; the columns are {', '.join(header[:20])}")
    return list(header).index(name)


def check_header(header: Sequence[str]) -> None:
    """Refuse a header that names two columns alike."""
    repeated = [name or "(no name)" for name, count in Counter(header).items() if count > 1]
    if repeated:
        raise ForeignTableError(f"columns occur twice: {', '.join(repeated[:8])}; name each column once")


def unit_in_name(name: str) -> Unit | None:
    """Return the unit that a column's name states.

    Examples
    --------
    >>> unit_in_name("Ch 1 [dBm]"), unit_in_name("c00_dbw"), unit_in_name("level")
    ('dBm', 'dBW', None)
    """
    found = _UNIT_IN_NAME.search(name)
    if found is None:
        return None
    return "dBm" if found.group(1).lower() == "dbm" else "dBW"


def without_unit(name: str) -> str:
    """Return a column's name without its unit."""
    return _UNIT_IN_NAME.sub("", name).strip()


def is_number(cell: object, decimal: Decimal) -> bool:
    """Return whether a cell is a number in the given decimals."""
    if isinstance(cell, str):
        return _NUMBERS[decimal].fullmatch(cell.strip()) is not None
    return isinstance(cell, int | float) and not isinstance(cell, bool)
