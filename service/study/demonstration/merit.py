"""Figures of merit: estimates beside the truth, and beside the answer that the spacecraft never moves.

Every rms stands beside the rms of the truth itself; skill = 1 - mean(error^2) / mean(truth^2), so that the answer
0/0/0 has skill 0 and cannot pass for an estimate.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import FloatArray

AXES = ("yaw", "roll", "pitch")

#: bounds of a demonstration by method: rms of each axis in deg, slope of estimate on truth
RMS_BOUNDS_DEG = {
    "robust": {"yaw": 0.18, "roll": 0.03, "pitch": 0.04},
    "paper": {"roll": 0.08, "pitch": 0.10},
}
SLOPE_BOUNDS = {"robust": {"yaw": 0.30, "roll": 0.05, "pitch": 0.05}, "paper": {"roll": 0.15, "pitch": 0.15}}
#: least rms of the truth: a spacecraft that hardly moves proves nothing
TRUTH_RMS_DEG = 0.12


class AxisMerit(NamedTuple):
    """Figures of one axis, deg."""

    rms_deg: float
    #: 95 % of the errors are smaller
    error_95_deg: float
    truth_rms_deg: float
    skill: float
    #: least-squares slope of the estimate on the truth
    slope: float


def judge_axis(estimate_deg: FloatArray, truth_deg: FloatArray) -> AxisMerit:
    """Return the figures of some estimates; rows without an estimate (NaN) do not count."""
    present = np.isfinite(estimate_deg) & np.isfinite(truth_deg)
    estimate, truth = estimate_deg[present], truth_deg[present]
    if len(truth) < 2:
        nan = float("nan")
        return AxisMerit(nan, nan, nan, nan, nan)
    error = estimate - truth
    mean_square_truth = float(np.mean(truth**2))
    centred = truth - truth.mean()
    return AxisMerit(
        float(np.sqrt(np.mean(error**2))),
        float(np.quantile(np.abs(error), 0.95)),
        float(np.sqrt(mean_square_truth)),
        1.0 - float(np.mean(error**2)) / mean_square_truth,
        float(centred @ (estimate - estimate.mean()) / (centred @ centred)),
    )


def missed_bounds(merits: Mapping[str, AxisMerit], method: str, *, is_moved: bool = True) -> list[str]:
    """Return what misses the bounds of the demonstration, in words; NaN misses every bound.

    Of a spacecraft that is kept still (`is_moved` false) only errors are judged: slopes need motion.
    """
    missed = []
    for axis, bound_deg in RMS_BOUNDS_DEG[method].items():
        merit, reach = merits[axis], SLOPE_BOUNDS[method][axis]
        if not merit.rms_deg <= bound_deg:
            missed.append(f"{axis} rms {merit.rms_deg:.3f} deg above {bound_deg}")
        if is_moved and not abs(merit.slope - 1.0) <= reach:
            missed.append(f"{axis} slope {merit.slope:.3f} not within 1 +- {reach}")
    missed += [
        f"{axis} truth rms {merits[axis].truth_rms_deg:.3f} deg below {TRUTH_RMS_DEG}: too little moved"
        for axis in AXES
        if is_moved and not merits[axis].truth_rms_deg >= TRUTH_RMS_DEG
    ]
    return missed
