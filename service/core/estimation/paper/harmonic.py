"""The daily harmonic of a carrier's power, as the paper fits it.

``S_i = h + a1 cos(p_i) + a2 sin(p_i)``, the same as ``am cos(p_i + phi) + h`` with ``am = hypot(a1, a2)`` and
``phi = atan2(-a2, a1)`` (equations 3 to 6). S and h are powers in dBm, am, a1, a2 in dB, p is the phase in rad since
the ascending node (``service.core.geometry.node_phase``). Only samples with ``|Func_i - S_i| < 3 sigma`` take part,
where ``sigma^2 = sum (Func_i - S_i)^2 / N``; ``sigma_clip`` holds the rule and how it ends.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from service.core.estimation.paper.sigma_clip import fit_clipped

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

#: Fewer samples than this are no fit.
MIN_SAMPLES = 8


class HarmonicFit(NamedTuple):
    """Harmonic of one carrier; all NaN when it cannot be fitted.

    Parameters
    ----------
    amplitude_db : float, dB
        am >= 0.
    phase_rad : float, rad
        phi in (-pi, pi].
    offset_dbm : float, dBm
        h.
    rms_db : float, dB
        The paper's sigma over the samples used.
    samples_used, samples_rejected : int
        Present samples in the fit and outside the gate; both 0 without a fit.
    converged : bool
        The rejection reached a fixed point.
    covariance : ndarray, shape (3, 3), dB^2
        Of (h, a1, a2), from the residuals with N - 3 degrees of freedom, as if they were independent.
    """

    amplitude_db: float
    phase_rad: float
    offset_dbm: float
    rms_db: float
    samples_used: int
    samples_rejected: int
    converged: bool
    covariance: FloatArray


class HarmonicFits(NamedTuple):
    """Harmonics of N carriers: the fields of :class:`HarmonicFit` with a leading axis N.

    Parameters
    ----------
    amplitude_db, phase_rad, offset_dbm, rms_db : ndarray, shape (N,)
        As in :class:`HarmonicFit`.
    samples_used, samples_rejected : ndarray of int, shape (N,)
        As in :class:`HarmonicFit`.
    converged : ndarray of bool, shape (N,)
        As in :class:`HarmonicFit`.
    covariance : ndarray, shape (N, 3, 3), dB^2
        As in :class:`HarmonicFit`.
    is_used : ndarray of bool, shape (T, N)
        Samples in the fit.
    """

    amplitude_db: FloatArray
    phase_rad: FloatArray
    offset_dbm: FloatArray
    rms_db: FloatArray
    samples_used: IntArray
    samples_rejected: IntArray
    converged: BoolArray
    covariance: FloatArray
    is_used: BoolArray


def fit_harmonics(
    phase_rad: FloatArray, power_dbm: FloatArray, max_iterations: int = 50, gate_sigma: float = 3.0
) -> HarmonicFits:
    """Return the daily harmonic of many carriers measured at the same epochs.

    Parameters
    ----------
    phase_rad : ndarray, shape (T,), rad
        Phase since the ascending node. NaN makes the row absent.
    power_dbm : ndarray, shape (T, N), dBm
        NaN marks an absent sample.
    max_iterations : int
        Limit of rejection passes.
    gate_sigma : float
        Half width of the gate in sigmas.

    Returns
    -------
    HarmonicFits
        Fewer than eight samples, or phases that do not determine three unknowns, give NaN.
    """
    basis = np.stack([np.ones_like(phase_rad), np.cos(phase_rad), np.sin(phase_rad)], axis=-1)
    is_present = np.isfinite(power_dbm) & np.isfinite(phase_rad)[:, np.newaxis]
    count = np.maximum(is_present.sum(axis=0), 1)
    level_dbm = np.where(is_present, power_dbm, 0.0).sum(axis=0) / count
    fit = fit_clipped(
        basis,
        power_dbm - level_dbm,
        gate_sigma=gate_sigma,
        max_iterations=max_iterations,
        min_samples=MIN_SAMPLES,
    )
    h, a1, a2 = fit.coefficients.T
    used = fit.is_used.sum(axis=0).astype(np.int64)
    variance_db2 = fit.rms_db**2 * used / np.maximum(used - 3, 1)
    return HarmonicFits(
        amplitude_db=np.hypot(a1, a2),
        phase_rad=np.arctan2(-a2, a1),
        offset_dbm=h + level_dbm,
        rms_db=fit.rms_db,
        samples_used=used,
        samples_rejected=np.where(used > 0, is_present.sum(axis=0) - used, 0).astype(np.int64),
        converged=fit.is_converged,
        covariance=fit.normal_inverse * variance_db2[:, np.newaxis, np.newaxis],
        is_used=fit.is_used,
    )


def fit_harmonic(
    phase_rad: FloatArray, power_dbm: FloatArray, max_iterations: int = 50, gate_sigma: float = 3.0
) -> HarmonicFit:
    """Return the daily harmonic of one carrier.

    Parameters
    ----------
    phase_rad : ndarray, shape (T,), rad
        Phase since the ascending node. NaN makes the sample absent.
    power_dbm : ndarray, shape (T,), dBm
        NaN marks an absent sample.
    max_iterations : int
        Limit of rejection passes.
    gate_sigma : float
        Half width of the gate in sigmas.

    Returns
    -------
    HarmonicFit
        Fewer than eight samples, or phases that do not determine three unknowns, give NaN.

    Notes
    -----
    The published curve (am 0.3489 dB, phi -0.6178 rad, h -72.8866 dBW) is recovered to 1e-9 from 1440 samples
    (``tests/regression/test_demo_world.py``).

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, equations (3) to (6).

    Examples
    --------
    >>> phase_rad = np.linspace(0.0, 6.0, 40)
    >>> fit = fit_harmonic(phase_rad, 0.35 * np.cos(phase_rad - 0.6) - 42.0)
    >>> round(fit.amplitude_db, 9), round(fit.phase_rad, 9), round(fit.offset_dbm, 9), fit.samples_used
    (0.35, -0.6, -42.0, 40)
    """
    fits = fit_harmonics(phase_rad, power_dbm[:, np.newaxis], max_iterations, gate_sigma)
    return HarmonicFit(
        amplitude_db=float(fits.amplitude_db[0]),
        phase_rad=float(fits.phase_rad[0]),
        offset_dbm=float(fits.offset_dbm[0]),
        rms_db=float(fits.rms_db[0]),
        samples_used=int(fits.samples_used[0]),
        samples_rejected=int(fits.samples_rejected[0]),
        converged=bool(fits.converged[0]),
        covariance=fits.covariance[0],
    )


def evaluate_harmonic(phase_rad: ArrayLike, amplitude_db: ArrayLike, phase_rad_of_fit: ArrayLike) -> FloatArray:
    """Return the harmonic with h = 0, the part that is taken off the power deviation.

    Parameters
    ----------
    phase_rad : array_like, shape (T,) or (), rad
        Phase since the ascending node.
    amplitude_db : array_like, shape (N,) or (), dB
        am of each carrier.
    phase_rad_of_fit : array_like, shape (N,) or (), rad
        phi of each carrier.

    Returns
    -------
    ndarray, shape (T, N), dB
        ``am cos(phase + phi)``; an axis given as a number is absent from the shape.

    Examples
    --------
    >>> evaluate_harmonic([0.0, np.pi], [0.5], [0.0])
    array([[ 0.5],
           [-0.5]])
    """
    angle_rad = np.add.outer(np.asarray(phase_rad, dtype=np.float64), np.asarray(phase_rad_of_fit, dtype=np.float64))
    return np.asarray(np.asarray(amplitude_db, dtype=np.float64) * np.cos(angle_rad))
