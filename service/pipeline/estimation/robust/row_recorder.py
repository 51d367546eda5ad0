"""Recorder of effective rows: what the filter did with each row in time, for a smoother.

A row that is taken again, because a command was reported or an alignment reached back, replaces itself and all later
ones: what is kept is the final version of the rows.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np

from service.core.estimation.effective_row import (
    EffectiveRow,
    effective_row,
    restarted_states,
    state_origin,
)
from service.core.estimation.filtering.filter_model import DRIFT, RATE, FilterSettings
from service.core.estimation.filtering.filter_state import FilterState
from service.core.estimation.filtering.motion_sensor import NO_EFFECT, SensorEffect
from service.core.estimation.filtering.plant import TORQUES, has_torque, sensor_states
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
        #: mean before the records of other sensors that the next row follows, and what they did
        self._began: FloatArray | None = None
        self._effects: tuple[SensorEffect, ...] = ()

    @property
    def rows(self) -> Sequence[EffectiveRow]:
        """Return the rows that are kept."""
        return self._rows

    def drop(self, count: int) -> None:
        """Drop the oldest rows."""
        for _ in range(count):
            self._rows.popleft()

    def sense(
        self, began: FloatArray, effects: Sequence[SensorEffect], moved: FilterState | None, *, is_measured: bool
    ) -> None:
        """Keep what records of other sensors did to a mean (D,) before the row that is pushed next.

        `moved` is the state after the rate of the body was put into it, None where no sensor measures one; the step
        knows a rate that is measured.
        """
        if moved is not None:
            begun = restarted_states(moved.covariance)
            begun = begun[(begun >= DRIFT.start) & (begun < RATE.stop)]
            if is_measured:
                begun = np.union1d(begun, np.arange(RATE.start, RATE.stop))
            effects = [*effects, SensorEffect(begun)]
        self._began, self._effects = began, tuple(each for each in effects if each is not NO_EFFECT)

    def push(self, model: RobustModel, before: FilterState, after: FilterState, row: np.void, trace: RowTrace) -> None:
        """Keep a row of the filter, a record of `RESULT`, with its trace and the states around it."""
        effects, began = self._effects, before.mean if self._began is None else self._began
        self._began, self._effects = None, ()
        if after is before:
            return
        while self._rows and self._rows[-1].epoch_us >= after.epoch_us:
            self._rows.pop()
        origin = self._origin(model, began)
        self._rows.append(effective_row(model.filter, model.settings, before, after, row, trace, origin, effects))
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
