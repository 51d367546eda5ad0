"""State of the robust method between two rows, the outcome of a row, and both as they are saved and restored."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.filtering.filter_state import FilterState
from service.pipeline.estimation.robust.model import RobustModel
from service.pipeline.inputs.known_motion import CommandedMotion
from service.records.catalogue import Ephemeris
from service.records.levels.attitude import AttitudeRow, FloatArray, IntArray


@dataclass(frozen=True)
class RobustState:
    """State of the robust method between two rows."""

    filter: FilterState
    commanded: CommandedMotion
    #: (N,) of `READING`
    readings: NDArray[np.void]
    #: effect of each unreported command, by counter; one share each in the filter's state
    released: tuple[tuple[int, CommandedMotion], ...] = ()
    #: source of the newest row, None before the first
    source: str | None = None


class RobustStep(NamedTuple):
    """One row's outcome and the state after it, or after the last of its block."""

    row: AttitudeRow
    #: (N,) dBm and dB
    expected_dbm: FloatArray
    deviation_db: FloatArray
    residual_db: FloatArray
    state: RobustState
    #: (N,) positions in `CARRIER_HYPOTHESES`
    hypothesis: IntArray
    #: (4, 3) torque that is not fed forward, as in `RESULT`
    torque_deg_h2: FloatArray
    #: as in `RESULT`
    missed_log_ratio: float = 0.0
    #: whether nothing was found or declared
    is_ordinary: bool = True


class SavedRobust(NamedTuple):
    """State of the method between two rows, and its newest row."""

    state: RobustState
    #: orbit that held at the alignment
    aligned_under_id: int | None
    row: AttitudeRow | None
    #: (N,) dBm and dB of the newest row, hypotheses of its carriers; empty without one
    expected_dbm: FloatArray
    deviation_db: FloatArray
    residual_db: FloatArray
    hypothesis: IntArray
    #: (4, 3) torque that is not fed forward, as in `RESULT`
    torque_deg_h2: FloatArray


def saved_robust(state: RobustState, aligned_under: Ephemeris | None, last: RobustStep | None) -> SavedRobust:
    """Return the record of a state, with the newest row if there is one."""
    under = None if aligned_under is None else aligned_under.id
    if last is None:
        nothing = np.zeros(0)
        return SavedRobust(state, under, None, *(nothing,) * 3, np.zeros(0, dtype=np.int64), nothing)
    return SavedRobust(
        state,
        under,
        last.row,
        last.expected_dbm,
        last.deviation_db,
        last.residual_db,
        last.hypothesis,
        last.torque_deg_h2,
    )


def newest_row(saved: SavedRobust, model: RobustModel | None) -> tuple[RobustStep, RobustModel] | None:
    """Return the step that made the newest row, with its model; None without one."""
    if saved.row is None or model is None:
        return None
    levels = saved.expected_dbm, saved.deviation_db, saved.residual_db
    step = RobustStep(saved.row, *levels, saved.state, saved.hypothesis, saved.torque_deg_h2)
    return step, model
