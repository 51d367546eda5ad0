"""Summaries of sealed rows: bins of an hour, and of a minute where rows are dense, of every column that is sampled.

Bins are made with their segment, in the transaction that writes it, and go with it. Of each there is how many rows hold
a value, the sum, the least and the greatest value and the epochs of these, one Parquet blob for the columns of a
quantity. A segment is read as its longest bins that lie within one interval each; where none do, as rows.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, func, select

from db.database import Database
from db.encoding.column_blob import ColumnBlob, arrow, pack_columns
from db.encoding.segments import DAY_US, SegmentHead, day_of, heads
from db.schema.columns import agrees
from db.schema.tables import summary
from service.core.arrays import IntArray
from service.core.rows import NEVER_US, Summaries, joined
from service.ports.archive import Intervals
from service.records.calibration import Window
from service.records.epoch import US_PER_S

_LOG = logging.getLogger(__name__)
HOUR_S, MINUTE_S = 3600, 60
#: rows closer than this, by their median, get minutes too
DENSE_US = 20 * US_PER_S
#: blobs by quantity and length of a bin, s
Bins = Mapping[tuple[str, int], bytes]
Conditions = Sequence[ColumnElement[bool]]
#: days that one read transaction looks at
_SEASON_US = 128 * DAY_US


def bins_of(quantity: str, epochs_us: IntArray, values: NDArray[np.floating]) -> dict[tuple[str, int], bytes]:
    """Return the bins of rows.

    Parameters
    ----------
    quantity : str
        Name of the columns.
    epochs_us : ndarray, shape (T,)
        Ascending.
    values : ndarray, shape (T, C)
        NaN = absent.
    """
    if not len(epochs_us):
        return dict.fromkeys(((quantity, HOUR_S), (quantity, MINUTE_S)), b"")
    is_dense = len(epochs_us) > 1 and float(np.median(np.diff(epochs_us))) < DENSE_US
    bins, made = Summaries.of_rows(epochs_us, values), {}
    is_empty = bool(np.isnan(values).all())
    for bin_s in (MINUTE_S, HOUR_S) if is_dense else (HOUR_S,):
        bins = bins.gathered(bins.first_us // (bin_s * US_PER_S))
        # without a value no byte, which says that rows need not be read
        made[quantity, bin_s] = b"" if is_empty else _blob(bins, bin_s * US_PER_S)
    return made


def _blob(bins: Summaries, bin_us: int) -> bytes:
    """Return bins as a blob, a row for each bin of each column."""
    pa = arrow()
    starts_us = bins.first_us // bin_us * bin_us
    is_held = bins.counts > 0
    count, columns = bins.counts.shape

    def flat(values: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(values.T).ravel()

    least_us, greatest_us = (
        pa.array(flat(np.where(is_held, each - starts_us[:, None], 0))).dictionary_encode()
        for each in (bins.minimum_us, bins.maximum_us)
    )
    least, greatest = (flat(np.where(is_held, each, np.nan)) for each in (bins.minima, bins.maxima))
    return pack_columns(
        {
            "column": np.repeat(np.arange(columns), count),
            "start_us": np.tile(starts_us, columns),
            "rows": flat(bins.counts),
            "sum": flat(bins.sums),
            "least": least,
            "greatest": greatest,
            "least_us": least_us,
            "greatest_us": greatest_us,
        }
    )


def bins_from(blob: bytes, bin_s: int) -> Summaries:
    """Return the bins of a blob; ValueError where it holds none."""
    held = ColumnBlob(blob)
    column, starts_us, counts, sums = held.whole("column", "start_us", "rows", "sum")
    least, greatest, least_us, greatest_us = held.whole("least", "greatest", "least_us", "greatest_us")
    columns = int(column[-1]) + 1 if len(column) else 0
    if not columns or len(column) % columns:
        message = f"{len(column)} bins of {columns} columns"
        raise ValueError(message)
    counts, sums, least, greatest, least_us, greatest_us = (
        each.reshape(columns, -1).T for each in (counts, sums, least, greatest, least_us, greatest_us)
    )
    first_us, is_held = starts_us[: len(counts)], counts > 0
    return Summaries(
        first_us,
        first_us + bin_s * US_PER_S - 1,
        counts,
        sums,
        np.where(is_held, least, np.inf),
        np.where(is_held, greatest, -np.inf),
        np.where(is_held, first_us[:, None] + least_us, NEVER_US),
        np.where(is_held, first_us[:, None] + greatest_us, NEVER_US),
    )


def stored_blobs(connection: Connection, ids: Sequence[int], quantity: str, bin_s: int) -> dict[int, bytes]:
    """Return the blobs of segments by id; what is missing or damaged is not among them: its rows are still there."""
    found: dict[int, bytes] = {}
    is_one = summary.c.segment_id.in_(ids)
    query = select(summary).where(is_one, summary.c.quantity == quantity, summary.c.bin_s == bin_s)
    for row in connection.execute(query):
        if agrees(summary, row):
            found[row.segment_id] = row.content
        else:
            _warn(row.segment_id, "its checksum differs from its content")
    return found


def bins_within(
    connection: Connection, heads: Sequence[SegmentHead], quantity: str, intervals: Intervals, columns: slice
) -> tuple[Summaries | None, list[SegmentHead]]:
    """Return columns of segments in bins that lie within one interval each, and the segments to be read as rows."""
    parts: list[Summaries] = []
    rest = list(heads)
    for bin_s in (HOUR_S, MINUTE_S):
        fitting = [head.segment_id for head in rest if _fits(head, intervals, bin_s * US_PER_S)]
        read = set()
        for name, blob in stored_blobs(connection, fitting, quantity, bin_s).items():
            try:
                bins = bins_from(blob, bin_s) if blob else None
            except ValueError as fault:
                _warn(name, str(fault))
                continue
            read.add(name)
            if bins is not None:
                parts.append(bins.columns(columns))
        rest = [head for head in rest if head.segment_id not in read]
    return joined(parts) if parts else None, rest


def seasons(
    database: Database, window: Window, next_us: Callable[[Connection, int], int | None]
) -> Iterator[tuple[Connection, Window]]:
    """Yield parts of a window that hold rows, whole days but for its ends, each with a read transaction.

    A row is sealed or not within one transaction, and never leaves its day: each is counted once. ``next_us`` gives an
    epoch up to which no row lies from the given one on, None where none follows.
    """
    epoch_us: int | None = window.start_us
    while epoch_us is not None and epoch_us < window.stop_us:
        with database.read() as connection:
            epoch_us = next_us(connection, epoch_us)
            if epoch_us is None or epoch_us >= window.stop_us:
                return
            stop_us = min(window.stop_us, day_of(epoch_us) * DAY_US + _SEASON_US)
            yield connection, Window(epoch_us, stop_us)
        epoch_us = stop_us


def next_row_us(
    connection: Connection, column: ColumnElement[int], rows: Conditions, segments: Conditions, epoch_us: int
) -> int | None:
    """Return an epoch up to which no row lies from the given one on; None where none follows.

    Parameters
    ----------
    column : ColumnElement
        Epochs of the table of rows.
    rows, segments : sequence of conditions
        Of what is looked for.
    """
    first_us = connection.scalar(select(func.min(column)).where(*rows, column >= epoch_us))
    head = next(heads(connection, segments, epoch_us, 1 << 62), None)
    found = [first_us, None if head is None else head.first_epoch_us]
    return min((max(each, epoch_us) for each in found if each is not None), default=None)


def _fits(head: SegmentHead, intervals: Intervals, bin_us: int) -> bool:
    """Return whether every bin of a segment lies within one interval."""
    starts_us = np.arange(head.first_epoch_us // bin_us, head.last_epoch_us // bin_us + 1) * bin_us
    first_us = np.maximum(starts_us, head.first_epoch_us)
    return bool(intervals.hold(first_us, np.minimum(starts_us + bin_us - 1, head.last_epoch_us)).all())


def _warn(segment_id: int, reason: str) -> None:
    _LOG.warning(
        "a summary of segment %d is damaged, rows are read in its place; `soo doctor` tells more: %s",
        segment_id,
        reason,
    )


def differences(stored: bytes, made: bytes) -> Iterator[str]:
    """Yield the columns of a blob that are not those made again; sums to rounding."""
    if not stored or not made:
        yield from [] if stored == made else ["rows"]
        return
    try:
        one, other = ColumnBlob(stored), ColumnBlob(made)
        if (one.names, one.count) != (other.names, other.count):
            yield "rows"
            return
        for name in one.names:
            held, again = (np.array(each.values(name, slice(None))) for each in (one, other))
            is_sum = held.dtype.kind == "f" and again.dtype.kind == "f"
            if not (np.allclose(held, again, 1e-9, 1e-9, equal_nan=True) if is_sum else np.array_equal(held, again)):
                yield name
    except ValueError as fault:
        yield str(fault)
