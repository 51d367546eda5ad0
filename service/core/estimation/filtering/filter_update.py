"""Measurement update of the attitude filter.

    nu = y - h(x),   S = H P H' + R = L L',   W = L^-1 H P,   w = L^-1 nu
    x' = x + W' w,   P' = P - W' W

H has three columns of attitude, one each of chain and rain, ones at common parts and the carrier's own states, so that
H P is a sum of rows and nothing of size (D, D) is ever multiplied with another of that size. The law of this file: the
covariance stays symmetric, to the last bit, and positive definite. What W' W loses to rounding in row i and column j is
some n eps sqrt(P_ii P_jj), 1e-14 of the two sigmas; every step adds far more than that to each state that rows tell
about, and the white noise keeps what is left of it large against that.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.kernels import state_kernels
from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    CHAIN,
    RAIN,
    CarrierModel,
    Gaussian,
    common_states,
    hidden_count,
    pattern_change,
)

#: an update that moves the attitude by more than this is linearised again where it leads, deg
_RELINEARISE_DEG = 0.05
_MAX_PASSES = 4


class Innovation(NamedTuple):
    """Measured minus predicted of n carriers, with what the update needs."""

    #: (n,) numbers of the carriers
    carriers: IntArray
    #: (n,) dB
    innovation_db: FloatArray
    #: (n, n) dB^2, without the white noise
    predicted_db2: FloatArray
    #: (n,) dB^2
    white_db2: FloatArray
    #: (n, C) and (n, D)
    core_jacobian: FloatArray
    cross: FloatArray

    @property
    def sigma_db(self) -> FloatArray:
        """(n,) one standard deviation of each innovation, dB."""
        return np.asarray(np.sqrt(self.predicted_db2.diagonal() + self.white_db2))

    @property
    def covariance_db2(self) -> FloatArray:
        """(n, n) covariance of the innovations, dB^2."""
        covariance = self.predicted_db2.copy()
        covariance.ravel()[:: len(covariance) + 1] += self.white_db2
        return covariance


def site_db(model: CarrierModel, mean: FloatArray) -> FloatArray:
    """Return the deviations (N,) of attitude, chain, rain and common parts, without the carriers' own states, dB."""
    common = mean[CHAIN] + mean[common_states(model)].sum() - model.rain_share * mean[RAIN]
    site: FloatArray = pattern_change(model, mean[ATTITUDE]).deviation_db + common
    return site


def innovate(
    model: CarrierModel,
    state: Gaussian,
    deviation_db: FloatArray,
    carriers: IntArray,
    white_db2: FloatArray,
) -> Innovation:
    """Return the innovations of some carriers, their patterns linearised at the predicted attitude.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : Gaussian
        Predicted state.
    deviation_db : ndarray, shape (N,), dB
        Measured minus reference minus harmonic; not NaN at the carriers used.
    carriers : ndarray, shape (n,)
        Which carriers.
    white_db2 : ndarray, shape (N,), dB^2
        White noise of every carrier.

    Returns
    -------
    Innovation
        Of the carriers in the order given.
    """
    return _innovate_at(model, state, deviation_db, carriers, white_db2, state.mean[ATTITUDE])


def _innovate_at(
    model: CarrierModel,
    state: Gaussian,
    deviation_db: FloatArray,
    carriers: IntArray,
    white_db2: FloatArray,
    at_deg: FloatArray,
) -> Innovation:
    """Return the innovations of some carriers, patterns linearised at an attitude (3,), deg."""
    innovation_db, jacobian = state_kernels.linearise(
        state.mean,
        at_deg,
        model.gradient_db_deg,
        model.hessian_db_deg2,
        model.rain_share,
        deviation_db,
        carriers,
        len(model.common_sigma_db),
        hidden_count(model, len(state.mean)),
    )
    cross = state_kernels.project(state.covariance, jacobian, carriers, len(model.rain_share))
    predicted = state_kernels.spread(cross, jacobian, carriers, len(model.rain_share))
    return Innovation(carriers, innovation_db, predicted, white_db2[carriers], jacobian, cross)


class EffectiveUpdate(NamedTuple):
    """Update of a row as it acted, for who goes back over the rows."""

    #: state right after it
    state: Gaussian
    #: innovations that moved the state, linearised where they led, white noise as weighted
    innovation: Innovation
    #: carriers in it, 0 = there was no update
    degrees: int
    #: dB, what rain below zero was raised by
    rain_raised_db: float


class Updated(NamedTuple):
    """State after a row and the residuals of the row."""

    state: Gaussian
    #: (3,) shift of the attitude in units of its own sigma; white and of unit variance while the model holds
    attitude_shift: FloatArray
    #: normalised innovation squared and the carriers in it
    nis: float
    degrees: int
    effective: EffectiveUpdate


def update(
    model: CarrierModel,
    state: Gaussian,
    deviation_db: FloatArray,
    innovation: Innovation,
) -> Updated:
    """Return the state after its measurement.

    Parameters
    ----------
    model : CarrierModel
        The carriers.
    state : Gaussian
        Predicted state.
    deviation_db : ndarray, shape (N,), dB
        The measurement.
    innovation : Innovation
        Of the carriers to be used, white noise raised where one is trusted less; n >= 1.

    Returns
    -------
    Updated
        New state. Rain below zero is put to zero along its correlations.
    """
    carriers, white = innovation.carriers, innovation.white_db2
    mean, whitened, residual = _updated(state, innovation)
    own = np.ascontiguousarray(whitened[:, ATTITUDE])
    shift, nis = (residual @ own) / np.sqrt((own * own).sum(axis=0)), float(residual @ residual)
    at_deg, final = state.mean[ATTITUDE], innovation
    for _ in range(_MAX_PASSES):
        if float(np.abs(mean[ATTITUDE] - at_deg).max()) <= _RELINEARISE_DEG:
            break
        at_deg = mean[ATTITUDE]
        all_white = np.zeros(len(deviation_db))
        all_white[carriers] = white
        final = _innovate_at(model, state, deviation_db, carriers, all_white, at_deg)
        mean, whitened, residual = _updated(state, final)
    covariance = state_kernels.reduce(state.covariance, whitened)
    after = _with_rain_above_zero(mean, covariance)
    effective = EffectiveUpdate(after, final, len(carriers), max(0.0, -float(mean[RAIN])))
    return Updated(after, shift, nis, len(carriers), effective)


def _updated(state: Gaussian, innovation: Innovation) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean after the innovations, W and w."""
    _, nu, predicted, white, _, cross = innovation
    return state_kernels.update_state(state.mean, nu, predicted, white, cross)


def _with_rain_above_zero(mean: FloatArray, covariance: FloatArray) -> Gaussian:
    """Return the state on the border r = 0 where its rain lies below it."""
    if mean[RAIN] < 0.0:
        mean = mean - covariance[RAIN] * (mean[RAIN] / covariance[RAIN, RAIN])
        mean[RAIN] = 0.0
    return Gaussian(mean, covariance)
