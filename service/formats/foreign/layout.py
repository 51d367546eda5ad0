"""Layout of a foreign table: columns, units, clocks, and the fault that names a line."""

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from math import isfinite
from typing import Literal, NamedTuple
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from service.records.epoch import EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S, parse_epoch


class ForeignTableError(ValueError):
    """The table cannot be read as a whole; the text says why and what to do."""


class ForeignCellError(ValueError):
    """A cell means nothing under the stated layout.

    Parameters
    ----------
    kind : str
        Reason, equal for all cells with the same fault.
    cell : object
        The cell.
    """

    def __init__(self, kind: str, cell: object) -> None:
        super().__init__(f"{kind}: {str(cell)[:40]!r}")
        self.kind = kind


#: fault of an epoch that no zone was stated for
NO_OFFSET = "epoch without offset; state --tz"
ISO = "iso"
#: microseconds of one unit
_UNIX_US = {"unix_s": US_PER_S, "unix_ms": 1000, "unix_us": 1}
_DAYS = ("%d.%m.%Y", "%d/%m/%Y", "%d-%m-%Y", "%m.%d.%Y", "%m/%d/%Y", "%m-%d-%Y", "%Y.%m.%d", "%Y/%m/%d", "%d %b %Y")
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%H:%M:%S,%f", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
#: patterns that are tried on epochs that are neither ISO 8601 nor numbers
_PATTERNS = (*(f"{day} {clock}" for day in _DAYS for clock in _CLOCKS), "%Y-%m-%d %I:%M:%S %p", "%Y-%jT%H:%M:%S")
_UNIX = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_NUMBER = re.compile(r"\d+(\.\d+)?")
_FIXED_OFFSET = re.compile(r"([+-])(\d{2}):?(\d{2})")
_DATE_ONLY = re.compile(r"[\d./-]{6,10}")


def zone_of(name: str) -> tzinfo:
    """Return a time zone: UTC, an offset such as ``+03:00``, or a name of the IANA database.

    Raises
    ------
    ForeignTableError
        No such zone.
    """
    offset = _FIXED_OFFSET.fullmatch(name)
    if offset is not None and int(offset.group(2)) <= 14 and int(offset.group(3)) < 60:
        size = timedelta(hours=int(offset.group(2)), minutes=int(offset.group(3)))
        return timezone(-size if offset.group(1) == "-" else size)
    if name.upper() in {"UTC", "Z"}:
        return UTC
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        detail = f"--tz {name[:40]!r} is no time zone; write UTC, an offset such as +03:00, or a name: Europe/Moscow"
        raise ForeignTableError(detail) from None


class EpochReader:
    """Reader of the epochs of one table.

    Parameters
    ----------
    time_format : str
        ``iso``, ``unix_s``, ``unix_ms``, ``unix_us``, or a pattern of ``strptime``.
    tz : str or None
        Zone of epochs that carry no offset; None: those are refused.

    Raises
    ------
    ForeignTableError
        No such format or zone.
    """

    def __init__(self, time_format: str, tz: str | None) -> None:
        self._zone = None if tz is None else zone_of(tz)
        self._format = time_format
        self._moment: Callable[[str], datetime] = _iso_moment
        if time_format not in {ISO, *_UNIX_US}:
            if "%" not in time_format:
                known = ", ".join((ISO, *_UNIX_US))
                detail = f"--time-format {time_format[:40]!r} is unknown; write {known}, or a pattern: %d.%m.%Y %H:%M"
                raise ForeignTableError(detail)
            self._moment = lambda text: datetime.strptime(text, time_format)  # noqa: DTZ007 the zone is stated apart

    def read(self, cell: object) -> int:
        """Return microseconds UTC.

        Raises
        ------
        ForeignCellError
            No epoch of this format, one without an offset where no zone was stated, one in an hour that a change of
            the clocks repeats or leaves out, or one outside of 2000 to 2100.
        """
        text = str(cell).strip()
        epoch_us = self._unix_us(text) if self._format in _UNIX_US else self._calendar_us(text)
        if not EARLIEST_EPOCH_US <= epoch_us < LATEST_EPOCH_US:
            raise ForeignCellError("epoch before 2000 or after 2100; is --time-format right?", text)
        return epoch_us

    def _unix_us(self, text: str) -> int:
        """Return microseconds of a number."""
        if _NUMBER.fullmatch(text) is None:
            raise ForeignCellError("epoch is no number", text)
        whole, _, fraction = text.partition(".")
        unit_us = _UNIX_US[self._format]
        return int(whole) * unit_us + (round(float(f"0.{fraction}") * unit_us) if fraction else 0)

    def _calendar_us(self, text: str) -> int:
        """Return microseconds of a calendar epoch."""
        if _DATE_ONLY.fullmatch(text) is not None:
            raise ForeignCellError("epoch without time of day; state --time-column for date and time", text)
        try:
            moment = self._moment(text)
        except ValueError:
            try:
                # second 60 exists in RFC 3339 only
                return parse_epoch(text)
            except ValueError:
                raise ForeignCellError(f"epoch is not {self._format}", text) from None
        if moment.tzinfo is not None:
            return (moment - _UNIX) // _MICROSECOND
        if self._zone is None:
            raise ForeignCellError(NO_OFFSET, text)
        early, late = (moment.replace(tzinfo=self._zone, fold=fold).utcoffset() for fold in (0, 1))
        if early != late or early is None:
            raise ForeignCellError("epoch in an hour that the change of the clocks repeats or leaves out", text)
        return (moment.replace(tzinfo=UTC) - early - _UNIX) // _MICROSECOND


def _iso_moment(text: str) -> datetime:
    """Return an ISO 8601 moment; the decimal sign may be a comma."""
    return datetime.fromisoformat(text)


def readable(time_format: str, texts: Sequence[str]) -> int:
    """Return the number of texts that a format reads, whatever their zone."""
    reader = EpochReader(time_format, "UTC")
    found = 0
    for text in texts:
        try:
            reader.read(text)
        except ForeignCellError:
            continue
        found += 1
    return found


def has_offsets(time_format: str, texts: Sequence[str]) -> bool:
    """Return whether each readable text carries its offset, or counts seconds since 1970."""
    reader = EpochReader(time_format, None)
    for text in texts:
        try:
            reader.read(text)
        except ForeignCellError as error:
            if error.kind == NO_OFFSET:
                return False
    return True


def formats_of(texts: Sequence[str]) -> list[str]:
    """Return the formats that read the most texts, nine of ten at least; several when day and month may be exchanged.

    Examples
    --------
    >>> formats_of(["01.02.2026 10:00:00"])
    ['%d.%m.%Y %H:%M:%S', '%m.%d.%Y %H:%M:%S']
    >>> formats_of(["21.02.2026 10:00:00", "1.02.2026 10:00:00"])
    ['%d.%m.%Y %H:%M:%S']
    """
    if not texts:
        return []
    for candidates in ((ISO,), tuple(_UNIX_US), _PATTERNS):
        # a pattern that reads none of some texts is not tried on the others
        some = texts[:: max(1, len(texts) // 8)]
        tried = [each for each in candidates if readable(each, some) > 0]
        counts = {each: readable(each, texts) for each in tried}
        most = max(counts.values(), default=0)
        if most >= 0.9 * len(texts):
            return [each for each, count in counts.items() if count == most]
    return []


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
