"""Recorder of effective rows: what the filter did with each row in time, for a smoother.

A row that is taken again, because a command was reported or an alignment reached back, replaces itself and all later
ones: what is kept is the final version of the rows.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from service.core.estimation.filtering.filter_records import FilterState, FilterStep
from service.core.estimation.filtering.model.filter_state import DRIFT, RATE
from service.core.estimation.filtering.model.torque_prior import TORQUES, is_pushed
from service.core.estimation.filtering.rows.row_kernels import RowKernels
from service.core.estimation.smoothing.effective_row import EffectiveRow, effective_row, state_origin
from service.core.estimation.smoothing.row_capture import StepCapture
from service.pipeline.estimation.robust.model import RobustModel
from service.records.levels.attitude import IntArray


class RowRecorder:
    """Newest effective rows of the robust method, the oldest first.

    Parameters
    ----------
    most_rows : int
        Older rows are dropped beyond this number.
    """

    def __init__(self, most_rows: int) -> None:
        self._rows: deque[EffectiveRow] = deque(maxlen=most_rows)
        self._capture: StepCapture | None = None
        self._model: RobustModel | None = None

    @property
    def rows(self) -> Sequence[EffectiveRow]:
        """Return the rows that are kept."""
        return self._rows

    def drop(self, count: int) -> None:
        """Drop the oldest rows."""
        for _ in range(count):
            self._rows.popleft()

    def capturing(self, kernels: RowKernels) -> RowKernels:
        """Return the stages of a row that let their step of time be seen."""
        if self._capture is None:
            self._capture = StepCapture(kernels)
        return self._capture.kernels

    def push(self, model: RobustModel, before: FilterState, found: FilterStep) -> None:
        """Keep a row of the filter that was taken with the capturing stages."""
        if found.state is before:
            return
        while self._rows and self._rows[-1].epoch_us >= found.state.epoch_us:
            self._rows.pop()
        if self._capture is None or self._capture.newest is None:
            return
        origin = self._origin(model, before)
        self._rows.append(effective_row(model.filter, model.settings, before, found, self._capture.newest, origin))
        self._model = model

    def _origin(self, model: RobustModel, before: FilterState) -> IntArray | None:
        """Return where each number of the state before a row stood after the row before, None = nowhere."""
        if not self._rows or self._model is None:
            return None
        if model.settings.momentum is not None or model.settings.polarimeters:
            # records of the wheels and of polarimeters act between rows, which a smoother does not take back
            return None
        former, mean = self._rows[-1].mean, before.gaussian.mean
        if former is mean:
            return np.arange(len(mean))
        if model.rate_sensor is not None and len(former) == len(mean):
            # a measured rate is put into the state before a row, and a bias may have taken the place of the drift
            stays, moving = former == mean, np.arange(len(mean))
            return np.where(stays, moving, -1) if stays[: DRIFT.start].all() and stays[RATE.stop :].all() else None
        if (self._model.calibration_id, self._model.carrier_ids) != (model.calibration_id, model.carrier_ids):
            return None
        torques = TORQUES if is_pushed(model.settings) else 0
        return state_origin(model.filter, former, mean, torques)
