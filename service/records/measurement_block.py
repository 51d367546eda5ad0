"""Level L1 by columns: many measurements of one source under one plan, as arrays."""

from dataclasses import dataclass

from service.records.attitude import IntArray
from service.records.measurement import Float32Array


@dataclass(frozen=True, slots=True)
class MeasurementBlock:
    """Rows in order of epoch."""

    source: str
    plan_id: int
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T, N) dBm as stored, in the order of the plan; NaN = absent
    power_dbm: Float32Array
