"""Rows of a window as a calibration reads them: rows closer than twenty seconds become means of a minute.

A calibration averages stretches of ten minutes anyway, and its noise model begins at correlation times of five: more
than a row a minute costs memory and time in every step and tells nothing more. Rows further apart stay as they are,
bit for bit. The law of this file: what is held beside the result does not grow with the window.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.calibration_bins import Stretches, stretch_means
from service.records.calibration import CalibrationRequest
from service.records.epoch import US_PER_S
from service.records.inputs import Operation
from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.measurement import MeasurementSeries

#: rows with a smaller median distance are averaged, us
CLOSE_US = 20 * US_PER_S
_MINUTE_US = 60 * US_PER_S
#: rows that are averaged at once
_ROWS_AT_ONCE = 1024


class MinuteRows(NamedTuple):
    """Rows of a window, T of them, in order of epoch."""

    #: mean epoch and mean power of each row's measurements, impulses left out
    series: MeasurementSeries
    #: (T,) measurements in each row; 1 = the row is the measurement
    measurements: IntArray
    #: (T, N) dBm, first measurement of each row: a mean does not show the steps of an analyzer
    first_dbm: FloatArray

    @property
    def usual_measurements(self) -> float:
        """Measurements in a usual row."""
        return float(np.median(self.measurements)) if len(self.measurements) else 1.0


class _Rows(NamedTuple):
    """Some rows: epochs (T,), powers (T, N)."""

    epochs_us: IntArray
    power_dbm: FloatArray


def mean_edges_us(request: CalibrationRequest, operations: Iterable[Operation]) -> tuple[int, ...]:
    """Return the epochs that no mean of a calibration reaches across: ends of its windows and of operations."""
    spans = [(window.start_us, window.stop_us) for window in (request.quiet, request.turns)]
    spans += [(each.start_us, each.start_us if each.stop_us is None else each.stop_us) for each in operations]
    return tuple(epoch_us for span in spans for epoch_us in span)


def minute_rows(
    parts: Iterable[MeasurementSeries], carrier_ids: tuple[str, ...], edges_us: Sequence[int]
) -> MinuteRows:
    """Return the rows of a window for a calibration.

    Parameters
    ----------
    parts : iterable of MeasurementSeries
        Measurements of the carriers, in order of epoch within and across parts.
    carrier_ids : tuple of str
        The carriers.
    edges_us : sequence of int
        Epochs that no mean reaches across: ends of windows, of declared operations.
    """
    empty = _Rows(np.zeros(0, dtype=np.int64), np.zeros((0, len(carrier_ids))))
    edges = np.unique(np.array(edges_us, dtype=np.int64))
    found = [(empty, empty.epochs_us, empty.power_dbm), *_read(parts, edges)]
    rows, counts, first_dbm = zip(*found, strict=True)
    series = MeasurementSeries(carrier_ids, *(np.concatenate(arrays) for arrays in zip(*rows, strict=True)))
    return MinuteRows(series, np.concatenate(counts), np.concatenate(first_dbm))


def _read(parts: Iterable[MeasurementSeries], edges_us: IntArray) -> Iterator[tuple[_Rows, IntArray, FloatArray]]:
    """Yield rows, how many measurements each holds, and the first of them."""
    rest: list[_Rows] = []
    for page in _pages(parts):
        rows = _joined([*rest, page])
        whole = _whole(rows.epochs_us, edges_us)
        if whole:
            yield _averaged(_Rows(rows.epochs_us[:whole], rows.power_dbm[:whole]), edges_us)
        rest = [_Rows(rows.epochs_us[whole:], rows.power_dbm[whole:])]
    if rest and len(rest[0].epochs_us):
        yield _averaged(rest[0], edges_us)


def _pages(parts: Iterable[MeasurementSeries]) -> Iterator[_Rows]:
    """Yield the rows by equal numbers, so that it tells nothing where parts of the archive end."""
    kept, count = [], 0
    for part in parts:
        start = 0
        while start < len(part.epochs_us):
            stop = start + _ROWS_AT_ONCE - count
            kept.append(_Rows(part.epochs_us[start:stop], part.power_dbm[start:stop]))
            count += len(kept[-1].epochs_us)
            start = stop
            if count == _ROWS_AT_ONCE:
                yield _joined(kept)
                kept, count = [], 0
    if kept:
        yield _joined(kept)


def _joined(parts: list[_Rows]) -> _Rows:
    return _Rows(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _are_close(epochs_us: IntArray) -> bool:
    """Return whether rows (T,) are to be averaged."""
    return len(epochs_us) > 1 and float(np.median(np.diff(epochs_us))) < CLOSE_US


def _starts(epochs_us: IntArray, edges_us: IntArray) -> IntArray:
    """Return where the minutes of rows (T,) begin; an edge begins one too."""
    minute = epochs_us // _MINUTE_US
    span = np.searchsorted(edges_us, epochs_us, side="right")
    is_new = (np.diff(minute) != 0) | (np.diff(span) != 0)
    return np.concatenate([[0], 1 + np.flatnonzero(is_new)]).astype(np.int64)


def _whole(epochs_us: IntArray, edges_us: IntArray) -> int:
    """Return how many rows (T,) belong to minutes of which all rows are there."""
    return int(_starts(epochs_us, edges_us)[-1]) if _are_close(epochs_us) else len(epochs_us)


def _averaged(rows: _Rows, edges_us: IntArray) -> tuple[_Rows, IntArray, FloatArray]:
    """Return some rows, averaged if they are close."""
    if not _are_close(rows.epochs_us):
        return rows, np.ones(len(rows.epochs_us), dtype=np.int64), rows.power_dbm
    starts = _starts(rows.epochs_us, edges_us)
    counts = np.diff(starts, append=len(rows.epochs_us))
    steps = np.arange(counts.max())
    gathered = starts[:, np.newaxis] + np.minimum(steps, counts[:, np.newaxis] - 1)
    stretches = Stretches(gathered, steps < counts[:, np.newaxis])
    means = stretch_means(stretches, rows.power_dbm, np.zeros((*rows.power_dbm.shape, 0)))
    power_dbm = np.where(means.rows_used > 0, means.power_db, np.nan).T
    # relative to the first, whose sum over a minute stays far below the digits of an integer
    offsets_us = rows.epochs_us - np.repeat(rows.epochs_us[starts], counts)
    epochs_us = rows.epochs_us[starts] + np.add.reduceat(offsets_us, starts) // counts
    return _Rows(epochs_us, power_dbm), counts, rows.power_dbm[starts]
