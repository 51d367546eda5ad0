"""Sensors of motion beside the powers: the update of the state by a record, and the judgement of their records.

A record beyond two sigma counts less, one beyond four is left out. Where records of six hours keep disagreeing, or jump
again and again, the sensor is refused until the next alignment, and yaw is as uncertain as after hours without it. The
law of this file: it has what wheels and polarimeters share; the file of each sensor says what a jump is.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray
from service.core.estimation.filtering.filter_model import ATTITUDE, Gaussian

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
#: epoch of the newest record before the first
NEVER_US = -(1 << 62)


class SensorUpdate(NamedTuple):
    """Measurements n of a sensor compared with a state of D numbers."""

    #: (n, D) H and (n,) in the unit of the sensor
    jacobian: FloatArray
    innovation: FloatArray
    #: (n, n) H P H' + R and (n, D) H P
    covariance: FloatArray
    cross: FloatArray

    @property
    def excess(self) -> float:
        """Return the size of the largest innovation, sigmas."""
        return float(np.abs(self.innovation / np.sqrt(self.covariance.diagonal())).max())

    @property
    def mean_square(self) -> float:
        """Return the normalised square of the innovations, a degree of freedom."""
        square = float(self.innovation @ np.linalg.solve(self.covariance, self.innovation))
        return square / len(self.innovation)

    def widened(self, variance: float) -> "SensorUpdate":
        """Return the same with a noise whose variance is greater in each measurement."""
        return self._replace(covariance=self.covariance + variance * np.eye(len(self.innovation)))

    def applied(self, gaussian: Gaussian) -> Gaussian:
        """Return the state after the update."""
        factor = np.linalg.cholesky(self.covariance)
        solved = np.linalg.solve(factor, np.column_stack([self.cross, self.innovation]))
        whitened, residual = solved[:, :-1], solved[:, -1]
        return Gaussian(gaussian.mean + residual @ whitened, gaussian.covariance - whitened.T @ whitened)


class SensorEffect(NamedTuple):
    """Effect of one record; variance that it added is noise, of which nothing is kept."""

    #: (k,) states that began again before the update
    restarted: IntArray
    #: None = the record was left out
    update: SensorUpdate | None = None


#: effect of a record that was left out
NO_EFFECT = SensorEffect(np.zeros(0, dtype=np.int64))


class SensorWatch(NamedTuple):
    """State of the judgement; sums forget."""

    #: newest record of use, at first the begin of the watch
    heard_us: int = NEVER_US
    #: epoch of the newest record judged
    newest_us: int = NEVER_US
    #: newest record of wheels: a repeated one is left out
    newest_n_m_s: FloatArray = np.zeros(3)
    #: records left out in a row
    skipped: int = 0
    #: weights, sum of mean squares of innovations and jumps of the last hours
    records: float = 0.0
    squares: float = 0.0
    jumps: float = 0.0
    jumped_us: int = NEVER_US
    is_refused: bool = False
    #: co-polar power of a polarimeter in clear sky
    clear_dbm: float = math.nan

    def hours_until(self, epoch_us: int) -> float:
        """Return how long ago the newest record was, 0 before the first."""
        return 0.0 if self.newest_us == NEVER_US else (epoch_us - self.newest_us) / 3.6e9

    def jumped(self, epoch_us: int) -> "SensorWatch":
        """Return the watch after a jump."""
        return self._replace(skipped=0, jumps=self.jumps + 1.0, jumped_us=epoch_us)

    def has_jumped(self, epoch_us: int) -> bool:
        """Return whether an undeclared jump is reported at an epoch."""
        return epoch_us - self.jumped_us < _REPORTED_US

    def is_silent(self, since_us: int, epoch_us: int) -> bool:
        """Return whether a sensor that is not refused has had no record of use for hours."""
        return epoch_us - max(self.heard_us, since_us) > SILENT_US and not self.is_refused


def with_record(watch: SensorWatch, epoch_us: int) -> SensorWatch:
    """Return the watch at a newer record, what was before it forgotten as time has passed."""
    keep = math.exp(-watch.hours_until(epoch_us) / MEMORY_H)
    return watch._replace(
        newest_us=epoch_us,
        records=keep * watch.records,
        squares=keep * watch.squares,
        jumps=keep * watch.jumps,
    )


def judged(
    watch: SensorWatch, gaussian: Gaussian, mean_square: float, least_records: float, few_records: float = 0.0
) -> tuple[SensorWatch, Gaussian]:
    """Return watch and state after a record of some mean square; the sensor is refused where they stay too large.

    A mean is judged of `least_records`; `few_records` are counted beside them, so that the limit is wider for few.
    """
    watch = watch._replace(records=watch.records + 1.0, squares=watch.squares + min(mean_square, GATE**2))
    is_bad = watch.records >= least_records and watch.squares > _REFUSED_MEAN * (watch.records + few_records)
    if not (is_bad or watch.jumps > _REFUSED_JUMPS):
        return watch, gaussian
    return watch._replace(is_refused=True), misled(gaussian)


def misled(gaussian: Gaussian) -> Gaussian:
    """Return the state whose angles are known less, by what a sensor that is refused may have done to them."""
    covariance = gaussian.covariance.copy()
    covariance[ATTITUDE, ATTITUDE] += np.diag(np.square(_MISLED_DEG))
    return Gaussian(gaussian.mean, covariance)
