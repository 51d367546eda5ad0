"""Stretches of the archive as arrays, and the small answers of the archive about itself."""

from dataclasses import dataclass
from typing import Annotated

from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.measurement import RowRefusal


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
