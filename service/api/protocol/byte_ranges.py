"""Byte ranges of RFC 9110: which part of a file of known length a request wants."""

import re

_ONE_RANGE = re.compile(r"bytes\s*=\s*(\d{0,19})-(\d{0,19})\s*", re.ASCII | re.IGNORECASE)


class UnsatisfiableRangeError(Exception):
    """The range lies behind the end of the file."""


def wanted_range(header: str | None, size: int) -> tuple[int, int] | None:
    """Return first and last byte that are wanted, None for the whole file.

    Parameters
    ----------
    header : str or None
        Value of ``Range``. Several ranges, other units and what cannot be read mean the whole file, as RFC 9110 allows.
    size : int
        Bytes of the file.

    Raises
    ------
    UnsatisfiableRangeError
        A readable range that holds no byte of the file.

    Examples
    --------
    >>> wanted_range("bytes=10-", 100), wanted_range("bytes=-10", 100), wanted_range("bytes=0-1,5-6", 100)
    ((10, 99), (90, 99), None)
    """
    match = _ONE_RANGE.fullmatch(header or "")
    if match is None or match.groups() == ("", ""):
        return None
    first_text, last_text = match.groups()
    if not first_text:
        first, last = max(0, size - int(last_text)), size - 1
    else:
        first, last = int(first_text), min(int(last_text or size - 1), size - 1)
        if last_text and int(last_text) < first:
            return None
    if first > last or first >= size:
        raise UnsatisfiableRangeError
    return first, last
