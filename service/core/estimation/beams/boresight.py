"""Boresight of a receiving antenna against the body, hour by hour, from powers and the angles of a working sensor.

``d_hi - f_i(l_h) = c_h - u_i b_h + o_i + e_hi``: d deviation of carrier i in hour h, dB; f response to the sensor's
angles l; c level that all carriers of the antenna share; u gradient of the beam, dB/deg; b boresight (East,
North) in deg; o what carrier i's level has changed by since the calibration. Offsets are fitted beside the boresight,
so that a carrier that leaves does not move it. Only what the offsets together look like as a constant boresight stays
open: ``constant_sigma_deg``. A part of the gradient that all carriers share counts as level, so that the answer to a
turn of the body serves as well as the uplink beam alone.

The boresight of one antenna and an error of the sensor's angle look alike: what all antennas share is no proof.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: three unknowns an hour and two carriers that check them
MIN_CARRIERS = 5
#: sigmas at which Tukey's weight becomes zero; 95 % efficient on normal noise
_TUKEY_SIGMAS = 4.685
_START_PASSES, _PASSES = 12, 8
_MAD_TO_SIGMA = 1.4826
#: dB, least scatter of the levels that single carriers change by
_LEAST_OFFSET_DB = 0.01
#: smallest eigenvalue of a normal matrix of unit diagonal that still determines the boresight
_MIN_EIGENVALUE = 1e-4


class BoresightSeries(NamedTuple):
    """Boresight of one antenna in H hours; NaN where too few carriers tell it.

    Parameters
    ----------
    boresight_deg, sigma_deg : ndarray, shape (H, 2), deg
        East and North of where the calibration had it; sigma of noise alone.
    common_db : ndarray, shape (H,), dB
        Level that the carriers share.
    carriers_used : ndarray of int, shape (H,)
        Carriers with a weight above a half.
    constant_sigma_deg : ndarray, shape (2,), deg
        Sigma of what all hours share: levels of single carriers that changed since the calibration.
    residual_rms_db : float, dB
        Of the carriers used, over all hours.
    gain_deg_per_db : ndarray, shape (2, N)
        What an error of each carrier does to the boresight.
    """

    boresight_deg: FloatArray
    sigma_deg: FloatArray
    common_db: FloatArray
    carriers_used: IntArray
    constant_sigma_deg: FloatArray
    residual_rms_db: float
    gain_deg_per_db: FloatArray


def boresight_series(residual_db: FloatArray, gradient_db_deg: FloatArray, sigma_db: FloatArray) -> BoresightSeries:
    """Return the boresight of an antenna by Tukey's M-estimate.

    Parameters
    ----------
    residual_db : ndarray, shape (H, N), dB
        Hourly means of deviations less the response to the sensor's angles; NaN = absent.
    gradient_db_deg : ndarray, shape (N, 2), dB/deg
        Gradient of each carrier's beam to East and North.
    sigma_db : ndarray, shape (N,), dB
        Noise of an hourly mean; one scale for all carriers is found by their residuals.

    Returns
    -------
    BoresightSeries

    Notes
    -----
    Noise of 0.03 dB an hour on sixteen carriers of 1.4 dB/deg leaves 0.008 deg an hour; errors of the calibrated
    gradients (0.07 dB/deg) add 5 % of the boresight itself.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> gradient = rng.normal(0.0, 1.2, (8, 2))
    >>> moved = -gradient @ [0.02, -0.01] + 0.3
    >>> series = boresight_series(np.tile(moved, (30, 1)), gradient, np.full(8, 0.03))
    >>> series.boresight_deg[0].round(6), series.common_db[0].round(6)
    (array([ 0.02, -0.01]), np.float64(0.3))
    """
    is_seen = np.isfinite(residual_db)
    design = np.column_stack([-gradient_db_deg, np.ones(len(gradient_db_deg))])
    value = np.where(is_seen, residual_db, 0.0)
    offset, weight, scale = np.zeros(len(design)), is_seen.astype(np.float64), 1.0
    # Huber's weights begin, for Tukey's find the minimum that is nearest
    for weigh in (*(_huber,) * _START_PASSES, *(_tukey,) * _PASSES):
        theta, _, _ = _solved(design, value - offset, weight / np.square(sigma_db))
        rest = value - theta @ design.T
        # of the offsets only what no boresight and no level explains
        offset = _unexplained(design, _medians(rest, is_seen), is_seen.sum(axis=0) / np.square(sigma_db))
        sigmas = np.abs(rest - offset) / sigma_db
        scale = _scale(sigmas, is_seen)
        weight = np.where(is_seen, weigh(sigmas / scale), 0.0)
    information = weight / np.square(scale * sigma_db)
    theta, inverse, is_determined = _solved(design, value - offset, information)
    used = (weight > 0.5).sum(axis=1)
    is_known = is_determined & (used >= MIN_CARRIERS)
    rest = value - theta @ design.T - offset
    gain = _mean_gain(design, information.sum(axis=0))
    # a level that stands out was found, and does not make the others less sure
    ordinary_db = np.minimum(np.abs(offset), 3.0 * _MAD_TO_SIGMA * np.median(np.abs(offset)))
    counted = int((weight.sum(axis=0) > 0.0).sum())
    widening = math.sqrt(counted / max(1, counted - design.shape[1]))
    return BoresightSeries(
        np.where(is_known[:, None], theta[:, :2], np.nan),
        np.where(is_known[:, None], np.sqrt(np.diagonal(inverse, axis1=1, axis2=2)[:, :2]), np.nan),
        np.where(is_known, theta[:, 2], np.nan),
        used.astype(np.int64),
        widening * np.linalg.norm(gain[:2] * ordinary_db, axis=1),
        float(np.sqrt((weight * np.square(rest)).sum() / max(weight.sum(), 1e-9))),
        gain[:2],
    )


def _solved(design: FloatArray, value: FloatArray, information: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return unknowns (H, 3), inverse normal matrices (H, 3, 3), and which hours determine them."""
    normal = np.einsum("hn,ni,nj->hij", information, design, design)
    length = np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-30))
    scaled = normal / (length[:, :, None] * length[:, None])
    is_determined = np.linalg.eigvalsh(scaled)[:, 0] > _MIN_EIGENVALUE
    safe = np.where(is_determined[:, None, None], scaled, np.eye(design.shape[1]))
    inverse = np.linalg.inv(safe) / (length[:, :, None] * length[:, None])
    theta = np.einsum("hij,hn,nj,hn->hi", inverse, information, design, value, optimize=True)
    return np.where(is_determined[:, None], theta, 0.0), inverse, is_determined


def _unexplained(design: FloatArray, offset: FloatArray, information: FloatArray) -> FloatArray:
    """Return offsets (N,) less what a constant boresight and level explain of them.

    A level that changed is one carrier's: what most of them show is the boresight, and those that contradict stand out.
    """
    weight, rest = information, offset
    for weigh in (*(_huber,) * _START_PASSES, *(_tukey,) * _PASSES):
        rest = offset - design @ (_mean_gain(design, weight) @ offset)
        size = np.abs(rest)
        scale = max(_LEAST_OFFSET_DB, _MAD_TO_SIGMA * float(np.median(np.append(size[information > 0.0], 0.0))))
        weight = information * weigh(size / scale)
    return rest


def _mean_gain(design: FloatArray, information: FloatArray) -> FloatArray:
    """Return what a constant error of each carrier does to the unknowns, (3, N)."""
    weighted = (design * information[:, None]).T
    return np.asarray(np.linalg.pinv(weighted @ design) @ weighted)


def _scale(sigmas: FloatArray, is_seen: BoolArray) -> float:
    """Return by what factor, at least a half, noise is larger than stated, by the median of the residuals."""
    seen = sigmas[is_seen]
    if not len(seen):
        return 1.0
    carriers = len(seen) / int(is_seen.any(axis=1).sum())
    # three unknowns an hour make residuals smaller than noise
    freedom = math.sqrt(carriers / max(carriers - 3.0, 1.0))
    return max(0.5, _MAD_TO_SIGMA * float(np.median(seen)) * freedom)


def _medians(rest: FloatArray, is_seen: BoolArray) -> FloatArray:
    """Return the median (N,) over the hours of each carrier, 0 of one that was never seen."""
    ordered = np.sort(np.where(is_seen, rest, np.inf), axis=0)
    count = is_seen.sum(axis=0)
    if not len(rest):
        return np.zeros(rest.shape[1])
    low, high = (np.take_along_axis(ordered, np.maximum(at, 0)[None], 0)[0] for at in ((count - 1) // 2, count // 2))
    high = np.where(np.isfinite(high), high, low)
    return np.where(count > 0, 0.5 * (low + high), 0.0)


def _huber(sigmas: FloatArray) -> FloatArray:
    """Return Huber's weights of residuals in sigmas."""
    return np.asarray(1.0 / np.maximum(sigmas, 1.0))


def _tukey(sigmas: FloatArray) -> FloatArray:
    """Return Tukey's weights of residuals in sigmas."""
    return np.asarray(np.where(sigmas < _TUKEY_SIGMAS, np.square(1.0 - np.square(sigmas / _TUKEY_SIGMAS)), 0.0))
