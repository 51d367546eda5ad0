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

from service.core.rows.summaries import Summaries
from service.records.epoch import US_PER_S
from service.records.levels.attitude import IntArray

HOUR_US, MINUTE_US = 3600 * US_PER_S, 60 * US_PER_S
#: rows closer than this, by their median, get minutes too
DENSE_US = 20 * US_PER_S
_LEVEL = 3
_SHAPE = struct.Struct("<3q")


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
        Columns that are sampled in intervals of any length: the first ones.
    """
    is_dense = len(epochs_us) > 1 and float(np.median(np.diff(epochs_us))) < DENSE_US
    owners = epochs_us // (MINUTE_US if is_dense else HOUR_US)
    frames = [_pack_rows(epochs_us[part], values[part, :row_columns]) for part in _runs(owners)]
    level = _over(Summaries.of_rows(epochs_us, values).gathered(owners), frames)
    minute_frames = None
    row_frames = b"".join(frames)
    if is_dense:
        hours = level.buckets.first_us // HOUR_US
        frames = [_pack_level(_part(level, part)) for part in _runs(hours)]
        level, minute_frames = _over(level.buckets.gathered(hours), frames), b"".join(frames)
    day = level.buckets.gathered(np.zeros(len(level.starts), dtype=np.int64))
    return SummaryBlobs(_pack_level(_over(day, [b""])), _pack_level(level), minute_frames, row_frames)


def unpack_level(blob: bytes) -> Level:
    """Return buckets; ValueError when they are damaged."""
    raw = _unpacked(blob)
    count, columns, _ = _SHAPE.unpack_from(raw)
    words = np.frombuffer(raw, dtype="<i8", offset=_SHAPE.size)
    if len(words) != count * (4 + 6 * columns):
        message = f"{len(words)} values where {count} buckets of {columns} columns belong"
        raise ValueError(message)
    first_us, last_us, starts, sizes = words[: 4 * count].reshape(4, count)
    integers = words[4 * count :].reshape(6, count, columns)
    figures = integers.view("<f8")
    counts, _, _, _, minimum_us, maximum_us = integers
    return Level(
        Summaries(first_us, last_us, counts, figures[1], figures[2], figures[3], minimum_us, maximum_us), starts, sizes
    )


def unpack_rows(blob: bytes) -> FrameRows:
    """Return the rows of a narrowest bucket; ValueError when they are damaged."""
    raw = _unpacked(blob)
    count, columns, width = _SHAPE.unpack_from(raw)
    epochs_us = np.cumsum(np.frombuffer(raw, dtype="<i8", count=count, offset=_SHAPE.size))
    values = np.frombuffer(raw, dtype=f"<f{width}", offset=_SHAPE.size + 8 * count)
    return FrameRows(epochs_us, values.reshape(columns, count).T)


def _runs(owners: IntArray) -> list[slice]:
    bounds = [0, *(np.flatnonzero(np.diff(owners)) + 1).tolist(), len(owners)]
    return [slice(start, stop) for start, stop in pairwise(bounds)]


def _over(buckets: Summaries, frames: Sequence[bytes]) -> Level:
    sizes = np.array([len(frame) for frame in frames], dtype=np.int64)
    return Level(buckets, np.cumsum(sizes) - sizes, sizes)


def _part(level: Level, part: slice) -> Level:
    return Level(level.buckets.at(part), level.starts[part], level.sizes[part])


def _pack_level(level: Level) -> bytes:
    buckets = level.buckets
    ones = (buckets.first_us, buckets.last_us, level.starts, level.sizes)
    parts = [array.astype("<i8") for array in ones] + [
        array.astype("<f8" if array.dtype.kind == "f" else "<i8") for array in buckets[2:]
    ]
    return _packed(_SHAPE.pack(*buckets.counts.shape, 8) + b"".join(part.tobytes() for part in parts))


def _pack_rows(epochs_us: IntArray, values: NDArray[np.floating]) -> bytes:
    steps = np.diff(epochs_us, prepend=0).astype("<i8")
    width = values.dtype.itemsize
    columns = np.ascontiguousarray(values.T, dtype=f"<f{width}")
    return _packed(_SHAPE.pack(*values.shape, width) + steps.tobytes() + columns.tobytes())


def _packed(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=_LEVEL, write_checksum=True).compress(raw)


def _unpacked(blob: bytes) -> bytes:
    try:
        return zstandard.ZstdDecompressor().decompress(blob)
    except (zstandard.ZstdError, MemoryError) as fault:
        # a damaged size may be larger than any memory
        raise ValueError(str(fault)) from fault
