"""Epochs of foreign tables: texts and numbers of a whole column at once become microseconds UTC."""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from functools import lru_cache
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np

from service.core.arrays import BoolArray, IntArray
from service.formats.ephemeris import utc_us
from service.formats.foreign.table import ForeignTableError, Question
from service.records.epoch import DAY_US, EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S

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
_HALVES = {"a": 0, "p": 12}
#: of an epoch that states no offset from UTC, microseconds
_NO_OFFSET = 1 << 60
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
    text = time_format.replace("%B", "%b").replace("%A", "%a").replace("%S.%f", "%S").replace("%S,%f", "%S")
    tokens = re.findall("%(.?)", text)
    for token in tokens:
        if token not in _TOKENS or tokens.count(token) > 1:
            raise ForeignTableError(f"time_format {time_format[:40]!r}: %{token} is unknown or occurs twice")
    pattern, is_close = "", False
    for token, sign in re.findall(r"%(.)|([^%])", text):
        if sign:
            pattern += r"[Tt\s]\s*" if sign in " T" else re.escape(sign)
        else:
            # without a sign between them numbers have two digits
            pattern += _TOKENS[token].replace("{1,2}", "{2}") if is_close else _TOKENS[token]
        is_close = not sign
    return f"^{pattern}{'' if 'z' in tokens else _ZONE}$"


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
    import pyarrow.compute as pc

    time_format = clock.time_format or ISO
    pattern = regex_of(time_format)
    # of groups that one pattern names twice the second is another branch
    parts = pc.extract_regex(texts, pattern=pattern)

    def part(name: str, value_of: Callable[[str], int] = _number, default: int = 0) -> IntArray:
        """Return the numbers of a part of the texts; a default where the format has no such part."""
        if f"?P<{name}>" not in pattern:
            return np.full(len(texts), default, dtype=np.int64)
        encoded = pc.dictionary_encode(pc.fill_null(pc.struct_field(parts, name), ""))
        values = np.array([value_of(each) for each in encoded.dictionary.to_pylist()], dtype=np.int64)
        return np.asarray(values[encoded.indices.to_numpy()], dtype=np.int64)

    hour, minute, second = (part(each) for each in "HMS")
    nanoseconds = part("f", lambda text: int(text[:9].ljust(9, "0")))
    half = part("p", lambda text: _HALVES.get(text[:1].lower(), 0), -1)
    is_midnight = (hour == 24) & (minute == 0) & (second == 0) & (nanoseconds == 0)
    is_right = np.where(half >= 0, (hour >= 1) & (hour <= 12), (hour <= 23) | is_midnight)
    hour = np.where(half >= 0, hour % 12 + half, hour)
    is_right &= parts.is_valid().to_numpy(zero_copy_only=False) & (minute <= 59) & (second <= 60)
    # half a day that the format does not know would be read as the other half
    is_right &= part("w", lambda text: text.strip(" ().").lower() in ("am", "pm", "a", "p")) == 0
    clock_us = ((hour * 60 + minute) * 60 + second) * US_PER_S + (nanoseconds + 500) // 1000
    if is_clock_only(time_format):
        days, is_day = _rolled_days(clock_us, is_right, clock.date)
    else:
        days, is_day = _days(part)
    offset_us = part("z", _offset_us, _NO_OFFSET)
    is_local = (offset_us == _NO_OFFSET) & is_right & is_day
    us = days * DAY_US + clock_us - np.where(offset_us == _NO_OFFSET, 0, offset_us)
    epochs = Epochs(us, np.zeros(len(us), dtype=np.bool_), [], is_local)
    epochs.refuse(f"epoch is not {time_format}", ~(is_right & is_day))
    return epochs


def _number(text: str) -> int:
    """Return the number of a part, 0 of an empty one."""
    return int(text or 0)


def _offset_us(text: str) -> int:
    """Return the offset from UTC of a stated zone; `_NO_OFFSET`: it states none."""
    found = re.search(r"([+-])(\d{2})(?::?(\d{2}))?", text)
    if found is None:
        return 0 if text else _NO_OFFSET
    size_us = (int(found.group(2)) * 60 + int(found.group(3) or 0)) * 60 * US_PER_S
    return -size_us if found.group(1) == "-" else size_us


def _days(part: Callable[..., IntArray]) -> tuple[IntArray, BoolArray]:
    """Return days since 1970, and which of them exist."""
    year = part("Y", default=-1)
    year = np.where(year < 0, 2000 + part("y"), year)
    ordinal, named = part("j", default=-1), part("b", lambda text: _MONTHS.get(text.casefold()[:3], -1))
    is_ordinal = ordinal >= 0
    month = np.where(named == 0, part("m", default=1), named)
    day = np.where(is_ordinal, ordinal, part("d", default=1))
    first = (np.clip(year, 1, 9999) - 1970).astype("datetime64[Y]")
    begin = first.astype("datetime64[M]") + (np.clip(month, 1, 12) - 1).astype("timedelta64[M]")
    starts, ends = (
        np.where(is_ordinal, *(each.astype("datetime64[D]").astype(np.int64) for each in pair))
        for pair in ((first, begin), (first + np.timedelta64(1, "Y"), begin + np.timedelta64(1, "M")))
    )
    days = starts + day - 1
    return days, (month >= 1) & (month <= 12) & (day >= 1) & (days < ends)


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
