"""Benchmarks: ratios of two things measured in turn."""

import sys
from pathlib import Path

import numpy as np

from service.records.levels.measurement import MeasurementBatch

# what tests share imports its neighbours by name, as pytest's pythonpath lets it
FAKES = Path(__file__).resolve().parent.parent / "tests" / "fakes"
sys.path.extend(str(FAKES / room) for room in ("worlds", "drivers", "ports"))


def plain_batch(
    spacecraft_id: str, received_at_us: int, epochs_us: np.ndarray, power_dbm: np.ndarray, plan_id: int = 1
) -> MeasurementBatch:
    """Return rows (T,), (T, N) as a batch of a front end, without flags and in time."""
    rows = len(epochs_us)
    return MeasurementBatch(
        spacecraft_id,
        "sa-1",
        plan_id,
        received_at_us=received_at_us,
        index=np.arange(rows),
        epochs_us=epochs_us,
        power_dbm=power_dbm.astype(np.float32),
        flags=(None,) * rows,
        is_stale=np.zeros(rows, dtype=bool),
    )
