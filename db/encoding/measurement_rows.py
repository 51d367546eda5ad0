"""Rows of measurements as the table of rows holds them, and the records made of them.

Powers are float32 LE of each carrier, every NaN the same NaN; flags are int32 LE, no byte where none is set; the
figures of details are float32 LE, one kind after another. A row that states no flags or no details has NULL.

Rows of several sources and segments are brought in order here: as runs of one piece, and as blocks.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from service.ports.archive import Cursor
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import (
    DETAIL_NAMES,
    CarrierDetails,
    Float32Array,
    Measurement,
    MeasurementBlock,
    QualityFlag,
)

#: powers, flags and figures of one row
StoredArrays = tuple[bytes, bytes | None, bytes | None]


def stored_arrays(
    power_dbm: Float32Array, flags: Sequence[Sequence[int] | IntArray | None], details: Float32Array | None
) -> list[StoredArrays]:
    """Return the arrays of rows as bytes.

    Parameters
    ----------
    power_dbm : ndarray, shape (T, N)
        dBm, NaN = absent.
    flags : sequence of sequences of int
        Bit masks of each row, None = none stated.
    details : ndarray, shape (T, K, N), or None
        Figures of DETAIL_NAMES, NaN = not stated.
    """
    powers = _cut(canonical(power_dbm))
    masks: list[bytes | None] = [
        None if row is None else np.array(row, dtype="<i4").tobytes() if any(row) else b"" for row in flags
    ]
    figures: list[bytes | None] = [None] * len(powers)
    if details is not None:
        is_stated: NDArray[np.bool_] = np.any(~np.isnan(details), axis=(1, 2))
        parts = zip(is_stated.tolist(), _cut(canonical(details)), strict=True)
        figures = [part if is_known else None for is_known, part in parts]
    return list(zip(powers, masks, figures, strict=True))


def canonical(figures: NDArray[np.floating]) -> Float32Array:
    """Return figures as float32 little endian in a block of their own, every NaN the same NaN."""
    copied: Float32Array = np.array(figures, dtype="<f4", order="C")
    copied[np.isnan(copied)] = np.nan
    return copied


def _cut(rows: Float32Array) -> list[bytes]:
    whole, width = rows.tobytes(), rows.nbytes // max(len(rows), 1)
    return [whole[position * width : (position + 1) * width] for position in range(len(rows))]


def powers_of(blobs: Sequence[bytes]) -> Float32Array:
    """Return the powers of rows of one carrier plan, (T, N) dBm, bit for bit what was stored, read-only."""
    return np.frombuffer(b"".join(blobs), dtype="<f4").reshape(len(blobs), len(blobs[0]) // 4)


def details_of(blobs: Sequence[bytes | None], carriers: int) -> Float32Array:
    """Return the figures of details of rows of one carrier plan, (T, K, N), NaN = not stated, read-only."""
    shape = (len(DETAIL_NAMES), carriers)
    blank = np.full(shape, np.nan, dtype="<f4").tobytes()
    return np.frombuffer(b"".join(each or blank for each in blobs), dtype="<f4").reshape(len(blobs), *shape)


def measurement_of(row: Sequence[Any], source: str) -> Measurement:
    """Return the record of a row of the table of measurements, all of its columns in their order."""
    _, epoch_us, _, number, plan_id, seq, delay_us, is_late, feeds, powers, flags, figures, *_ = tuple(row)
    power_dbm = _read_only(powers_of([powers])[0].astype(np.float64))
    details = None
    if figures is not None:
        details = CarrierDetails(*_read_only(details_of([figures], len(power_dbm))[0].astype(np.float64)))
    masks = None if flags is None else _read_only(masks_of(flags, len(power_dbm)))
    return Measurement(
        epoch_us, epoch_us + delay_us, number, source, plan_id, power_dbm, masks, is_late, feeds, seq, details
    )


def masks_of(flags: bytes, carriers: int) -> IntArray:
    """Return the bit masks of one row, (N,)."""
    return np.frombuffer(flags or bytes(4 * carriers), dtype="<i4").astype(np.int64)


class RowContent(NamedTuple):
    """Plan, powers, flags and details of one row, equal for equal content; a sign of zero does not count."""

    plan_id: int
    powers: bytes
    flags: bytes | None
    figures: bytes | None

    @property
    def is_leap(self) -> bool:
        """True for a row measured within a leap second, or moved because of one."""
        return bool(np.any(np.frombuffer(self.flags or b"", dtype="<i4") & QualityFlag.LEAP_SECOND))

    def in_leap_second(self) -> "RowContent":
        """Return the content with the flag LEAP_SECOND on every carrier."""
        masks = masks_of(self.flags or b"", len(self.powers) // 4) | QualityFlag.LEAP_SECOND
        return self._replace(flags=masks.astype("<i4").tobytes())


def row_content(plan_id: int, stored: StoredArrays) -> RowContent:
    """Return the content of a row."""
    powers, flags, figures = stored
    return RowContent(plan_id, _unsigned(powers), flags, None if figures is None else _unsigned(figures))


def _unsigned(figures: bytes) -> bytes:
    return (np.frombuffer(figures, dtype="<f4") + np.float32(0.0)).tobytes()


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    values.setflags(write=False)
    return values


#: rows of a run from which on a run is told as it lies, mean of a page
_LONG_RUN = 64


class Chunk(Protocol):
    """Rows of one source under one plan."""

    source: str
    plan_id: int
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T,) journal numbers
    numbers: IntArray
    #: (T,) microseconds UTC
    received_at_us: IntArray

    def power_dbm(self) -> Float32Array:
        """Return the powers as stored, (T, N) dBm."""

    def records(self, positions: IntArray) -> list[Measurement]:
        """Return the rows at some places."""


class ChunkRun(NamedTuple):
    """Rows of one piece that follow each other in the order of epochs."""

    chunk: Chunk
    #: (n,) places within the piece
    positions: IntArray

    @property
    def end(self) -> Cursor:
        """Return the cursor behind the last row."""
        return int(self.chunk.epochs_us[self.positions[-1]]), int(self.chunk.numbers[self.positions[-1]])

    def records(self) -> list[Measurement]:
        """Return the rows."""
        return self.chunk.records(self.positions)

    def power_dbm(self) -> Float32Array:
        """Return the powers of the rows, (n, N) dBm."""
        first, last = int(self.positions[0]), int(self.positions[-1])
        held = self.chunk.power_dbm()
        # nearly always the rows lie side by side: nothing is copied
        return held[first : last + 1] if last - first + 1 == len(self.positions) else held[self.positions]

    def block(self) -> MeasurementBlock:
        """Return the rows as arrays."""
        return _block((self.chunk.source,), self.chunk, self.chunk.epochs_us[self.positions], self.power_dbm(), None)


class OrderedRows:
    """The first rows of several pieces in order of (epoch, number).

    Parameters
    ----------
    parts : sequence of Run
        Rows of each piece, in order of epoch.
    limit : int
        How many rows.
    """

    def __init__(self, parts: Sequence[ChunkRun], limit: int) -> None:
        self._parts = parts
        epochs_us = np.concatenate([chunk.epochs_us[positions] for chunk, positions in parts])
        numbers = np.concatenate([chunk.numbers[positions] for chunk, positions in parts])
        order = np.lexsort((numbers, epochs_us))[:limit]
        self._owners = np.repeat(np.arange(len(parts)), [len(positions) for _, positions in parts])[order]
        self._positions: IntArray = np.concatenate([positions for _, positions in parts])[order]
        self._breaks = np.flatnonzero(np.diff(self._owners)) + 1

    def runs(self) -> list[ChunkRun]:
        """Return the rows as runs."""
        bounds = [0, *self._breaks.tolist(), len(self._owners)]
        return [self._run(start, stop) for start, stop in pairwise(bounds)]

    def blocks(self) -> list[MeasurementBlock]:
        """Return the rows as blocks."""
        if len(self._breaks) * _LONG_RUN <= len(self._owners):
            return [run.block() for run in self.runs()]
        plans = np.array([chunk.plan_id for chunk, _ in self._parts])[self._owners]
        bounds = [0, *(np.flatnonzero(np.diff(plans)) + 1).tolist(), len(plans)]
        return [self._mixed(start, stop) for start, stop in pairwise(bounds)]

    @property
    def end(self) -> Cursor:
        """Return the cursor behind the last row."""
        return self._run(len(self._owners) - 1, len(self._owners)).end

    def _run(self, start: int, stop: int) -> ChunkRun:
        return ChunkRun(self._parts[self._owners[start]].chunk, self._positions[start:stop])

    def _mixed(self, start: int, stop: int) -> MeasurementBlock:
        """Return rows of several pieces under one plan."""
        owners, positions = self._owners[start:stop], self._positions[start:stop]
        chunks = {owner: self._parts[owner].chunk for owner in np.unique(owners).tolist()}
        sources = tuple(dict.fromkeys(chunk.source for chunk in chunks.values()))
        first = self._parts[owners[0]].chunk
        epochs_us, source_positions = np.empty((2, stop - start), dtype=np.int64)
        power_dbm = np.empty((stop - start, first.power_dbm().shape[1]), dtype=np.float32)
        for owner, chunk in chunks.items():
            is_its = owners == owner
            epochs_us[is_its] = chunk.epochs_us[positions[is_its]]
            power_dbm[is_its] = chunk.power_dbm()[positions[is_its]]
            source_positions[is_its] = sources.index(chunk.source)
        return _block(sources, first, epochs_us, power_dbm, source_positions)


def _block(
    sources: tuple[str, ...], chunk: Chunk, epochs_us: IntArray, power_dbm: Float32Array, positions: IntArray | None
) -> MeasurementBlock:
    """Return a block that nobody can change."""
    for array in (epochs_us, power_dbm):
        array.setflags(write=False)
    return MeasurementBlock(sources, chunk.plan_id, epochs_us, power_dbm, positions)


def end_us(parts: Sequence[ChunkRun], limit: int) -> int | None:
    """Return the epoch right behind the first ``limit`` rows of parts, None when they hold fewer."""
    if sum(len(positions) for _, positions in parts) < limit:
        return None
    epochs_us = np.concatenate([chunk.epochs_us[positions] for chunk, positions in parts])
    return int(np.partition(epochs_us, limit - 1)[limit - 1]) + 1
