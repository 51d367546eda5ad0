"""Daily and seasonal change of a boresight: one fit of an hourly series.

``b(t) = b0 + b1 t + a cos(2 pi t / day) + s sin(2 pi t / day) [+ the same over a year]``, t from midnight UTC. Sigma is
that of the scatter about the fit, widened by how much the residuals of neighbouring hours have in common. What the
series is too short for is NaN.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_HOUR_S, _DAY_S = 3600.0, 86_400.0
_YEAR_S = 365.25 * _DAY_S
#: shortest series that tells a daily change from a drift, and share of the hours of a day that it must hold
_MIN_DAILY_S, _MIN_HOURS_OF_DAY = 1.5 * _DAY_S, 16
#: shortest series that tells a yearly change from a drift
_MIN_YEARLY_S = 300.0 * _DAY_S
#: one sample is not worth less than a sixteenth of an independent one
_MAX_COMMON = 0.88


class Wave(NamedTuple):
    """A period of a fit; NaN where the series does not tell it.

    Parameters
    ----------
    amplitude_deg, sigma_deg : float, deg
        Size of the wave, and standard deviation of its cosine and sine.
    peak_s : float, s
        When it is greatest, counted from the start of the period (midnight UTC; 1 January 1970 for the year).
    """

    amplitude_deg: float
    sigma_deg: float
    peak_s: float


class BoresightFit(NamedTuple):
    """Change of one axis.

    Parameters
    ----------
    mean_deg, mean_sigma_deg : float, deg
        At the middle of the series.
    drift_deg_per_day, drift_sigma_deg_per_day : float, deg/day
    daily, yearly : Wave
    residual_rms_deg : float, deg
        Scatter of the hours about the fit.
    """

    mean_deg: float
    mean_sigma_deg: float
    drift_deg_per_day: float
    drift_sigma_deg_per_day: float
    daily: Wave
    yearly: Wave
    residual_rms_deg: float


UNKNOWN_WAVE = Wave(math.nan, math.nan, math.nan)
UNKNOWN_FIT = BoresightFit(math.nan, math.nan, math.nan, math.nan, UNKNOWN_WAVE, UNKNOWN_WAVE, math.nan)


def fit_boresight(epochs_s: FloatArray, value_deg: FloatArray, sigma_deg: FloatArray) -> BoresightFit:
    """Return mean, drift, daily and yearly change of a series.

    Parameters
    ----------
    epochs_s : ndarray, shape (H,), s
        Middle of the hours since 1 January 1970, UTC.
    value_deg, sigma_deg : ndarray, shape (H,), deg
        Boresight on one axis and its noise; NaN = not told.

    Returns
    -------
    BoresightFit
        ``UNKNOWN_FIT`` of fewer than five hours.

    Examples
    --------
    >>> hours_s = 3600.0 * np.arange(72)
    >>> wave_deg = 0.03 * np.cos(2.0 * np.pi * (hours_s - 21_600.0) / 86_400.0)
    >>> daily = fit_boresight(hours_s, wave_deg, np.full(72, 0.01)).daily
    >>> round(daily.amplitude_deg, 6), round(daily.peak_s)
    (0.03, 21600)
    """
    is_known = np.isfinite(value_deg) & np.isfinite(sigma_deg) & (sigma_deg > 0.0)
    at_s, value, weight = epochs_s[is_known], value_deg[is_known], 1.0 / sigma_deg[is_known]
    if len(at_s) < 5:
        return UNKNOWN_FIT
    span_s = float(at_s[-1] - at_s[0])
    periods_s = _resolved_periods(at_s, span_s)
    design = _columns(at_s, periods_s)
    theta = np.asarray(np.linalg.lstsq(design * weight[:, None], value * weight, rcond=None)[0], dtype=np.float64)
    rest = value - design @ theta
    sigmas = _sigmas(design, weight, rest, at_s)
    waves = {
        period_s: _wave(theta[2 + 2 * k : 4 + 2 * k], sigmas[2 + 2 * k : 4 + 2 * k], period_s)
        for k, period_s in enumerate(periods_s)
    }
    return BoresightFit(
        float(theta[0]),
        float(sigmas[0]),
        float(theta[1]),
        float(sigmas[1]),
        waves.get(_DAY_S, UNKNOWN_WAVE),
        waves.get(_YEAR_S, UNKNOWN_WAVE),
        float(np.sqrt(np.mean(np.square(rest)))),
    )


def _resolved_periods(at_s: FloatArray, span_s: float) -> list[float]:
    """Return the periods that the series is long enough for."""
    hours_of_day = len(np.unique((at_s % _DAY_S) // _HOUR_S))
    is_daily = span_s >= _MIN_DAILY_S and hours_of_day >= _MIN_HOURS_OF_DAY
    return [_DAY_S] * is_daily + [_YEAR_S] * (is_daily and span_s >= _MIN_YEARLY_S)


def _columns(at_s: FloatArray, periods_s: list[float]) -> FloatArray:
    """Return columns: constant, days from the middle, cosine and sine of each period."""
    middle_s = 0.5 * (at_s[0] + at_s[-1])
    angles = [2.0 * np.pi * (at_s % period_s) / period_s for period_s in periods_s]
    waves = [wave(angle) for angle in angles for wave in (np.cos, np.sin)]
    return np.column_stack([np.ones(len(at_s)), (at_s - middle_s) / _DAY_S, *waves])


def _sigmas(design: FloatArray, weight: FloatArray, rest: FloatArray, at_s: FloatArray) -> FloatArray:
    """Return standard deviations of the coefficients, for residuals whose neighbours have something in common."""
    scaled = rest * weight
    variance = max(1.0, float(np.square(scaled).sum() / max(len(rest) - design.shape[1], 1)))
    is_next = np.diff(at_s) < 1.5 * _HOUR_S
    before, after = scaled[:-1][is_next], scaled[1:][is_next]
    size = float(np.sqrt(np.square(before).sum() * np.square(after).sum()))
    common = float(np.clip(before @ after / size, 0.0, _MAX_COMMON)) if size > 0.0 else 0.0
    normal = (design * np.square(weight)[:, None]).T @ design
    widened = variance * (1.0 + common) / (1.0 - common)
    return np.asarray(np.sqrt(widened * np.diagonal(np.linalg.pinv(normal))))


def _wave(parts: FloatArray, sigmas: FloatArray, period_s: float) -> Wave:
    """Return a wave from its cosine and sine."""
    angle = math.atan2(float(parts[1]), float(parts[0])) % (2.0 * math.pi)
    return Wave(float(np.hypot(*parts)), float(np.sqrt(np.mean(np.square(sigmas)))), angle / (2.0 * math.pi) * period_s)
