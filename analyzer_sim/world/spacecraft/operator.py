"""Operator: commands corrections from the powers that the product sees, with a plain filter of his own.

    z = x + A n        n noise and weather of the stations, cut at half a decibel; A pseudo-inverse of [J 1]

His estimate depends on the true attitude through the powers alone, so that the corrections tell nothing that the powers
have not told. An operator who knew the truth but for an error of his own would give it away with every correction.
"""

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.streams import FloatArray
from analyzer_sim.world.scenario.story import KeepingErrors
from analyzer_sim.world.spacecraft.coupling import coupling_step

#: a carrier is believed to deviate by no more, dB
CUT_DB = 0.5
#: noise of a carrier in a mean of half an hour: 0.1 dB that last for hours count as white noise of three times the size
_SLOW_DB = 0.3
#: knowledge of the angles at the start, deg
_START_DEG = 0.02
#: rows of so many hours are averaged into one measurement
MEAN_H = 0.5


def sensed_error_deg(
    sensitivity_db_per_deg: FloatArray, noise_db: FloatArray, is_aligned: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return what noise (T, N) looks like as attitude (T, 3), deg, and its covariance (3, 3) for a slow noise.

    The level of each carrier in the rows `is_aligned` (T,) is its reference.
    """
    design = np.column_stack([sensitivity_db_per_deg, np.ones(len(sensitivity_db_per_deg))])
    solve = np.linalg.pinv(design)[:3]
    cut_db = np.clip(noise_db - noise_db[is_aligned].mean(axis=0), -CUT_DB, CUT_DB)
    return np.asarray(cut_db @ solve.T), np.asarray(_SLOW_DB**2 * solve @ solve.T)


class Operator:
    """Kalman filter of angles and drift, deg and deg/h, order yaw, roll, pitch."""

    def __init__(self, start_deg: FloatArray, sensed_deg2: FloatArray, keeping: KeepingErrors) -> None:
        self._keeping, self._sensed_deg2 = keeping, sensed_deg2
        self._drift_deg_h = np.array(keeping.drift_deg_h)
        self._state = np.concatenate([start_deg, np.zeros(3)])
        self._covariance = np.diag(np.concatenate([np.full(3, _START_DEG**2), self._drift_deg_h**2]))

    def sense(self, sensed_deg: FloatArray) -> FloatArray:
        """Take in what the powers look like as attitude (3,), and return the estimate (3,)."""
        gain = np.linalg.solve(self._covariance[:3, :3] + self._sensed_deg2, self._covariance[:3]).T
        self._state = self._state + gain @ (sensed_deg - self._state[:3])
        self._covariance = self._covariance - gain @ self._covariance[:3]
        return np.asarray(self._state[:3].copy())

    def predict(self, hours: float, commanded_deg_h: FloatArray) -> None:
        """Carry the estimate on under a commanded rate (3,)."""
        phi, gamma = coupling_step(hours, is_coupled=self._keeping.is_coupling_announced)
        keep = float(np.exp(-hours * 3600.0 / self._keeping.drift_tau_s))
        transition = np.block([[phi, gamma], [np.zeros((3, 3)), keep * np.eye(3)]])
        self._state = transition @ self._state
        self._state[:3] += gamma @ commanded_deg_h
        self._covariance = transition @ self._covariance @ transition.T
        self._covariance[3:, 3:] += np.diag(self._drift_deg_h**2 * (1.0 - keep**2))
