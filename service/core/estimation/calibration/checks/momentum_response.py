"""Response of the reported wheel momentum to the calibration turns: sign, order and scale of its axes.

    hx = a_x ((hy + (Jx - Jy) w) yaw - hz pitch) + slow     w = orbital rate; hx, hy, hz as reported, slow: a cubic
    hy = a_y (hz roll - hx yaw) + slow
    hz = a_z (hx pitch - (hy + (Jz - Jy) w) roll) + slow    a = 1 of true telemetry

A wrong sign, an exchange of axes and a wrong scale of one axis change a; a factor that all axes share does not, because
it changes both sides. The law of this file: records during slews take no part, nor do records before and after a jump
that no turn explains; what the turns do not determine is NaN.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_ORBITAL_RATE_RAD_S = 7.292115e-5
#: degree of the slow motion of the momentum by torques and by the orbit
_SLOW_DEGREE = 3
#: turns change a record by this share of the greatest momentum and angle at most; what changes it more is a jump
_JUMP_SHARE = 3.0
#: fewest records beyond the unknowns of an axis
_LEAST_FREE = 4
#: a coefficient counts as determined up to this sigma
DETERMINED = 0.2
#: share by which noise of the sensor may make a coefficient too small
_SENSOR_SHARE = 0.02


class MomentumResponse(NamedTuple):
    """Response of the momentum to the turns; order roll, pitch, yaw.

    Parameters
    ----------
    coefficient, sigma : ndarray, shape (3,)
        a and one standard deviation; NaN = not determined.
    mean_n_m_s : ndarray, shape (3,), N m s
        Mean of the records that were used.
    records : int
        Records that were used: the longest stretch without jump or unloading, without slews.
    stretches : int
        Stretches that jumps and unloadings make of the turns.
    """

    coefficient: FloatArray
    sigma: FloatArray
    mean_n_m_s: FloatArray
    records: int
    stretches: int

    @property
    def is_determined(self) -> bool:
        """Return whether the turns tell the response along roll and yaw."""
        return bool((self.sigma[[0, 2]] <= DETERMINED).all())

    def deviation(self, scale_error: float) -> float:
        """Return the greatest deviation from true telemetry of a stated scale error, sigmas; 0 without any response.

        Each axis is judged, and roll and yaw together, which a wrong pitch axis moves alike.
        """
        known = self.sigma <= DETERMINED
        if not known.any():
            return 0.0
        off = self.coefficient[known] - 1.0
        own = np.hypot(self.sigma[known], np.hypot(np.sqrt(2.0) * scale_error, _SENSOR_SHARE))
        single = float(np.abs(off / own).max())
        if not self.is_determined:
            return single
        both = 1.0 / np.square(own[[0, -1]])
        return max(single, float(abs(both @ off[[0, -1]]) / np.sqrt(both.sum())))


def momentum_response(
    epochs_s: FloatArray,
    reported_n_m_s: FloatArray,
    attitude_deg: FloatArray,
    is_slewing: BoolArray,
    is_unloading: BoolArray,
    inertia_kg_m2: FloatArray,
) -> MomentumResponse:
    """Return the response of the reported momentum to the turns.

    Parameters
    ----------
    epochs_s : ndarray, shape (K,), s
        Epochs of the records, ascending.
    reported_n_m_s : ndarray, shape (K, 3), N m s
        Momentum of the wheels along roll, pitch, yaw of the body.
    attitude_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch by the sensors; NaN rows take no part.
    is_slewing : ndarray of bool, shape (K,)
        The spacecraft turns: its own momentum is in the record.
    is_unloading : ndarray of bool, shape (K,)
        Thrusters unload the wheels at the record.
    inertia_kg_m2 : ndarray, shape (3,), kg m^2
        About roll, pitch, yaw.
    """
    known = np.isfinite(attitude_deg).all(axis=1) & np.isfinite(reported_n_m_s).all(axis=1)
    reach_rad = float(np.radians(np.abs(attitude_deg[known]).max(initial=0.0)))
    label = _stretches(reported_n_m_s, reach_rad, is_unloading)
    usable = known & ~is_slewing & ~is_unloading
    counts = np.bincount(label[usable], minlength=1)
    used = usable & (label == int(np.argmax(counts)))
    momentum = reported_n_m_s[used]
    turned = _turned(momentum, np.radians(attitude_deg[used]), inertia_kg_m2)
    slow = _slow(epochs_s[used])
    fits = np.array([_fit(turned[:, axis], momentum[:, axis], slow) for axis in range(3)])
    mean = momentum.mean(axis=0) if len(momentum) else np.full(3, np.nan)
    return MomentumResponse(fits[:, 0], fits[:, 1], mean, int(used.sum()), int(label.max(initial=-1)) + 1)


def _stretches(reported: FloatArray, reach_rad: float, is_unloading: BoolArray) -> NDArray[np.int64]:
    """Return the number (K,) of the stretch of each record; an unloading or a jump begins the next one."""
    if not len(reported):
        return np.zeros(0, dtype=np.int64)
    step = np.abs(np.diff(reported, axis=0)).max(axis=1)
    size = float(np.median(np.linalg.norm(reported, axis=1)))
    # scatter of a record, with a floor for a momentum that is reported in steps
    scatter = 1.4826 * float(np.median(step)) if len(step) else 0.0
    is_jump = step > _JUMP_SHARE * (size * reach_rad + 2.0 * scatter)
    begins = np.append(False, is_jump) | is_unloading
    begins[0] = False
    return np.cumsum(begins).astype(np.int64)


def _turned(momentum: FloatArray, attitude: FloatArray, inertia: FloatArray) -> FloatArray:
    """Return what turns (K, 3) rad move of the momentum (K, 3) along roll, pitch, yaw."""
    (yaw, roll, pitch), (x, y, z) = attitude.T, momentum.T
    about_roll, about_yaw = (inertia[[0, 2]] - inertia[1]) * _ORBITAL_RATE_RAD_S
    return np.column_stack([(y + about_roll) * yaw - z * pitch, z * roll - x * yaw, x * pitch - (y + about_yaw) * roll])


def _slow(epochs_s: FloatArray) -> FloatArray:
    """Return the columns (K, 4) of the slow motion."""
    span = float(np.ptp(epochs_s)) if len(epochs_s) else 0.0
    if span == 0.0:
        return np.ones((len(epochs_s), 1))
    scaled = 2.0 * (epochs_s - epochs_s[0]) / span - 1.0
    return np.polynomial.legendre.legvander(scaled, _SLOW_DEGREE)


def _fit(turned: FloatArray, momentum: FloatArray, slow: FloatArray) -> tuple[float, float]:
    """Return the coefficient of one axis and its sigma by the scatter of the records."""
    free = len(momentum) - slow.shape[1] - 1
    if free < _LEAST_FREE:
        return float("nan"), float("nan")
    basis = np.linalg.qr(slow)[0]
    column, value = (part - basis @ (basis.T @ part) for part in (turned, momentum))
    size = float(column @ column)
    if size == 0.0:
        return float("nan"), float("nan")
    coefficient = float(column @ value) / size
    left = value - coefficient * column
    return coefficient, float(np.sqrt(left @ left / free / size))
