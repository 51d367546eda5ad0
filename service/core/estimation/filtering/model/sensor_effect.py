"""Effect of a record of another sensor on the state: what began again, then an update.

The law of this file: a record of what the filter did, in the order in which it did it; nothing is decided here.
"""

from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray, IntArray


class SensorUpdate(NamedTuple):
    """Measurements n of a sensor compared with a state of D numbers."""

    #: (n, D) H and (n,) in the unit of the sensor
    jacobian: FloatArray
    innovation: FloatArray
    #: (n, n) H P H' + R and (n, D) H P
    covariance: FloatArray
    cross: FloatArray

    def widened(self, variance: float) -> "SensorUpdate":
        """Return the same with a noise whose variance is greater in each measurement."""
        return self._replace(covariance=self.covariance + variance * np.eye(len(self.innovation)))


class SensorEffect(NamedTuple):
    """Effect of one record; variance that it added is noise, of which nothing is kept."""

    #: (k,) states that began again before the update
    restarted: IntArray
    #: None = the record was left out
    update: SensorUpdate | None = None


#: effect of a record that was left out
NO_EFFECT = SensorEffect(np.zeros(0, dtype=np.int64))
