"""Benchmarks: ratios of two things measured in turn."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from db.storage import SqlStorage
from service.records.calibration import Alignment
from service.records.levels.measurement import MeasurementBatch

# what tests share imports its neighbours by name, as pytest's pythonpath lets it
FAKES = Path(__file__).resolve().parent.parent / "tests" / "fakes"
sys.path.extend(str(FAKES / room) for room in ("worlds", "drivers", "ports"))


def options_of(description: str | None, **defaults: float) -> argparse.Namespace:
    """Return the numbers that a benchmark is run with: those of the command line, else the defaults."""
    parser = argparse.ArgumentParser(description=description)
    for name, default in defaults.items():
        parser.add_argument(f"--{name}", type=type(default), default=default)
    options, _ = parser.parse_known_args()
    return options


def prepare(storage: SqlStorage, payload: Any, name: str, alignment: Alignment) -> None:
    """Store a calibrated and aligned spacecraft."""
    storage.catalogue.add_spacecraft(replace(payload.spacecraft(), id=name))
    storage.catalogue.put_plan(name, payload.carriers(), "bench")
    storage.catalogue.put_ephemeris(name, payload.ephemeris())
    known = payload.calibration()
    draft = storage.results.add_calibration(name, known.request, 1, 1, 0, "bench")
    storage.results.finish_calibration(name, draft.id, known.result, None)
    storage.results.activate_calibration(name, draft.id)
    storage.results.add_alignment(name, replace(alignment, calibration_id=draft.id))


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
