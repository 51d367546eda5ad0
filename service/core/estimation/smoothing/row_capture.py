"""Capture of the step of time while the filter takes a row: its stages run as ever, their arguments are kept."""

from typing import Any

import numpy as np

from service.core.estimation.filtering.filter_predict import Mover, TransitionMatrices
from service.core.estimation.filtering.model.filter_model import CarrierModel, FloatArray
from service.core.estimation.filtering.model.filter_state import FIRST_COMMON, RAIN, Gaussian, core_size
from service.core.estimation.filtering.rows.row_kernels import RowKernels
from service.core.estimation.smoothing.adjoint import LinearStep


class StepCapture:
    """Stages of a row that keep the step of time of the newest one.

    Parameters
    ----------
    kernels : RowKernels
        Who does the arithmetic; not a bit of it changes.
    """

    def __init__(self, kernels: RowKernels) -> None:
        self._mover: Mover = kernels.move_state
        self.kernels = kernels._replace(move_state=self._move)
        self.newest: LinearStep | None = None

    def _move(
        self, model: CarrierModel, state: Gaussian, motion: TransitionMatrices, *rest: Any
    ) -> tuple[Gaussian, FloatArray]:
        _push, _variance, _sigma, common_tau_s, seconds, rain_factor = rest[:6]
        self.newest = _linear_step(model, motion.transition, common_tau_s, seconds, rain_factor)
        return self._mover(model, state, motion, *rest)


def _linear_step(
    model: CarrierModel, transition: FloatArray, common_tau_s: FloatArray, seconds: float, rain_factor: float
) -> LinearStep:
    """Return the step of a state whose first nine numbers move by a transition (9, 9 + E)."""
    core = np.ones(FIRST_COMMON)
    core[RAIN] = rain_factor
    decays = [np.exp(-seconds / common_tau_s), np.exp(-seconds / model.coloured_tau_s).T.ravel()]
    factor = np.concatenate([core, *decays, np.ones(model.carriers)])
    moving = np.arange(len(transition))
    hidden = core_size(model) + np.arange(transition.shape[1] - len(transition))
    sources = np.concatenate([moving, hidden])
    return LinearStep(factor, moving, sources, transition * factor[sources])
