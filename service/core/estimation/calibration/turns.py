"""Turns by the powers against those of the attitude sensor: lag of the clocks, what turns leave, scale of the angles.

The law of this file: of the calibration that it judges, a lag takes only levels, daily change and noise of quiet days.
Every carrier answers with slopes and curvatures of its own, so that exchanged or flipped axes do not look like a lag.
What the carriers of a band share, the receiving chain and rain at its site, is taken out, and each carrier weighs by
its own scatter: rain over some stations costs only those.
"""

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.calibration.geometry_columns import BEAM_SIZE, CarrierGeometry, response_monomials
from service.core.estimation.calibration.whitened_fit import ColouredNoise, stretch_variance_db2, whitened_rows
from service.core.estimation.robust_statistics import MAD_TO_SIGMA, middle_values

#: from epochs (K,), s, to yaw, roll, pitch (K, 3), deg, by the sensor; NaN = not known
Attitude = Callable[[FloatArray], FloatArray]

#: s, lags that are tried: every zone of time
LONGEST_LAG_S = 14 * 3600.0
#: s, steps of the lag in means of five minutes and in rows, and how far from the former the latter look
_COARSE_S, _FINE_S, _REACH_S = 120.0, 20.0, 140.0
#: s, rows that are read before and after the turns, and distance of two peaks
_MARGIN_S = 600.0
_MEAN_S, _MOST_ROWS = 300.0, 600
#: peaks of the coarse search that are looked at in rows
_PEAKS = 3
#: degree of a carrier's slow change over the rows
_SLOW_DEGREE = 2
_MONOMIALS = 9
#: fewest rows beyond the unknowns, and carriers of a band from which their common change is known
_LEAST_FREE, _LEAST_OF_BAND = 20, 3
#: sigmas beyond which a change counts as that large; sigma of Tracy and Widom
_HELD_SIGMAS, _TRACY_WIDOM_SIGMA = 4.0, 1.27
#: share of the rows in which a carrier must be seen
_SEEN_SHARE = 0.5
#: the peak is a parabola within this loss of log likelihood
_PARABOLA = 8.0


class TurnPowers(NamedTuple):
    """Powers of N carriers in T rows around the turns.

    Parameters
    ----------
    epoch_s : ndarray, shape (T,), s
        Ascending.
    power_db : ndarray, shape (T, N), dB
        Level and daily change removed; NaN = absent.
    band : ndarray of int, shape (N,)
        Carriers of one band share their receiving chain.
    noise : ColouredNoise
        Own noise of the carriers on quiet days.
    """

    epoch_s: FloatArray
    power_db: FloatArray
    band: IntArray
    noise: ColouredNoise


class _Means(NamedTuple):
    """Means of rows: B of them, N carriers."""

    epoch_s: FloatArray
    power_db: FloatArray
    seen: FloatArray
    span_s: FloatArray
    #: (B,) first row of each
    first: IntArray


class TurnLag(NamedTuple):
    """Lag of the powers behind the sensor, positive = they are late, by L lags that were tried.

    Parameters
    ----------
    lags_s, likelihood : ndarray, shape (L,), s
        Lags, and their log likelihood over that of no turns.
    gain : float
        Log likelihood of the best over that of no lag.
    left : ndarray, shape (N,)
        Squares of what turns leave of the powers over those of the noise; NaN = not used.
    shared_sigmas : float
        How far more the carriers share of it than chance: rain does not hit all at once, an unseen turn does.
    """

    lags_s: FloatArray
    likelihood: FloatArray
    gain: float
    left: FloatArray
    shared_sigmas: float

    @property
    def best(self) -> tuple[float, float]:
        """Lag of the highest likelihood, s, and one standard deviation by its curvature."""
        return _parabola(self.lags_s, self.likelihood, 0.5 * _REACH_S)

    @property
    def weight(self) -> FloatArray:
        """Weight of each carrier in what all share: one that scatters more than noise does is in rain."""
        return 1.0 / np.square(np.maximum(self.left, 1.0))


def turn_lag(powers: TurnPowers, turns_s: tuple[float, float], attitude_at: Attitude) -> TurnLag | None:
    """Return the lag of the powers; None where they are too few.

    Parameters
    ----------
    powers : TurnPowers
        Rows of the turns and as far to both sides as there are any.
    turns_s : tuple of float, s
        First and last epoch of the turns by the sensor.
    attitude_at : callable
        As ``Attitude``.

    Notes
    -----
    By the profile likelihood, of which every carrier's slopes, curvatures and variance are the other unknowns.
    """
    epoch_s, seen = powers.epoch_s, np.isfinite(powers.power_db)
    within = (epoch_s >= turns_s[0]) & (epoch_s <= turns_s[1])
    used = np.flatnonzero(seen[within].mean(axis=0) >= _SEEN_SHARE) if within.any() else np.zeros(0, dtype=np.int64)
    if not len(used):
        return None
    own = TurnPowers(
        epoch_s, powers.power_db[:, used], powers.band[used], ColouredNoise(*(part[used] for part in powers.noise))
    )
    still = _whitened(_less_common(own, np.ones(len(used))), turns_s, 0.0, attitude_at, reach_s=0.0)
    lags_s = np.arange(-LONGEST_LAG_S, LONGEST_LAG_S + 1.0, _COARSE_S)
    dry = _less_common(own, still.weight)
    peaks = [0.0, *_peaks(lags_s, _coarse(dry, lags_s, attitude_at))]
    best = max((_whitened(dry, turns_s, near_s, attitude_at) for near_s in peaks), key=lambda one: one.gain)
    dry = _less_common(own, best.weight)
    near = {0.0, best.best[0]}
    best = max((_whitened(dry, turns_s, near_s, attitude_at) for near_s in near), key=lambda one: one.gain)
    if not math.isfinite(best.gain):
        return None
    left = np.full(powers.power_db.shape[1], np.nan)
    left[used] = best.left
    return best._replace(left=left)


def _less_common(powers: TurnPowers, weight: FloatArray | None) -> TurnPowers:
    """Return powers less what the carriers of a band have in common: their mean by weights (N,), or their median."""
    power_db = powers.power_db.copy()
    for one in np.unique(powers.band):
        members = np.flatnonzero(powers.band == one)
        own = power_db[:, members]
        seen = np.isfinite(own)
        if len(members) < _LEAST_OF_BAND:
            continue
        if weight is None:
            common = middle_values(own, axis=1)[0][:, np.newaxis]
        else:
            share = seen * weight[members]
            common = np.nansum(share * own, axis=1, keepdims=True)
            common /= np.maximum(share.sum(axis=1, keepdims=True), 1e-300)
        power_db[:, members] = own - common
    return powers._replace(power_db=power_db)


def _means(epoch_s: FloatArray, power_db: FloatArray, width_s: float) -> _Means:
    """Return means of the rows (T, N) within each width."""
    number = np.floor(epoch_s / width_s) if width_s > 0.0 else np.arange(len(epoch_s))
    first = np.flatnonzero(np.diff(number, prepend=-np.inf))
    rows = np.diff(first, append=len(epoch_s))
    seen = np.isfinite(power_db)
    count = np.add.reduceat(seen.astype(np.float64), first)
    mean_db = np.add.reduceat(np.where(seen, power_db, 0.0), first) / np.maximum(count, 1.0)
    period_s = float(np.median(np.diff(epoch_s))) if len(epoch_s) > 1 else 1.0
    return _Means(np.add.reduceat(epoch_s, first) / rows, mean_db, count, rows * period_s, first)


def _answers(means: _Means, epoch_s: FloatArray, lags_s: FloatArray, attitude_at: Attitude) -> Iterator[FloatArray]:
    """Yield for each lag the means (B, 9) of the monomials of the attitude, NaN = not known."""
    rows = np.diff(means.first, append=len(epoch_s))[:, np.newaxis]
    for lag_s in lags_s.tolist():
        yield np.add.reduceat(response_monomials(attitude_at(epoch_s - lag_s)), means.first) / rows


def _slow(epoch_s: FloatArray) -> FloatArray:
    """Return the columns (B, 3) of a carrier's slow change."""
    scaled = 2.0 * (epoch_s - epoch_s[0]) / max(float(np.ptp(epoch_s)), 1.0) - 1.0
    return np.polynomial.legendre.legvander(scaled, _SLOW_DEGREE)


def _coarse(powers: TurnPowers, lags_s: FloatArray, attitude_at: Attitude) -> FloatArray:
    """Return the log likelihood (L,) of each lag over that of no turns, by changes between means of equal weight."""
    means = _means(powers.epoch_s, powers.power_db, _MEAN_S)
    change_db = np.diff(means.power_db, axis=0)
    is_seen = (means.seen[1:] > 0) & (means.seen[:-1] > 0)
    found = np.full(len(lags_s), -np.inf)
    for k, turned in enumerate(_answers(means, powers.epoch_s, lags_s, attitude_at)):
        changed = np.diff(turned, axis=0)
        known = np.isfinite(changed).all(axis=1)
        columns = np.tile(changed[known], (change_db.shape[1], 1, 1))
        found[k], _ = _explained(columns, change_db[known].T, is_seen[known].T.astype(np.float64), 0)
    return found


def _whitened(
    powers: TurnPowers,
    turns_s: tuple[float, float],
    near_s: float,
    attitude_at: Attitude,
    reach_s: float = _REACH_S,
) -> TurnLag:
    """Return what lags near one say in whitened rows of the turns, of the powers and of the sensor."""
    begin_s, end_s = turns_s
    epoch_s = powers.epoch_s
    around = np.zeros(len(epoch_s), dtype=np.bool_)
    for lag_s in (0.0, near_s):
        around |= (epoch_s >= begin_s + lag_s - _MARGIN_S) & (epoch_s <= end_s + lag_s + _MARGIN_S)
    lags_s = np.append(near_s + np.arange(-reach_s, reach_s + 1.0, _FINE_S), 0.0)
    width_s = np.ptp(epoch_s[around]) / _MOST_ROWS if around.sum() > _MOST_ROWS else 0.0
    means = _means(epoch_s[around], powers.power_db[around], float(width_s))
    turned = np.stack(list(_answers(means, epoch_s[around], lags_s, attitude_at)), axis=1)
    known = np.asarray(np.isfinite(turned).reshape(len(turned), -1).all(axis=1))
    count = np.where(known[:, np.newaxis], means.seen, 0.0).T
    slow = _slow(means.epoch_s)
    size, is_seen = slow.shape[1], (count > 0).astype(np.float64)
    shared = np.concatenate([slow, np.nan_to_num(turned).reshape(len(known), -1)], axis=1)
    rows = np.concatenate([np.tile(shared, (len(count), 1, 1)), means.power_db.T[..., np.newaxis]], axis=2)
    variance = stretch_variance_db2(powers.noise, count, means.span_s)
    white = whitened_rows(rows, means.epoch_s, variance, powers.noise, is_seen)
    columns = [[*range(size), *range(size + _MONOMIALS * k, size + _MONOMIALS * (k + 1))] for k in range(len(lags_s))]
    fits = [_explained(white[..., chosen], white[..., -1], is_seen, size) for chosen in columns]
    likelihood = np.array([one for one, _ in fits])
    best = int(likelihood[:-1].argmax())
    missed_db = rows[..., -1] - (rows[..., columns[best]] @ fits[best][1])[..., 0]
    missed = powers._replace(power_db=np.where(count > 0, missed_db, np.nan).T)
    # by the median: one carrier in rain must not lend all its own
    missed_db = _less_common(missed, None).power_db
    figures = _left(means.epoch_s, missed_db, powers.noise), _shared_sigmas(means.epoch_s, missed_db)
    return TurnLag(lags_s[:-1], likelihood[:-1], float(likelihood[best] - likelihood[-1]), *figures)


def _left(epoch_s: FloatArray, missed_db: FloatArray, noise: ColouredNoise) -> FloatArray:
    """Return the squares (N,) of what turns leave (B, N), in means of ten minutes, over those of the noise."""
    means = _means(epoch_s, missed_db, 2.0 * _MEAN_S)
    variance = stretch_variance_db2(noise, means.seen.T, means.span_s)
    is_seen = means.seen.T > 0
    return np.asarray((means.power_db.T**2 / variance).sum(axis=1) / np.maximum(is_seen.sum(axis=1), 1))


def _shared_sigmas(epoch_s: FloatArray, missed_db: FloatArray) -> float:
    """Return by how many sigmas the largest part that carriers share of changes (B, N) exceeds that of chance.

    The largest eigenvalue of chance has the law of Tracy and Widom (Johnstone, Annals of Statistics 29, 2001).
    """
    means = _means(epoch_s, missed_db, _MEAN_S)
    change_db = np.diff(means.power_db, axis=0)[((means.seen[1:] > 0) & (means.seen[:-1] > 0)).all(axis=1)]
    change_db = change_db[:, np.ptp(change_db, axis=0) > 0.0] if len(change_db) else change_db
    rows, carriers = change_db.shape
    if rows <= carriers or carriers < _LEAST_OF_BAND:
        return 0.0
    # a step or an impulse of one carrier is no correlation
    scale = np.maximum(MAD_TO_SIGMA * np.median(np.abs(change_db), axis=0), 1e-9)
    held = np.clip(change_db / scale, -_HELD_SIGMAS, _HELD_SIGMAS)
    largest: float = np.linalg.eigvalsh(np.corrcoef(held.T))[-1].item()
    roots = math.sqrt(rows) + math.sqrt(carriers)
    spread = roots * (1.0 / math.sqrt(rows) + 1.0 / math.sqrt(carriers)) ** (1.0 / 3.0) / rows
    return float((largest - roots**2 / rows) / (_TRACY_WIDOM_SIGMA * spread))


def _explained(columns: FloatArray, value: FloatArray, weight: FloatArray, slow: int) -> tuple[float, FloatArray]:
    """Return the log likelihood of turns over no turns, and the coefficients (N, K, 1) of all columns.

    The first ``slow`` columns are no turns. Each carrier's variance is its own unknown, so that one in rain says as
    much as its scatter allows.
    """
    free = weight.sum(axis=1) - columns.shape[2]
    is_enough = free >= _LEAST_FREE
    weighted = np.swapaxes(columns * weight[..., np.newaxis], 1, 2)
    normal, right = weighted @ columns, weighted @ value[..., np.newaxis]
    scale = 1.0 / np.sqrt(np.maximum(np.diagonal(normal, axis1=1, axis2=2), 1e-300))[..., np.newaxis]
    normal = scale * normal * np.swapaxes(scale, 1, 2) + 1e-9 * np.eye(columns.shape[2])
    right = scale * right
    total = (weight * value**2).sum(axis=1)
    parts = [np.linalg.solve(normal[:, :k, :k], right[:, :k]) for k in (slow, columns.shape[2])]
    before, after = (np.maximum(total - (right[:, : part.shape[1]] * part).sum(axis=(1, 2)), 1e-12) for part in parts)
    gained: FloatArray = free * np.log(before / after)
    likelihood = 0.5 * float(gained[is_enough].sum()) if is_enough.any() else -math.inf
    return likelihood, scale * parts[1]


def _peaks(lags_s: FloatArray, likelihood: FloatArray) -> list[float]:
    """Return the lags of the highest peaks that lie apart."""
    left = likelihood.copy()
    found: list[float] = []
    while len(found) < _PEAKS and np.isfinite(left).any():
        found.append(float(lags_s[int(left.argmax())]))
        left[np.abs(lags_s - found[-1]) <= _MARGIN_S] = -np.inf
    return found


def _parabola(values: FloatArray, likelihood: FloatArray, reach: float) -> tuple[float, float]:
    """Return the value at the top of the likelihood and its sigma by the curvature there."""
    best = int(likelihood.argmax())
    near = np.abs(np.arange(len(values)) - min(max(best, 1), len(values) - 2)) <= 1
    near |= (likelihood > likelihood[best] - _PARABOLA) & (np.abs(values - values[best]) <= reach)
    bend, slope, _ = np.polyfit(values[near] - values[best], likelihood[near], 2)
    if not bend < 0.0:
        return float(values[best]), math.inf
    top = float(np.clip(values[best] - slope / (2.0 * bend), values[0], values[-1]))
    return top, 1.0 / math.sqrt(-2.0 * bend)


#: deg, the Earth from the geostationary orbit: no antenna of a spacecraft there is wider at 3 dB
EARTH_WIDTH_DEG = 17.4
#: dB/deg^2, curvature of that antenna, whose gain falls by 12 (angle / width)^2 dB: no other bends less
LEAST_CURVATURE = 24.0 / EARTH_WIDTH_DEG**2
#: dB/deg, its slope at the limb of the Earth, its steepest
LEAST_SLOPE = LEAST_CURVATURE * EARTH_WIDTH_DEG / 2.0
#: logarithms of the scales that are tried
_LOG_SCALES = np.linspace(math.log(1e-3), math.log(1e5), 1843)
#: deg, stations of a beam this near tell one gradient
_LEAST_APART_DEG = 0.1


class BeamScale(NamedTuple):
    """Common scale of the angles by the beams, and how the beams compare to one as wide as the Earth.

    Parameters
    ----------
    scale, log_sigma : float
        Angles of the sensor over those of the beams, and one standard deviation of its logarithm; NaN = not known.
    curvature, curvature_sigma : float, dB/deg^2
        Fall of the beams, mean of the carriers, and one standard deviation.
    slope : float, dB/deg
        Root mean square of the gradients.
    """

    scale: float
    log_sigma: float
    curvature: float
    curvature_sigma: float
    slope: float

    @property
    def flat_sigmas(self) -> float:
        """Sigmas by which the beams are flatter than one as wide as the Earth; negative = they are not."""
        if not self.slope < LEAST_SLOPE:
            return -math.inf
        return (LEAST_CURVATURE - self.curvature) / self.curvature_sigma


def beam_scale(
    beams: FloatArray, covariance: FloatArray, geometry: CarrierGeometry, beam: IntArray, is_used: NDArray[np.bool_]
) -> BeamScale:
    """Return the scale: gradients of one beam differ between its stations by its curvature and their known distance.

    A gradient falls with the scale of the angles and a curvature with its square.

    Parameters
    ----------
    beams : ndarray, shape (N, 5)
        Gradient, dB/deg, and Hessian (az az, az el, el el), dB/deg^2.
    covariance : ndarray, shape (N, 5, 5)
        Of ``beams``.
    geometry : CarrierGeometry
        Where the stations stand.
    beam : ndarray of int, shape (N,)
        Number of the receive beam of each carrier.
    is_used : ndarray of bool, shape (N,)
        Carriers with a station and beams.
    """
    used = np.flatnonzero(is_used)
    if not len(used):
        return BeamScale(*(math.nan,) * 5)
    bent = -0.5 * (beams[used, 2] + beams[used, 4])
    mix = np.array([0.0, 0.0, -0.5, 0.0, -0.5])
    weight = 1.0 / (mix @ covariance[used] @ mix)
    mean = float(weight @ bent / weight.sum())
    growth = max(1.0, float(weight @ (bent - mean) ** 2) / max(len(used) - 1, 1))
    share = _gradient_share(covariance[used])
    slope = math.sqrt(float(share @ np.square(beams[used, :2]).sum(axis=1)))
    shape = mean, math.sqrt(growth / float(weight.sum())), slope
    position = np.column_stack([geometry.azimuth_deg, geometry.elevation_deg])
    misfit, logarithm, count = np.zeros(len(_LOG_SCALES)), np.zeros(len(_LOG_SCALES)), 0
    for one in np.unique(beam[used]):
        members = used[beam[used] == one]
        if np.ptp(position[members], axis=0).max() > _LEAST_APART_DEG:
            parts = _scale_misfit(beams[members], covariance[members], position[members])
            misfit, logarithm, count = misfit + parts[0], logarithm + parts[1], count + 2 * len(members) - 3
    if count < 1:
        return BeamScale(math.nan, math.nan, *shape)
    likelihood = -0.5 * (misfit + logarithm)
    log_scale, sigma = _parabola(_LOG_SCALES, likelihood, 0.3)
    growth = max(1.0, float(misfit[int(likelihood.argmax())]) / count)
    return BeamScale(math.exp(log_scale), sigma * math.sqrt(growth), *shape)


def _gradient_share(covariance: FloatArray) -> FloatArray:
    """Return the share (M,) of each gradient in their mean."""
    weight = 1.0 / np.trace(covariance[:, :2, :2], axis1=1, axis2=2)
    return np.asarray(weight / weight.sum())


def _scale_misfit(beams: FloatArray, covariance: FloatArray, position_deg: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return chi-square and log determinant, by scale, of the gradients of M stations (M, 2) of one beam."""
    share = _gradient_share(covariance)
    apart_deg, found = (values - share @ values for values in (position_deg, beams[:, :2]))
    precision = np.linalg.inv(covariance[:, 2:, 2:])
    pooled = np.linalg.inv(precision.sum(axis=0))
    hessian = pooled @ (precision @ beams[:, 2:, np.newaxis]).sum(axis=0)[:, 0]
    by_hessian = np.zeros((len(beams), 2, BEAM_SIZE - 2))
    by_hessian[:, 0, :2] = by_hessian[:, 1, 1:] = apart_deg
    scale = np.exp(_LOG_SCALES)[:, np.newaxis, np.newaxis]
    left = found - scale * (by_hessian @ hessian)
    by_curvature = by_hessian @ pooled @ np.swapaxes(by_hessian, 1, 2)
    variance = covariance[:, :2, :2] + scale[..., np.newaxis] ** 2 * by_curvature
    chi_square = (left * np.linalg.solve(variance, left[..., np.newaxis])[..., 0]).sum(axis=(1, 2))
    return chi_square, np.linalg.slogdet(variance)[1].sum(axis=1)
