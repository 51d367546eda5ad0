"""Rows of float32 values as text for CSV and NDJSON: epoch, values, fixed pieces around them.

Two ways to the same text: a compiled loop (11 ns a value) and numpy with Python (400 ns). A block that holds what the
loop cannot write, such as 1e-05, goes the other way, and nobody can tell. A service never compiles within a request:
until a thread has compiled the loop, which takes seconds and longer on a busy machine, exports go the other way.
"""

from collections.abc import Callable
from threading import Event, Lock, Thread
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.formats.numbers import text_of_float32
from service.formats.tabular.row_kernel import (
    EPOCH_BYTES,
    LAST_EPOCH_US,
    VALUE_BYTES,
    FillRows,
    Positions,
    compiled_fill_rows,
)
from service.records.epoch import format_epoch

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
