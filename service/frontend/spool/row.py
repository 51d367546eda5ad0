"""Rows and traces as the spool's file holds them: arrays as little-endian bytes, absent values as NaN.

Powers keep the float64 they were measured with; the other figures are float32, far finer than what they are worth.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from service.core.radio.decibel import dbm_from_mw
from service.frontend.acquisition.evaluation import MeasuredRow
from service.records.levels.sweep import Sweep

#: array of a row -> how its numbers are written; the names are those of the columns
ARRAYS = {
    "power_dbm": "<f8",
    "flags": "<i4",
    "sigma_db": "<f4",
    "c_n0_db_hz": "<f4",
    "occupied_bandwidth_hz": "<f4",
    "centroid_offset_hz": "<f4",
}
#: bytes of a row beside its arrays: numbers, keys, index
ROW_OVERHEAD = 64


class SpooledTask(NamedTuple):
    """Task of a spooled row: hash, and carriers of its arrays."""

    sha256: str
    #: carriers of the arrays, in their order
    carrier_ids: tuple[str, ...]


class SpooledRow(NamedTuple):
    """A row that waits for the service."""

    #: for ever increasing; None while the row has not been on the disk
    seq: int | None
    task: SpooledTask
    row: MeasuredRow


class SpooledTrace(NamedTuple):
    """A sweep kept as evidence."""

    key: int
    epoch_us: int
    sweep: str
    start_hz: float
    step_hz: float
    rbw_hz: float
    enbw_hz: float
    sweep_time_s: float
    #: (B,) dBm as float32 bytes
    power_dbm: bytes


def encode_row(row: MeasuredRow) -> tuple[bytes, ...]:
    """Return the arrays of a row as bytes, in the order of `ARRAYS`.

    Raises
    ------
    ValueError
        Arrays of different lengths.
    """
    if len({len(getattr(row, name)) for name in ARRAYS}) != 1:
        message = f"the arrays of the row of {row.epoch_us} us have different lengths"
        raise ValueError(message)
    return tuple(np.asarray(getattr(row, name)).astype(kind).tobytes() for name, kind in ARRAYS.items())


def decode_row(epoch_us: int, blobs: Sequence[bytes]) -> MeasuredRow:
    """Return the row that `encode_row` wrote.

    Raises
    ------
    ValueError
        The bytes are not those of arrays of one length.
    """
    arrays: Mapping[str, Any] = {
        name: np.frombuffer(blob, dtype=kind).astype(np.int64 if name == "flags" else np.float64)
        for (name, kind), blob in zip(ARRAYS.items(), blobs, strict=True)
    }
    if len({len(array) for array in arrays.values()}) != 1:
        message = f"the arrays of the row of {epoch_us} us have different lengths"
        raise ValueError(message)
    return MeasuredRow(epoch_us, **arrays)


def size_of(blobs: Sequence[bytes]) -> int:
    """Return the size of a row for the bound of the spool, bytes."""
    return ROW_OVERHEAD + sum(map(len, blobs))


def trace_of(sweep: Sweep) -> tuple[Any, ...]:
    """Return the columns of a trace, those of `SpooledTrace` without the key."""
    settings = sweep.settings
    return (
        sweep.epoch_us,
        sweep.sweep_id,
        settings.start_hz,
        settings.step_hz,
        settings.rbw_hz,
        settings.enbw_hz,
        settings.sweep_time_s,
        dbm_from_mw(sweep.power_mw).astype("<f4").tobytes(),
    )
