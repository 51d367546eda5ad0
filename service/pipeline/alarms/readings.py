"""From a row that the chain has just computed to the readings that alarms look at; nothing is computed twice."""

import math
from collections import deque
from collections.abc import Iterator, Mapping
from itertools import pairwise
from statistics import median

import numpy as np

from service.pipeline.alarms.alarm_engine import AlarmEngine, Readings
from service.pipeline.alarms.limit_sets import AlarmContext, context
from service.pipeline.estimation.method import CarrierLevels, RowEvidence
from service.pipeline.estimation.robust.attitude_rows import MOTION_ADVICE
from service.records.catalogue import CarrierPlan
from service.records.epoch import US_PER_S
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import AttitudeRow, FloatArray, Status
from service.records.levels.measurement import Measurement, QualityFlag
from service.records.operations.alarms import AlarmChange, EngineMemory

#: rows from whose median distance the period is taken
_PERIOD_ROWS = 16
#: rows that a reference is compared with, and how close in time one must be, us
_KEPT_ROWS = 256
_REACH_US = 300 * US_PER_S
#: a sensor and the estimate differ when they do by this many sigma of both
_SENSOR_SIGMAS = 3.0
#: a fade of unknown depth is a fade
_SOME_FADE_DB = 1e-3
_AXES = ("yaw", "roll", "pitch")
#: inhibition of a row whose method has only begun
_SETTLING = "settling"


class RowReader:
    """Reader of rows and references of one spacecraft into its alarm engine.

    Parameters
    ----------
    engine : AlarmEngine
        Receives the readings.
    memory : EngineMemory
        Position of the former run.
    """

    def __init__(self, engine: AlarmEngine, memory: EngineMemory) -> None:
        self._engine = engine
        self._newest_us = memory.newest_row_us
        self._recent_us: deque[int] = deque(maxlen=_PERIOD_ROWS)
        self._kept_period_s = memory.row_period_s
        self._nominal_dbm: Mapping[str, float] = {}
        self._reported: deque[AttitudeRow] = deque(maxlen=_KEPT_ROWS)
        self._holds = AlarmContext()
        self._holds_for: tuple[object, object, object] = (None, None, None)
        self._plan: CarrierPlan | None = None
        self._carrier_ids: tuple[str, ...] = ()
        self._bandwidth_db: FloatArray = np.zeros(0)

    @property
    def newest_row_us(self) -> int | None:
        """Epoch of the newest row that was read."""
        return self._newest_us

    @property
    def row_period_s(self) -> float | None:
        """Median time between rows, s; None before there are three."""
        if len(self._recent_us) >= 3:
            self._kept_period_s = median(after - before for before, after in pairwise(self._recent_us)) / US_PER_S
        return self._kept_period_s

    def use_nominal(self, nominal_dbm: Mapping[str, float]) -> None:
        """Take over the levels of carriers of which nothing better is expected."""
        self._nominal_dbm = nominal_dbm

    def read_row(self, facts: RowEvidence) -> list[AlarmChange]:
        """Read a row; a late row or one out of order changes nothing."""
        epoch_us = facts.measurement.epoch_us
        if facts.measurement.is_late or epoch_us <= (self._newest_us or 0):
            return []
        self._newest_us = epoch_us
        self._recent_us.append(epoch_us)
        driving = next((row for row in facts.rows if row.method is facts.method), None)
        changes = self._context(facts, epoch_us, is_raining=driving is not None and driving.downlink_fade)
        for readings in self._of_carriers(facts):
            changes += self._engine.observe(readings, epoch_us)
        if driving is not None:
            for readings in self._of_attitude(facts, driving):
                changes += self._engine.observe(readings, epoch_us)
        if driving is not None and driving.status is Status.ACQUIRED:
            self._reported.append(driving)
        return changes + self._engine.pass_time(epoch_us)

    def read_reference(self, reference: AttitudeReference) -> list[AlarmChange]:
        """Compare a reference with the row nearest in time; one without a row near the newest says nothing."""
        if not self._reported or abs(reference.epoch_us - self._reported[-1].epoch_us) > _REACH_US:
            return []
        row = min(reversed(self._reported), key=lambda one: abs(one.epoch_us - reference.epoch_us))
        apart_deg = _apart_deg(reference, row)
        if apart_deg is None:
            return []
        readings = Readings("sensor_disagreement", (reference.source,), (apart_deg,), is_partial=True)
        return self._engine.observe(readings, reference.epoch_us)

    def _context(self, facts: RowEvidence, epoch_us: int, *, is_raining: bool) -> list[AlarmChange]:
        """Find out what holds, where it can have changed."""
        holds, former = self._holds, self._holds_for
        is_same = former[0] is facts.operations and former[1] is facts.plan and former[2] is is_raining
        if is_same and holds.since_us <= epoch_us < holds.until_us:
            return []
        self._holds_for = (facts.operations, facts.plan, is_raining)
        self._holds = context(facts.operations.values(), facts.plan, epoch_us, is_raining=is_raining)
        return self._engine.enter(self._holds, epoch_us)

    def _of_carriers(self, facts: RowEvidence) -> Iterator[Readings]:
        """Yield the readings of single carriers; a row without findings costs a few extremes of arrays."""
        if facts.plan is not self._plan:
            self._use_plan(facts.plan)
        measurement, is_settled = facts.measurement, self._engine.is_settled
        # the sum is NaN where one of them is
        if math.isnan(measurement.power_dbm.sum()) or not is_settled("carrier_absent", 0.0):
            yield self._absence(measurement)
        if measurement.details is not None:
            c_n_db = measurement.details.c_n0_db_hz - self._bandwidth_db
            if not is_settled("carrier_c_n0", float(np.fmin.reduce(c_n_db))):
                yield Readings("carrier_c_n0", self._carrier_ids, c_n_db)
        if facts.levels is None or self._nominal_dbm:
            yield self._level_by_name(facts)
        else:
            yield from self._extremes("carrier_level", facts.levels, facts.levels.deviation_db)
        if facts.levels is not None:
            yield from self._extremes("carrier_residual", facts.levels, facts.levels.residual_db)

    def _extremes(self, condition: str, levels: CarrierLevels, values_db: FloatArray) -> Iterator[Readings]:
        """Yield the sizes of what carriers differ by, where one of them wants a look."""
        away_db = np.abs(values_db)
        if not self._engine.is_settled(condition, float(np.fmax.reduce(away_db))):
            yield Readings(condition, levels.carrier_ids, away_db)

    def _of_attitude(self, facts: RowEvidence, driving: AttitudeRow) -> Iterator[Readings]:
        """Yield the readings of the rows of the methods."""
        is_settled, is_told = self._engine.is_settled, driving.status is Status.ACQUIRED
        angles_deg = tuple(map(abs, driving.attitude_deg)) if is_told else (math.nan,) * 3
        if not is_settled("attitude_angle", max(angles_deg)):
            yield Readings("attitude_angle", _AXES, angles_deg)
        # yaw is controlled by its sigma
        levels_deg = (driving.protection_deg.roll, driving.protection_deg.pitch)
        if not is_settled("protection_level", max(levels_deg)):
            yield Readings("protection_level", ("roll", "pitch"), levels_deg)
        # a method whose means are still filling is not lost
        lost = math.nan if _SETTLING in driving.inhibitions else float(not is_told)
        if not is_settled("attitude_lost", lost):
            yield Readings("attitude_lost", (driving.method.value,), (lost,))
        is_advised = tuple(float(code in driving.advice) for code in MOTION_ADVICE)
        if not is_settled("measured_motion", max(is_advised)):
            yield Readings("measured_motion", MOTION_ADVICE, is_advised)
        apart_deg = facts.disagreement_deg
        if not is_settled("methods_disagree", apart_deg):
            yield Readings("methods_disagree", ("robust, paper",), (apart_deg,))
        fade_db = driving.downlink_fade_db if driving.downlink_fade else 0.0
        is_deep = not driving.downlink_fade or fade_db > 0.0
        fade_db = fade_db if is_deep else _SOME_FADE_DB
        if not is_settled("downlink_fade", fade_db):
            yield Readings("downlink_fade", ("receiving site",), (fade_db,))

    def _absence(self, measurement: Measurement) -> Readings:
        """Return which carriers are absent; of one that is not measured nothing is known."""
        is_absent = np.isnan(measurement.power_dbm).astype(np.float64)
        if measurement.flags is not None:
            is_absent[(measurement.flags & QualityFlag.NOT_MEASURED) != 0] = math.nan
        return Readings("carrier_absent", self._carrier_ids, is_absent)

    def _level_by_name(self, facts: RowEvidence) -> Readings:
        """Return the deviations, from the nominal level where nothing is expected of a carrier."""
        away_db = {}
        for name, power_dbm in zip(self._carrier_ids, facts.measurement.power_dbm.tolist(), strict=True):
            if name in self._nominal_dbm:
                away_db[name] = abs(power_dbm - self._nominal_dbm[name])
        if facts.levels is not None:
            expected = zip(facts.levels.carrier_ids, np.abs(facts.levels.deviation_db).tolist(), strict=True)
            away_db |= {name: db for name, db in expected if math.isfinite(db) or name not in away_db}
        return Readings("carrier_level", tuple(away_db), tuple(away_db.values()))

    def _use_plan(self, plan: CarrierPlan) -> None:
        """Take over names and bandwidths of a plan's carriers."""
        self._plan, self._carrier_ids = plan, plan.carrier_ids
        self._bandwidth_db = 10.0 * np.log10([carrier.bandwidth_hz for carrier in plan.carriers])


def _apart_deg(reference: AttitudeReference, row: AttitudeRow) -> float | None:
    """Return the greatest difference that the sigmas of both do not explain, 0 when they do; None without angles."""
    worst_deg, is_any = 0.0, False
    for angle, sensed_deg, reported_deg in zip(_AXES, reference.attitude_deg, row.attitude_deg, strict=True):
        apart_deg = abs(sensed_deg - reported_deg)
        if math.isnan(apart_deg):
            continue
        is_any = True
        sigmas_deg = (getattr(reference.sigma_deg, angle), getattr(row.sigma_deg, angle))
        sigma_deg = math.hypot(*(0.0 if math.isnan(sigma) else sigma for sigma in sigmas_deg))
        if apart_deg > _SENSOR_SIGMAS * sigma_deg:
            worst_deg = max(worst_deg, apart_deg)
    return worst_deg if is_any else None
