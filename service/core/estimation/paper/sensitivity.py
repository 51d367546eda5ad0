"""Sensitivity of the carriers to the three angles, from calibration turns, each sign of each axis on its own."""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray, IntArray
from service.core.estimation.observability import normal_inverse
from service.core.estimation.paper.harmonic import fit_clipped

#: deg, a side of an axis counts as turned beyond this.
MIN_EXCURSION_DEG = 0.1
#: Fewer samples of a carrier than this are no fit.
MIN_SAMPLES = 16


class TurnSensitivity(NamedTuple):
    """Sensitivities of N carriers; columns yaw, roll, pitch; sides plus, minus.

    Parameters
    ----------
    plus, minus : ndarray, shape (N, 3), dB/deg
        Slope ``d dP / d l`` for positive and for negative angles. NaN where the side was not turned.
    symmetric : ndarray, shape (N, 3), dB/deg
        Mean of both sides, or the side there is.
    plus_sigma, minus_sigma : ndarray, shape (N, 3), dB/deg
        Standard errors, residuals taken as independent.
    level_db : ndarray, shape (N,), dB
        Free level, the error of the reference.
    residual_db : ndarray, shape (N,), dB
        Root mean square of what the model leaves, over the samples used.
    is_missing : ndarray of bool, shape (N, 3, 2)
        Sides that the carrier did not see turned.
    samples_used, samples_rejected : ndarray of int, shape (N,)
        Samples in the fit and outside the gate.
    """

    plus: FloatArray
    minus: FloatArray
    symmetric: FloatArray
    plus_sigma: FloatArray
    minus_sigma: FloatArray
    level_db: FloatArray
    residual_db: FloatArray
    is_missing: BoolArray
    samples_used: IntArray
    samples_rejected: IntArray


def one_sided_columns(angle_deg: FloatArray) -> FloatArray:
    """Return the six columns max(l, 0), min(l, 0) of angles (K, 3): three plus, then three minus.

    Examples
    --------
    >>> one_sided_columns(np.array([[0.1, -0.2, 0.0]]))
    array([[ 0.1,  0. ,  0. ,  0. , -0.2,  0. ]])
    """
    return np.concatenate([np.maximum(angle_deg, 0.0), np.minimum(angle_deg, 0.0)], axis=1)


def fit_turn_sensitivity(
    angle_deg: FloatArray, deviation_db: FloatArray, *, gate_sigma: float = 3.0, baseline: FloatArray | None = None
) -> TurnSensitivity:
    """Return the sensitivity of every carrier to each sign of each angle.

    Parameters
    ----------
    angle_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch of each row. A row with NaN is absent.
    deviation_db : ndarray, shape (K, N), dB
        Powers with harmonic and level removed. NaN marks an absent sample.
    gate_sigma : float
        Samples beyond this many sigmas are rejected until nothing changes (``sigma_clip``).
    baseline : ndarray, shape (K, B), optional
        Basis of the level of a carrier over the turns, its rows adding up to one (``level_knots``); without it the
        level is one constant. What a harmonic fit leaves is slow and, over hours of turns, larger than what a quarter
        of a degree of yaw does: a level that may wander keeps it out of the slopes.

    Returns
    -------
    TurnSensitivity
        A carrier with fewer than sixteen samples, or whose turns do not tell the axes apart, is all NaN.

    References
    ----------
    .. [1] Sevast'yanov, N. N., "Yamal-200 spacecrafts attitude control by the signals of onboard repeater complex",
       2013, equation (1).

    Examples
    --------
    >>> angle_deg = np.repeat(0.5 * np.vstack([np.eye(3), -np.eye(3), np.zeros((1, 3))]), 10, axis=0)
    >>> deviation_db = one_sided_columns(angle_deg) @ np.array([[0.1, 1.0, 1.2, 0.2, 2.0, 1.5]]).T + 0.05
    >>> fit = fit_turn_sensitivity(angle_deg, deviation_db)
    >>> fit.plus.round(9), fit.minus.round(9), fit.level_db.round(9)
    (array([[0.1, 1. , 1.2]]), array([[0.2, 2. , 1.5]]), array([0.05]))
    """
    is_row: BoolArray = np.asarray(np.isfinite(angle_deg).all(axis=1))
    is_present = np.isfinite(deviation_db) & is_row[:, np.newaxis]
    columns = one_sided_columns(np.where(is_row[:, np.newaxis], angle_deg, 0.0))
    is_turned: BoolArray = np.asarray(np.abs(columns) >= MIN_EXCURSION_DEG)
    level = np.ones((len(columns), 1)) if baseline is None else baseline
    fits = [
        _fit_carrier(columns, level, deviation_db[:, carrier], is_present[:, carrier], is_turned, gate_sigma)
        for carrier in range(deviation_db.shape[1])
    ]
    slope = np.array([fit.slope for fit in fits]).reshape(-1, 2, 3)
    sigma = np.array([fit.sigma for fit in fits]).reshape(-1, 2, 3)
    plus, minus = slope[:, 0], slope[:, 1]
    used = np.array([fit.samples_used for fit in fits], dtype=np.int64)
    return TurnSensitivity(
        plus=plus,
        minus=minus,
        symmetric=symmetric_sensitivity(plus, minus),
        plus_sigma=sigma[:, 0],
        minus_sigma=sigma[:, 1],
        level_db=np.array([fit.level_db for fit in fits]),
        residual_db=np.array([fit.residual_db for fit in fits]),
        is_missing=np.moveaxis(np.isnan(slope), 1, 2),
        samples_used=used,
        samples_rejected=np.where(used > 0, is_present.sum(axis=0) - used, 0).astype(np.int64),
    )


def symmetric_sensitivity(plus: FloatArray, minus: FloatArray) -> FloatArray:
    """Return the mean slope of both signs, or that of the sign there is; NaN where neither was measured.

    Examples
    --------
    >>> symmetric_sensitivity(np.array([1.0, 1.0, np.nan]), np.array([2.0, np.nan, np.nan]))
    array([1.5, 1. , nan])
    """
    return np.where(np.isnan(plus), minus, np.where(np.isnan(minus), plus, 0.5 * (plus + minus)))


class _CarrierFit(NamedTuple):
    """Fit of one carrier: slopes and standard errors (6,), three plus then three minus."""

    slope: FloatArray
    sigma: FloatArray
    level_db: float
    residual_db: float
    samples_used: int


def level_knots(time_s: FloatArray, spacing_s: float) -> FloatArray:
    """Return hat functions over a stretch of time: a level that is a straight line between knots.

    Parameters
    ----------
    time_s : ndarray, shape (K,), s
        Instants of the rows.
    spacing_s : float, s
        Distance between knots at least; the stretch is divided evenly.

    Returns
    -------
    ndarray, shape (K, B)
        Each row adds up to one.

    Examples
    --------
    >>> level_knots(np.array([0.0, 5.0, 10.0]), 10.0)
    array([[1. , 0. ],
           [0.5, 0.5],
           [0. , 1. ]])
    """
    start_s, span_s = float(time_s.min()), float(np.ptp(time_s))
    chunks = max(1, int(span_s / spacing_s))
    position = (time_s - start_s) / max(span_s, 1e-9) * chunks
    return np.clip(1.0 - np.abs(position[:, np.newaxis] - np.arange(chunks + 1)), 0.0, None)


def _fit_carrier(
    columns: FloatArray,
    level: FloatArray,
    deviation_db: FloatArray,
    is_present: BoolArray,
    is_turned: BoolArray,
    gate_sigma: float,
) -> _CarrierFit:
    """Fit one carrier on the sides it saw turned; a missing side follows the slope of the other."""
    slope, sigma = np.full(6, math.nan), np.full(6, math.nan)
    if is_present.sum() < MIN_SAMPLES:
        return _CarrierFit(slope, sigma, math.nan, math.nan, 0)
    is_seen = np.asarray(is_turned[is_present].any(axis=0))
    opposite = np.roll(np.arange(6), 3)
    folded = columns + np.where(is_seen[opposite], 0.0, columns[:, opposite])
    # a knot without a sample has no level; its column would make the system singular
    is_level = np.asarray((level[is_present] > 0.0).any(axis=0))
    basis = np.column_stack([folded[:, is_seen], level[:, is_level]])
    fit = fit_clipped(
        basis,
        np.where(is_present, deviation_db, math.nan)[:, np.newaxis],
        gate_sigma=gate_sigma,
        min_samples=MIN_SAMPLES,
    )
    used = int(fit.is_used.sum())
    sides = int(np.count_nonzero(is_seen))
    slope[is_seen] = fit.coefficients[0, :sides]
    variance_db2 = fit.rms_db[0] ** 2 * used / max(used - basis.shape[1], 1)
    sigma[is_seen] = np.sqrt(np.diagonal(fit.normal_inverse[0])[:sides] * variance_db2)
    return _CarrierFit(slope, sigma, float(fit.coefficients[0, sides:].mean()), float(fit.rms_db[0]), used)


#: deg, rows further than this from the first row of a level begin a new one.
LEVEL_WIDTH_DEG = 0.05
#: A level of fewer rows than this share of the level to which the median row belongs is a slew and is left out.
MIN_LEVEL_SHARE = 0.5
#: Levels up to this many times the range take part in the fit.
RANGE_MARGIN = 1.1
#: A design that amplifies the noise of one level more than this, in the departure at the end of the range, does not
#: measure curvature: it has only one level on the side, or two close together.
MAX_NOISE_GAIN = 3.0


class TurnLevels(NamedTuple):
    """L levels of N carriers.

    Parameters
    ----------
    angle_deg : ndarray, shape (L, 3), deg
        Mean yaw, roll, pitch.
    deviation_db : ndarray, shape (L, N), dB
        Median deviation; NaN where fewer than half of the level's rows are present.
    """

    angle_deg: FloatArray
    deviation_db: FloatArray


class Curvature(NamedTuple):
    """Curvature of one carrier about one axis, sides plus and minus; NaN where the turns do not determine it.

    Parameters
    ----------
    q_db_per_deg2, sigma_db_per_deg2 : ndarray, shape (2,), dB/deg^2
        Coefficient of the square, and its standard error.
    excursion_deg : float, deg
        Largest angle reached on both sides, within the range and its margin.
    """

    q_db_per_deg2: FloatArray
    sigma_db_per_deg2: FloatArray
    excursion_deg: float


def reduce_to_levels(angle_deg: FloatArray, deviation_db: FloatArray) -> TurnLevels:
    """Return the levels of rows given in order of time.

    Parameters
    ----------
    angle_deg : ndarray, shape (K, 3), deg
        Yaw, roll, pitch. Rows with NaN are left out.
    deviation_db : ndarray, shape (K, N), dB
        NaN marks an absent sample.

    Returns
    -------
    TurnLevels
        Slews, recognised by their few rows, are left out. Rows that are levels already (each far from the next) pass
        through unchanged.

    Examples
    --------
    >>> angle_deg = np.array([[0, 0.10, 0], [0, 0.12, 0], [0, 0.5, 0], [0, 0.5, 0]])
    >>> reduce_to_levels(angle_deg, np.array([[1.0], [2.0], [4.0], [4.0]])).deviation_db
    array([[1.5],
           [4. ]])
    """
    is_row = np.asarray(np.isfinite(angle_deg).all(axis=1))
    angles, deviations = angle_deg[is_row], deviation_db[is_row]
    starts = [0] if len(angles) else []
    for row in range(1, len(angles)):
        if np.abs(angles[row] - angles[starts[-1]]).max() > LEVEL_WIDTH_DEG:
            starts.append(row)
    counts = np.diff([*starts, len(angles)]) if starts else np.zeros(0, dtype=np.int64)
    least = MIN_LEVEL_SHARE * np.median(np.repeat(counts, counts)) if starts else 0.0
    spans = [slice(start, start + int(count)) for start, count in zip(starts, counts, strict=True) if count >= least]
    return TurnLevels(
        angle_deg=np.array([angles[span].mean(axis=0) for span in spans]).reshape(-1, 3),
        deviation_db=np.array([_column_medians(deviations[span]) for span in spans]).reshape(-1, deviations.shape[1]),
    )


def one_sided_curvature(levels: TurnLevels, carrier: int, axis: int, range_deg: float) -> Curvature:
    """Return the curvature of one carrier on both sides of an axis.

    Parameters
    ----------
    levels : TurnLevels
        Levels of the turns.
    carrier : int
        Column of the levels.
    axis : int
        0 yaw, 1 roll, 2 pitch; -1 gives NaN.
    range_deg : float, deg
        Levels with an angle beyond this, and a margin, are left out.

    Returns
    -------
    Curvature
        NaN for a side without two well separated levels, and for both without a level to spare.
    """
    absent = Curvature(np.full(2, math.nan), np.full(2, math.nan), math.nan)
    level_db = levels.deviation_db[:, carrier]
    is_used = np.isfinite(level_db) & (np.abs(levels.angle_deg) <= RANGE_MARGIN * range_deg).all(axis=1)
    if axis < 0 or not is_used.any():
        return absent
    columns, level_db = one_sided_columns(levels.angle_deg[is_used]), level_db[is_used]
    reach_deg = np.abs(columns).max(axis=0)
    is_seen: BoolArray = reach_deg >= MIN_EXCURSION_DEG
    sides = np.array([axis, axis + 3])
    basis = np.column_stack([columns[:, is_seen], np.ones(len(columns)), columns[:, sides[is_seen[sides]]] ** 2])
    spare = len(basis) - basis.shape[1]
    if spare < 1 or not is_seen[sides].any():
        return absent
    inverse = normal_inverse(basis)
    coefficients = inverse @ (basis.T @ level_db)
    scatter_db = math.sqrt(float(np.square(level_db - basis @ coefficients).sum()) / spare)
    found = int(is_seen[sides].sum())
    unit_sigma = np.sqrt(np.diagonal(inverse)[-found:])
    is_measured = unit_sigma * range_deg**2 / 4.0 <= MAX_NOISE_GAIN
    q, sigma = np.full(2, math.nan), np.full(2, math.nan)
    q[is_seen[sides]] = np.where(is_measured, coefficients[-found:], math.nan)
    sigma[is_seen[sides]] = np.where(is_measured, unit_sigma * scatter_db, math.nan)
    return Curvature(q, sigma, float(reach_deg[sides].min()))


def _column_medians(values: FloatArray) -> FloatArray:
    """Return the median of each column over its present values, NaN where fewer than half are present."""
    ordered = np.sort(values, axis=0)  # NaN goes last
    count = np.isfinite(values).sum(axis=0)
    columns = np.arange(values.shape[1])
    lower, upper = np.maximum(count - 1, 0) // 2, np.minimum(count // 2, len(values) - 1)
    middle = 0.5 * (ordered[lower, columns] + ordered[upper, columns])
    return np.where(2 * count >= len(values), middle, math.nan)
