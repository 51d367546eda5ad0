"""Sensors of motion beside the powers: the update of the state by a record, and the judgement of their records.

A record beyond two sigma counts less, one beyond four is left out. Where records of six hours keep disagreeing, or jump
again and again, the sensor is refused until the next alignment, and yaw is as uncertain as after hours without it. The
law of this file: it has what wheels and polarimeters share; the file of each sensor says what a jump is. State and
judgement are written in place; the functions are compiled as they stand.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.estimation.filtering.filter_state import NEVER_US

#: sigmas from which a record counts less, and is left out
TRUSTED, GATE = 2.0, 4.0
#: records are watched with this memory, h
MEMORY_H = 6.0
#: mean square of the innovations, a degree of freedom, and jumps within the memory from which a sensor is refused
_REFUSED_MEAN, _REFUSED_JUMPS = 2.5, 2.5
#: what a sensor that was refused may have done to the angles, deg, order yaw, roll, pitch
_MISLED_DEG = (0.2, 0.02, 0.02)
#: a jump is reported for this long, us
_REPORTED_US = 3_600_000_000
#: without anything of use for this long yaw is known as without the sensor, us; records of each hour may miss one
SILENT_US = 3 * 3_600_000_000
_US_PER_H = 3.6e9
#: bits of `sensor_advice`
REFUSED, JUMPED, SILENT = 1, 2, 4


class SensorInnovation(NamedTuple):
    """Measurements n of a sensor compared with a state of D numbers."""

    #: (n, D) H and (n,) in the unit of the sensor
    jacobian: FloatArray
    innovation: FloatArray
    #: (n, n) H P H' + R and (n, D) H P
    covariance: FloatArray
    cross: FloatArray


def greatest_excess(compared: SensorInnovation) -> float:
    """Return the size of the largest innovation, sigmas."""
    excess = 0.0
    for row in range(len(compared.innovation)):
        excess = max(excess, abs(compared.innovation[row]) / math.sqrt(compared.covariance[row, row]))
    return excess


def mean_square(compared: SensorInnovation) -> float:
    """Return the normalised square of the innovations, a degree of freedom."""
    lower, total = lower_triangle(compared.covariance, 0.0), 0.0
    whitened = compared.innovation.copy()
    for row in range(len(whitened)):
        for k in range(row):
            whitened[row] -= lower[row, k] * whitened[k]
        whitened[row] /= lower[row, row]
        total += whitened[row] ** 2
    return total / len(whitened)


def lower_triangle(covariance: FloatArray, variance: float) -> FloatArray:
    """Return L (n, n) of ``L L'``, a covariance whose diagonal is greater by a variance."""
    lower = np.zeros(covariance.shape)
    for row in range(len(covariance)):
        for column in range(row + 1):
            total = covariance[row, column] + (variance if row == column else 0.0)
            for k in range(column):
                total -= lower[row, k] * lower[column, k]
            lower[row, column] = math.sqrt(total) if row == column else total / lower[column, column]
    return lower


def use_record(
    mean: FloatArray, covariance: FloatArray, compared: SensorInnovation, variance: float, trace_rows: FloatArray
) -> None:
    """Take measurements into mean (D,) and covariance (D, D), the noise of each greater by a variance.

    `trace_rows` (3, 2 D + 1) is written as `RowTrace` has it where it has room.
    """
    lower, size = lower_triangle(compared.covariance, variance), len(mean)
    whitened, residual = compared.cross.copy(), compared.innovation.copy()
    for row in range(len(residual)):
        for k in range(row):
            whitened[row] -= lower[row, k] * whitened[k]
            residual[row] -= lower[row, k] * residual[k]
        whitened[row] /= lower[row, row]
        residual[row] /= lower[row, row]
        mean += residual[row] * whitened[row]
        if len(trace_rows):
            trace_rows[row, :size] = compared.jacobian[row]
            for k in range(row):
                trace_rows[row, :size] -= lower[row, k] * trace_rows[k, :size]
            trace_rows[row, :size] /= lower[row, row]
            trace_rows[row, size : 2 * size] = whitened[row]
            trace_rows[row, 2 * size] = residual[row]
    product = whitened.T @ whitened
    covariance -= 0.5 * (product + product.T)


def hours_since(watch: NDArray[np.void], epoch_us: int) -> float:
    """Return how long ago the newest record was, 0 before the first."""
    if watch["newest_us"] == NEVER_US:
        return 0.0
    return float((epoch_us - watch["newest_us"]) / _US_PER_H)


def begin_record(watch: NDArray[np.void], epoch_us: int) -> None:
    """Let a newer record be the newest, and forget what was before it as time has passed."""
    keep = math.exp(-hours_since(watch, epoch_us) / MEMORY_H)
    watch["newest_us"] = epoch_us
    watch["records"] *= keep
    watch["squares"] *= keep
    watch["jumps"] *= keep


def count_jump(watch: NDArray[np.void], epoch_us: int) -> None:
    """Count a jump."""
    watch["skipped"] = 0
    watch["jumps"] += 1.0
    watch["jumped_us"] = epoch_us


def judge_record(
    watch: NDArray[np.void], covariance: FloatArray, square: float, least_records: float, few_records: float
) -> None:
    """Count the mean square of a record; the sensor is refused where they stay too large.

    A mean is judged of `least_records`; `few_records` are counted beside them, so that the limit is wider for few.
    """
    watch["records"] += 1.0
    watch["squares"] += min(square, GATE**2)
    is_bad = watch["records"] >= least_records and watch["squares"] > _REFUSED_MEAN * (watch["records"] + few_records)
    if is_bad or watch["jumps"] > _REFUSED_JUMPS:
        watch["is_refused"] = True
        mislead(covariance)


def mislead(covariance: FloatArray) -> None:
    """Let the angles be known less, by what a sensor that is refused may have done to them."""
    for axis in range(3):
        covariance[axis, axis] += _MISLED_DEG[axis] ** 2


def sensor_advice(sensors: NDArray[np.void], epoch_us: int) -> int:
    """Return whether any of some sensors is `REFUSED`, has `JUMPED` undeclared, or has been `SILENT` for hours: bits.

    Silence is counted only of sensors that are not refused.
    """
    advice = 0
    for watch in sensors:
        if watch["is_refused"]:
            advice |= REFUSED
        elif epoch_us - watch["heard_us"] > SILENT_US:
            advice |= SILENT
        if epoch_us - watch["jumped_us"] < _REPORTED_US:
            advice |= JUMPED
    return advice
