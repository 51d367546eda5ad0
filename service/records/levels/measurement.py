"""Level L1: powers of the carriers row by row and as columns, their quality flags, series of the archive."""

from dataclasses import dataclass, field, fields
from enum import IntFlag
from types import EllipsisType
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.records.levels.attitude import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class SweepSettings:
    """Settings as the analyzer states them after it was set, not as they were asked for."""

    start_hz: float
    stop_hz: float
    points: int
    #: 3 dB width of the resolution filter, Hz
    rbw_hz: float
    #: noise bandwidth of the resolution filter, Hz
    enbw_hz: float
    vbw_hz: float
    #: time of one sweep, s
    sweep_time_s: float
    #: RMS, POS, NEG, SAMP or AVER
    detector: str
    #: sweeps averaged by the analyzer
    count: int = 1

    @property
    def step_hz(self) -> float:
        """Distance of neighbouring points, Hz."""
        return (self.stop_hz - self.start_hz) / max(self.points - 1, 1)


@dataclass(frozen=True, slots=True)
class Sweep:
    """One trace."""

    #: name of the sweep in the measurement task
    sweep_id: str
    #: microseconds UTC, middle of the dwell
    epoch_us: int
    settings: SweepSettings
    #: (B,) mW behind the resolution filter, NaN = the analyzer gave no number
    power_mw: NDArray[np.float64]
    #: the analyzer reported an overload
    is_overrange: bool = False
    #: the analyzer reported an uncalibrated sweep
    is_uncalibrated: bool = False
    #: the analyzer's reference oscillator is not locked
    is_reference_unlocked: bool = False
    #: the trace repeats the previous one
    is_stale: bool = False
    #: settings changed under the front end's hands or were not taken
    is_setting_mismatch: bool = False


#: fields that say what is wrong with a trace
SWEEP_FLAGS = tuple(field.name for field in fields(Sweep) if field.name.startswith("is_"))


@dataclass(frozen=True, slots=True)
class TraceSettings:
    """Under which settings a trace was really taken."""

    #: frequency of the first point, Hz
    start_hz: float
    #: distance of neighbouring points, Hz
    step_hz: float
    #: 3 dB width of the resolution filter, Hz
    rbw_hz: float
    #: noise bandwidth of the resolution filter, Hz
    enbw_hz: float
    #: time of one sweep, s
    sweep_time_s: float


@dataclass(frozen=True, slots=True)
class Trace:
    """One trace as a front end sends it."""

    epoch_us: int
    #: name of the sweep in the measurement task
    sweep: str
    settings: TraceSettings
    #: (B,) dBm behind the resolution filter, NaN = the analyzer gave no number
    power_dbm: FloatArray


@dataclass(frozen=True, slots=True)
class TraceHead:
    """A kept trace without its points."""

    #: order of receipt
    number: int
    source: str
    epoch_us: int
    sweep: str
    settings: TraceSettings
    points: int
    received_at_us: int
    size_bytes: Annotated[int, "Size of its points in the archive."]


@dataclass(frozen=True, slots=True)
class KeptTrace:
    """A kept trace."""

    head: TraceHead
    #: (B,) dBm as stored (float32 widened), NaN = the analyzer gave no number
    power_dbm: FloatArray


@dataclass(frozen=True, slots=True)
class Ring:
    """Bounds of the traces kept of one source; beyond them the oldest epochs are dropped."""

    traces: int
    size_bytes: int


@dataclass(frozen=True, slots=True)
class TraceReceipt:
    """Receipt of traces; given only after the commit."""

    accepted: int
    #: source, sweep and epoch were known; the first one stays
    duplicates: int
    dropped: Annotated[int, "Traces, new or old, that the ring of the source had no place for."]


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
    #: key that it came with and its station; None where that was not asked, station also of a person's key
    key_id: str | None = None
    station: str | None = None


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
    #: None: a person, who may send for any source
    station: str | None = None


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


@dataclass(frozen=True, slots=True)
class MeasurementBlock:
    """Rows in order of epoch."""

    #: who sent them
    sources: tuple[str, ...]
    plan_id: int
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, N) dBm as stored, in the order of the plan; NaN = absent
    power_dbm: Float32Array
    #: (T,) place of each row's source in ``sources``; None = every row is of the first
    source_positions: IntArray | None = None

    def part(self, first: int, last: int) -> "MeasurementBlock":
        """Return the rows at the places ``first`` to ``last - 1``."""
        positions = None if self.source_positions is None else self.source_positions[first:last]
        return MeasurementBlock(
            self.sources, self.plan_id, self.epochs_us[first:last], self.power_dbm[first:last], positions
        )


class QualityFlag(IntFlag):
    """Bit mask that goes with every level."""

    #: the clock behind the epoch is not synchronised
    CLOCK_UNSYNC = 1
    #: the row came late or out of order
    LATE = 2
    #: the analyzer's input or converter was overdriven
    OVERRANGE = 4
    #: the analyzer says the sweep is not calibrated, for example too fast for its bandwidth
    UNCAL = 8
    #: no carrier found: the level is absent, never the noise
    NO_CARRIER = 16
    #: the carrier's bandwidth or level changed by traffic
    TRAFFIC_CHANGE = 32
    #: a foreign signal lies in the band
    INTERFERENCE = 64
    #: the level falls as rain makes it fall
    RAIN_FADE_SUSPECT = 128
    #: the level is older than its validity
    EXPIRED = 256
    #: the level comes from a simulation
    SIMULATED = 512
    #: the level was computed again from a kept trace
    REPROCESSED = 1024
    #: the analyzer's settings were not those that were asked for
    SETTING_MISMATCH = 2048
    #: the analyzer gave the same trace again
    STALE_TRACE = 4096
    #: the trace held values that are not numbers
    NONFINITE_VALUE = 8192
    #: a neighbour lies within two resolution bandwidths or leaks more than 0.1 dB into the band
    NEIGHBOUR = 16384
    #: a noise window held a signal
    NOISE_WINDOW_DIRTY = 32768
    #: the noise floor is the analyzer's own
    DANL_LIMITED = 65536
    #: carrier over noise in the symbol rate below 3 dB
    LOW_C_N = 131072
    #: the carrier's centre is more than a tenth of the symbol rate off
    FREQUENCY_OFFSET = 262144
    #: a sweep of the cycle failed; carriers of the other sweeps are good
    PARTIAL_CYCLE = 524288
    #: first row after the connection to the analyzer was lost
    RECONNECTED = 1048576
    #: the analyzer's reference oscillator is not locked
    REFERENCE_UNLOCKED = 2097152
    #: the carrier stands in the plan but not in the measurement task
    NOT_MEASURED = 4194304
    #: the row was measured within a leap second, or its epoch gave way by 1 us to a row that was
    LEAP_SECOND = 8388608


def flag_names(mask: int) -> list[str]:
    """Return the names of the flags of a bit mask, lowest bit first; a bit without a name is told by its number.

    Examples
    --------
    >>> flag_names(16 | 4096 | 1 << 30)
    ['NO_CARRIER', 'STALE_TRACE', 'BIT_30']
    """
    bits = (bit for bit in range(mask.bit_length()) if mask >> bit & 1)
    return [_NAMES.get(1 << bit, f"BIT_{bit}") for bit in bits]


_NAMES = {flag.value: flag.name for flag in QualityFlag if flag.name is not None}


@dataclass(frozen=True, slots=True)
class MeasurementSeries:
    """Rows of the prime source in order of epoch, columns in the order of the carriers asked for."""

    carrier_ids: tuple[str, ...]
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, N) dBm, NaN = absent or not in the row's plan
    power_dbm: FloatArray


@dataclass(frozen=True, slots=True)
class ReferenceSeries:
    """Attitude references of one sensor in order of epoch."""

    source: str
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, 3) deg, yaw, roll, pitch; NaN = angle not seen
    attitude_deg: FloatArray
    #: (T, 3) deg; NaN = not stated
    sigma_deg: FloatArray


@dataclass(frozen=True, slots=True)
class SourceState:
    """One front end that sends measurements of a spacecraft."""

    id: str
    #: prime or backup
    role: str
    newest_epoch_us: int | None
    rows: int
    rows_missing: Annotated[
        int | None, "Rows that its sequence numbers count and the archive does not hold; null = it numbers no rows."
    ] = None
    station: Annotated[str | None, "Station that it belongs to; null: no station has sent it yet."] = None
    key_id: Annotated[str | None, "Key that its newest rows came with."] = None


@dataclass(frozen=True, slots=True)
class InputReceipt:
    """Receipt of a committed batch of slow inputs."""

    accepted: int
    duplicates: int
    refused: tuple[RowRefusal, ...]


@dataclass(frozen=True, slots=True)
class HeadState:
    """Positions of a spacecraft's journal and of its consumer."""

    #: number of the newest entry, 0 before the first
    newest_number: int
    #: number of the newest entry whose outcome is stored
    consumed_number: int
    #: epoch of the newest accepted measurement
    newest_epoch_us: int | None
    #: epoch of the newest measurement that the live chain has consumed
    consumed_epoch_us: int | None
    #: counts stored results of the live version
    result_sequence: int


class Whereabouts(NamedTuple):
    """Positions of everything that is stored of a spacecraft: what was read of it before holds while they stay."""

    head: HeadState
    sources: tuple[SourceState, ...]
    #: digest of the catalogue's entry
    digest: str
    #: number of the newest entry of the journal that is no row
    input_number: int
    #: newest alignment, and newest calibration in force
    alignment_id: int | None
    calibration_id: int | None
    #: attitude of before is no longer kept, microseconds UTC; None = all is
    kept_from_us: int | None
    #: other ones after each report of a link and each order to one
    links: tuple[int, ...]
