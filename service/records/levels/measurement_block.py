"""Level L1 by columns: many measurements under one plan, as arrays."""

from dataclasses import dataclass

from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Float32Array


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
