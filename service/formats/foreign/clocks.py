"""Clock of a foreign table: which columns hold epochs, in which format, zone or scale; proven, or asked for.

A calendar epoch goes before any number, and a number is a clock only where its name says so and its values rise like
one. Order of day and month, zone, time scale and date are found only where the table states or proves them.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

from service.formats.foreign import times
from service.formats.foreign.table import CODES, ForeignTableError, Question, Table, word_set
from service.records.epoch import DAY_US, EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S

#: an Excel serial number beyond it, in 2041, is a modified Julian day of 2000
_LATEST_SERIAL_US = (51_544 - 25_569) * DAY_US
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
_PLAIN_NUMBER = re.compile(r"[+-]?\d*[.,]?\d+")
_COMPACT_FORMATS = ("%Y%m%d", "%Y%j", "%H%M%S")
_NAMED_DAYS = frozenset({"%Y%m%d", "%Y%j"})
_SIGNED_DAYS = tuple(each for each in _DAY_FORMATS if each not in _NAMED_DAYS)
_FULL_FORMATS = (
    times.ISO,
    *(f"{day} {clock}" for day in _DAY_FORMATS if day != "%Y-%m-%d" for clock in _CLOCK_FORMATS[:-1]),
    "%Y%m%d %H%M%S",
    "%d/%b/%Y:%H:%M:%S",
    "%Y-%m-%d %I:%M:%S %p",
    "%Y-%m-%d %I:%M %p",
    "%a %b %d %H:%M:%S %Y",
)
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
_SAMPLE = 300
_SCALED = {"gps_s": "GPS", times.WEEK: "GPS"}
#: longest step of a table whose order of day and month its days prove, and the shortest under another order
_PROVING_STEP_US, _CONTRADICTING_STEP_US = 6 * 3600 * US_PER_S, 20 * DAY_US


def find_clock(
    table: Table, stated: times.TableClock, decimal: str
) -> tuple[times.TableClock, list[Question], times.Epochs | None]:
    """Return the clock of a table, what it leaves open, and the epochs that it gives.

    Parameters
    ----------
    table : Table
        The whole table.
    stated : TableClock
        What a person stated; it is checked and never replaced.
    decimal : str
        Decimal sign of numbers.

    Raises
    ------
    ForeignTableError
        A stated thing that is none, or that the table contradicts.
    """
    questions: list[Question] = []
    if stated.tz is not None and stated.tz.upper() not in times.SCALES:
        times.zone_of(stated.tz)
    found = _with_format(table, _with_columns(table, stated, questions), questions)
    if found.time_format is None:
        return found, questions, None
    texts = _joined(table, found.columns)
    if found.date is None and times.is_clock_only(found.time_format):
        text = f"the times of day, like {texts[0].as_py()!r}, have no date: that of the first row"
        questions.append(Question("date", text))
        return found, questions, None
    epochs = times.read_epochs(texts, found, decimal)
    if epochs.is_bad.mean() > 0.5:
        detail = f"time_format {found.time_format!r} does not read the epochs, like {texts[0].as_py()!r}"
        raise ForeignTableError(f"{detail}: {epochs.reasons[0][0]}" if epochs.reasons else detail)
    found = _with_date_and_zone(found, epochs, texts, questions)
    return found, questions, times.read_epochs(texts, found, decimal)


def _with_columns(table: Table, found: times.TableClock, questions: list[Question]) -> times.TableClock:
    """Return the clock with its columns; several are a question with the first as its guess."""
    if found.columns:
        return found
    candidates = _candidates(table)
    names = [" + ".join(columns) for columns in candidates]
    if len(candidates) != 1:
        text = "several columns hold epochs" if candidates else "no column holds epochs of a known format"
        questions.append(Question("time_columns", text, tuple(names or table.header), names[0] if names else None))
    return replace(found, columns=candidates[0]) if candidates else found


def _with_format(table: Table, found: times.TableClock, questions: list[Question]) -> times.TableClock:
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
    if found.time_format not in (times.ISO, times.WEEK, *times.COUNTS) and "%" not in found.time_format:
        known = ", ".join((times.ISO, *times.COUNTS, times.WEEK))
        raise ForeignTableError(f"time_format {found.time_format[:40]!r}; write {known}, or a pattern: %d.%m.%Y %H:%M")
    return found


def _with_date_and_zone(
    found: times.TableClock, epochs: times.Epochs, texts: Any, questions: list[Question]
) -> times.TableClock:
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
    if named is not None and named not in times.SCALES:
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
    found = [each for each in ("UTC", *times.SCALES) if each.casefold() in words or f"{each.casefold()}time" in words]
    found += ["UTC"] if words & {"gmt", "zulu", "utctime"} and "UTC" not in found else []
    if (local := _LOCAL.search(low)) is not None:
        return None, local.group(0)
    odd = words & {"msk", "мск", "cet", "cest", "est", "edt", "pst", "pdt", "cst", "ist", "jst", "bst", "eet", "mez"}
    if odd or len(found) > 1:
        return None, ", ".join([*sorted(odd), *found])
    return (found[0], found[0]) if found else (None, None)


def _joined(table: Table, columns: Sequence[str]) -> Any:
    """Return the texts of some columns of each row, joined by blanks."""
    import pyarrow.compute as pc

    texts = [table.column(name) for name in columns]
    return texts[0] if len(texts) == 1 else pc.binary_join_element_wise(*texts, " ")


def _some(texts: Any) -> Any:
    """Return some cells of a column that hold something, from its first row to its last."""
    import pyarrow as pa
    import pyarrow.compute as pc

    some = texts[:: max(1, len(texts) // (10 * _SAMPLE))]
    held = some.filter(pc.invert(pc.is_in(pc.utf8_lower(some), pa.array(list(CODES)))))
    return held[:: max(1, len(held) // _SAMPLE)]


def _candidates(table: Table) -> list[tuple[str, ...]]:
    """Return the columns that hold epochs: calendar epochs, a date and a time of day, else a number."""
    import pyarrow.compute as pc

    samples = {name: _some(column) for name, column in zip(table.header, table.columns, strict=True)}
    # a bare number is a date or a time of day by its name only
    is_named = {name: bool(words_of(name) & _CLOCK_WORDS) for name in samples}
    full = [(name,) for name, some in samples.items() if _fits(some, _FULL_FORMATS)]
    days = [name for name, some in samples.items() if _fits(some, _DAY_FORMATS if is_named[name] else _SIGNED_DAYS)]
    others = {name: some for name, some in samples.items() if name not in days}
    clocks = [name for name, some in others.items() if _fits(some, _CLOCK_FORMATS[: None if is_named[name] else 4])]
    weeks = _week_columns(table.header)
    groups: list[list[tuple[str, ...]]] = [
        [*full, *((day, clock) for day in days for clock in clocks)],
        [weeks] if weeks else [],
        [(name,) for name in table.header if _count_formats(name, table.column(name))],
        [(name,) for name in clocks],
    ]
    for group in filter(None, groups):
        texts = [_joined(table, columns) for columns in group]
        # epochs change from row to row
        is_moving = [len(each) < 3 or pc.count_distinct(each).as_py() > 1 for each in texts]
        return [columns for columns, moves in zip(group, is_moving, strict=True) if moves] or group
    return []


def words_of(name: str) -> set[str]:
    """Return the words of a name, lower case, also of CamelCase and with digits and signs between them."""
    return set(re.findall(r"[^\W\d_]+|°", re.sub(r"(?<=[a-zа-я])(?=[A-ZА-Я])", " ", name).casefold()))


def _fits(some: Any, formats: Sequence[str]) -> bool:
    """Return whether one format reads more than a quarter of some cells."""
    texts = some[:: max(1, len(some) // 20)].to_pylist()
    if all(map(_PLAIN_NUMBER.fullmatch, texts)):
        # no other format has a number without a second sign
        formats = [each for each in formats if each in _COMPACT_FORMATS]
    return any(4 * _matching(texts, each) > len(texts) for each in formats) if texts else False


def _matching(texts: Sequence[str], time_format: str) -> int:
    """Return how many texts a format reads."""
    match = _pattern(time_format).match
    # a text whose first letters the format does not read is seldom alone
    return sum(match(text) is not None for text in texts) if any(match(text) for text in texts[:8]) else 0


@lru_cache(maxsize=512)
def _pattern(time_format: str) -> re.Pattern[str]:
    """Return the expression of a format for a few texts, which RE2 would be slow to compile for."""
    return re.compile(times.regex_of(time_format).replace(r"\pL", r"[^\W\d_]"))


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
    for kind, (unit_us, origin_us) in times.COUNTS.items():
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
        return [times.WEEK]
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
        each: ~times.read_epochs(texts, times.TableClock(tuple(columns), each, "UTC", "2026-01-01"), "point").is_bad
        for each in tried
    }
    most = max((int(rows.sum()) for rows in read.values()), default=0)
    best = [each for each, rows in read.items() if int(rows.sum()) == most and most > 0]
    if len(best) > 1 and "%Y-%m-%d %H:%M:%S" in best and times.ISO in best:
        best.remove("%Y-%m-%d %H:%M:%S")
    return _proven_by_days(texts, best) if len(best) > 1 else best


def _proven_by_days(texts: Any, formats: list[str]) -> list[str]:
    """Return the only format under which the days follow one another, or all where the table does not show it."""
    smooth, broken = [], []
    for each in formats:
        epochs = times.read_epochs(texts, times.TableClock((), each, "UTC"), "point")
        us = epochs.us[~epochs.is_bad]
        steps = np.abs(np.diff(us))
        crosses = len(us) > 1 and us[0] // DAY_US != us[-1] // DAY_US
        if crosses and steps.max() <= _PROVING_STEP_US:
            smooth.append(each)
        elif len(steps) and steps.max() >= _CONTRADICTING_STEP_US:
            broken.append(each)
    return smooth if len(smooth) == 1 and len(broken) == len(formats) - 1 else formats
