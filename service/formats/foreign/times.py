"""Epochs of foreign tables: found, proven by their content, or asked for; whole columns at once.

A calendar epoch goes before any number, and a number is a clock only where its name says so and its values rise like
one. Order of day and month, zone, time scale and date are found only where the table states or proves them.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from functools import lru_cache
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

import numpy as np
from numpy.typing import NDArray

from service.formats.ephemeris import utc_us
from service.formats.foreign.table import CODES, ForeignTableError, Question, Table, word_set
from service.records.epoch import DAY_US, EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
ISO = "iso"
_GPS_ORIGIN_US = 315_964_800 * US_PER_S
_WEEK_US = 7 * DAY_US
#: number of one column: microseconds of its unit, and of its zero
_COUNTS = {
    "unix_s": (US_PER_S, 0),
    "unix_ms": (1000, 0),
    "unix_us": (1, 0),
    "unix_ns": (0.001, 0),
    "gps_s": (US_PER_S, _GPS_ORIGIN_US),
    "jd": (DAY_US, round(-2_440_587.5 * DAY_US)),
    "mjd": (DAY_US, -40_587 * DAY_US),
    "excel": (DAY_US, -25_569 * DAY_US),
}
#: an Excel serial number beyond it, in 2041, is a modified Julian day of 2000
_LATEST_SERIAL_US = (51_544 - 25_569) * DAY_US
_WEEK = "gps_week_s"
#: time scales, which are stated in place of a zone
SCALES = ("GPS", "TAI", "TT")
_SCALED = {"gps_s": "GPS", _WEEK: "GPS"}
_DATES = (
    *(f"%d{s}%m{s}%Y %m{s}%d{s}%Y %d{s}%m{s}%y %m{s}%d{s}%y %y{s}%m{s}%d".split() for s in "./-"),
    sorted(
        word_set(
            "%Y.%m.%d %Y/%m/%d %Y-%m-%d %Y-%j %Y/%j %Y%m%d %Y%j %d-%b-%Y %d-%b-%y %d/%b/%Y %d.%b.%Y %Y-%b-%d",
        )
    ),
    ("%d %b %Y", "%d %b %y", "%b %d %Y", "%b %d, %Y", "%d. %b %Y", "%Y %b %d", "%a %b %d %Y", "%a, %d %b %Y"),
)
_DAY_FORMATS = tuple(each for group in _DATES for each in group)
_CLOCK_FORMATS = ("%H:%M:%S", "%I:%M:%S %p", "%H:%M", "%I:%M %p", "%H.%M.%S", "%H-%M-%S", "%H%M%S")
_NAMED_DAYS = frozenset({"%Y%m%d", "%Y%j"})
_FULL_FORMATS = (
    ISO,
    *(f"{day} {clock}" for day in _DAY_FORMATS if day != "%Y-%m-%d" for clock in _CLOCK_FORMATS[:-1]),
    "%Y%m%d %H%M%S",
    "%d/%b/%Y:%H:%M:%S",
    "%Y-%m-%d %I:%M:%S %p",
    "%Y-%m-%d %I:%M %p",
    "%a %b %d %H:%M:%S %Y",
)
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
_CLOCK_WORDS = word_set(
    "time times epoch epochs timestamp timestamps datetime date unix posix utc gps tow sow gpst jd mjd "
    "tai ts t day seconds secs week wk время дата zeit datum uhrzeit temps heure hora fecha timetag "
    "unixtime utctime"
)
_NO_CLOCK_WORDS = word_set(
    "counter count index record serial number no id freq frequency hz khz mhz ghz seq sequence sweep lo "
    "if rbw vbw points gain orbit rev номер частота"
)
_LOCAL = re.compile(r"\b(local|loc|lt|ortszeit|местное|мест|lokal)\b")
_OFFSET_IN_NAME = re.compile(r"\b(?:utc|gmt)\s*([+-])\s*(\d{1,2})(?::?(\d{2}))?\b")
_IANA = re.compile(r"\b([A-Z][A-Za-z]+/[A-Z][A-Za-z_]+)\b")
_FIXED_OFFSET = re.compile(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d{2}))?")
_SAMPLE = 300
#: longest step of a table whose order of day and month its days prove, and the shortest under another order
_PROVING_STEP_US, _CONTRADICTING_STEP_US = 6 * 3600 * US_PER_S, 20 * DAY_US
#: epochs ahead of this machine's clock by less are a difference of clocks
_FUTURE_US = 60 * US_PER_S
#: rows whose newest is older are asked about
_OLD_US = 7 * DAY_US


@dataclass(slots=True)
class Clock:
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


def find_clock(table: Table, stated: Clock, decimal: str) -> tuple[Clock, list[Question], Epochs | None]:
    """Return the clock of a table, what it leaves open, and the epochs that it gives.

    Parameters
    ----------
    table : Table
        The whole table.
    stated : Clock
        What a person stated; it is checked and never replaced.
    decimal : str
        Decimal sign of numbers.

    Raises
    ------
    ForeignTableError
        A stated thing that is none, or that the table contradicts.
    """
    questions: list[Question] = []
    if stated.tz is not None and stated.tz.upper() not in SCALES:
        zone_of(stated.tz)
    found = _with_format(table, _with_columns(table, stated, questions), questions)
    if found.time_format is None:
        return found, questions, None
    texts = _joined(table, found.columns)
    if found.date is None and _is_clock_only(found.time_format):
        text = f"the times of day, like {texts[0].as_py()!r}, have no date: that of the first row"
        questions.append(Question("date", text))
        return found, questions, None
    epochs = read_epochs(texts, found, decimal)
    if epochs.is_bad.mean() > 0.5:
        detail = f"time_format {found.time_format!r} does not read the epochs, like {texts[0].as_py()!r}"
        raise ForeignTableError(f"{detail}: {epochs.reasons[0][0]}" if epochs.reasons else detail)
    found = _with_date_and_zone(found, epochs, texts, questions)
    return found, questions, read_epochs(texts, found, decimal)


def _with_columns(table: Table, found: Clock, questions: list[Question]) -> Clock:
    """Return the clock with its columns; several are a question with the first as its guess."""
    if found.columns:
        return found
    candidates = _candidates(table)
    names = [" + ".join(columns) for columns in candidates]
    if len(candidates) != 1:
        text = "several columns hold epochs" if candidates else "no column holds epochs of a known format"
        questions.append(Question("time_columns", text, tuple(names or table.header), names[0] if names else None))
    return replace(found, columns=candidates[0]) if candidates else found


def _with_format(table: Table, found: Clock, questions: list[Question]) -> Clock:
    """Return the clock with the format of its epochs; several are a question with the first as its guess."""
    if not found.columns:
        return replace(found, time_format=None)
    if found.time_format is None:
        texts = _joined(table, found.columns)
        formats = _formats_of(texts, table, found.columns)
        first = repr(texts[0].as_py()) if len(texts) else "nothing"
        if len(formats) != 1:
            text = f"day and month may be exchanged: {first}" if formats else f"format of the epochs, like {first}"
            questions.append(Question("time_format", text, tuple(formats), formats[0] if formats else None))
        return replace(found, time_format=formats[0]) if formats else found
    if found.time_format not in (ISO, _WEEK, *_COUNTS) and "%" not in found.time_format:
        known = ", ".join((ISO, *_COUNTS, _WEEK))
        raise ForeignTableError(f"time_format {found.time_format[:40]!r}; write {known}, or a pattern: %d.%m.%Y %H:%M")
    return found


def _with_date_and_zone(found: Clock, epochs: Epochs, texts: Any, questions: list[Question]) -> Clock:
    """Return the clock with date and zone; what is not proven joins the questions with a guess."""
    first = texts[0].as_py()
    named, reason = zone_in_names(found.columns)
    if found.tz is not None:
        if epochs.is_local.any() or found.time_format not in ("unix_s", "unix_ms", "unix_us", "unix_ns"):
            return found
        raise ForeignTableError(f"tz {found.tz} is stated, and each epoch, like {first!r}, states its own")
    scale = _SCALED.get(found.time_format or "")
    if scale is not None:
        text = f"the epochs, like {first!r}, look like GPS time: leap seconds are taken off"
        questions.append(Question("tz", text, ("GPS", "UTC"), scale))
        return replace(found, tz=scale)
    if not epochs.is_local.any():
        if reason is not None and named not in ("UTC", None) and not (named or "").startswith(("+", "-")):
            text = f"the name says {reason}, the epochs, like {first!r}, state an offset"
            questions.append(Question("tz", text, ("UTC", named or ""), "UTC"))
        return found
    if named is not None and named not in SCALES:
        return replace(found, tz=named)
    text = f"time zone of the epochs: {first!r} has no offset" + (f", the name says {reason}" if reason else "")
    questions.append(Question("tz", text, (), named or "UTC"))
    return replace(found, tz=named or "UTC")


def zone_in_names(names: Sequence[str]) -> tuple[str | None, str | None]:
    """Return the zone or scale that names of columns state, None where none or two do, and the words that say so.

    Examples
    --------
    >>> zone_in_names(["Time (UTC+3)"]), zone_in_names(["Local time"]), zone_in_names(["Date", "Time"])
    (('+03:00', 'UTC+3'), (None, 'local'), (None, None))
    """
    joined = " ".join(names)
    if (iana := _IANA.search(joined)) is not None:
        return iana.group(1), iana.group(1)
    low = re.sub(r"[_\[\]();,]", " ", joined).casefold()
    if (offset := _OFFSET_IN_NAME.search(low)) is not None:
        sign, hours, minutes = offset.groups()
        return f"{sign}{int(hours):02d}:{minutes or '00'}", offset.group(0).upper()
    words = set(re.findall(r"[^\W\d]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", joined).casefold().replace("_", " ")))
    found = [each for each in ("UTC", *SCALES) if each.casefold() in words or f"{each.casefold()}time" in words]
    found += ["UTC"] if words & {"gmt", "zulu", "utctime"} and "UTC" not in found else []
    if (local := _LOCAL.search(low)) is not None:
        return None, local.group(0)
    odd = words & {"msk", "мск", "cet", "cest", "est", "edt", "pst", "pdt", "cst", "ist", "jst", "bst", "eet", "mez"}
    if odd or len(found) > 1:
        return None, ", ".join([*sorted(odd), *found])
    return (found[0], found[0]) if found else (None, None)


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


def _joined(table: Table, columns: Sequence[str]) -> Any:
    """Return the texts of some columns of each row, joined by blanks."""
    import pyarrow.compute as pc

    texts = [table.column(name) for name in columns]
    return texts[0] if len(texts) == 1 else pc.binary_join_element_wise(*texts, " ")


def _some(texts: Any) -> Any:
    """Return some cells of a column that hold something, from its first row to its last."""
    import pyarrow as pa
    import pyarrow.compute as pc

    held = texts.filter(pc.invert(pc.is_in(pc.utf8_lower(texts), pa.array(list(CODES)))))
    step = max(1, len(held) // _SAMPLE)
    return held.take(pa.array(range(0, len(held), step)))


def _candidates(table: Table) -> list[tuple[str, ...]]:
    """Return the columns that hold epochs: calendar epochs, a date and a time of day, else a number."""
    samples = {name: _some(column) for name, column in zip(table.header, table.columns, strict=True)}
    full = [(name,) for name, some in samples.items() if _fits(some, _FULL_FORMATS)]
    days = [name for name, some in samples.items() if _fits(some, _day_formats(name))]
    clocks = [name for name, some in samples.items() if _fits(some, _clock_formats(name)) and name not in days]
    pairs = [(day, clock) for day in days for clock in clocks]
    parts = _part_columns(table.header)
    weeks = _week_columns(table.header)
    groups: list[list[tuple[str, ...]]] = [
        [*full, *pairs, *([parts] if parts else [])],
        [weeks] if weeks else [],
        [(name,) for name in table.header if _count_formats(name, table.column(name))],
        [(name,) for name in clocks],
    ]
    for group in groups:
        moving = [columns for columns in group if _is_moving(table, columns)] or group
        if moving:
            return moving
    return []


def _day_formats(name: str) -> tuple[str, ...]:
    """Return the formats of dates that a column of a name may have; a bare number is a date by its name only."""
    return _DAY_FORMATS if words_of(name) & _CLOCK_WORDS else tuple(set(_DAY_FORMATS) - _NAMED_DAYS)


def _clock_formats(name: str) -> tuple[str, ...]:
    """Return the formats of times of day that a column of a name may have."""
    return _CLOCK_FORMATS if words_of(name) & _CLOCK_WORDS else _CLOCK_FORMATS[:4]


def words_of(name: str) -> set[str]:
    """Return the words of a name, lower case, also of CamelCase and with digits and signs between them."""
    return set(re.findall(r"[^\W\d_]+|°", re.sub(r"(?<=[a-zа-я])(?=[A-ZА-Я])", " ", name).casefold()))


def _fits(some: Any, formats: Sequence[str]) -> bool:
    """Return whether one format reads more than a quarter of some cells."""
    texts = some[:: max(1, len(some) // 20)].to_pylist()
    return any(4 * _matching(texts, each) > len(texts) for each in formats) if texts else False


def _matching(texts: Sequence[str], time_format: str) -> int:
    """Return how many texts a format reads."""
    match = _pattern(time_format).match
    # a text whose first letters the format does not read is seldom alone
    return sum(match(text) is not None for text in texts) if any(match(text) for text in texts[:8]) else 0


@lru_cache(maxsize=512)
def _pattern(time_format: str) -> re.Pattern[str]:
    """Return the expression of a format for a few texts, which RE2 would be slow to compile for."""
    return re.compile(_regex(time_format).replace(r"\pL", r"[^\W\d_]"))


def _is_moving(table: Table, columns: Sequence[str]) -> bool:
    """Return whether the epochs of some columns change from row to row."""
    import pyarrow.compute as pc

    texts = _joined(table, columns)
    return len(texts) < 3 or pc.count_distinct(texts).as_py() > 1


def _part_columns(header: Sequence[str]) -> tuple[str, ...]:
    """Return the columns year, month, day, hour, minute and second, where there are such."""
    low = {name.casefold().strip(): name for name in header}
    names = [low.get(part) for part in ("year", "month", "day", "hour", "minute", "second")]
    return tuple(name for name in names if name is not None) if all(names) else ()


def _week_columns(header: Sequence[str]) -> tuple[str, ...]:
    """Return the columns of GPS week and seconds of the week, where each is named once."""
    weeks = [name for name in header if words_of(name) & {"week", "wk", "wn"}]
    seconds = [name for name in header if words_of(name) & {"tow", "sow"} or words_of(name) >= {"seconds", "gps"}]
    return (weeks[0], seconds[0]) if len(weeks) == 1 and len(seconds) == 1 and weeks != seconds else ()


def _count_formats(name: str, column: Any) -> list[str]:
    """Return as what numbers a column counts time, if its name says so and it rises like a clock."""
    import pyarrow as pa
    import pyarrow.compute as pc

    words = words_of(name)
    if not words & _CLOCK_WORDS or words & _NO_CLOCK_WORDS:
        return []
    held = column.filter(pc.match_substring_regex(column, pattern=r"^\d+([.,]\d+)?$"))
    values = pc.replace_substring(held, ",", ".").cast(pa.float64()).to_numpy()
    steps = np.diff(values)
    is_rising = not len(steps) or (np.mean(steps >= 0) >= 0.9 and np.any(steps > 0))
    if 2 * len(held) < len(column) or not len(held) or not is_rising:
        return []
    found = []
    for kind, (unit_us, origin_us) in _COUNTS.items():
        middle_us = float(np.median(values)) * unit_us + origin_us
        latest_us = _LATEST_SERIAL_US if kind == "excel" else LATEST_EPOCH_US
        if EARLIEST_EPOCH_US <= middle_us < latest_us and (kind != "gps_s" or words & {"gps", "gpst"}):
            found.append(kind)
    if "gps_s" in found and not words & {"unix", "posix"}:
        return ["gps_s"]
    # a unit that the size of the numbers contradicts is a question
    units = [f"unix_{unit}" for unit in ("ms", "us", "ns") if unit in words]
    return found if not found or not units or found == units else [*found, *units]


def _formats_of(texts: Any, table: Table, columns: Sequence[str]) -> list[str]:
    """Return the formats that read the most texts; several when day and month may be exchanged."""
    if tuple(columns) == _week_columns(table.header):
        return [_WEEK]
    if tuple(columns) == _part_columns(table.header) and columns:
        return ["%Y %m %d %H %M %S"]
    some = _some(texts).to_pylist()
    tried: list[str] = [each for each in _FULL_FORMATS if _matching(some, each)]
    if len(columns) == 2:
        more = [f"{day} {clock}" for day in (*_NAMED_DAYS, "%Y-%m-%d") for clock in _CLOCK_FORMATS]
        tried += [each for each in more if each not in tried and _matching(some, each)]
    if not tried and len(columns) == 1:
        tried = [each for each in _CLOCK_FORMATS[:4] if _matching(some, each)]
        counted = _count_formats(columns[0], texts)
        if counted:
            return counted
    read = {
        each: ~read_epochs(texts, Clock(tuple(columns), each, "UTC", "2026-01-01"), "point").is_bad for each in tried
    }
    most = max((int(rows.sum()) for rows in read.values()), default=0)
    best = [each for each, rows in read.items() if int(rows.sum()) == most and most > 0]
    if len(best) > 1 and "%Y-%m-%d %H:%M:%S" in best and ISO in best:
        best.remove("%Y-%m-%d %H:%M:%S")
    return _proven_by_days(texts, best) if len(best) > 1 else best


def _proven_by_days(texts: Any, formats: list[str]) -> list[str]:
    """Return the only format under which the days follow one another, or all where the table does not show it."""
    smooth, broken = [], []
    for each in formats:
        epochs = read_epochs(texts, Clock((), each, "UTC"), "point")
        us = epochs.us[~epochs.is_bad]
        steps = np.abs(np.diff(us))
        crosses = len(us) > 1 and us[0] // DAY_US != us[-1] // DAY_US
        if crosses and steps.max() <= _PROVING_STEP_US:
            smooth.append(each)
        elif len(steps) and steps.max() >= _CONTRADICTING_STEP_US:
            broken.append(each)
    return smooth if len(smooth) == 1 and len(broken) == len(formats) - 1 else formats


@lru_cache(maxsize=512)
def _regex(time_format: str) -> str:
    """Return the expression of RE2 for a pattern of ``strptime``; fractions and offsets may always follow.

    Raises
    ------
    ForeignTableError
        A sign after % that is not known, or one that stands twice.
    """
    if time_format == ISO:
        seconds = r"(?::(?P<S>\d{2})(?:[.,](?P<f>\d{1,12}))?)?"
        start = _regex("%Y-%m-%d %H:%M").removesuffix(f"{_ZONE}$")
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
                raise ForeignTableError(f"time_format {time_format[:40]!r}: %{token} is unknown or stands twice")
            # without a sign between them numbers have two digits
            is_close = text[max(position - 2, 0) : position].startswith("%") and position > 0
            seen.add(token)
            pattern += _TOKENS[token].replace("{1,2}", "{2}") if is_close else _TOKENS[token]
            position += 2
            continue
        pattern += r"[Tt\s]\s*" if sign in " T" else re.escape(sign)
        position += 1
    return f"^{pattern}{'' if 'z' in seen else _ZONE}$"


def _is_clock_only(time_format: str) -> bool:
    """Return whether a format has no date."""
    return "%" in time_format and not any(token in time_format for token in ("%d", "%j"))


def read_epochs(texts: Any, clock: Clock, decimal: str) -> Epochs:
    """Return the epochs of texts under a clock; rows without one are bad, with their reason."""
    if clock.time_format in _COUNTS or clock.time_format == _WEEK:
        epochs = _counted(texts, clock.time_format or "", decimal)
    else:
        epochs = _calendar(texts, clock)
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
    if kind == _WEEK:
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
    unit_us, origin_us = _COUNTS[kind]
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
        self._pattern = _regex(time_format)
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


def _calendar(texts: Any, clock: Clock) -> Epochs:
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
    if _is_clock_only(time_format):
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
