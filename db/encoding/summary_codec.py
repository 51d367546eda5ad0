"""Summaries of a day as bytes: the day, its hours, minutes where rows are dense, and the rows that split a bucket.

An interval of a chart ends where it ends, in the middle of an hour. What lies on either side of it is told by the rows
of that hour, or of that minute, alone: the sampled columns are stored once more, a frame of its own for each of the
narrowest buckets. An interval then costs the same however much there is around it. Every frame carries the checksum of
zstd; a frame that differs from it is a ValueError.
"""

import struct
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from service.core.rows import NEVER_US, Summaries
from service.records.epoch import US_PER_S
from service.records.levels.attitude import IntArray

HOUR_US, MINUTE_US = 3600 * US_PER_S, 60 * US_PER_S
#: rows closer than this, by their median, get minutes too
DENSE_US = 20 * US_PER_S
_LEVEL = 3
#: buckets, columns, step of the values (0 = doubles)
_LEVEL_SHAPE = struct.Struct("<2qd")
#: rows, columns, bytes of a value
_ROWS_SHAPE = struct.Struct("<3q")


class SummaryBlobs(NamedTuple):
    """Summaries of one day as they are stored; frames stand one after another."""

    day: bytes
    hours: bytes
    #: of the minutes, a frame an hour; None where an hour is the narrowest bucket
    minute_frames: bytes | None
    #: a frame for each of the narrowest buckets
    row_frames: bytes


class Level(NamedTuple):
    """Buckets, and where the frame of each begins and how long it is, bytes."""

    buckets: Summaries
    starts: IntArray
    sizes: IntArray


class FrameRows(NamedTuple):
    """Rows of a narrowest bucket: (T,) microseconds UTC and (T, C) values."""

    epochs_us: IntArray
    values: NDArray[np.floating]


def pack_day(epochs_us: IntArray, values: NDArray[np.floating], row_columns: int) -> SummaryBlobs:
    """Return the summaries of the rows of a day.

    Parameters
    ----------
    epochs_us : ndarray, shape (T,)
        Ascending, T > 0.
    values : ndarray, shape (T, C)
        NaN = absent.
    row_columns : int
        Columns that are sampled in intervals of any length: the first ones; 0 = none, no rows are kept.
    """
    has_minutes = is_dense(epochs_us)
    owners = epochs_us // (MINUTE_US if has_minutes else HOUR_US)
    frames = [_pack_rows(epochs_us[part], values[part, :row_columns]) if row_columns else b"" for part in _runs(owners)]
    level = _over(Summaries.of_rows(epochs_us, values).gathered(owners), frames)
    return _pack_levels(level, b"".join(frames), 0.0, has_minutes=has_minutes)


def pack_buckets(minutes: Summaries, step: float, *, has_minutes: bool) -> SummaryBlobs:
    """Return the summaries of a day, without rows, from those of its minutes; values are multiples of a step."""
    buckets = minutes if has_minutes else minutes.gathered(minutes.first_us // HOUR_US)
    return _pack_levels(_over(buckets, [b""] * len(buckets.first_us)), b"", step, has_minutes=has_minutes)


def is_dense(epochs_us: IntArray) -> bool:
    """Return whether the rows of a day get minutes."""
    return len(epochs_us) > 1 and float(np.median(np.diff(epochs_us))) < DENSE_US


def _pack_levels(level: Level, row_frames: bytes, step: float, *, has_minutes: bool) -> SummaryBlobs:
    """Return the narrowest buckets and those above them."""
    minute_frames = None
    if has_minutes:
        hours = level.buckets.first_us // HOUR_US
        frames = [_pack_level(_part(level, part), step) for part in _runs(hours)]
        level, minute_frames = _over(level.buckets.gathered(hours), frames), b"".join(frames)
    day = level.buckets.gathered(np.zeros(len(level.starts), dtype=np.int64))
    return SummaryBlobs(_pack_level(_over(day, [b""]), step), _pack_level(level, step), minute_frames, row_frames)


def unpack_level(blob: bytes) -> Level:
    """Return buckets; ValueError when they are damaged."""
    raw = _unpacked(blob)
    count, columns, step = _LEVEL_SHAPE.unpack_from(raw)
    words = _unshuffled(raw[_LEVEL_SHAPE.size :])
    if len(words) != count * (4 + 6 * columns):
        message = f"{len(words)} values where {count} buckets of {columns} columns belong"
        raise ValueError(message)
    first_us, length_us, starts, sizes = words[: 4 * count].reshape(4, count)
    first_us, starts = np.cumsum(first_us), np.cumsum(starts)
    integers = words[4 * count :].reshape(6, columns, count).transpose(0, 2, 1)
    counts, minimum_us, maximum_us = integers[:3]
    is_held = counts > 0
    sums, minima, maxima = integers[3:] * step if step else integers[3:].view("<f8")
    buckets = Summaries(
        first_us,
        first_us + length_us,
        counts,
        sums,
        np.where(is_held, minima, np.inf),
        np.where(is_held, maxima, -np.inf),
        np.where(is_held, first_us[:, None] + minimum_us, NEVER_US),
        np.where(is_held, first_us[:, None] + maximum_us, NEVER_US),
    )
    return Level(buckets, starts, sizes)


def unpack_rows(blob: bytes) -> FrameRows:
    """Return the rows of a narrowest bucket; ValueError when they are damaged."""
    raw = _unpacked(blob)
    count, columns, width = _ROWS_SHAPE.unpack_from(raw)
    stop = _ROWS_SHAPE.size + 8 * count
    epochs_us = np.cumsum(_unshuffled(raw[_ROWS_SHAPE.size : stop]))
    values = _unshuffled(raw[stop:], width).view(f"<f{width}")
    return FrameRows(epochs_us, values.reshape(columns, count).T)


def _runs(owners: IntArray) -> list[slice]:
    bounds = [0, *(np.flatnonzero(np.diff(owners)) + 1).tolist(), len(owners)]
    return [slice(start, stop) for start, stop in pairwise(bounds)]


def _over(buckets: Summaries, frames: Sequence[bytes]) -> Level:
    sizes = np.array([len(frame) for frame in frames], dtype=np.int64)
    return Level(buckets, np.cumsum(sizes) - sizes, sizes)


def _part(level: Level, part: slice) -> Level:
    return Level(level.buckets.at(part), level.starts[part], level.sizes[part])


def _pack_level(level: Level, step: float) -> bytes:
    """Return buckets as bytes: small differences where numbers grow, equal bytes of all numbers together."""
    buckets, first_us = level.buckets, level.buckets.first_us
    is_held = buckets.counts > 0
    epochs_us = [np.where(is_held, each - first_us[:, None], 0) for each in (buckets.minimum_us, buckets.maximum_us)]
    values = [np.where(is_held, each, 0.0) for each in (buckets.sums, buckets.minima, buckets.maxima)]
    words = [np.rint(each / step).astype("<i8") if step else each.astype("<f8").view("<i8") for each in values]
    ones = [np.diff(first_us, prepend=0), buckets.last_us - first_us, np.diff(level.starts, prepend=0), level.sizes]
    columns = [each.T.ravel() for each in (buckets.counts, *epochs_us, *words)]
    return _packed(_LEVEL_SHAPE.pack(*buckets.counts.shape, step) + _shuffled(np.concatenate((*ones, *columns))))


def _pack_rows(epochs_us: IntArray, values: NDArray[np.floating]) -> bytes:
    width = values.dtype.itemsize
    columns = np.ascontiguousarray(values.T, dtype=f"<f{width}")
    shape = _ROWS_SHAPE.pack(*values.shape, width)
    return _packed(shape + _shuffled(np.diff(epochs_us, prepend=0)) + _shuffled(columns))


def _shuffled(values: NDArray[np.generic]) -> bytes:
    """Return the first bytes of all values, then the second ones, and so on."""
    width = values.dtype.itemsize
    return np.ascontiguousarray(values).view(np.uint8).reshape(-1, width).T.tobytes()


def _unshuffled(raw: bytes, width: int = 8) -> IntArray:
    """Return the values that bytes were made of, as integers of a width."""
    planes = np.frombuffer(raw, dtype=np.uint8).reshape(width, -1)
    integers: IntArray = np.ascontiguousarray(planes.T).view(f"<i{width}").ravel()
    return integers


def _packed(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(raw)


def _unpacked(blob: bytes) -> bytes:
    try:
        return zstandard.ZstdDecompressor().decompress(blob)
    except (zstandard.ZstdError, MemoryError) as fault:
        # a damaged size may be larger than any memory
        raise ValueError(str(fault)) from fault
