"""SCPI dialogue as values: answers of an analyzer in, arrays and records out. No socket, no clock.

Law of this file: it never trusts a length or a count that the other side names; whatever does not fit raises
`AnswerError` with the first bytes of what came. Rules behind it:

* A block is ``#<d><length><bytes>``; ``#0<bytes>`` ends with the message; ``#(<length>)`` carries a gigabyte and more.
  Its bytes may hold line feeds, so a block is cut out by length and never by line.
* An ASCII trace is comma separated; some analyzers end it with a comma, some put an ``#A`` header before it.
* 9.91E37 and -999 mean "no number", 9.9E37 "infinite"; all become NaN.
* Several queries of one message are answered in one line, joined by ``;`` outside quotes.
* The error queue answers ``<code>,"<text>[;<detail>]"``, some analyzers ``<code>`` alone; code 0 is the empty queue.
"""

import re
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import FloatArray

#: SCPI's not-a-number and infinities start here
SCPI_NO_NUMBER = 9.0e37
#: value that some analyzers give where there is no result
NO_RESULT = -999.0
#: digits that the length of a block may have
_MAX_LENGTH_DIGITS = 9

_ERROR = re.compile(r'\s*([+-]?\d+)\s*(?:,\s*(?:"((?:[^"]|"")*)"|(.*)))?\s*', re.DOTALL)
_DATE = re.compile(r"\s*(\d{4})\s*,\s*(\d{1,2})\s*,\s*(\d{1,2})\s*")
_TIME = re.compile(r"\s*(\d{1,2})\s*,\s*(\d{1,2})\s*,\s*(\d{1,2}(?:\.\d+)?)\s*")


class AnswerError(ValueError):
    """An answer of the analyzer is not what the query asks for."""


class AnalyzerMessage(NamedTuple):
    """One entry of the analyzer's error queue."""

    code: int
    text: str

    @property
    def is_execution_error(self) -> bool:
        """Return whether the analyzer did not do what it was told (-200 to -299); -222 only clamps a setting."""
        return -300 < self.code <= -200 and self.code != -222

    @property
    def is_command_error(self) -> bool:
        """Return whether the analyzer did not understand (-100 to -199), or cannot answer (-400 to -499)."""
        return -200 < self.code <= -100 or -500 < self.code <= -400


class Identity(NamedTuple):
    """Answer to ``*IDN?``."""

    vendor: str
    model: str
    serial: str
    firmware: str


def parse_identity(text: str) -> Identity:
    """Return the four fields of ``*IDN?``.

    Examples
    --------
    >>> parse_identity("Rohde&Schwarz,FSW-26,1331.5003K26/100001,5.30").model
    'FSW-26'
    """
    fields = [field.strip().strip('"') for field in text.strip().split(",")]
    if len(fields) < 2 or not fields[0]:
        raise AnswerError(f"*IDN? answered {text[:80]!r}")
    padded = [*fields[:3], ",".join(fields[3:])] if len(fields) > 3 else [*fields, "", ""]
    return Identity(padded[0], padded[1], padded[2], padded[3])


def split_answers(line: str) -> list[str]:
    """Return the answers of one line, cut at semicolons outside quotes.

    Examples
    --------
    >>> split_answers('1;-222,"Data out of range;RBW";3E4')
    ['1', '-222,"Data out of range;RBW"', '3E4']
    """
    answers, quote = [""], ""
    for letter in line.strip("\r\n"):
        if letter == ";" and not quote:
            answers.append("")
            continue
        if letter in "\"'" and quote in ("", letter):
            quote = "" if quote else letter
        answers[-1] += letter
    return [answer.strip() for answer in answers]


def parse_number(text: str, query: str = "") -> float:
    """Return one number; NaN for SCPI's not-a-number and infinities. An error names the query.

    Examples
    --------
    >>> parse_number("+3.0000E+04")
    30000.0
    """
    try:
        value = float(text)
    except ValueError as error:
        raise AnswerError(f"{query} answered {text[:80]!r}, which is not a number".strip()) from error
    return value if abs(value) < SCPI_NO_NUMBER else float("nan")


def parse_flag(text: str) -> bool:
    """Return one boolean answer (``1``, ``0``, ``ON``, ``OFF``)."""
    word = text.strip().upper()
    if word in {"1", "ON", "+1"}:
        return True
    if word in {"0", "OFF", "+0"}:
        return False
    raise AnswerError(f"{text[:80]!r} is not a boolean")


def parse_message(text: str) -> AnalyzerMessage:
    """Return one entry of the error queue.

    Examples
    --------
    >>> parse_message('-113,"Undefined header;FOO?"')
    AnalyzerMessage(code=-113, text='Undefined header;FOO?')
    """
    match = _ERROR.fullmatch(text)
    if match is None:
        raise AnswerError(f"SYST:ERR? answered {text[:80]!r}")
    quoted = match.group(2)
    return AnalyzerMessage(
        int(match.group(1)), quoted.replace('""', '"') if quoted is not None else match.group(3) or ""
    )


def is_message(text: str) -> bool:
    """Return whether a text is an entry of the error queue, with its text in quotes.

    Examples
    --------
    >>> is_message('0,"No error"'), is_message("-90,-80")
    (True, False)
    """
    match = _ERROR.fullmatch(text)
    return match is not None and match.group(2) is not None


def block_length(header: bytes) -> int:
    """Return how many digits of length follow ``#<d>``; 0 for an indefinite block.

    Parameters
    ----------
    header : bytes
        The first two bytes of an answer.

    Raises
    ------
    AnswerError
        It does not open a block.
    """
    if len(header) != 2 or header[:1] != b"#" or not header[1:2].isdigit():
        raise AnswerError(f"{header!r} does not open a block")
    return int(header[1:2])


def split_block(data: bytes) -> tuple[bytes, bytes]:
    r"""Return the payload of the block that data starts with, and what follows it.

    Examples
    --------
    >>> split_block(b"#14ab\ncd;7")
    (b'ab\nc', b'd;7')
    """
    if data[:2] == b"#(":
        digits, closing, rest = data[2:].partition(b")")
        return _cut(digits if closing else b"", rest)
    count = block_length(data[:2])
    if count == 0:
        return data[2:].removesuffix(b"\n"), b""
    if count > _MAX_LENGTH_DIGITS:
        raise AnswerError(f"block with {count} digits of length")
    return _cut(data[2 : 2 + count], data[2 + count :])


def _cut(digits: bytes, rest: bytes) -> tuple[bytes, bytes]:
    """Cut a payload off by its length in digits."""
    if not digits.isdigit():
        raise AnswerError(f"block with the length {digits[:20]!r}")
    length = int(digits)
    if len(rest) < length:
        raise AnswerError(f"block of {length} bytes ends after {len(rest)}")
    return rest[:length], rest[length:]


def levels_of_block(payload: bytes, points: int, *, is_big_endian: bool = False) -> FloatArray:
    """Return the levels of a REAL,32 trace.

    Parameters
    ----------
    payload : bytes
        Without block header.
    points : int
        How many values there must be.
    is_big_endian : bool
        Byte order; Rohde & Schwarz send little-endian.

    Returns
    -------
    ndarray, shape (points,), dBm
        NaN where the analyzer gave no number.
    """
    if len(payload) != 4 * points:
        raise AnswerError(f"trace of {len(payload)} bytes where {points} points take {4 * points}")
    values = np.frombuffer(payload, dtype=">f4" if is_big_endian else "<f4").astype(np.float64)
    return _without_codes(values)


def levels_of_text(text: str, points: int) -> FloatArray:
    """Return the levels of an ASCII trace.

    Parameters
    ----------
    text : str
        Comma separated numbers; a comma at the end and an ``#A`` header are let pass.
    points : int
        How many values there must be.

    Returns
    -------
    ndarray, shape (points,), dBm
        NaN where the analyzer gave no number.
    """
    body = re.sub(r"^#A\d*\s*", "", text.strip()).rstrip(", \r\n")
    fields = body.split(",") if body else []
    if len(fields) != points:
        raise AnswerError(f"trace of {len(fields)} values where {points} were due: {text[:40]!r}")
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError as error:
        raise AnswerError(f"trace holds something that is not a number: {error}") from error
    return _without_codes(values)


def _without_codes(values: FloatArray) -> FloatArray:
    """Return the values with the codes for "no number" as NaN."""
    with np.errstate(invalid="ignore"):
        is_number = np.isfinite(values) & (np.abs(values) < SCPI_NO_NUMBER) & (values != NO_RESULT)
    return np.where(is_number, values, np.nan)


def parse_date_time(date: str, time: str) -> str:
    """Return RFC 3339 text of ``SYST:DATE?`` and ``SYST:TIME?``, taken as UTC.

    Examples
    --------
    >>> parse_date_time("2026,11,21", "3,2,32")
    '2026-11-21T03:02:32Z'
    """
    day, clock = _DATE.fullmatch(date), _TIME.fullmatch(time)
    if day is None or clock is None:
        raise AnswerError(f"date {date[:40]!r}, time {time[:40]!r}")
    second = clock.group(3)
    padded = second if len(second.partition(".")[0]) == 2 else f"0{second}"
    return (
        f"{int(day.group(1)):04d}-{int(day.group(2)):02d}-{int(day.group(3)):02d}"
        f"T{int(clock.group(1)):02d}:{int(clock.group(2)):02d}:{padded}Z"
    )
