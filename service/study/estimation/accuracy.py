"""Errors of an answer beside the truth, axis by axis, and their figures over several seeds.

    skill = 1 - mean(error^2) / mean(truth^2)     slope of the answer on the truth by least squares

Both are pooled over seeds, as is the stated sigma; rms and the 95 % error are the means of the seeds' own. The law of
this file: a row without an answer is no error, but an answer to fewer than ``MIN_ANSWERED`` of the rows has no figures.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import BoolArray, FloatArray

AXES = ("yaw", "roll", "pitch")
#: silence must not buy accuracy
MIN_ANSWERED = 0.9

#: figures by name, ``quantity.axis`` where there is one for each axis
Statistics = dict[str, float]


class Accuracy(NamedTuple):
    """Sums of one answer in one world; arrays (3,) in the order yaw, roll, pitch, deg and deg^2."""

    #: share of the rows that have an answer
    answered: float
    mean_square_error: FloatArray
    mean_square_truth: FloatArray
    #: of the answer's own sigma; NaN where it states none
    mean_square_sigma: FloatArray
    #: of answer and truth about their means, and of the truth
    covariance: FloatArray
    variance: FloatArray
    #: 95 % of the errors are smaller, all of them are
    error_95: FloatArray
    greatest: FloatArray


def measure_accuracy(estimate_deg: FloatArray, sigma_deg: FloatArray, truth_deg: FloatArray) -> Accuracy:
    """Return what the rows (T, 3) of an answer amount to.

    Examples
    --------
    >>> truth = np.array([[0.1, 0.2, 0.3], [-0.1, -0.2, -0.3]])
    >>> measure_accuracy(0.5 * truth, np.full((2, 3), np.nan), truth).mean_square_error.round(6)
    array([0.0025, 0.01  , 0.0225])
    """
    present: BoolArray = np.asarray(np.isfinite(estimate_deg).all(axis=1))
    answered = float(present.mean()) if len(present) else 0.0
    if answered < MIN_ANSWERED:
        nothing = np.full(3, np.nan)
        return Accuracy(answered, *(nothing,) * 7)
    estimate, truth, sigma = estimate_deg[present], truth_deg[present], sigma_deg[present]
    error, centred = np.abs(estimate - truth), truth - truth.mean(axis=0)
    return Accuracy(
        answered,
        np.mean(error**2, axis=0),
        np.mean(truth**2, axis=0),
        np.mean(sigma**2, axis=0),
        np.mean(centred * estimate, axis=0),
        np.mean(centred**2, axis=0),
        np.quantile(error, 0.95, axis=0),
        np.max(error, axis=0),
    )


def accuracy_statistics(seeds: Sequence[Accuracy]) -> Statistics:
    """Return the figures of one answer over the seeds of a scenario; NaN where any seed has none."""
    square = np.mean([seed.mean_square_error for seed in seeds], axis=0)
    truth = np.mean([seed.mean_square_truth for seed in seeds], axis=0)
    sigma = np.mean([seed.mean_square_sigma for seed in seeds], axis=0)
    covariance = np.mean([seed.covariance for seed in seeds], axis=0)
    variance = np.mean([seed.variance for seed in seeds], axis=0)
    # a truth that never moves has neither skill nor slope
    with np.errstate(divide="ignore", invalid="ignore"):
        by_axis = {
            "rms_deg": np.mean([np.sqrt(seed.mean_square_error) for seed in seeds], axis=0),
            "p95_deg": np.mean([seed.error_95 for seed in seeds], axis=0),
            "max_deg": np.max([seed.greatest for seed in seeds], axis=0),
            "truth_rms_deg": np.mean([np.sqrt(seed.mean_square_truth) for seed in seeds], axis=0),
            "skill": 1.0 - square / truth,
            "slope": covariance / variance,
            "rms_over_sigma": np.sqrt(square / sigma),
            "sigma_deg": np.sqrt(sigma),
        }
    statistics = {f"{name}.{axis}": float(values[k]) for name, values in by_axis.items() for k, axis in enumerate(AXES)}
    return {**statistics, "answered": float(np.mean([seed.answered for seed in seeds]))}
