"""Epochs of other programs: ISO 8601, seconds since 1970, or a pattern of ``strptime``, in a stated time zone."""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from service.formats.foreign.fault import ForeignCellError, ForeignTableError
from service.records.epoch import EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S, parse_epoch

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
