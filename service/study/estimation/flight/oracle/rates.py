"""Rate sensor in the oracle: mean rates of a step tell corrections, drift and the bias of the sensor together.

    reported = (1 + s) u + d + b + noise       u commanded, s scale error, d drift, b bias of first order; deg/h

as in `filter`, without the turn of the orbit. Before operation the motion is known, and what is reported is the bias.
"""

import numpy as np

from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import FloatArray
from service.study.estimation.flight.motion_statistics import TrueRates
from service.study.estimation.flight.oracle.flown_rows import (
    DRIFTS,
    SCALES,
    FlownRows,
    MeasuredStates,
    OracleMeasurement,
    OracleState,
)
from service.study.estimation.flight.world import Ground

#: turn of the orbit, deg/h, about pitch
_ORBIT_DEG_H = np.array([0.0, 0.0, 15.0410686])
#: known motion that is faster than this, deg/h, or a longer step, h, tells nothing: rates are about turned axes
_FASTEST_DEG_H, _LONGEST_H = 1.0, 1.0


class RateStates(MeasuredStates):
    """Bias of the sensor: three states from a place on."""

    def __init__(self, ground: Ground, flown: FlownRows, statistics: TrueRates, first: int) -> None:
        self._flown, self._statistics, self._own = flown, statistics, slice(first, first + 3)
        self._known_deg, self._reported_deg = flown.inertial_deg, _reported_deg(ground, flown)
        sigma = statistics.bias_factor * statistics.bias_deg_h
        self.beginning = OracleState(np.zeros(3), sigma**2 * np.eye(3))
        self.tau_h = np.full(3, statistics.bias_tau_h)

    def during(self, last: int, row: int, states: int) -> OracleMeasurement | None:
        """Return the mean rate of a step, None where it tells nothing."""
        is_known = last < self._flown.operation_row
        hours = self._flown.hours[row] - self._flown.hours[last]
        reported = (self._reported_deg[row] - self._reported_deg[last]) / hours
        moved = self._known_deg if is_known else self._flown.commanded_deg
        known = (moved[row] - moved[last]) / hours
        is_unfit = is_known and (hours > _LONGEST_H or np.abs(known).max() > _FASTEST_DEG_H)
        if is_unfit or not np.isfinite(reported).all():
            return None
        design = np.zeros((3, states))
        design[:, self._own] = np.eye(3)
        if not is_known:
            design[:, DRIFTS], design[:, SCALES] = np.eye(3), np.diag(known)
        return OracleMeasurement(design, reported - known, self._statistics.noise_deg_sqrt_h**2 / hours * np.eye(3))


def _reported_deg(ground: Ground, flown: FlownRows) -> FloatArray:
    """Return the turn (T, 3) that the rates add up to, NaN from the first row without one."""
    records = (event.content for event in ground.events if isinstance(event.content, TelemetryRecord))
    rates = {record.epoch_us: record.body_rate_deg_s for record in records if record.body_rate_deg_s is not None}
    nothing = (np.nan,) * 3
    reported = 3600.0 * np.array([rates.get(epoch_us, nothing) for epoch_us in flown.epochs_us[1:].tolist()])
    gained = (reported + _ORBIT_DEG_H) * np.diff(flown.hours)[:, np.newaxis]
    return np.vstack([np.zeros(3), np.cumsum(gained, axis=0)])
