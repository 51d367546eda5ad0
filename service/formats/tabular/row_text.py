"""Rows of float32 values as text for CSV and NDJSON: epoch, values, fixed pieces around them.

Two ways to the same text: a compiled loop (11 ns a value) and numpy with Python (400 ns). A block that holds what the
loop cannot write, such as 1e-05, goes the other way, and nobody can tell. A service never compiles within a request:
until a thread has compiled the loop, which takes seconds and longer on a busy machine, exports go the other way.

Rows of float32 values as text, in a loop that numba compiles: epoch, then the values, between fixed pieces.

Law of this file: numbers and arrays only, so that numba compiles it without help; what it cannot write it says so by a
negative length, and the caller writes that block by other means. A value is written with the fewest decimals that read
back to it: the trial begins with a number of decimals at which neighbouring float32 are told apart, so that one
multiplication and one division find nearly every level that was rounded to five decimals.
"""

from collections.abc import Callable
from functools import lru_cache
from threading import Event, Lock, Thread
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.formats.numbers import text_of_float32
from service.records.epoch import format_epoch

Bytes = NDArray[np.uint8]
#: bytes of an epoch, ``2026-11-21T00:00:00.000000Z``
EPOCH_BYTES = 27
#: bytes of its date, with the T behind it
DATE_BYTES = 11
#: bytes of a value at most: sign, seven digits, point, nine decimals
VALUE_BYTES = 18
#: instants that the calendar below is meant for: 1970 to 9999
LAST_EPOCH_US = 253_402_300_800_000_000

Positions = NDArray[np.int64]
#: out, epochs, values, before, betweens, their ends, which of them, leads, ends of the leads, absent, after
FillRows = Callable[
    [Bytes, Positions, NDArray[np.float32], Bytes, Bytes, Positions, Positions, Bytes, Positions, Bytes, Bytes], int
]

_POWERS = np.array([10**k for k in range(18)], dtype=np.int64)
_DIGIT = ord("0")
#: both digits of the numbers below 100, and the bytes of point and digits that hundredths need
_PAIRS = np.array([[_DIGIT + k // 10, _DIGIT + k % 10] for k in range(100)], dtype=np.uint8)
_DECIMALS_BYTES = np.array([0 if k == 0 else 2 if k % 10 == 0 else 3 for k in range(100)], dtype=np.int64)


def fill_rows(
    out: Bytes,
    epochs_us: Positions,
    values: NDArray[np.float32],
    before: Bytes,
    betweens: Bytes,
    between_ends: Positions,
    between_of: Positions,
    leads: Bytes,
    lead_ends: Positions,
    absent: Bytes,
    after: Bytes,
) -> int:
    """Write ``before epoch between lead value lead value .. after`` for each row; return the bytes written.

    Parameters
    ----------
    out : ndarray of uint8
        Long enough for every row.
    epochs_us : ndarray, shape (T,)
        Microseconds UTC, 1970 to 9999.
    values : ndarray of float32, shape (T, N)
        NaN is written as ``absent``.
    before, absent, after : ndarray of uint8
        Fixed pieces of a row.
    betweens : ndarray of uint8
        What may stand between epoch and values, one after the other.
    between_ends : ndarray, shape (B + 1,)
        Where each of them begins, and where the last one ends.
    between_of : ndarray, shape (T,)
        Which of them stands in a row.
    leads : ndarray of uint8
        What stands before each value, one after the other.
    lead_ends : ndarray, shape (N + 1,)
        Where each of them begins, and where the last one ends.

    Returns
    -------
    int
        -1 when a value has no text of at most nine decimals and six digits before the point.
    """
    at = 0
    date = np.empty(DATE_BYTES, dtype=np.uint8)
    known_day = np.int64(-1)
    for row in range(len(epochs_us)):
        at = _put_bytes(out, at, before)
        day = epochs_us[row] // 86_400_000_000
        if day != known_day:
            # the calendar costs more than the rest of the row: rows of one day share it
            _put_date(date, day)
            known_day = day
        at = _put_bytes(out, at, date)
        at = _put_time(out, at, epochs_us[row] - day * 86_400_000_000)
        at = _put_text(out, at, betweens, between_ends, between_of[row])
        for column in range(values.shape[1]):
            at = _put_text(out, at, leads, lead_ends, column)
            value = values[row, column]
            size = np.float64(abs(value))
            # false for what is absent; the comparison comes first, for what is too large is no number of hundredths
            hundredths = np.uint32(size * 100.0 + 0.5) if size < 1000.0 else np.uint32(0)
            if size < 1000.0 and np.float32(hundredths * 0.01) == np.float32(size):
                at = _put_hundredths(out, at, hundredths, np.signbit(value))
            else:
                at = _put_bytes(out, at, absent) if np.isnan(value) else _put_value(out, at, value)
            if at < 0:
                return -1
        at = _put_bytes(out, at, after)
    return at


def _put_hundredths(out: Bytes, at: int, hundredths: np.uint32, is_negative: bool) -> int:  # noqa: FBT001 compiled in
    """Write hundredths below 100 000 without the zeros that say nothing: nearly every level there is.

    What does not belong to the text is written too and then written over, which costs less than a branch.
    """
    out[at] = 45  # minus
    at += 1 if is_negative else 0
    whole = hundredths // np.uint32(100)
    rest = hundredths - whole * np.uint32(100)
    hundreds = whole // np.uint32(100)
    tens = whole - hundreds * np.uint32(100)
    out[at] = _DIGIT + hundreds
    at += 1 if hundreds > np.uint32(0) else 0
    out[at] = _PAIRS[tens, 0]
    at += 1 if whole >= np.uint32(10) else 0
    out[at] = _PAIRS[tens, 1]
    out[at + 1] = 46  # point
    out[at + 2] = _PAIRS[rest, 0]
    out[at + 3] = _PAIRS[rest, 1]
    return at + 1 + int(_DECIMALS_BYTES[rest])


def _put_bytes(out: Bytes, at: int, chunk: Bytes) -> int:
    """Write a fixed piece at a place; return the next place."""
    for byte in chunk:
        out[at] = byte
        at += 1
    return at


def _put_text(out: Bytes, at: int, chunks: Bytes, ends: Positions, which: int | np.int64) -> int:
    """Write one of several pieces that lie one after the other; return the next place."""
    for position in range(ends[which], ends[which + 1]):
        out[at] = chunks[position]
        at += 1
    return at


def _put_value(out: Bytes, at: int, value: np.float32) -> int:
    """Write one finite value at a place; return the next place, -1 when it does not fit the form."""
    size = np.float32(abs(value))
    wide = np.float64(size)
    if np.signbit(value):
        out[at] = 45  # minus
        at += 1
    if wide >= 1e6 or (wide > 0.0 and wide < 1e-3):
        return -1
    decimals = 5
    for limit in (128.0, 1024.0, 8192.0, 131072.0):
        if wide >= limit:
            decimals -= 1
    digits = _rounded(wide * _POWERS[decimals])
    while np.float32(digits / _POWERS[decimals]) != size:
        decimals += 1
        if decimals > 9:
            return -1
        digits = _rounded(wide * _POWERS[decimals])
    while decimals > 0 and digits % 10 == 0:
        digits //= 10
        decimals -= 1
    return _put_decimal(out, at, digits, decimals)


def _rounded(scaled: np.float64) -> np.int64:
    """Return the nearest whole number, the even one of two: the product is exact, so ties are ties."""
    digits = np.int64(scaled + 0.5)
    return digits - 1 if digits - scaled == 0.5 and digits % 2 == 1 else digits


def _put_decimal(out: Bytes, at: int, digits: np.int64, decimals: int) -> int:
    """Write ``digits / 10^decimals`` at a place, from its last digit on; return the next place."""
    length = decimals + 1
    while length < 17 and digits >= _POWERS[length]:
        length += 1
    end = at + length + (1 if decimals > 0 else 0)
    position = end - 1
    for _ in range(decimals):
        out[position] = _DIGIT + digits % 10
        digits //= 10
        position -= 1
    if decimals > 0:
        out[position] = 46  # point
        position -= 1
    while position >= at:
        out[position] = _DIGIT + digits % 10
        digits //= 10
        position -= 1
    return end


def _put_date(date: Bytes, day: np.int64) -> None:
    """Write ``2026-11-21T`` for a day since 1970."""
    # the calendar counts from 0000-03-01, so that the leap day is the last of its year
    shifted = day + 719_468
    era = shifted // 146_097
    day_of_era = shifted - era * 146_097
    year_of_era = (day_of_era - day_of_era // 1460 + day_of_era // 36_524 - day_of_era // 146_096) // 365
    day_of_year = day_of_era - (365 * year_of_era + year_of_era // 4 - year_of_era // 100)
    month_from_march = (5 * day_of_year + 2) // 153
    month = month_from_march + 3 if month_from_march < 10 else month_from_march - 9
    year = year_of_era + era * 400 + (1 if month <= 2 else 0)
    at = _put_pair(date, 0, year // 100)
    at = _put_pair(date, at, year % 100)
    date[at] = 45  # hyphen
    at = _put_pair(date, at + 1, month)
    date[at] = 45
    at = _put_pair(date, at + 1, day_of_year - (153 * month_from_march + 2) // 5 + 1)
    date[at] = 84  # T


def _put_time(out: Bytes, at: int, rest_us: np.int64) -> int:
    """Write ``00:00:00.000000Z`` for the microseconds of a day; return the next place."""
    # divisions of 32 bits cost a third
    second = np.uint32(rest_us // 1_000_000)
    micros = np.uint32(rest_us - second * 1_000_000)
    minute = second // np.uint32(60)
    hour = minute // np.uint32(60)
    at = _put_pair(out, at, hour)
    out[at] = 58  # colon
    at = _put_pair(out, at + 1, minute - hour * np.uint32(60))
    out[at] = 58
    at = _put_pair(out, at + 1, second - minute * np.uint32(60))
    out[at] = 46  # point
    hundreds = micros // np.uint32(100)
    at = _put_pair(out, at + 1, hundreds // np.uint32(100))
    at = _put_pair(out, at, hundreds % np.uint32(100))
    at = _put_pair(out, at, micros - hundreds * np.uint32(100))
    out[at] = 90  # Z
    return at + 1


def _put_pair(out: Bytes, at: int, number: np.int64 | np.uint32) -> int:
    """Write a number below 100 as two digits; return the next place."""
    out[at] = _PAIRS[number, 0]
    out[at + 1] = _PAIRS[number, 1]
    return at + 2


@lru_cache(maxsize=1)
def compiled_fill_rows() -> FillRows:
    """Return ``fill_rows`` compiled; machine code is kept between processes where there is a place for it."""
    from numba.extending import register_jitable

    from service.core.machine_code import compiled

    register_jitable(_put_bytes)
    register_jitable(_put_decimal)
    register_jitable(_put_date)
    register_jitable(inline="always")(_put_pair)
    register_jitable(_put_text)
    register_jitable(_put_time)
    register_jitable(_rounded)
    register_jitable(inline="always")(_put_hundredths)
    register_jitable(_put_value)
    fill: FillRows = compiled(fill_rows)
    return fill


#: rows written at once; room for the text of 32 carriers takes 2 MB
BLOCK_ROWS = 2_500
_compiled = Event()
#: taken for good by the one who compiles
_compiling = Lock()


class RowFrame(NamedTuple):
    """Constant text around epoch and values of a row."""

    before: bytes
    #: possible texts after the epoch
    betweens: tuple[bytes, ...]
    #: before each value
    leads: tuple[bytes, ...]
    #: in place of a value that is absent
    absent: bytes
    after: bytes


class RowText:
    """Writer of rows that keeps its buffer.

    Parameters
    ----------
    kernels : str
        ``numba`` writes in a compiled loop, ``numpy`` without a compiler.
    """

    def __init__(self, kernels: Literal["numba", "numpy"] = "numba") -> None:
        self._fill: Callable[[], FillRows] | None = compiled_fill_rows if kernels == "numba" else None
        self._buffer = np.empty(0, dtype=np.uint8)

    def rows(
        self, epochs_us: Positions, values: NDArray[np.float32], frame: RowFrame, between_of: Positions | None = None
    ) -> bytes:
        """Return the text of rows.

        Parameters
        ----------
        epochs_us : ndarray, shape (T,)
            Microseconds UTC.
        values : ndarray of float32, shape (T, N)
            NaN = absent.
        frame : RowFrame
            Fixed pieces.
        between_of : ndarray, shape (T,), optional
            Position of what stands after the epoch among ``frame.betweens``; None: the first.
        """
        if between_of is None:
            between_of = np.zeros(len(epochs_us), dtype=np.int64)
        parts = [slice(start, start + BLOCK_ROWS) for start in range(0, len(epochs_us), BLOCK_ROWS)]
        return b"".join(self._block(epochs_us[part], values[part], frame, between_of[part]) for part in parts)

    def _block(
        self, epochs_us: Positions, values: NDArray[np.float32], frame: RowFrame, between_of: Positions
    ) -> bytes:
        is_in_calendar = int(epochs_us.min()) >= 0 and int(epochs_us.max()) < LAST_EPOCH_US
        if self._fill is None or not is_in_calendar or np.isinf(values).any():
            return plain_rows(epochs_us, values, frame, between_of)
        leads = b"".join(frame.leads)
        fixed = len(frame.before) + max(map(len, frame.betweens)) + len(leads) + len(frame.after)
        row_bytes = EPOCH_BYTES + fixed + values.shape[1] * max(VALUE_BYTES, len(frame.absent))
        if len(self._buffer) < len(epochs_us) * row_bytes:
            self._buffer = np.empty(len(epochs_us) * row_bytes, dtype=np.uint8)
        written = self._fill()(
            self._buffer,
            # the loop is compiled for arrays of one kind; blocks from a sealed day are read only
            np.require(epochs_us, np.int64, ["C", "W"]),
            np.require(values, np.float32, ["C", "W"]),
            _as_array(frame.before),
            _as_array(b"".join(frame.betweens)),
            _ends(frame.betweens),
            np.require(between_of, np.int64, ["C", "W"]),
            _as_array(leads),
            _ends(frame.leads),
            _as_array(frame.absent),
            _as_array(frame.after),
        )
        return self._buffer[:written].tobytes() if written >= 0 else plain_rows(epochs_us, values, frame, between_of)


def ready_kernels(wanted: Literal["numba", "numpy"]) -> Literal["numba", "numpy"]:
    """Return who writes now: ``numpy`` while a thread, started by the first call, compiles the loop."""
    if wanted == "numba" and not _compiled.is_set():
        if _compiling.acquire(blocking=False):
            Thread(target=_compile, name="row-kernel", daemon=True).start()
        return "numpy"
    return wanted


def _compile() -> None:
    """Compile the loop by writing one row."""
    frame = RowFrame(b"", (b"",), (b",",), b"", b"")
    RowText("numba").rows(np.zeros(1, dtype=np.int64), np.zeros((1, 1), dtype=np.float32), frame)
    _compiled.set()


def _as_array(chunk: bytes) -> NDArray[np.uint8]:
    return np.frombuffer(chunk, dtype=np.uint8)


def _ends(chunks: tuple[bytes, ...]) -> Positions:
    """Return where each piece begins, and where the last one ends, when they lie one after the other."""
    return np.cumsum([0, *map(len, chunks)], dtype=np.int64)


def plain_rows(
    epochs_us: Positions, values: NDArray[np.float32], frame: RowFrame, between_of: Positions | None = None
) -> bytes:
    """Return the text of rows without a compiler.

    Examples
    --------
    >>> frame = RowFrame(b"", (b",sa-1",), (b",", b","), b"", b";")
    >>> plain_rows(np.array([0]), np.array([[-42.1, np.nan]], dtype=np.float32), frame)
    b'1970-01-01T00:00:00.000000Z,sa-1,-42.1,;'
    """
    width = values.shape[1]
    texts = [text.removesuffix(".0").encode() or frame.absent for text in text_of_float32(values)]
    parts: list[bytes] = []
    positions = [0] * len(epochs_us) if between_of is None else between_of.tolist()
    for row, (epoch_us, which) in enumerate(zip(epochs_us.tolist(), positions, strict=True)):
        parts += (frame.before, format_epoch(epoch_us).encode(), frame.betweens[which])
        for lead, text in zip(frame.leads, texts[row * width : (row + 1) * width], strict=True):
            parts += (lead, text)
        parts.append(frame.after)
    return b"".join(parts)
