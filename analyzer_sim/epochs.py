"""Time: int64 microseconds UTC inside, RFC 3339 with `Z` and six decimals outside. No clock is read here."""

from datetime import UTC, datetime, timedelta

US_PER_S = 1_000_000
US_PER_H = 3600 * US_PER_S
US_PER_DAY = 24 * US_PER_H
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def rfc3339(epoch_us: int) -> str:
    """Write an epoch as text.

    Examples
    --------
    >>> rfc3339(1793491200000000)
    '2026-11-01T00:00:00.000000Z'
    """
    moment = _UNIX_EPOCH + timedelta(microseconds=int(epoch_us))
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%f") + "Z"


def epoch_us_from_text(text: str) -> int:
    """Read an RFC 3339 epoch; a text without a zone is refused.

    Examples
    --------
    >>> epoch_us_from_text("2026-11-01T00:00:00Z")
    1793491200000000
    """
    moment = datetime.fromisoformat(text)
    if moment.tzinfo is None:
        raise ValueError(f"epoch {text!r} has no time zone; write it with Z")
    return (moment - _UNIX_EPOCH) // timedelta(microseconds=1)
