"""A batch of measurements as the writer needs it: rows as bytes, and what the fast ways of storing ask for."""

from dataclasses import dataclass

import numpy as np

from db.encoding.measurement_details import PreparedDetails, prepare_details
from db.encoding.power_codec import NO_FLAGS, StoredRows, pack_flags, pack_powers
from db.encoding.row_content import RowContent, row_content
from service.records.levels.attitude import BoolArray
from service.records.levels.measurement import MeasurementBatch


@dataclass(frozen=True, slots=True)
class PreparedBatch:
    """A batch as the writer needs it; made outside the writer's thread."""

    spacecraft_key: int
    batch: MeasurementBatch
    epochs_us: list[int]
    powers: StoredRows
    #: zeros where a row has none
    flags: StoredRows
    #: (T,)
    has_flags: BoolArray
    is_ascending: bool
    #: places in the request without gap, and flags with every row or with none
    is_even: bool
    #: None when no row states any
    details: PreparedDetails | None = None

    def content(self, position: int) -> RowContent:
        """Return the content of a row, for comparison with the stored one."""
        batch, flags = self.batch, self.batch.flags[position]
        details = None if batch.details is None else batch.details.row(position)
        masks = None if flags is None else np.array(flags, dtype="<i4")
        return row_content(batch.plan_id, batch.power_dbm[position], masks, details)


def prepare(spacecraft_key: int, batch: MeasurementBatch) -> PreparedBatch:
    """Return the batch with its rows as bytes."""
    has_flags = np.array([row is not None for row in batch.flags], dtype=np.bool_)
    # nothing to compare, and it is what front ends send as long as all is well
    is_single = len(has_flags) == 1
    return PreparedBatch(
        spacecraft_key,
        batch,
        epochs_us=batch.epochs_us.tolist(),
        powers=pack_powers(batch.power_dbm),
        flags=_flags(batch) if has_flags.any() else NO_FLAGS,
        has_flags=has_flags,
        is_ascending=is_single or bool(np.all(batch.epochs_us[1:] > batch.epochs_us[:-1])),
        is_even=is_single or bool(np.all(np.diff(batch.index) == 1) and has_flags.all() == has_flags.any()),
        details=prepare_details(batch.details),
    )


def _flags(batch: MeasurementBatch) -> StoredRows:
    """Return the bit masks of a batch, zeros where a row has none."""
    blank = (0,) * batch.power_dbm.shape[1]
    return pack_flags(np.array([blank if row is None else row for row in batch.flags], dtype=np.int32))
