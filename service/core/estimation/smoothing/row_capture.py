"""Capture of the step of time while the filter takes a row: its stages run as ever, their arguments are kept."""

from typing import Any

import numpy as np

from service.core.estimation.filtering.filter_records import FilterState
from service.core.estimation.filtering.model.filter_model import CarrierModel, FloatArray
from service.core.estimation.filtering.model.filter_state import FIRST_COMMON, RAIN, RATE, Gaussian, core_size
from service.core.estimation.filtering.model.step_inputs import StepInputs
from service.core.estimation.filtering.rows.row_kernels import RowKernels
from service.core.estimation.filtering.rows.row_stages import OrdinaryRow
from service.core.estimation.smoothing.adjoint import LinearStep


class StepCapture:
    """Stages of a row that keep the step of time of the newest one.

    Parameters
    ----------
    kernels : RowKernels
        Who does the arithmetic; not a bit of it changes.
    """

    def __init__(self, kernels: RowKernels) -> None:
        self._kernels = kernels
        self.kernels = kernels._replace(move_state=self._move, ordinary_row=self._row)
        self.newest: LinearStep | None = None

    def _move(self, model: CarrierModel, state: Gaussian, step: StepInputs, *rest: Any) -> tuple[Gaussian, FloatArray]:
        self.newest = _linear_step(model, step)
        return self._kernels.move_state(model, state, step, *rest)

    def _row(self, model: CarrierModel, state: FilterState, step: StepInputs, *rest: Any) -> OrdinaryRow:
        self.newest = _linear_step(model, step)
        return self._kernels.ordinary_row(model, state, step, *rest)


def _linear_step(model: CarrierModel, step: StepInputs) -> LinearStep:
    """Return the step of a state whose first nine numbers, and the momentum of the wheels, move by a transition."""
    core, transition = np.ones(FIRST_COMMON), step.transition
    core[RAIN] = step.rain_factor
    decays = [np.exp(-step.seconds / step.common_tau_s), np.exp(-step.seconds / model.coloured_tau_s).T.ravel()]
    factor = np.concatenate([core, *decays, np.ones(model.carriers)])
    moving = np.arange(RATE.stop)
    hidden = core_size(model) + np.arange(transition.shape[1] - len(moving))
    sources = np.concatenate([moving, hidden])
    targets = np.concatenate([moving, step.momentum_first + np.arange(len(transition) - len(moving))])
    return LinearStep(factor, targets, sources, transition * factor[sources])
