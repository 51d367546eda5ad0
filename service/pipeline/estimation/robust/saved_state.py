"""State of the robust method as it is saved between two rows and restored."""

from typing import NamedTuple

import numpy as np

from service.pipeline.estimation.robust.method import RobustState, RobustStep
from service.pipeline.estimation.robust.model import RobustModel
from service.records.catalogue import Ephemeris
from service.records.levels.attitude import AttitudeRow, FloatArray


class SavedRobust(NamedTuple):
    """State of the method between two rows, and its newest row."""

    state: RobustState
    #: orbit that held at the alignment
    aligned_under_id: int | None
    row: AttitudeRow | None
    #: (N,) dBm and dB of the newest row; empty without one
    expected_dbm: FloatArray
    deviation_db: FloatArray
    residual_db: FloatArray


def saved_robust(state: RobustState, aligned_under: Ephemeris | None, last: RobustStep | None) -> SavedRobust:
    """Return the record of a state, with the newest row if there is one."""
    under = None if aligned_under is None else aligned_under.id
    if last is None:
        return SavedRobust(state, under, None, *(np.zeros(0),) * 3)
    return SavedRobust(state, under, last.row, last.expected_dbm, last.deviation_db, last.residual_db)


def newest_row(saved: SavedRobust, model: RobustModel | None) -> tuple[RobustStep, RobustModel] | None:
    """Return the step that made the newest row, with its model; None without one."""
    if saved.row is None or model is None:
        return None
    return RobustStep(saved.row, saved.expected_dbm, saved.deviation_db, saved.residual_db, saved.state), model
