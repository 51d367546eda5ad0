"""Epochs: int64 microseconds UTC inside, RFC 3339 with ``Z`` and six decimals outside.

The limits are those of four-digit years; a leap second ``:60`` is read as the first instant of the next minute,
which is what every UTC clock of this century counts it as.
"""

import re
from datetime import UTC, datetime, timedelta

US_PER_S = 1_000_000
#: 2000-01-01T00:00:00Z; nothing that this service handles is older
EARLIEST_EPOCH_US = 946_684_800 * US_PER_S

_UNIX = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND = timedelta(microseconds=1)
_RFC3339 = re.compile(
    r"(\d{4})-(\d{2})-(\d{2})[Tt](\d{2}):(\d{2}):(\d{2})(?:\.(\d{1,9}))?(?:([Zz])|([+-])(\d{2}):(\d{2}))", re.ASCII
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
    fraction_us = round(int((match.group(7) or "0").ljust(9, "0")) / 1000)
    whole_us = (moment - _UNIX) // _MICROSECOND + (US_PER_S if leap else fraction_us)
    return whole_us - _offset_us(match)


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
