"""Level L1: one power per carrier, and what becomes of a batch of them."""

from dataclasses import dataclass, field, fields
from types import EllipsisType

import numpy as np
from numpy.typing import NDArray

from service.records.levels.attitude import FloatArray, IntArray

Float32Array = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class CarrierDetails:
    """Details of a front end beside the powers, in the shape of the powers; NaN = not stated.

    Kept with the row and shown with it; nothing is computed from it. It belongs to the content of the row: a row that
    comes again with other details is a conflict.
    """

    #: predicted scatter of the power, one sigma, dB
    sigma_db: FloatArray | Float32Array
    #: carrier over noise density, dB Hz
    c_n0_db_hz: FloatArray | Float32Array
    #: bandwidth that holds 99 per cent of the power, Hz
    occupied_bandwidth_hz: FloatArray | Float32Array
    #: centre of the power above the nominal frequency, Hz
    centroid_offset_hz: FloatArray | Float32Array

    def row(self, position: int | EllipsisType) -> Float32Array:
        """Return the figures of the row at a place, or with ``...`` of the only row, as (K, N) float32."""
        return np.array([getattr(self, name)[position] for name in DETAIL_NAMES], dtype=np.float32)


#: what may be stated beside powers, in the order in which it is stored
DETAIL_NAMES: tuple[str, ...] = tuple(each.name for each in fields(CarrierDetails))


@dataclass(frozen=True, slots=True)
class Measurement:
    """One row as the archive keeps it."""

    epoch_us: int
    received_at_us: int
    #: journal number
    number: int
    source: str
    plan_id: int
    #: (N,) dBm as stored (float32 widened), NaN = absent
    power_dbm: FloatArray
    #: (N,) bit masks of QualityFlag, or None when the front end sent none
    flags: IntArray | None
    #: whether the row came late or out of order
    is_late: bool = False
    #: whether its source was the prime one when it was stored
    feeds_estimator: bool = True
    seq: int | None = None
    #: (N,) each; None when the front end stated none
    details: CarrierDetails | None = None


@dataclass(frozen=True, slots=True)
class RowNotice:
    """One row of a batch that was stored otherwise than it was sent, or numbered otherwise than expected."""

    index: int
    seq: int | None
    #: time.leap_second or seq.jump
    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class RowRefusal(RowNotice):
    """One refused row of a batch; code: time.future, time.too_old, value.out_of_range, value.count or conflict."""


@dataclass(frozen=True, slots=True)
class Sender:
    """The key that rows came with, and how many sources it may make."""

    key_id: str
    max_sources: int


@dataclass(frozen=True, slots=True)
class MeasurementBatch:
    """The rows of one request that passed screening; ``index`` is their place in the request."""

    spacecraft_id: str
    source: str
    plan_id: int
    received_at_us: int
    #: (T,) place in the request
    index: IntArray
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, N) dBm, NaN = absent
    power_dbm: Float32Array
    #: (T,) rows of flags, None where none were sent
    flags: tuple[tuple[int, ...] | None, ...]
    #: (T,) whether the row is older than the lateness limit of the system clock
    is_stale: NDArray[np.bool_]
    first_seq: int | None = None
    #: (T, N) each; None when no row states any
    details: CarrierDetails | None = None
    #: None: nobody is asked how many sources there are
    sender: Sender | None = None


@dataclass(frozen=True, slots=True)
class BatchReceipt:
    """Receipt of a committed batch; given only after the commit."""

    accepted: int
    duplicates: int
    late: int
    refused: tuple[RowRefusal, ...]
    flagged: tuple[RowNotice, ...] = ()
    #: journal number of the first row accepted, the others follow it; None when there is none
    first_number: int | None = field(default=None, compare=False)
    #: whether its source was the prime one
    feeds_estimator: bool = field(default=False, compare=False)
    #: of each row accepted, whether it is late; None where all are or none
    is_late: NDArray[np.bool_] | None = field(default=None, compare=False)
