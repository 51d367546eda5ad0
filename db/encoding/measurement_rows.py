"""Rows of measurements as the table of rows holds them, and the records made of them.

Powers are float32 LE of each carrier, every NaN the same NaN; flags are int32 LE, no byte where none is set; the
figures of details are float32 LE, one kind after another. A row that states no flags or no details has NULL.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.records.levels.attitude import IntArray
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails, Float32Array, Measurement, QualityFlag

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
