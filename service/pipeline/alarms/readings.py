"""From a row that the chain has just computed to the readings that alarms look at; nothing is computed twice.

Which alarm explains a value (ISA-18.2, suppression by design): fade, angle beyond its limit, lost chain or link.

What follows from a cause is recorded inside it and told nobody, as long as the cause explains its size within sigma. A
carrier's level is explained but for its residual: what neither attitude nor chain nor rain leave of it.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median
from typing import Self

import numpy as np

from service.pipeline.alarms.alarm_engine import AlarmEngine, Explanation, Key, Readings
from service.pipeline.alarms.conditions import AlarmContext, context
from service.pipeline.estimation.method import CarrierLevels, RowEvidence
from service.pipeline.estimation.robust.attitude_rows import MOTION_ADVICE
from service.records.catalogue import CarrierPlan
from service.records.epoch import US_PER_S
from service.records.inputs import AttitudeReference
from service.records.levels.attitude import AttitudeRow, FloatArray, Status
from service.records.levels.measurement import Measurement, QualityFlag
from service.records.operations.alarms import AlarmChange, EngineMemory

SITE = "receiving site"
FADE, CHAIN_LOST, CHAIN_LEVEL = ("downlink_fade", SITE), ("chain_lost", SITE), ("chain_level", SITE)
AXES = ("yaw", "roll", "pitch")
ANGLES = tuple(("attitude_angle", axis) for axis in AXES)

#: one standard deviation of what a cause does to a level, by its size: bands differ, slopes are calibrated to a tenth
_EFFECT_ERROR = 0.1
#: the same of a level of which nothing better than the nominal one is expected, dB
_NOMINAL_SIGMA_DB = 1.0
#: the paper method takes a common change of level for an angle of at most so much, deg/dB
_MISREAD_DEG_DB = 0.5
#: noise temperature of rain over that of the receiver in the dry
_RAIN_NOISE = 2.75

#: explanation of a carrier's level, and the change in dB that it explains
LevelCause = tuple[Explanation, float]


@dataclass(frozen=True, slots=True)
class RowCauses:
    """Causes at one row with their sizes; whether their alarms stand is asked of the engine."""

    stands: Callable[[Key], bool]
    fade_db: float = 0.0
    chain_db: float = 0.0
    #: greatest size of each cause since it stands, dB or deg: means of methods are slow
    greatest: Mapping[Key, float] = field(default_factory=dict)

    def after(self, fade_db: float, chain_db: float, angles_deg: Sequence[float]) -> Self:
        """Return the causes at the next row; an angle that is not known is NaN."""
        sizes = {FADE: fade_db, CHAIN_LEVEL: abs(chain_db), **dict(zip(ANGLES, angles_deg, strict=True))}
        for cause, before in self.greatest.items():
            # where the size is not known, the one before
            sizes[cause] = max(before, sizes[cause]) if self.stands(cause) or math.isnan(sizes[cause]) else sizes[cause]
        return replace(self, fade_db=fade_db, chain_db=chain_db, greatest=sizes)

    def first(self, *causes: Key) -> Explanation | None:
        """Return the first of some causes that stands."""
        return next((Explanation(cause) for cause in causes if self.stands(cause)), None)

    def angle(self) -> tuple[Key, float] | None:
        """Return the greatest angle whose alarm stands, and its size, deg."""
        beyond = [(key, self.greatest.get(key, 0.0)) for key in ANGLES if self.stands(key)]
        return max(beyond, key=lambda one: one[1], default=None)

    def of_answer(self, apart_deg: float, *lost: Key) -> Explanation | None:
        """Return what explains that answers of a method are apart or wide: a lost fix, or a change read as an angle."""
        deg_of = dict.fromkeys(ANGLES, 1.0) | {FADE: _MISREAD_DEG_DB, CHAIN_LEVEL: _MISREAD_DEG_DB}
        explaining = (key for key, share in deg_of.items() if apart_deg <= share * self.greatest.get(key, 0.0))
        return self.first(*lost, *explaining)

    def of_levels(self, levels: CarrierLevels) -> dict[str, LevelCause]:
        """Return by carrier what explains its level, and the change that it explains, dB."""
        angle = self.angle()
        if angle is None and self.first(FADE, CHAIN_LEVEL) is None:
            return {}
        change_db = levels.deviation_db - levels.residual_db
        sigmas = np.abs(levels.residual_db) / np.hypot(levels.sigma_db, _EFFECT_ERROR * change_db)
        explained = {}
        for name, change, left in zip(levels.carrier_ids, change_db.tolist(), sigmas.tolist(), strict=True):
            cause = self._greatest(change, angle)
            if cause is not None:
                explained[name] = Explanation(cause, left), change
        return explained

    def of_nominal(self, deviation_db: float) -> Explanation | None:
        """Return what explains the level of a carrier of which no more than a nominal one is known."""
        change_db = self.chain_db - self.fade_db
        cause = self._greatest(change_db, None)
        if cause is None:
            return None
        sigma_db = math.hypot(_NOMINAL_SIGMA_DB, _EFFECT_ERROR * change_db)
        return Explanation(cause, abs(deviation_db - change_db) / sigma_db)

    def _greatest(self, change_db: float, angle: tuple[Key, float] | None) -> Key | None:
        """Return the cause that makes the greatest part of a change; None where it is not the better half of it."""
        parts_db = {FADE: self.fade_db, CHAIN_LEVEL: abs(self.chain_db)}
        if angle is not None:
            parts_db[angle[0]] = abs(change_db + self.fade_db - self.chain_db)
        cause, part_db = max(
            ((cause, part) for cause, part in parts_db.items() if self.stands(cause)),
            key=lambda one: one[1],
            default=(None, 0.0),
        )
        return None if part_db < abs(change_db) / 2.0 else cause


def c_n_loss_db(cause: Key, change_db: float) -> float:
    """Return by how much a change of level lowers carrier to noise; rain brings noise of its own.

    Examples
    --------
    >>> round(c_n_loss_db(CHAIN_LEVEL, -6.0), 1), round(c_n_loss_db(FADE, -6.0), 1), c_n_loss_db(FADE, 1.0)
    (6.0, 10.9, 0.0)
    """
    loss_db = max(0.0, -change_db)
    return loss_db + rain_noise_db(loss_db) if cause == FADE else loss_db


def rain_noise_db(fade_db: float) -> float:
    """Return by how much the noise of the receiver rises in rain that fades so much."""
    return 10.0 * math.log10(1.0 + _RAIN_NOISE * (1.0 - 10.0 ** (-fade_db / 10.0)))


def with_own_level(
    explained: Mapping[str, LevelCause], stands: Callable[[Key], bool], levels: CarrierLevels
) -> dict[str, LevelCause]:
    """Return what explains residual and C/N0 of each carrier: an alarm of its own level goes before other causes."""
    own = {
        name: (Explanation(key), deviation)
        for name, deviation in zip(levels.carrier_ids, levels.deviation_db.tolist(), strict=True)
        if stands(key := ("carrier_level", name))
    }
    return {**explained, **own}


#: rows from whose median distance the period is taken
_PERIOD_ROWS = 16
#: rows that a reference is compared with, and how close in time one must be, us
_KEPT_ROWS = 256
_REACH_US = 300 * US_PER_S
#: a sensor and the estimate differ when they do by this many sigma of both
_SENSOR_SIGMAS = 3.0
#: a fade of unknown depth is a fade
_SOME_FADE_DB = 1e-3
#: inhibition of a row whose method has only begun
_SETTLING = "settling"
#: carrier to noise below which a carrier may be lost in the noise, dB
_DETECTABLE_DB = 0.0


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
        self._holds_for: tuple[object, object] = (None, None)
        self._causes = RowCauses(engine.stands)
        self._plan: CarrierPlan | None = None
        self._carrier_ids: tuple[str, ...] = ()
        self._bandwidth_db: FloatArray = np.zeros(0)
        #: carrier to noise that each carrier had at last, less the fade of then; with that of when it was lost; dB
        self._dry_c_n_db: FloatArray = np.zeros(0)
        self._lost_c_n_db: FloatArray = np.zeros(0)

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
        changes = self._context(facts, epoch_us)
        # causes go before what follows from them
        families = [self._of_chain(facts, driving)]
        families += [] if driving is None else [self._of_attitude(facts, driving)]
        for family in (*families, self._of_carriers(facts)):
            for readings in family:
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
        answers = zip(reference.attitude_deg, row.attitude_deg, row.protection_deg, strict=True)
        is_within = all(math.isnan(sensed) or abs(sensed - reported) <= bound for sensed, reported, bound in answers)
        cause = self._causes.first(FADE, CHAIN_LOST, CHAIN_LEVEL) if is_within else None
        things, causes = (reference.source,), _by_thing(reference.source, cause)
        readings = Readings("sensor_disagreement", things, (apart_deg,), is_partial=True, causes=causes)
        return self._engine.observe(readings, reference.epoch_us)

    def _context(self, facts: RowEvidence, epoch_us: int) -> list[AlarmChange]:
        """Find out what holds, where it can have changed."""
        holds, former = self._holds, self._holds_for
        is_same = former[0] is facts.operations and former[1] is facts.plan
        if is_same and holds.since_us <= epoch_us < holds.until_us:
            return []
        self._holds_for = (facts.operations, facts.plan)
        self._holds = context(facts.operations.values(), facts.plan, epoch_us)
        return self._engine.enter(self._holds, epoch_us)

    def _of_carriers(self, facts: RowEvidence) -> Iterator[Readings]:
        """Yield the readings of single carriers; a row without findings costs a few extremes of arrays."""
        measurement, is_settled, levels = facts.measurement, self._engine.is_settled, facts.levels
        # the sum is NaN where one of them is
        if math.isnan(measurement.power_dbm.sum()) or not is_settled("carrier_absent", 0.0):
            is_absent = _absent(measurement)
            causes = {name: cause for name, cause in self._of_absence() if cause is not None}
            yield Readings("carrier_absent", self._carrier_ids, is_absent, causes=causes)
        explained = {} if levels is None else self._causes.of_levels(levels)
        if levels is None or self._nominal_dbm:
            yield self._level_by_name(facts, explained)
        else:
            yield from self._extremes("carrier_level", levels, levels.deviation_db, explained)
        if levels is not None:
            if not is_settled("carrier_level", 0.0):
                explained = with_own_level(explained, self._engine.stands, levels)
            yield from self._extremes("carrier_residual", levels, levels.residual_db, explained)
        if measurement.details is not None:
            yield from self._carrier_to_noise(measurement.details.c_n0_db_hz - self._bandwidth_db, explained)

    def _extremes(
        self, condition: str, levels: CarrierLevels, values_db: FloatArray, explained: Mapping[str, LevelCause]
    ) -> Iterator[Readings]:
        """Yield the sizes of what carriers differ by, where one of them wants a look."""
        away_db = np.abs(values_db)
        if not self._engine.is_settled(condition, float(np.fmax.reduce(away_db))):
            causes = {name: explanation for name, (explanation, _) in explained.items()}
            yield Readings(condition, levels.carrier_ids, away_db, causes=causes)

    def _carrier_to_noise(self, c_n_db: FloatArray, explained: Mapping[str, LevelCause]) -> Iterator[Readings]:
        """Yield the carrier to noise ratios; a cause explains what would lie within the limit without it."""
        dry_db = c_n_db + c_n_loss_db(FADE, -self._causes.fade_db)
        self._dry_c_n_db = np.where(np.isnan(dry_db), self._dry_c_n_db, dry_db)
        self._lost_c_n_db = np.where(np.isnan(dry_db), self._lost_c_n_db, math.nan)
        if not self._engine.is_settled("carrier_c_n0", float(np.fmin.reduce(c_n_db))):
            limit_db, causes = self._engine.bound("carrier_c_n0"), {}
            for name, ratio_db in zip(self._carrier_ids, c_n_db.tolist(), strict=True):
                if name in explained:
                    explanation, change_db = explained[name]
                    is_within = not ratio_db + c_n_loss_db(explanation.cause, change_db) < limit_db
                    causes[name] = explanation if is_within else explanation._replace(sigmas=math.inf)
            yield Readings("carrier_c_n0", self._carrier_ids, c_n_db, causes=causes)

    def _of_absence(self) -> Iterator[tuple[str, Explanation | None]]:
        """Yield what explains that a carrier is absent: a lost chain, or a fade that takes it below the noise."""
        is_lost, is_fading = self._engine.stands(CHAIN_LOST), self._engine.stands(FADE)
        # what fell silent in the dry is not explained by rain that comes later
        now_db = self._dry_c_n_db - c_n_loss_db(FADE, -self._causes.fade_db)
        self._lost_c_n_db = np.where(np.isnan(self._lost_c_n_db), now_db, self._lost_c_n_db)
        for name, ratio_db in zip(self._carrier_ids, self._lost_c_n_db.tolist(), strict=True):
            # no ratio was ever measured: nothing is known
            sigmas = math.nan if math.isnan(ratio_db) else 0.0 if ratio_db < _DETECTABLE_DB else math.inf
            yield name, Explanation(CHAIN_LOST) if is_lost else Explanation(FADE, sigmas) if is_fading else None

    def _of_chain(self, facts: RowEvidence, driving: AttitudeRow | None) -> Iterator[Readings]:
        """Yield what the receiving site has in common, and note the causes of this row."""
        if facts.plan is not self._plan:
            self._use_plan(facts.plan)
        measurement, is_settled = facts.measurement, self._engine.is_settled
        if math.isnan(measurement.power_dbm.sum()) or not is_settled("chain_lost", 0.0):
            is_absent = _absent(measurement)
            is_absent = is_absent[~np.isnan(is_absent)]
            # of one carrier its user is asked first
            is_lost = float(is_absent.all()) if len(is_absent) > 1 else math.nan
            yield Readings("chain_lost", (SITE,), (is_lost,))
        if driving is None:
            self._causes = RowCauses(self._engine.stands)
            return
        fade_db = _fade_db(driving)
        chain_db = next((row.common_db for row in facts.rows if math.isfinite(row.common_db)), math.nan)
        angles_deg = driving.steered_deg if driving.status is Status.ACQUIRED else (math.nan,) * 3
        known_db = 0.0 if math.isnan(chain_db) else chain_db
        self._causes = self._causes.after(fade_db, known_db, tuple(map(abs, angles_deg)))
        if not is_settled("downlink_fade", fade_db):
            yield Readings("downlink_fade", (SITE,), (fade_db,))
        if not is_settled("chain_level", abs(chain_db)):
            yield Readings("chain_level", (SITE,), (abs(chain_db),))

    def _of_attitude(self, facts: RowEvidence, driving: AttitudeRow) -> Iterator[Readings]:
        """Yield the readings of the rows of the methods."""
        is_settled, is_told = self._engine.is_settled, driving.status is Status.ACQUIRED
        angles_deg = tuple(map(abs, driving.steered_deg)) if is_told else (math.nan,) * 3
        if not is_settled("attitude_angle", max(angles_deg)):
            yield Readings("attitude_angle", AXES, angles_deg)
        # a method whose means are still filling is not lost
        lost, method = math.nan if _SETTLING in driving.inhibitions else float(not is_told), driving.method.value
        if not is_settled("attitude_lost", lost):
            cause = self._causes.first(CHAIN_LOST, FADE)
            yield Readings("attitude_lost", (method,), (lost,), causes=_by_thing(method, cause))
        # yaw is controlled by its sigma
        levels_deg = (driving.protection_deg.roll, driving.protection_deg.pitch)
        if not is_settled("protection_level", max(levels_deg)):
            causes: dict[str, Explanation] = {}
            for axis, level_deg in zip(AXES[1:], levels_deg, strict=True):
                cause = self._causes.of_answer(level_deg, CHAIN_LOST, ("attitude_lost", method))
                cause = cause or self._causes.first(FADE)
                causes |= _by_thing(axis, cause)
            yield Readings("protection_level", AXES[1:], levels_deg, causes=causes)
        is_advised = tuple(float(code in driving.advice) for code in MOTION_ADVICE)
        if not is_settled("measured_motion", max(is_advised)):
            yield Readings("measured_motion", MOTION_ADVICE, is_advised)
        is_undeclared = float("undeclared_operation" in driving.inhibitions)
        if not is_settled("undeclared_operation", is_undeclared):
            yield Readings("undeclared_operation", ("thrusters",), (is_undeclared,))
        apart_deg = facts.disagreement_deg
        if not is_settled("methods_disagree", apart_deg):
            causes = _by_thing("robust, paper", self._causes.of_answer(apart_deg, CHAIN_LOST))
            yield Readings("methods_disagree", ("robust, paper",), (apart_deg,), causes=causes)

    def _level_by_name(self, facts: RowEvidence, explained: Mapping[str, LevelCause]) -> Readings:
        """Return the deviations, from the nominal level where nothing is expected of a carrier."""
        away_db, causes = {}, {name: explanation for name, (explanation, _) in explained.items()}
        for name, power_dbm in zip(self._carrier_ids, facts.measurement.power_dbm.tolist(), strict=True):
            if name in self._nominal_dbm:
                away_db[name] = abs(power_dbm - self._nominal_dbm[name])
                cause = self._causes.of_nominal(power_dbm - self._nominal_dbm[name])
                causes |= {} if name in causes or cause is None else {name: cause}
        if facts.levels is not None:
            expected = zip(facts.levels.carrier_ids, np.abs(facts.levels.deviation_db).tolist(), strict=True)
            away_db |= {name: db for name, db in expected if math.isfinite(db) or name not in away_db}
        return Readings("carrier_level", tuple(away_db), tuple(away_db.values()), causes=causes)

    def _use_plan(self, plan: CarrierPlan) -> None:
        """Take over names and bandwidths of a plan's carriers."""
        self._plan, self._carrier_ids = plan, plan.carrier_ids
        self._bandwidth_db = 10.0 * np.log10([carrier.bandwidth_hz for carrier in plan.carriers])
        self._dry_c_n_db = self._lost_c_n_db = np.full(len(plan.carriers), math.nan)


def _by_thing(thing: str, cause: Explanation | None) -> dict[str, Explanation]:
    return {} if cause is None else {thing: cause}


def _fade_db(row: AttitudeRow) -> float:
    if not row.downlink_fade:
        return 0.0
    return row.downlink_fade_db if row.downlink_fade_db > 0.0 else _SOME_FADE_DB


def _absent(measurement: Measurement) -> FloatArray:
    """Return which carriers are absent, 1 or 0; of one that is not measured nothing is known."""
    is_absent = np.isnan(measurement.power_dbm).astype(np.float64)
    if measurement.flags is not None:
        is_absent[(measurement.flags & QualityFlag.NOT_MEASURED) != 0] = math.nan
    return is_absent


def _apart_deg(reference: AttitudeReference, row: AttitudeRow) -> float | None:
    """Return the greatest difference that the sigmas of both do not explain, 0 when they do; None without angles."""
    worst_deg, is_any = 0.0, False
    for angle, sensed_deg, reported_deg in zip(AXES, reference.attitude_deg, row.attitude_deg, strict=True):
        apart_deg = abs(sensed_deg - reported_deg)
        if math.isnan(apart_deg):
            continue
        is_any = True
        sigmas_deg = (getattr(reference.sigma_deg, angle), getattr(row.sigma_deg, angle))
        sigma_deg = math.hypot(*(0.0 if math.isnan(sigma) else sigma for sigma in sigmas_deg))
        if apart_deg > _SENSOR_SIGMAS * sigma_deg:
            worst_deg = max(worst_deg, apart_deg)
    return worst_deg if is_any else None
