"""Recorder of effective rows: what the filter did with each row in time, for a smoother.

A row that is taken again, because a command was reported or an alignment reached back, replaces itself and all later
ones: what is kept is the final version of the rows.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from service.core.estimation.effective_row import EffectiveRow, effective_row, state_origin
from service.core.estimation.filtering.filter_model import FilterSettings
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.plant import TORQUES, has_torque, measured_settings, sensor_states
from service.core.estimation.filtering.row_block import RowTrace
from service.core.estimation.filtering.state_changes import sensors_of
from service.pipeline.estimation.robust.model import RobustModel
from service.records.levels.attitude import FloatArray, IntArray


class RowRecorder:
    """Newest effective rows of the robust method, the oldest first.

    Parameters
    ----------
    most_rows : int
        Older rows are dropped beyond this number.
    """

    def __init__(self, most_rows: int) -> None:
        self._rows: deque[EffectiveRow] = deque(maxlen=most_rows)
        self._model: RobustModel | None = None

    @property
    def rows(self) -> Sequence[EffectiveRow]:
        """Return the rows that are kept."""
        return self._rows

    def drop(self, count: int) -> None:
        """Drop the oldest rows."""
        for _ in range(count):
            self._rows.popleft()

    def push(self, model: RobustModel, before: FilterState, after: FilterState, row: np.void, trace: RowTrace) -> None:
        """Keep a row of the filter, a record of `RESULT`, with its trace and the states around it."""
        if after is before:
            return
        while self._rows and self._rows[-1].epoch_us >= after.epoch_us:
            self._rows.pop()
        origin, settings = self._origin(model, before.mean), model.settings
        if model.rate_sensor is not None and after.rates["is_measured"][0]:
            settings = measured_settings(settings, model.rate_sensor)
        self._rows.append(effective_row(model.filter, settings, before, after, row, trace, origin))
        self._model = model

    def _origin(self, model: RobustModel, mean: FloatArray) -> IntArray | None:
        """Return where each number of the mean that a row began with stood after the row before, None = nowhere."""
        if not self._rows or self._model is None:
            return None
        former = self._rows[-1].mean
        if former is mean:
            return np.arange(len(mean))
        if (self._model.calibration_id, self._model.carrier_ids) != (model.calibration_id, model.carrier_ids):
            return None
        kept, now = self._model.settings, model.settings
        is_same = sensors_of(kept) == sensors_of(now)
        behind = _behind_shares(kept), _behind_shares(now)
        return state_origin(model.filter, former, mean, behind, is_same=is_same)


def _behind_shares(settings: FilterSettings) -> int:
    """Return how many hidden states stand behind the shares of commands: torques and other sensors."""
    return TORQUES * has_torque(settings) + sensor_states(settings)
