"""Noise model of the carriers, learned from the residuals of quiet days.

Real links flicker: averaging stops helping after minutes, and a filter that believes in white noise and one correlated
part is overconfident. The noise of a carrier is therefore white plus parts with the correlation times of
``LADDER_S``, a set that follows 1/f noise from minutes to half a day within a few per cent, and all carriers together
have a part in common. Each residual is split into the mean of all carriers and what is the carrier's own, which takes
the share w_i of its own variance with it; variances come from the periodograms (``noise.components``).

The law of this file: slow noise that the window cannot exclude is believed in, up to ``UNSEEN_DB``; where the window
excludes it, it goes to nothing.

Random walk of the carriers' levels, from the slopes that quiet days show beyond their noise: a walk of w dB per square
root of hour leaves in the straight line through T hours a slope of variance ``(6/5) w^2 / T``; noise of the density S_0
at low frequency leaves ``12 S_0 / T^3``. What all carriers do together belongs to the receiving chain and is taken out
first. One slope is one figure, so the walk of all carriers counts as several of each carrier's own, and no walk is
believed to be below the floor given.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.estimation.noise import Spectra, fitted_variances, grouped_spectra, pooled_variances, regular_grid
from service.core.estimation.robust_statistics import MAD_TO_SIGMA, middle_values

#: s, correlation times.
LADDER_S = (300.0, 1200.0, 7200.0, 36_000.0)
#: dB, what a correlated part may have that no window has excluded: half of what real links show.
UNSEEN_DB = 0.05
#: Frequencies that the estimate of all carriers is worth in that of one, white noise first.
_POOL_WEIGHT = np.array([0.0, 2.0, 2.0, 3.0, 3.0])
#: A carrier whose slow noise has this many times the variance of the median one's says nothing about the others.
_ODD_RATIO = 6.0
#: Rows without which a carrier's noise is that of all carriers.
MIN_ROWS = 100
#: Fewest carriers in a row whose mean tells what they have in common.
_MIN_COMMON = 4
#: Rows of a mean in which a shower shows, what it loses at least, dB and in spreads of such means, means left out
#: before and after it.
_BLOCK_ROWS = 10
_FADE_DB, _FADE_SPREADS = 0.3, 4.0
_MARGIN_BLOCKS = 3
#: Rows of a mean of slow noise, and the share of what lies above the usual level below which rain lowers the rest.
_SLOW_ROWS = 60
_ASYMMETRIC = 0.8
#: dB, a common part below this is none.
_LEAST_COMMON_DB = 0.005
#: dB, noise of a row when no carrier tells any.
_DEFAULT_WHITE_DB = 0.155


class IdentifiedNoise(NamedTuple):
    """Noise of N carriers over the ladder of C correlation times.

    Parameters
    ----------
    white_db : ndarray, shape (N,), dB
        Of one row, quantisation included.
    sigma_db : ndarray, shape (N, C), dB
        Correlated parts of each carrier's own.
    tau_s : ndarray, shape (C,), s
        Correlation times.
    common_db : ndarray, shape (C,), dB
        Correlated parts that all carriers share; 0 = none.
    """

    white_db: FloatArray
    sigma_db: FloatArray
    tau_s: FloatArray
    common_db: FloatArray

    @property
    def slow_db(self) -> FloatArray:
        """Own correlated parts together, shape (N,)."""
        return np.asarray(np.sqrt(np.square(self.sigma_db).sum(axis=1)))

    @property
    def whole_db(self) -> FloatArray:
        """Own and common correlated parts together, shape (N, C)."""
        return np.asarray(np.hypot(self.sigma_db, self.common_db))


def identify_noise(residual_db: FloatArray, epoch_s: FloatArray) -> IdentifiedNoise:
    """Return the noise of every carrier.

    Parameters
    ----------
    residual_db : ndarray, shape (T, N), dB
        Powers of quiet days less level, daily change and what the attitude did. NaN marks a sample that is absent or
        was found wrong.
    epoch_s : ndarray, shape (T,), s
        Ascending.

    Returns
    -------
    IdentifiedNoise
        A carrier with fewer than a hundred rows has the noise of all. Never zero, never NaN.

    Notes
    -----
    Over three days of 60 s rows of 16 carriers (10 seeds): white noise to 1 %, parts of 300 and 1200 s to 10 %, those
    of 7200 and 36000 s to 20 %; of white noise alone no part comes out above 0.02 dB.

    References
    ----------
    .. [1] Sykulski, A. M., Olhede, S. C., Guillaumin, A. P., Lilly, J. M., Early, J. J., "The debiased Whittle
       likelihood", Biometrika 106, 2019.
    """
    tau_s = np.array(LADDER_S)
    grid = regular_grid(epoch_s)
    residual_db = _without_fades(residual_db)
    spread = _spread_db(residual_db)
    common, share = _common_db(residual_db, spread)
    own = grouped_spectra(residual_db - common.reshape(-1, 1), grid, tau_s, MIN_ROWS)
    own = own._replace(power=own.power / (1.0 - share).reshape(-1, 1))
    start = np.square(spread)[:, np.newaxis] * np.array([0.5, 0.125, 0.125, 0.125, 0.125])
    variance = _own_variances(own, start)
    variance[:, 1:] *= _symmetric_share(residual_db - common.reshape(-1, 1))
    return IdentifiedNoise(
        np.sqrt(variance[:, 0]),
        np.sqrt(variance[:, 1:]),
        tau_s,
        _common_parts_db(grouped_spectra(common.reshape(-1, 1), grid, tau_s, MIN_ROWS), own, variance, share),
    )


def _without_fades(residual_db: FloatArray) -> FloatArray:
    """Return the residuals with NaN in showers and around them: what rain does to a carrier is not its noise."""
    if not residual_db.size:
        return residual_db
    blocks = -(-len(residual_db) // _BLOCK_ROWS)
    padded = np.full((blocks * _BLOCK_ROWS, residual_db.shape[1]), np.nan)
    padded[: len(residual_db)] = residual_db
    by_block = padded.reshape(blocks, _BLOCK_ROWS, residual_db.shape[1])
    count = np.isfinite(by_block).sum(axis=1)
    mean = np.where(count > 0, np.nansum(by_block, axis=1) / np.maximum(count, 1), np.nan)
    limit = np.maximum(_FADE_DB, _FADE_SPREADS * _spread_db(mean))
    is_faded = np.nan_to_num(mean) < -limit
    is_out = is_faded.copy()
    for shift in range(1, _MARGIN_BLOCKS + 1):
        is_out[shift:] |= is_faded[:-shift]
        is_out[:-shift] |= is_faded[shift:]
    return np.where(np.repeat(is_out, _BLOCK_ROWS, axis=0)[: len(residual_db)], np.nan, residual_db)


def _symmetric_share(residual_db: FloatArray) -> float:
    """Return the share of the slow variance that stands above the usual level as well: below it there is rain too."""
    hours = residual_db[: len(residual_db) // _SLOW_ROWS * _SLOW_ROWS]
    hours = hours.reshape(len(hours) // _SLOW_ROWS, _SLOW_ROWS, residual_db.shape[1])
    count = np.isfinite(hours).sum(axis=1)
    mean = np.where(count > _SLOW_ROWS // 2, np.nansum(hours, axis=1) / np.maximum(count, 1), np.nan)
    if not np.isfinite(mean).any():
        return 1.0
    apart = mean - middle_values(mean)[0]
    scale = np.nan_to_num(MAD_TO_SIGMA * middle_values(np.abs(apart))[0])
    apart = np.where(np.isfinite(apart), apart / np.maximum(scale, 1e-6), 0.0)
    above, below = float(np.sum(np.maximum(apart, 0.0) ** 2)), float(np.sum(np.minimum(apart, 0.0) ** 2))
    share = 2.0 * above / max(above + below, 1e-12)
    return share if share < _ASYMMETRIC else 1.0


def _own_variances(own: Spectra, start: FloatArray) -> FloatArray:
    """Return the variances (N, C + 1) of the carriers' own noise, each drawn towards that of the usual ones."""
    is_seen: BoolArray = np.asarray(own.weight.any(axis=1))
    variance, pooled = _drawn_variances(own, start, own)
    if is_seen.any():
        slow = variance[:, 1:].sum(axis=1)
        is_odd = slow > _ODD_RATIO * np.median(slow[is_seen])
        if is_odd.any():
            usual = own._replace(weight=np.where(is_odd[:, np.newaxis], 0.0, own.weight))
            variance, pooled = _drawn_variances(own, start, usual)
    white_db2 = float(np.median(variance[is_seen, 0])) if is_seen.any() else _DEFAULT_WHITE_DB**2
    return np.where(is_seen[:, np.newaxis], variance, np.append(white_db2, pooled))


def _drawn_variances(own: Spectra, start: FloatArray, usual: Spectra) -> tuple[FloatArray, FloatArray]:
    """Return the variances (N, C + 1) drawn towards what some carriers share, and that (C,)."""
    pooled, error = pooled_variances(usual, start)
    pooled = np.maximum(pooled, np.minimum(error, UNSEEN_DB**2))
    prior = np.concatenate([start[:, :1], np.tile(pooled, (len(start), 1))], axis=1)
    return fitted_variances(own, prior, prior, _POOL_WEIGHT), pooled


def _spread_db(residual_db: FloatArray) -> FloatArray:
    """Return the robust scatter (N,) of each carrier."""
    if not len(residual_db):
        return np.full(residual_db.shape[1], _DEFAULT_WHITE_DB)
    spread = MAD_TO_SIGMA * middle_values(np.abs(residual_db))[0]
    return np.maximum(np.where(np.isfinite(spread), spread, _DEFAULT_WHITE_DB), 1e-3)


def _common_db(residual_db: FloatArray, spread_db: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weighted mean (T,) of each row, 0 with too few carriers, and each carrier's share in it (N,)."""
    weight = spread_db**-2.0
    is_there = np.isfinite(residual_db)
    is_enough = is_there.sum(axis=1) >= _MIN_COMMON
    total = (is_there * weight).sum(axis=1)
    mean = (np.where(is_there, residual_db, 0.0) * weight).sum(axis=1) / np.maximum(total, 1e-300)
    if not is_enough.any():
        return np.zeros(len(mean)), np.zeros(len(weight))
    return np.where(is_enough, mean, 0.0), np.minimum(weight / total[np.flatnonzero(is_enough)].mean(), 0.9)


def _common_parts_db(mean: Spectra, own: Spectra, variance: FloatArray, share: FloatArray) -> FloatArray:
    """Return the correlated parts (C,) of the common noise, beyond what the carriers' own leaves in a mean."""
    if not share.any():
        return np.zeros(variance.shape[1] - 1)
    is_seen = own.weight.any(axis=1)
    # what the carriers' own noise leaves in the mean stands beside the unknown parts as one more, of known size
    left = np.einsum("n,nc->c", np.square(share) * is_seen, variance)
    known = np.einsum("c,ncf->nf", left, mean.expected)[:, np.newaxis]
    parts = mean._replace(expected=np.concatenate([known, mean.expected], axis=1))
    start = np.concatenate([[1.0], np.full(variance.shape[1], 0.25 * max(left.sum(), 1e-8))])[np.newaxis]
    held = np.zeros(start.shape[1])
    held[0] = 1e6
    found = fitted_variances(parts, start, np.where(held > 0.0, 1.0, 0.0)[np.newaxis], held)[0, 2:]
    sigma_db = np.sqrt(found)
    return np.where(sigma_db < _LEAST_COMMON_DB, 0.0, sigma_db)


#: Figures that the walk of all carriers is worth in that of one.
_DRIFT_POOL_WEIGHT = 4.0
#: dB per square root of hour, no level wanders more: it would be no level.
_MOST_DB = 0.1
_HOUR_S = 3600.0


class LevelDrift(NamedTuple):
    """Slopes of N carriers over quiet days.

    Parameters
    ----------
    slope_db_per_day : ndarray, shape (N,)
        NaN for a carrier seen too little.
    sigma_db_per_day : ndarray, shape (N,)
        What noise alone leaves.
    walk_db : ndarray, shape (N,), dB per square root of hour
        Random walk of the level, never NaN.
    """

    slope_db_per_day: FloatArray
    sigma_db_per_day: FloatArray
    walk_db: FloatArray


def without_common(residual_db: FloatArray) -> FloatArray:
    """Return residuals (T, N) less the median of each row; rows of fewer than four carriers are left as they are."""
    # one carrier that drifts must not make all others drift the other way
    lower, upper = middle_values(residual_db, axis=1)
    is_common = np.isfinite(residual_db).sum(axis=1) >= _MIN_COMMON
    return np.asarray(residual_db - np.where(is_common, 0.5 * (lower + upper), 0.0)[:, np.newaxis])


def level_drift(residual_db: FloatArray, epoch_s: FloatArray, noise: IdentifiedNoise, floor_db: float) -> LevelDrift:
    """Return slopes and random walks.

    Parameters
    ----------
    residual_db : ndarray, shape (T, N), dB
        Of quiet rows; NaN = absent.
    epoch_s : ndarray, shape (T,), s
        Ascending.
    noise : IdentifiedNoise
        Of the same rows.
    floor_db : float, dB per square root of hour
        Least walk.

    Returns
    -------
    LevelDrift
    """
    own_db = without_common(residual_db)
    is_there = np.isfinite(own_db)
    count = is_there.sum(axis=0)
    is_enough = count >= MIN_ROWS
    rows = np.maximum(count, 1)
    value = np.where(is_there, own_db, 0.0)
    hours = np.where(is_there, (epoch_s / _HOUR_S)[:, np.newaxis], 0.0)
    centred = np.where(is_there, hours - hours.sum(axis=0) / rows, 0.0)
    square = np.maximum((centred**2).sum(axis=0), 1e-12)
    slope = (centred * value).sum(axis=0) / square
    span_h = np.sqrt(12.0 * square / rows)
    step_h = np.maximum(span_h / rows, 1e-9)
    density = noise.white_db**2 * step_h + (2.0 * noise.tau_s / _HOUR_S * noise.sigma_db**2).sum(axis=1)
    variance = 12.0 * density / np.maximum(span_h, 1e-9) ** 3
    excess = np.where(is_enough, (slope**2 - variance) * span_h * 5.0 / 6.0, 0.0)
    pooled = max(float(excess[is_enough].mean()), 0.0) if is_enough.any() else 0.0
    walk2 = (np.maximum(excess, 0.0) + _DRIFT_POOL_WEIGHT * pooled) / (1.0 + _DRIFT_POOL_WEIGHT)
    return LevelDrift(
        np.where(is_enough, 24.0 * slope, np.nan),
        24.0 * np.sqrt(variance),
        np.clip(np.sqrt(walk2), floor_db, max(floor_db, _MOST_DB)),
    )
