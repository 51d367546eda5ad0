"""Predicted scatter of a measured carrier power, from the settings of the sweep alone.

A Gaussian resolution filter of 3 dB width RBW has the noise bandwidth ``ENBW = RBW sqrt(pi / (4 ln 2)) = 1.0645 RBW``.
Power detected in it over a dwell t is a sum of about ``N = sqrt(2) ENBW t`` independent exponential powers; over a
swept band B the dwell is ``T B / span``. Then, with r = noise / carrier power in the integration band,

    sigma_dB = 4.343 sqrt((1 + 2 r) / N_c + r^2 (1 / N_b + 1 / N_n))

N_c over the carrier's own band, N_b over the integration band, N_n over the noise windows; K averaged sweeps multiply
every N by K. A line (beacon) does not scatter by itself, only by the noise beside it: its first term is
``sqrt(2 / (CNR ENBW t))`` instead, CNR taken in the ENBW and t the dwell of one ENBW.
"""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf

from service.core.radio.decibel import DB_PER_NEPER, FloatArray

#: ENBW / RBW of a Gaussian filter, sqrt(pi / (4 ln 2))
GAUSSIAN_ENBW_RATIO = math.sqrt(math.pi / (4.0 * math.log(2.0)))


def degrees_of_freedom(enbw_hz: ArrayLike, dwell_s: ArrayLike) -> FloatArray:
    """Return the equivalent number of independent exponential powers in a dwell.

    Parameters
    ----------
    enbw_hz : array_like, Hz
        Noise bandwidth of the resolution filter.
    dwell_s : array_like, s
        Time over which power is averaged.

    Returns
    -------
    ndarray
        N >= 1; the mean of N exponential powers has the relative variance 1/N.

    Notes
    -----
    ``1/N = sqrt(pi) erf(x)/x - (1 - exp(-x^2))/x^2`` with ``x = sqrt(2 pi) ENBW t``: the variance of the mean of a
    process whose power has a Gaussian autocovariance. It tends to 1 for short and to sqrt(2) ENBW t for long dwells.

    Examples
    --------
    >>> float(round(degrees_of_freedom(1.0e4, 1.0) / 1.0e4, 2))
    1.41
    """
    x = np.maximum(math.sqrt(2.0 * math.pi) * np.asarray(enbw_hz) * np.asarray(dwell_s), 1e-3)
    inverse = math.sqrt(math.pi) * erf(x) / x + np.expm1(-np.square(x)) / np.square(x)
    return np.asarray(1.0 / inverse, dtype=np.float64)


def carrier_sigma_db(
    noise_to_carrier: ArrayLike,
    carrier_dof: ArrayLike,
    band_dof: ArrayLike,
    noise_dof: ArrayLike,
) -> FloatArray:
    """Return the standard deviation of a noise-subtracted carrier power.

    Parameters
    ----------
    noise_to_carrier : array_like
        r, noise over carrier power in the integration band.
    carrier_dof, band_dof, noise_dof : array_like
        N_c over the carrier, N_b over the integration band, N_n over the noise windows.

    Returns
    -------
    ndarray, dB
        One standard deviation; NaN where r is NaN.

    Examples
    --------
    >>> round(float(carrier_sigma_db(0.0, 1505.0 * 30, 1e9, 1e9)), 4)
    0.0204
    """
    r = np.asarray(noise_to_carrier, dtype=np.float64)
    variance = (1.0 + 2.0 * r) / np.asarray(carrier_dof)
    variance = variance + np.square(r) * (1.0 / np.asarray(band_dof) + 1.0 / np.asarray(noise_dof))
    return np.asarray(DB_PER_NEPER * np.sqrt(variance), dtype=np.float64)


def line_sigma_db(
    noise_to_carrier: ArrayLike,
    line_time_bandwidth: ArrayLike,
    integration_to_enbw: ArrayLike,
    band_dof: ArrayLike,
    noise_dof: ArrayLike,
) -> FloatArray:
    """Return the standard deviation of the noise-subtracted power of an unmodulated line.

    Parameters
    ----------
    noise_to_carrier : array_like
        r, noise over carrier power in the integration band.
    line_time_bandwidth : array_like
        ENBW times the time that the sweep dwells on one ENBW.
    integration_to_enbw : array_like
        Integration bandwidth over ENBW; turns r into the ratio inside the filter.
    band_dof, noise_dof : array_like
        N_b over the integration band, N_n over the noise windows.

    Returns
    -------
    ndarray, dB
        One standard deviation.
    """
    r = np.asarray(noise_to_carrier, dtype=np.float64)
    inverse_cnr = r / np.asarray(integration_to_enbw)
    variance = 2.0 * inverse_cnr / np.asarray(line_time_bandwidth)
    variance = variance + np.square(r) * (1.0 / np.asarray(band_dof) + 1.0 / np.asarray(noise_dof))
    return np.asarray(DB_PER_NEPER * np.sqrt(variance), dtype=np.float64)
