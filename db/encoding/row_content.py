"""Content of a row: what decides whether a row that comes again is a duplicate or a conflict.

Plan, powers, flags and details belong to it; sequence number and time of receipt do not. Powers and details are
compared as float32, every NaN the same and -0.0 equal to 0.0. A row without flags differs from one with flags of zero.
"""

from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Float32Array
from service.records.levels.quality_flag import QualityFlag


class RowContent(NamedTuple):
    """Plan, powers, flags and details of one row; arrays as bytes, None = none."""

    plan_id: int
    powers: bytes
    flags: bytes | None
    details: bytes | None

    @property
    def is_leap(self) -> bool:
        """True for a row measured within a leap second, or moved because of one."""
        flags = b"" if self.flags is None else self.flags
        return bool(np.any(np.frombuffer(flags, dtype="<i4") & QualityFlag.LEAP_SECOND))

    def in_leap_second(self, carriers: int) -> "RowContent":
        """Return the content with the flag LEAP_SECOND on every carrier."""
        flags = bytes(4 * carriers) if self.flags is None else self.flags
        return self._replace(flags=(np.frombuffer(flags, dtype="<i4") | np.int32(QualityFlag.LEAP_SECOND)).tobytes())


def row_content(
    plan_id: int, power_dbm: Float32Array, flags: IntArray | None, details: Float32Array | None
) -> RowContent:
    """Return the content of a row.

    Parameters
    ----------
    plan_id : int
        Carrier plan.
    power_dbm : ndarray, shape (N,)
        dBm, NaN = absent.
    flags : ndarray, shape (N,), or None
        Bit masks.
    details : ndarray, shape (K, N), or None
        Figures of DETAIL_NAMES, NaN = not stated.
    """
    masks = None if flags is None else flags.astype("<i4").tobytes()
    has_details = details is not None and not np.isnan(details).all()
    return RowContent(plan_id, _canonical(power_dbm), masks, _canonical(details) if has_details else None)


def _canonical(figures: Float32Array | None) -> bytes:
    """Return figures as float32 bytes, equal for equal figures."""
    canonical = np.array(figures, dtype="<f4") + np.float32(0.0)
    canonical[np.isnan(canonical)] = np.nan
    return canonical.tobytes()
