"""Rows of several sources and segments in order: as runs of one piece, and as blocks."""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from service.ports.archive import Cursor
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Float32Array, Measurement, MeasurementBlock

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
