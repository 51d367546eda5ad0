"""Rows as they were flown, and measurements of the oracle's states: the parts that filter and sensors share."""

from typing import NamedTuple

import numpy as np

from service.records.levels.attitude import FloatArray, IntArray
from service.study.estimation.flight.baselines import COUPLING_RAD_H, commanded_deg
from service.study.estimation.flight.world import Ground

#: states of the motion, before any other
ANGLES, DRIFTS, SCALES, MOTION = slice(0, 3), slice(3, 6), slice(6, 9), slice(0, 9)


class FlownRows(NamedTuple):
    """Rows of a world as they were flown; (T, 3) yaw, roll, pitch."""

    epochs_us: IntArray
    #: (T,) h since the first one
    hours: FloatArray
    attitude_deg: FloatArray
    #: what announced corrections had added up to
    commanded_deg: FloatArray
    #: first row of operation; before it attitude and motion are known
    operation_row: int
    #: (T - 1, 3) what roll and yaw exchanged from each row to the next
    exchanged_deg: FloatArray

    @property
    def inertial_deg(self) -> FloatArray:
        """Turn (T, 3) against inertial axes since the first row, pitch without that of the orbit."""
        gained = np.diff(self.attitude_deg, axis=0) - self.exchanged_deg
        return np.vstack([np.zeros(3), np.cumsum(gained, axis=0)])


class OracleState(NamedTuple):
    """Mean (D,) and covariance (D, D) of the states; both are changed in place."""

    mean: FloatArray
    covariance: FloatArray


class OracleMeasurement(NamedTuple):
    """M measurements of D states."""

    #: (M, D), (M,) and the covariance (M, M) of the noise
    design: FloatArray
    measured: FloatArray
    noise: FloatArray


class MeasuredStates:
    """States of what is measured beside powers; they stand together behind those of the noise."""

    #: at the first row, and correlation times (E,), h; infinite = constant
    beginning: OracleState
    tau_h: FloatArray

    def during(self, last: int, row: int, states: int) -> OracleMeasurement | None:
        """Return what is measured of the motion from a row to a later one by `states` in all."""

    def move(self, gaussian: OracleState, last: int, row: int) -> None:
        """Carry the states from a row to a later one, in place, beside their own decay."""

    def at(self, row: int, states: int) -> OracleMeasurement | None:
        """Return what is measured at a row by `states` in all."""


def flown_rows(ground: Ground, attitude_deg: FloatArray, operation_row: int, *, is_coupled: bool) -> FlownRows:
    """Return the rows of a world of true attitudes (T, 3)."""
    hours = (ground.epochs_us - ground.epochs_us[0]) / 3.6e9
    rate, steps_h = COUPLING_RAD_H * is_coupled, np.diff(hours)
    middle = 0.5 * (attitude_deg[1:] + attitude_deg[:-1])
    exchanged = rate * steps_h[:, np.newaxis] * np.column_stack([-middle[:, 1], middle[:, 0], 0.0 * middle[:, 2]])
    return FlownRows(
        ground.epochs_us,
        hours,
        attitude_deg,
        commanded_deg(ground.epochs_us, ground.corrections),
        operation_row,
        exchanged,
    )
