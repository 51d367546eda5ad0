"""Epochs: int64 microseconds UTC inside, RFC 3339 with ``Z`` and six decimals outside.

The limits are those of four-digit years. A leap second has no microsecond of its own: ``23:59:60.x`` is read as
``00:00:00.x`` of the next day, the instant at which POSIX clocks count it.
"""

import re
from datetime import UTC, datetime, timedelta
from fractions import Fraction

US_PER_S = 1_000_000
DAY_US = 86_400 * US_PER_S
#: 2000-01-01T00:00:00Z; nothing that this service handles is older
EARLIEST_EPOCH_US = 946_684_800 * US_PER_S
#: 2100-01-01T00:00:00Z; plans of operators do not reach beyond
LATEST_EPOCH_US = 4_102_444_800 * US_PER_S

_UNIX = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
#: of a fraction in microseconds
_DIGITS = 6
_RFC3339 = re.compile(
    r"(\d{4})-(\d{2})-(\d{2})[Tt](\d{2}):(\d{2}):(\d{2})(?:\.(\d+))?(?:([Zz])|([+-])(\d{2}):(\d{2}))", re.ASCII
)


def format_epoch(epoch_us: int) -> str:
    """Return RFC 3339 UTC with six decimals.

    Examples
    --------
    >>> format_epoch(0)
    '1970-01-01T00:00:00.000000Z'
    """
    moment = _UNIX + _MICROSECOND * int(epoch_us)
    return (
        moment.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        if moment.year >= 1000
        else f"{moment.year:04d}" + moment.strftime("-%m-%dT%H:%M:%S.%fZ")
    )


def parse_epoch(text: str) -> int:
    """Return microseconds UTC of an RFC 3339 instant with an offset.

    Parameters
    ----------
    text : str
        For example ``2026-11-21T03:02:32.011250Z``; digits beyond the microsecond are rounded to it.

    Raises
    ------
    ValueError
        Not RFC 3339, no offset, or a field out of range.

    Examples
    --------
    >>> parse_epoch("1970-01-01T01:00:00.5+01:00")
    500000
    """
    match = _RFC3339.fullmatch(text)
    if match is None:
        message = f"{text[:40]!r} is not an RFC 3339 instant with an offset, like 2026-11-21T03:02:32.011250Z"
        raise ValueError(message)
    year, month, day, hour, minute, second = (int(match.group(k)) for k in range(1, 7))
    leap = second == 60
    moment = datetime(year, month, day, hour, minute, 59 if leap else second, tzinfo=UTC)
    second_us = (moment - _UNIX) // _MICROSECOND + leap * US_PER_S - _offset_us(match)
    if leap and second_us % DAY_US:
        message = f"{text[:40]!r}: second 60 exists only as 23:59:60 UTC"
        raise ValueError(message)
    return second_us + _fraction_us(match.group(7) or "0")


def is_leap_second(text: str) -> bool:
    """Return whether an RFC 3339 instant, as `parse_epoch` takes it, lies within a leap second."""
    return text[17:19] == "60"


def _fraction_us(digits: str) -> int:
    """Return the microseconds of a fraction of a second, rounded half to even."""
    if len(digits) <= _DIGITS:
        return int(digits.ljust(_DIGITS, "0"))
    return round(Fraction(int(digits), 10 ** (len(digits) - _DIGITS)))


def _offset_us(match: re.Match[str]) -> int:
    """Return the offset from UTC of a matched instant."""
    if match.group(8):
        return 0
    hours, minutes = int(match.group(10)), int(match.group(11))
    if hours > 23 or minutes > 59:
        message = f"offset {match.group(9)}{match.group(10)}:{match.group(11)} is out of range"
        raise ValueError(message)
    size_us = (hours * 60 + minutes) * 60 * US_PER_S
    return -size_us if match.group(9) == "-" else size_us
