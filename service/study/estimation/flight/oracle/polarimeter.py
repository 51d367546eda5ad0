"""Polarimeter in the oracle: its angle follows the turn of the body about the line of sight.

    z = atan(10^(D/20)) - d0 = p + b + w + f (1 - m) + r fade + l t + white,   D dB ratio of two ports of a feed at d0

p is the true turn, b offset with the wave of a day, w a wander of hours, f the Faraday rotation by the reported
electron content and m its relative error, r the turn by rain over the site, l a drift. Rain is known, and so are a
storm of the ionosphere and the moment in which the feed turns.
"""

import math

import numpy as np

from service.records.inputs import PolarizationRecord
from service.records.levels.attitude import FloatArray
from service.study.estimation.flight.motion_statistics import TruePolarimeter
from service.study.estimation.flight.oracle.flown_rows import (
    ANGLES,
    FlownRows,
    MeasuredStates,
    OracleMeasurement,
    OracleState,
)
from service.study.estimation.flight.world import Ground, Truth

#: offset, daily cosine and sine, wander, error of the electron content, turn by rain, drift
_STATES = 7
#: Faraday rotation of 1 TECU at 1 Hz in 1 T, deg
_FARADAY_DEG = math.degrees(2.36e4 * 1e16)
_DAY_H = 24.0


class PolarimeterStates(MeasuredStates):
    """Errors of a polarimeter: seven states from a place on."""

    def __init__(
        self,
        ground: Ground,
        truth: Truth,
        flown: FlownRows,
        statistics: TruePolarimeter,
        turn_deg: FloatArray,
        first: int,
    ) -> None:
        self._flown, self._statistics, self._first = flown, statistics, first
        self._fade_db = truth.downlink_fade_db
        self._operation_h = (ground.phases["operation"].start_us - int(flown.epochs_us[0])) / 3.6e9
        # what is left of an angle without the true turn; slopes are those at the true attitude
        self._other_deg = flown.attitude_deg @ np.array(statistics.sight) - turn_deg
        self._records = _records(ground)
        stated = ground.spacecraft.polarimeters[0]
        self._faraday_deg_tecu = _FARADAY_DEG * stated.field_t / stated.frequency_hz**2
        # a leakage turns the angle by as much as the feed is turned
        leak = math.cos(math.radians(statistics.feed_offset_deg)) ** 2
        daily = leak * statistics.daily_deg / math.sqrt(2.0)
        offset, wander = leak * statistics.leakage_deg / math.sqrt(2.0), leak * statistics.wander_deg
        drift = leak * statistics.leak_drift_deg_h
        sigma = [offset, daily, daily, wander, statistics.map_error, statistics.rain_deg_db, drift]
        self.beginning = OracleState(np.zeros(_STATES), np.diag(np.square(sigma)))
        self.tau_h = np.full(_STATES, np.inf)
        self.tau_h[3] = statistics.wander_tau_s / 3600.0

    def move(self, gaussian: OracleState, last: int, row: int) -> None:
        """Free the offset where the feed turns, in place."""
        from_us, to_us = self._flown.epochs_us[last], self._flown.epochs_us[row]
        if from_us < self._statistics.feed_turn_from_us <= to_us:
            gaussian.covariance[self._first, self._first] += self._statistics.feed_turn_deg**2

    def at(self, row: int, states: int) -> OracleMeasurement | None:
        """Return the angle of a row, None without one."""
        epoch_us = int(self._flown.epochs_us[row])
        record = self._records.get(epoch_us)
        if record is None or record.ratio_db is None:
            return None
        true, hours = self._statistics, float(self._flown.hours[row])
        storm = true.storm_factor if epoch_us >= true.storm_from_us else 1.0
        rotation_deg = storm * self._faraday_deg_tecu * (record.tec_tecu or 0.0)
        phase = 2.0 * math.pi * hours / _DAY_H
        design = np.zeros((1, states))
        design[0, ANGLES] = true.sight
        design[0, self._first : self._first + _STATES] = (
            1.0,
            math.cos(phase),
            math.sin(phase),
            1.0,
            -rotation_deg,
            self._fade_db[row],
            max(0.0, hours - self._operation_h),
        )
        angle_deg = math.degrees(math.atan(10.0 ** (record.ratio_db / 20.0))) - true.feed_offset_deg
        measured = np.array([angle_deg - rotation_deg + self._other_deg[row]])
        return OracleMeasurement(design, measured, np.array([[true.white_deg**2]]))


def _records(ground: Ground) -> dict[int, PolarizationRecord]:
    """Return the records by epoch."""
    found = (event.content for event in ground.events if isinstance(event.content, PolarizationRecord))
    return {record.epoch_us: record for record in found}
