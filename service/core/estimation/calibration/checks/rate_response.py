"""Response of the reported rates of the body to the calibration turns: sign, order and scale of their axes.

    r = A z + c        r rate that the angles of the sensors make, z as reported; A = 1 and c = 0 of true telemetry

    r_yaw = yaw' + w roll,  r_roll = roll' - w yaw,  r_pitch = pitch'        w = orbital rate

The noise of z is small beside that of r, so that A is not drawn to zero. The law of this file: z is the mean since the
record before, pitch without the turn of the orbit; what the turns do not determine is NaN.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_ORBITAL_RATE_PER_H = 0.2625162
#: records are taken together until they span so much, and those further apart tell nothing, h
_SPAN_H, _APART_H = 1.0 / 60.0, 1.0 / 6.0
#: a coefficient counts as determined up to this sigma, a great one up to this share
DETERMINED = 0.2
#: share by which epochs and readings of a record may make a coefficient wrong, and the same of the rate at rest, deg/h
_EPOCH_SHARE, _REST_DEG_H = 0.03, 0.1
#: fewest spans beyond the unknowns of an axis
_LEAST_FREE = 10


class RateResponse(NamedTuple):
    """Response of the rates to the turns; order yaw, roll, pitch.

    Parameters
    ----------
    coefficient, sigma : ndarray, shape (3, 3)
        A and one standard deviation; NaN = not determined.
    rest_deg_h, rest_sigma_deg_h : ndarray, shape (3,), deg/h
        c and one standard deviation.
    spans : int
        Spans that were compared.
    """

    coefficient: FloatArray
    sigma: FloatArray
    rest_deg_h: FloatArray
    rest_sigma_deg_h: FloatArray
    spans: int

    @property
    def is_determined(self) -> bool:
        """Return whether the turns tell the response to each axis."""
        return bool((self.sigma.diagonal() <= DETERMINED).all())

    def deviation(self, bias_deg_h: float) -> float:
        """Return the greatest deviation from true telemetry of a bias of a size, sigmas; 0 without any response."""
        if not self.spans:
            return 0.0
        off = np.abs(self.coefficient - np.eye(3)) / np.hypot(self.sigma, _EPOCH_SHARE)
        is_known = self.sigma <= DETERMINED * np.maximum(1.0, np.abs(self.coefficient))
        rest = np.abs(self.rest_deg_h) / np.hypot(self.rest_sigma_deg_h, np.hypot(_REST_DEG_H, bias_deg_h))
        return float(np.max(np.concatenate([off[is_known], rest])))


def rate_response(epochs_h: FloatArray, reported_deg_h: FloatArray, attitude_deg: FloatArray) -> RateResponse:
    """Return the response of the reported rates to the turns.

    Parameters
    ----------
    epochs_h : ndarray, shape (K,), h
        Epochs of the records, ascending.
    reported_deg_h : ndarray, shape (K, 3), deg/h
        Mean rates since the record before, yaw, roll, pitch.
    attitude_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch by the sensors; spans from or to NaN take no part.
    """
    edges = _edges(epochs_h)
    gained = np.vstack([np.zeros(3), np.cumsum(reported_deg_h[1:] * np.diff(epochs_h)[:, None], axis=0)])
    span = np.diff(epochs_h[edges])[:, None]
    mean, angles = np.diff(gained[edges], axis=0) / span, attitude_deg[edges]
    yaw, roll, _ = (0.5 * (angles[1:] + angles[:-1])).T
    turned = np.diff(angles, axis=0) / span
    turned += _ORBITAL_RATE_PER_H * np.column_stack([roll, -yaw, np.zeros(len(yaw))])
    used = np.isfinite(turned).all(axis=1) & np.isfinite(mean).all(axis=1) & (span[:, 0] <= _APART_H)
    return _fit(mean[used], turned[used])


def _edges(epochs_h: FloatArray) -> NDArray[np.int64]:
    """Return the records (k,) that bound spans."""
    edges: list[int] = []
    for number, epoch_h in enumerate(epochs_h.tolist()):
        # a millisecond less: epochs come in hours
        if not edges or epoch_h - epochs_h[edges[-1]] >= _SPAN_H - 3e-7:
            edges.append(number)
    return np.array(edges, dtype=np.int64)


def _fit(mean: FloatArray, turned: FloatArray) -> RateResponse:
    """Return the response of the turned rates (k, 3) to the reported ones (k, 3)."""
    design = np.column_stack([mean, np.ones(len(mean))])
    free = len(mean) - design.shape[1]
    if free < _LEAST_FREE or np.linalg.matrix_rank(design) < design.shape[1]:
        unknown = np.full((3, 3), np.nan)
        return RateResponse(unknown, unknown, unknown[0], unknown[0], 0)
    solved = np.asarray(np.linalg.lstsq(design, turned, rcond=None)[0], dtype=np.float64)
    scatter = np.square(turned - design @ solved).sum(axis=0) / free
    sigma: FloatArray = np.sqrt(np.outer(scatter, np.linalg.inv(design.T @ design).diagonal()))
    return RateResponse(solved[:3].T, sigma[:, :3], solved[3], sigma[:, 3], len(mean))
