"""Beams by quiet days and turns: boresight of each antenna, beams at the stations."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.calibration.geometry_calibration import GeometryCalibration
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE

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


#: powers of East and North of a surface of degree three without its constant
_POWERS = ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3))
#: dB/deg^k, one sigma of a coefficient of degree k before the data
_PRIOR = np.array([10.0, 10.0, 3.0, 3.0, 3.0, 0.5, 0.5, 0.5, 0.5])


class StationBeams(NamedTuple):
    """Beams at N stations, East and North in the antenna frame.

    Parameters
    ----------
    gradient_db_deg, gradient_sigma : ndarray, shape (N, 2), dB/deg
    covariance : ndarray, shape (N, 2, 2), dB^2/deg^2
        Of the gradients.
    curvature_db_deg2, curvature_sigma : ndarray, shape (N, 3), dB/deg^2
        East East, East North, North North.
    """

    gradient_db_deg: FloatArray
    gradient_sigma: FloatArray
    covariance: FloatArray
    curvature_db_deg2: FloatArray
    curvature_sigma: FloatArray


def station_beams(calibration: GeometryCalibration) -> StationBeams:
    """Return the beams of a calibration at its N stations; NaN where it has no coefficients."""
    size = calibration.covariance.shape[1]
    gradient, curvature = slice(size - BEAM_SIZE, size - BEAM_SIZE + 2), slice(size - BEAM_SIZE + 2, size)
    sigma = np.sqrt(np.maximum(np.diagonal(calibration.covariance, axis1=1, axis2=2), 0.0))
    return StationBeams(
        calibration.gradient,
        sigma[:, gradient],
        calibration.covariance[:, gradient, gradient],
        calibration.hessian,
        sigma[:, curvature],
    )


def changes_in_sigmas(now: StationBeams, before: StationBeams) -> FloatArray:
    """Return by how many sigmas (N,) each gradient differs from that of another calibration.

    The square is chi square of two degrees of freedom where nothing changed; 3.0 is exceeded by one in ninety.

    Examples
    --------
    >>> beam = StationBeams(np.zeros((1, 2)), np.ones((1, 2)), np.eye(2)[None], np.zeros((1, 3)), np.ones((1, 3)))
    >>> changes_in_sigmas(beam, beam._replace(gradient_db_deg=np.array([[2.0, 0.0]]))).round(3)
    array([1.414])
    """
    difference = now.gradient_db_deg - before.gradient_db_deg
    covariance = now.covariance + before.covariance
    is_known = np.asarray(np.isfinite(difference).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
    safe = np.where(is_known[:, None, None], covariance, np.eye(2))
    square = np.einsum("ni,nij,nj->n", difference, np.linalg.inv(safe), difference)
    return np.where(is_known, np.sqrt(np.maximum(square, 0.0)), np.nan)


def beam_surface(position_deg: FloatArray, beams: StationBeams) -> FloatArray:
    """Return the surface of degree three that fits gradients and curvatures of the stations of one beam.

    Parameters
    ----------
    position_deg : ndarray, shape (N, 2), deg
        East and North of the stations in the antenna frame.
    beams : StationBeams
        Of the same stations.

    Returns
    -------
    ndarray, shape (9,), dB/deg^k
        Coefficients for ``surface_db``.
    """
    slope, bend = _derivatives(position_deg)
    rows = np.concatenate([slope.reshape(-1, len(_POWERS)), bend.reshape(-1, len(_POWERS))])
    value = np.concatenate([beams.gradient_db_deg.ravel(), beams.curvature_db_deg2.ravel()])
    sigma = np.concatenate([beams.gradient_sigma.ravel(), beams.curvature_sigma.ravel()])
    is_known = np.isfinite(value) & np.isfinite(sigma) & (sigma > 0.0)
    scaled = rows[is_known] / sigma[is_known, None]
    system = np.concatenate([scaled, np.diag(1.0 / _PRIOR)])
    right = np.concatenate([value[is_known] / sigma[is_known], np.zeros(len(_POWERS))])
    return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0])


def surface_db(position_deg: FloatArray, surface: FloatArray) -> FloatArray:
    """Return the gain (...) in dB of a surface at places (..., 2), relative to that at nadir.

    Examples
    --------
    >>> surface_db(np.array([2.0, 1.0]), np.array([1.0, 0, 0, 0, 0, 0, 0, 0, 1.0]))
    np.float64(3.0)
    """
    east, north = position_deg[..., 0], position_deg[..., 1]
    return np.asarray(np.stack([east**i * north**j for i, j in _POWERS], axis=-1) @ surface)[()]


def _derivatives(position_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns of gradients (N, 2, 9) and of curvatures (N, 3, 9) of the surface."""
    east, north = position_deg[:, 0], position_deg[:, 1]

    def term(i: int, j: int, along: int, across: int) -> FloatArray:
        factor = float(np.prod(range(i - along + 1, i + 1)) * np.prod(range(j - across + 1, j + 1)))
        if along > i or across > j:
            return np.zeros(len(east))
        return np.asarray(factor * east ** (i - along) * north ** (j - across))

    def columns(orders: tuple[tuple[int, int], ...]) -> FloatArray:
        return np.stack([np.stack([term(i, j, *order) for i, j in _POWERS], axis=-1) for order in orders], axis=1)

    return columns(((1, 0), (0, 1))), columns(((2, 0), (1, 1), (0, 2)))
