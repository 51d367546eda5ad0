"""Epochs of foreign tables: texts and numbers of a whole column at once become microseconds UTC."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from functools import lru_cache
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from service.formats.ephemeris import utc_us
from service.formats.foreign.table import ForeignTableError, Question
from service.records.epoch import DAY_US, EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ISO = "iso"
_GPS_ORIGIN_US = 315_964_800 * US_PER_S
_WEEK_US = 7 * DAY_US
#: number of one column: microseconds of its unit, and of its zero
COUNTS = {
    "unix_s": (US_PER_S, 0),
    "unix_ms": (1000, 0),
    "unix_us": (1, 0),
    "unix_ns": (0.001, 0),
    "gps_s": (US_PER_S, _GPS_ORIGIN_US),
    "jd": (DAY_US, round(-2_440_587.5 * DAY_US)),
    "mjd": (DAY_US, -40_587 * DAY_US),
    "excel": (DAY_US, -25_569 * DAY_US),
}
WEEK = "gps_week_s"
#: time scales, which are stated in place of a zone
SCALES = ("GPS", "TAI", "TT")
_TOKENS = {
    "Y": r"(?P<Y>\d{4})",
    "y": r"(?P<y>\d{2})",
    "m": r"(?P<m>\d{1,2})",
    "d": r"(?P<d>\d{1,2})",
    "j": r"(?P<j>\d{3})",
    "b": r"(?P<b>\pL{3,12})\.?",
    "H": r"(?P<H>\d{1,2})",
    "I": r"(?P<H>\d{1,2})",
    "M": r"(?P<M>\d{1,2})",
    "S": r"(?P<S>\d{1,2})(?:[.,:](?P<f>\d{1,12}))?",
    "f": r"(?P<f>\d{1,12})",
    "p": r"(?P<p>[AaPp])\.?[Mm]\.?",
    "z": r"(?P<z>Z|[+-]\d{2}:?\d{2})",
    "a": r"\pL{2,12}\.?",
    "%": "%",
}
_ZONE = r"\s*(?P<z>Z|z|UTC|GMT|UT|(?:UTC|GMT)?\s?[+-]\d{2}(?::?\d{2})?)?(?P<w>\s?\(?\pL{2,5}\)?)?"
_MONTHS = {
    name: number
    for names in (
        "jan feb mar apr may jun jul aug sep oct nov dec",
        "янв фев мар апр май июн июл авг сен окт ноя дек",
        "jan feb mär apr mai jun jul aug sep okt nov dez",
        "jän feb mrz apr мая jun jul aug sep okt nov déc",
    )
    for number, name in enumerate(names.split(), start=1)
}
_FIXED_OFFSET = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d{2}))?")
#: epochs ahead of this machine's clock by less are a difference of clocks
_FUTURE_US = 60 * US_PER_S
#: rows whose newest is older are asked about
_OLD_US = 7 * DAY_US


@dataclass(slots=True)
class TableClock:
    """Columns, format, zone or scale, and first date of the epochs of a table."""

    columns: tuple[str, ...] = ()
    time_format: str | None = None
    #: zone, offset, or one of `SCALES`; None: each epoch carries its offset, or counts from 1970
    tz: str | None = None
    #: of the first time of day, where no column holds dates
    date: str | None = None


@dataclass(slots=True)
class Epochs:
    """Epochs of the rows of a table."""

    #: microseconds UTC, 0 where there is none
    us: IntArray
    is_bad: BoolArray
    #: reasons of bad rows, with the rows that they are the reason of
    reasons: list[tuple[str, BoolArray]] = field(default_factory=list)
    #: rows without an offset of their own
    is_local: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def refuse(self, reason: str, rows: BoolArray) -> None:
        """Mark rows as bad, unless another reason did."""
        new = rows & ~self.is_bad
        if new.any():
            self.reasons.append((reason, new))
            self.is_bad |= new


def zone_of(name: str) -> tzinfo:
    """Return a time zone: UTC, an offset such as ``+03:00``, or a name of the IANA database.

    Raises
    ------
    ForeignTableError
        No such zone.
    """
    offset = _FIXED_OFFSET.fullmatch(name)
    if offset is not None and int(offset.group(2)) <= 14 and int(offset.group(3) or 0) < 60:
        size = timedelta(hours=int(offset.group(2)), minutes=int(offset.group(3) or 0))
        return timezone(-size if offset.group(1) == "-" else size)
    if name.upper() in {"UTC", "GMT", "Z"}:
        return UTC
    try:
        return ZoneInfo(name)
    except (ZoneInfoNotFoundError, ValueError, OSError):
        detail = f"tz {name[:40]!r} is no time zone; write UTC, an offset such as +03:00, a name: Europe/Moscow, or GPS"
        raise ForeignTableError(detail) from None


def age_question(epochs_us: IntArray, now_us: int, last_day: str | None, *, is_simulated: bool) -> Question | None:
    """Return the question about a table whose newest row is old or ahead of now, unless its day is stated.

    Raises
    ------
    ForeignTableError
        The stated day is another one.
    """
    if not len(epochs_us):
        return None
    newest_us = int(epochs_us.max())
    day = str(np.datetime64(newest_us, "us").astype("datetime64[D]"))
    if last_day is not None and abs(_day_number(last_day, "last_day") - newest_us // DAY_US) > 1:
        raise ForeignTableError(
            f"last_day {last_day} is stated; the newest row is of {day}, {in_words(newest_us, now_us)}"
        )
    is_fresh = now_us - _OLD_US <= newest_us <= now_us + _FUTURE_US
    if last_day is not None or is_fresh or (is_simulated and newest_us > now_us):
        return None
    return Question("last_day", f"the newest row is of {in_words(newest_us, now_us)}: is that its day?", (), day)


def in_words(epoch_us: int, now_us: int | None = None) -> str:
    """Return an epoch for people, with its age.

    Examples
    --------
    >>> in_words(1_795_233_600_000_000, 1_795_742_640_000_000)
    '21 Nov 2026 04:00 UTC, 5.9 days ago'
    """
    text = datetime.fromtimestamp(epoch_us // US_PER_S, UTC).strftime("%-d %b %Y %H:%M UTC")
    if now_us is None:
        return text
    size = abs(now_us - epoch_us) / 3_600e6
    shown = f"{size:.1f} h" if size < 48.0 else f"{size / 24.0:.1f} days"
    return f"{text}, {shown} {'ago' if epoch_us <= now_us else 'ahead of now'}"


@lru_cache(maxsize=512)
def regex_of(time_format: str) -> str:
    """Return the expression of RE2 for a pattern of ``strptime``; fractions and offsets may always follow.

    Raises
    ------
    ForeignTableError
        A sign after % that is not known, or one that occurs twice.
    """
    if time_format == ISO:
        seconds = r"(?::(?P<S>\d{2})(?:[.,](?P<f>\d{1,12}))?)?"
        start = regex_of("%Y-%m-%d %H:%M").removesuffix(f"{_ZONE}$")
        return f"{start}{seconds}{_ZONE}$"
    pattern, text = (
        "",
        time_format.replace("%B", "%b").replace("%A", "%a").replace("%S.%f", "%S").replace("%S,%f", "%S"),
    )
    seen: set[str] = set()
    position = 0
    while position < len(text):
        sign = text[position]
        if sign == "%":
            token = text[position + 1 : position + 2]
            if token not in _TOKENS or token in seen:
                raise ForeignTableError(f"time_format {time_format[:40]!r}: %{token} is unknown or occurs twice")
            # without a sign between them numbers have two digits
            is_close = text[max(position - 2, 0) : position].startswith("%") and position > 0
            seen.add(token)
            pattern += _TOKENS[token].replace("{1,2}", "{2}") if is_close else _TOKENS[token]
            position += 2
            continue
        pattern += r"[Tt\s]\s*" if sign in " T" else re.escape(sign)
        position += 1
    return f"^{pattern}{'' if 'z' in seen else _ZONE}$"


def is_clock_only(time_format: str) -> bool:
    """Return whether a format has no date."""
    return "%" in time_format and not any(token in time_format for token in ("%d", "%j"))


def read_epochs(texts: Any, clock: TableClock, decimal: str) -> Epochs:
    """Return the epochs of texts under a clock; rows without one are bad, with their reason."""
    if clock.time_format in COUNTS or clock.time_format == WEEK:
        epochs = _counted(texts, clock.time_format or "", decimal)
    else:
        epochs = (_plain_iso(texts) if clock.time_format == ISO else None) or _calendar(texts, clock)
    scale = (clock.tz or "").upper()
    if scale in SCALES:
        epochs.us = np.where(epochs.is_local, utc_us(epochs.us, scale), epochs.us)
    elif clock.tz is not None and epochs.is_local.any():
        _apply_zone(epochs, zone_of(clock.tz))
    outside = (epochs.us < EARLIEST_EPOCH_US) | (epochs.us >= LATEST_EPOCH_US)
    epochs.refuse("epoch before 2000 or after 2100; is time_format right?", outside)
    return epochs


def _counted(texts: Any, kind: str, decimal: str) -> Epochs:
    """Return the epochs of numbers."""
    import pyarrow as pa
    import pyarrow.compute as pc

    if decimal == "comma":
        texts = pc.replace_substring(texts, ",", ".")
    if kind == WEEK:
        parts = pc.extract_regex(texts, pattern=r"^(?P<week>\d{1,5})(?:\.0+)? (?P<s>\d{1,6}(?:\.\d+)?)$")
        is_bad = ~parts.is_valid().to_numpy(zero_copy_only=False)
        week, second = (
            pc.fill_null(pc.struct_field(parts, each), "0").cast(pa.float64()).to_numpy() for each in ("week", "s")
        )
        us = _GPS_ORIGIN_US + week.astype(np.int64) * _WEEK_US + np.rint(second * US_PER_S).astype(np.int64)
        epochs = Epochs(us, np.zeros(len(us), dtype=np.bool_), [], np.ones(len(us), dtype=np.bool_))
        epochs.refuse("no GPS week and seconds of the week", is_bad | (second > _WEEK_US / US_PER_S))
        return epochs
    is_number = pc.match_substring_regex(texts, pattern=r"^\d{1,19}(\.\d+)?$")
    plain = pc.if_else(is_number, texts, "0")
    unit_us, origin_us = COUNTS[kind]
    if pc.any(pc.match_substring(plain, ".")).as_py() or unit_us == DAY_US:
        numbers = plain.cast(pa.float64()).to_numpy()
        whole = np.floor(numbers)
        us = whole * unit_us + origin_us + np.rint((numbers - whole) * unit_us)
        us = np.rint(us / 1000) * 1000 if unit_us == DAY_US else us
        us = np.clip(us, -(2.0**62), 2.0**62).astype(np.int64)
    else:
        numbers = plain.cast(pa.uint64()).to_numpy().astype(np.int64)
        us = numbers // 1000 if kind == "unix_ns" else numbers * int(unit_us) + origin_us
    epochs = Epochs(us, np.zeros(len(us), dtype=np.bool_), [], np.full(len(us), not kind.startswith("unix")))
    epochs.refuse("epoch is no number", ~is_number.to_numpy(zero_copy_only=False))
    return epochs


class _Fields:
    """Numbers of the parts of matched texts."""

    def __init__(self, texts: Any, time_format: str) -> None:
        import pyarrow as pa
        import pyarrow.compute as pc

        self._arrow: Any = pa
        self._compute: Any = pc
        self._pattern = regex_of(time_format)
        # of groups that one pattern names twice the second is another branch
        self._parts = pc.extract_regex(texts, pattern=self._pattern)
        self.is_matched = self._parts.is_valid().to_numpy(zero_copy_only=False)
        self.count = len(texts)

    def text(self, name: str) -> Any | None:
        """Return the texts of a part; None where the format has no such part."""
        if f"?P<{name}>" not in self._pattern:
            return None
        return self._compute.fill_null(self._compute.struct_field(self._parts, name), "")

    def number(self, name: str, default: int = 0) -> IntArray:
        """Return the numbers of a part."""
        texts = self.text(name)
        if texts is None:
            return np.full(self.count, default, dtype=np.int64)
        filled = self._compute.if_else(self._compute.equal(texts, ""), str(default), texts)
        return np.asarray(filled.cast(self._arrow.int64()).to_numpy(), dtype=np.int64)

    def nanoseconds(self) -> IntArray:
        """Return the fractions of the second."""
        texts = self.text("f")
        if texts is None:
            return np.zeros(self.count, dtype=np.int64)
        padded = self._compute.utf8_slice_codeunits(self._compute.utf8_rpad(texts, 9, "0"), 0, 9)
        return np.asarray(padded.cast(self._arrow.int64()).to_numpy(), dtype=np.int64)

    def encoded(self, name: str) -> tuple[list[str], IntArray] | None:
        """Return the different texts of a part, and which each row has."""
        texts = self.text(name)
        if texts is None:
            return None
        found = self._compute.dictionary_encode(texts)
        return found.dictionary.to_pylist(), np.asarray(found.indices.to_numpy(), dtype=np.int64)

    def holds(self, name: str, words: Sequence[str]) -> BoolArray:
        """Return in which rows a part is one of some words."""
        found = self.encoded(name)
        if found is None:
            return np.zeros(self.count, dtype=np.bool_)
        return np.array([each.strip(" ().").casefold() in words for each in found[0]], dtype=np.bool_)[found[1]]

    def mapped(self, name: str, values: dict[str, int], length: int) -> IntArray:
        """Return the numbers that the first letters of a part stand for, -1 for unknown ones."""
        texts, rows = self.encoded(name) or ([], np.zeros(self.count, dtype=np.int64))
        return np.array([*(values.get(each.casefold()[:length], -1) for each in texts), -1], dtype=np.int64)[rows]


def _plain_iso(texts: Any) -> Epochs | None:
    """Return the epochs of texts that are all RFC 3339, or all without an offset; None: some are odd."""
    import pyarrow as pa
    import pyarrow.compute as pc

    # a date alone would be read as its midnight
    if not len(texts) or pc.min(pc.utf8_length(texts)).as_py() < len("2026-11-20T00:00"):
        return None
    for zone in ("UTC", None):
        try:
            us = texts.cast(pa.timestamp("us", tz=zone)).cast(pa.int64()).to_numpy()
        except pa.ArrowInvalid:
            continue
        return Epochs(us.copy(), np.zeros(len(us), dtype=np.bool_), [], np.full(len(us), zone is None))
    return None


def _calendar(texts: Any, clock: TableClock) -> Epochs:
    """Return the epochs of calendar texts as UTC where they state an offset, as they stand where they state none."""
    time_format = clock.time_format or ISO
    fields = _Fields(texts, time_format)
    hour, minute, second = (fields.number(each) for each in "HMS")
    is_right = fields.is_matched & (minute <= 59) & (second <= 60)
    nanoseconds = fields.nanoseconds()
    if fields.text("p") is not None:
        half = fields.mapped("p", {"a": 0, "p": 12}, 1)
        is_right &= (hour >= 1) & (hour <= 12)
        hour = hour % 12 + half
    is_right &= (hour <= 23) | ((hour == 24) & (minute == 0) & (second == 0) & (nanoseconds == 0))
    clock_us = ((hour * 60 + minute) * 60 + second) * US_PER_S + (nanoseconds + 500) // 1000
    if is_clock_only(time_format):
        days, is_day = _rolled_days(clock_us, is_right, clock.date)
    else:
        days, is_day = _days(fields)
    us = days * DAY_US + clock_us
    is_local = np.ones(fields.count, dtype=np.bool_)
    # half a day that the format does not know would be read as the other half
    is_right &= ~fields.holds("w", ("am", "pm", "a", "p"))
    zone = fields.encoded("z")
    if zone is not None:
        offsets = [_offset_us(each) for each in zone[0]]
        us = us - np.array([each or 0 for each in offsets], dtype=np.int64)[zone[1]]
        is_local = np.array([each is None for each in offsets], dtype=np.bool_)[zone[1]]
    epochs = Epochs(us, np.zeros(fields.count, dtype=np.bool_), [], is_local & is_right & is_day)
    epochs.refuse(f"epoch is not {time_format}", ~(is_right & is_day))
    return epochs


def _offset_us(text: str) -> int | None:
    """Return the offset from UTC of a stated zone; None: it states none."""
    if not text:
        return None
    found = re.search(r"([+-])(\d{2})(?::?(\d{2}))?", text)
    if found is None:
        return 0
    size_us = (int(found.group(2)) * 60 + int(found.group(3) or 0)) * 60 * US_PER_S
    return -size_us if found.group(1) == "-" else size_us


def _days(fields: _Fields) -> tuple[IntArray, BoolArray]:
    """Return days since 1970, and which of them exist."""
    year = fields.number("Y") if fields.text("Y") is not None else 2000 + fields.number("y")
    first = (np.clip(year, 1, 9999) - 1970).astype("datetime64[Y]")
    if fields.text("j") is not None:
        day = fields.number("j")
        days = first.astype("datetime64[D]").astype(np.int64) + day - 1
        is_day = (day >= 1) & (days < (first + 1).astype("datetime64[D]").astype(np.int64))
        return days, is_day
    month = fields.mapped("b", _MONTHS, 3) if fields.text("b") is not None else fields.number("m", 1)
    day = fields.number("d", 1)
    begin = (first.astype("datetime64[M]") + (np.clip(month, 1, 12) - 1)).astype("datetime64[M]")
    days = begin.astype("datetime64[D]").astype(np.int64) + day - 1
    last = (begin + 1).astype("datetime64[D]").astype(np.int64)
    return days, (month >= 1) & (month <= 12) & (day >= 1) & (days < last)


def _rolled_days(clock_us: IntArray, is_right: BoolArray, date: str | None) -> tuple[IntArray, BoolArray]:
    """Return the day of each time of day: one more after each midnight; a smaller step back is no row."""
    if date is None:
        return np.zeros(len(clock_us), dtype=np.int64), np.ones(len(clock_us), dtype=np.bool_)
    first = _day_number(date, "date")
    right = clock_us[is_right]
    steps = np.diff(right, prepend=right[:1])
    days = np.full(len(clock_us), first, dtype=np.int64)
    days[is_right] += np.cumsum(steps < -DAY_US // 2)
    is_day = np.ones(len(clock_us), dtype=np.bool_)
    is_day[is_right] = (steps >= 0) | (steps < -DAY_US // 2)
    return days, is_day


def _day_number(text: str, name: str) -> int:
    """Return the number of a stated day since 1970."""
    try:
        return int(np.datetime64(text, "D").astype(np.int64))
    except ValueError:
        raise ForeignTableError(f"{name} {text[:20]!r} is no day; write it as 2026-11-20") from None


def _apply_zone(epochs: Epochs, zone: tzinfo) -> None:
    """Bring local epochs to UTC; hours that a change of the clocks repeats are told apart by the order of the rows."""
    quarter_us = 15 * 60 * US_PER_S
    rows = np.flatnonzero(epochs.is_local & ~epochs.is_bad)
    quarters, of_rows = np.unique(epochs.us[rows] // quarter_us, return_inverse=True)
    moments = [datetime(1970, 1, 1) + timedelta(seconds=int(each) * 900) for each in quarters]  # noqa: DTZ001 local
    early, late = (
        np.array(
            [round((m.replace(tzinfo=zone, fold=fold).utcoffset() or timedelta()).total_seconds()) for m in moments],
            dtype=np.int64,
        )
        * US_PER_S
        for fold in (0, 1)
    )
    first, second = early[of_rows], late[of_rows]
    local_us = epochs.us[rows]
    offset_us = first.copy()
    is_unclear = first < second
    repeated = np.flatnonzero(first > second)
    for run in np.split(repeated, np.flatnonzero(np.diff(repeated) > 1) + 1) if len(repeated) else []:
        back = np.flatnonzero(np.diff(local_us[run]) < 0)
        if len(back) == 1:
            offset_us[run[back[0] + 1 :]] = second[run[back[0] + 1 :]]
        else:
            is_unclear[run] = True
    epochs.us[rows] -= offset_us
    unclear = np.zeros(len(epochs.us), dtype=np.bool_)
    unclear[rows[is_unclear]] = True
    epochs.refuse("epoch in an hour that the change of the clocks repeats or leaves out", unclear)
