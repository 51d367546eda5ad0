"""Measurement update of the attitude filter.

    nu = y - h(x),   S = H P H' + R,   K = P H' S^-1,   x += K nu
    P' = (I - K H) P (I - K H)' + K R K'        (Joseph)

H has three columns of attitude, one each of chain and rain, and ones at the carrier's own states, so that H P is a sum
of rows and nothing of size (D, D) is ever multiplied with another of that size. The law of this file: the covariance
stays symmetric and positive definite, whatever rounding does.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.filter_model import CarrierModel, FloatArray, IntArray, pattern_change
from service.core.estimation.filtering.filter_state import ATTITUDE, CHAIN, FIRST_COMMON, RAIN, Gaussian, core_size

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
        return np.asarray(np.sqrt(np.diagonal(self.predicted_db2) + self.white_db2))

    @property
    def covariance_db2(self) -> FloatArray:
        """(n, n) covariance of the innovations, dB^2."""
        return self.predicted_db2 + np.diag(self.white_db2)


def expected_db(model: CarrierModel, mean: FloatArray, carriers: IntArray) -> FloatArray:
    """Return the deviations (n,) that a state makes, dB."""
    own = mean[core_size(model) :].reshape(-1, model.carriers).sum(axis=0)
    return np.asarray((site_db(model, mean) + own)[carriers])


def site_db(model: CarrierModel, mean: FloatArray) -> FloatArray:
    """Return the deviations (N,) of attitude, chain, rain and common parts, without the carriers' own states, dB."""
    common = mean[CHAIN] + mean[FIRST_COMMON : core_size(model)].sum() - model.rain_share * mean[RAIN]
    return np.asarray(pattern_change(model, mean[ATTITUDE]).deviation_db + common)


def innovate(
    model: CarrierModel,
    state: Gaussian,
    deviation_db: FloatArray,
    carriers: IntArray,
    white_db2: FloatArray,
    at_deg: FloatArray | None = None,
) -> Innovation:
    """Return the innovations of some carriers.

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
    at_deg : ndarray, shape (3,), deg, optional
        Attitude at which the patterns are linearised; default the predicted one.

    Returns
    -------
    Innovation
        Of the carriers in the order given.
    """
    core = core_size(model)
    attitude = state.mean[ATTITUDE]
    pattern = pattern_change(model, attitude if at_deg is None else at_deg)
    jacobian = np.ones((len(carriers), core))
    jacobian[:, ATTITUDE] = pattern.gradient_db_deg[carriers]
    jacobian[:, ATTITUDE.stop : CHAIN] = 0.0
    jacobian[:, RAIN] = -model.rain_share[carriers]
    innovation = deviation_db[carriers] - expected_db(model, state.mean, carriers)
    if at_deg is not None:
        straight = pattern.deviation_db + pattern.gradient_db_deg @ (attitude - at_deg)
        innovation += (pattern_change(model, attitude).deviation_db - straight)[carriers]
    rows = state.covariance[core:].reshape(-1, model.carriers, len(state.mean)).sum(axis=0)
    cross = jacobian @ state.covariance[:core]
    cross += rows[carriers]
    predicted = cross[:, :core] @ jacobian.T
    predicted += _own_columns(model, cross, carriers)
    return Innovation(carriers, innovation, 0.5 * (predicted + predicted.T), white_db2[carriers], jacobian, cross)


def _own_columns(model: CarrierModel, matrix: FloatArray, carriers: IntArray) -> FloatArray:
    """Return (M, n): the columns of every carrier's own states added up."""
    own = matrix[:, core_size(model) :].reshape(len(matrix), -1, model.carriers).sum(axis=1)
    return np.asarray(own[:, carriers])


class Updated(NamedTuple):
    """State after a row and what the row said."""

    state: Gaussian
    #: (3,) shift of the attitude in units of its own sigma; white and of unit variance while the model holds
    attitude_shift: FloatArray
    #: normalised innovation squared and the carriers in it
    nis: float
    degrees: int


def update(model: CarrierModel, state: Gaussian, deviation_db: FloatArray, innovation: Innovation) -> Updated:
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
    carriers, nu, _, white, _, _ = innovation
    gain, whitened = _gain(innovation)
    attitude_variance = (gain[:, ATTITUDE] * innovation.cross[:, ATTITUDE]).sum(axis=0)
    shift = nu @ gain[:, ATTITUDE] / np.sqrt(attitude_variance)
    nis = float(nu @ whitened)
    mean = state.mean + nu @ gain
    all_white = np.zeros(model.carriers)
    all_white[carriers] = white
    at_deg, last = state.mean[ATTITUDE], innovation
    for _ in range(_MAX_PASSES):
        if float(np.abs(mean[ATTITUDE] - at_deg).max()) <= _RELINEARISE_DEG:
            break
        at_deg = mean[ATTITUDE]
        last = innovate(model, state, deviation_db, carriers, all_white, at_deg)
        gain, _ = _gain(last)
        mean = state.mean + last.innovation_db @ gain
    covariance = _joseph(model, state.covariance, last, gain)
    return Updated(_with_rain_above_zero(mean, covariance), shift, nis, len(carriers))


def _gain(innovation: Innovation) -> tuple[FloatArray, FloatArray]:
    """Return K' (n, D) and S^-1 nu (n,)."""
    right = np.column_stack([innovation.cross, innovation.innovation_db])
    solved = np.linalg.solve(innovation.covariance_db2, right)
    return np.asarray(solved[:, :-1]), np.asarray(solved[:, -1])


def _joseph(model: CarrierModel, covariance: FloatArray, innovation: Innovation, gain: FloatArray) -> FloatArray:
    """Return the covariance after an update; `gain` is K' of shape (n, D)."""
    # matrices of this size cost more to allocate than to add up: two are made, the rest is done in place
    left = gain.T @ innovation.cross
    np.subtract(covariance, left, out=left)
    across = left[:, : core_size(model)] @ innovation.core_jacobian.T
    across += _own_columns(model, left, innovation.carriers)
    across -= gain.T * innovation.white_db2
    right = across @ gain
    left -= right
    np.add(left, left.T, out=right)
    right *= 0.5
    return right


def _with_rain_above_zero(mean: FloatArray, covariance: FloatArray) -> Gaussian:
    """Return the state on the border r = 0 where its rain lies below it."""
    if mean[RAIN] < 0.0:
        mean = mean - covariance[RAIN] * (mean[RAIN] / covariance[RAIN, RAIN])
        mean[RAIN] = 0.0
    return Gaussian(mean, covariance)
