"""Tukey's M-estimate of all carriers jointly, from a trimmed start of each.

``min sum rho(r_ib / sigma_ib)`` over the own coefficients of every carrier and the shared ones: r the residual of
carrier i in stretch b, dB, ``sigma_ib^2 = white_i^2 / n_ib + s_i^2`` with s_i what the stretches scatter beyond white
noise. The law of this file: level and daily change start from the rows near zero attitude and the beam from all, so
that neither needs the other to survive wrong rows.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.estimation.calibration.geometry_columns import (
    BEAM_SIZE,
    DOWNLINK_PRIOR_DB_PER_DEG,
    SOLAR_SIZE,
)
from service.core.estimation.calibration.separable_fit import SeparableFit, fit_separable
from service.core.estimation.calibration.trimmed_start import trimmed_fit

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Sigmas at which Tukey's weight becomes zero; 95 % efficient on normal noise.
TUKEY_SIGMAS = 4.685
_TUKEY_PASSES = 8
_MAD_TO_SIGMA = 1.4826


class JointProblem(NamedTuple):
    """Thinned rows of N carriers in B stretches.

    Parameters
    ----------
    own : ndarray, shape (N, B, K)
        Columns of the carriers' own coefficients, the beam's last.
    shared : ndarray, shape (N, B, R)
        Columns of the shared ones.
    value : ndarray, shape (N, B), dB
        Powers less a rough level.
    rows_used : ndarray, shape (N, B)
        Rows in each mean; 0 = absent.
    centre_s, span_s : ndarray, shape (B,), s
        Middle and length of the stretches.
    is_near_zero : ndarray of bool, shape (B,)
        Stretches that tell level and daily change.
    beam_size : int
        How many of the own columns answer to the attitude.
    """

    own: FloatArray
    shared: FloatArray
    value: FloatArray
    rows_used: FloatArray
    centre_s: FloatArray
    span_s: FloatArray
    is_near_zero: BoolArray
    beam_size: int = BEAM_SIZE


def fit_jointly(problem: JointProblem, prior: FloatArray, white_db: FloatArray) -> tuple[SeparableFit, FloatArray]:
    """Return Tukey's joint fit, and the weights.

    Parameters
    ----------
    problem : JointProblem
        Thinned rows.
    prior : ndarray, shape (N, K)
        One sigma of each own coefficient before the data.
    white_db : ndarray, shape (N,), dB
        White noise of one row.

    Returns
    -------
    fit : SeparableFit
        Coefficients.
    weight : ndarray, shape (N, B)
        Tukey's weights, 0 where absent.
    """
    is_present = problem.rows_used > 0
    base = problem.own.shape[2] - problem.beam_size
    is_quiet = is_present & problem.is_near_zero
    # the solar day looks like the dish's; the start does without
    first = problem.own[..., : base - SOLAR_SIZE]
    misfit = problem.value - np.einsum("nbk,nk->nb", first, trimmed_fit(first, problem.value, is_quiet))
    # quiet rows outnumber the turns: trimmed together, the turns could go as outliers and nobody would know the beam
    is_turned = is_present & ~problem.is_near_zero
    beam = problem.own[..., base:]
    misfit = misfit - np.einsum("nbk,nk->nb", beam, trimmed_fit(beam, misfit, is_turned))
    white = np.maximum(white_db, 1e-4)[:, np.newaxis] ** 2 / np.maximum(problem.rows_used, 1)
    fit, weight = None, np.zeros_like(white)
    for _ in range(_TUKEY_PASSES):
        spread = _robust_scale(misfit, is_present)[:, np.newaxis]
        # what the spread of the stretches has beyond white noise is taken alike for all of them
        white_share = _masked_mean(white, is_present)[:, np.newaxis]
        sigma = np.sqrt(white + np.maximum(spread**2 - white_share, 0.0))
        weight = np.where(is_present, _tukey_weight(misfit / sigma), 0.0)
        root = np.sqrt(weight) / sigma
        fit = _joint(problem, prior, root)
        misfit = problem.value - _model(problem, fit)
    return fit or _joint(problem, prior, weight), weight


def _joint(problem: JointProblem, prior: FloatArray, root: FloatArray) -> SeparableFit:
    """Return the joint fit of rows multiplied by ``root`` (N, B)."""
    scaled = root[..., np.newaxis]
    return fit_separable(
        problem.own * scaled, problem.shared * scaled, problem.value * root, prior, DOWNLINK_PRIOR_DB_PER_DEG
    )


def _model(problem: JointProblem, fit: SeparableFit) -> FloatArray:
    """Return the model (N, B) at the stretches."""
    return np.asarray(np.einsum("nbk,nk->nb", problem.own, fit.own) + problem.shared @ fit.shared)


def _tukey_weight(standardised: FloatArray) -> FloatArray:
    """Return Tukey's biweight."""
    inside = np.maximum(1.0 - np.square(standardised / TUKEY_SIGMAS), 0.0)
    return np.asarray(inside**2)


def _robust_scale(misfit: FloatArray, is_present: BoolArray) -> FloatArray:
    """Return the spread (N,) of the present values from their median size."""
    ordered = np.sort(np.where(is_present, np.abs(misfit), math.inf), axis=1)
    middle = np.maximum(is_present.sum(axis=1) - 1, 0) // 2
    size = ordered[np.arange(len(ordered)), middle]
    return np.where(np.isfinite(size), np.maximum(_MAD_TO_SIGMA * size, 1e-4), 1.0)


def _masked_mean(values: FloatArray, mask: BoolArray) -> FloatArray:
    """Return means (N,) over the mask."""
    return np.asarray((values * mask).sum(axis=1) / np.maximum(mask.sum(axis=1), 1))
