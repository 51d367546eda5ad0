"""Whatever causes stand: what they do not explain is told, what they explain is not, and nothing flickers."""

import math
from dataclasses import replace

import numpy as np
from example_counts import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from service.pipeline.alarms.alarm_engine import AlarmEngine
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.readings import RowReader
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.estimation.method import CarrierLevels, RowEvidence
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.levels.attitude import Axes, Status, row_without_attitude
from service.records.levels.measurement import Measurement
from service.records.operations.alarms import EngineMemory

MINUTE = 60_000_000
PLAN = CarrierPlan(1, "sha", tuple(Carrier(f"c{k}", "Ku", "t", 11e9, 1e6) for k in range(4)))
CONDITIONS = condition_table(AlarmConfig(), RobustConfig())
SIGMA_DB = 0.2
ROWS = 60
#: when a cause or a fault begins
MINUTE_OF = st.integers(1, 20)
CAUSE = st.tuples(st.sampled_from([0.0, 0.5, 3.0, 8.0, 15.0]), st.sampled_from([-6.0, 0.0, 6.0]), st.floats(0.0, 1.0))


def evidence(minute, fade_db, chain_db, pitch_deg, left_db):
    """Return a row at which these causes act, 4 dB a degree, and leave so much of each carrier's level."""
    epoch_us = minute * MINUTE
    change_db = np.full(4, chain_db - fade_db + 4.0 * pitch_deg)
    plain = row_without_attitude(epoch_us, 0, minute, Method.ROBUST, ())
    row = replace(
        plain,
        status=Status.ACQUIRED,
        attitude_deg=Axes(0.0, 0.0, pitch_deg),
        downlink_fade=fade_db > 0.0,
        downlink_fade_db=fade_db,
        common_db=chain_db,
    )
    ids = PLAN.carrier_ids
    levels = CarrierLevels(ids, change_db + left_db, left_db, np.full(4, SIGMA_DB), np.ones(4, bool), np.zeros(4, int))
    measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, np.full(4, -40.0), None)
    return RowEvidence(measurement, PLAN, (row,), Method.ROBUST, levels, {})


def told(cause, begin, offset_db, fault_from, seed):
    """Return the changes about c0 that are told, and whether it follows from a cause at the end."""
    engine, noise = AlarmEngine("craft", CONDITIONS), np.random.default_rng(seed)
    reader, changes = RowReader(engine, EngineMemory()), []
    for minute in range(1, ROWS):
        left_db = SIGMA_DB * np.clip(noise.standard_normal(4), -2.0, 2.0)
        left_db[0] += offset_db if minute >= fault_from else 0.0
        acting = cause if minute >= begin else (0.0, 0.0, 0.0)
        changes += reader.read_row(evidence(minute, *acting, left_db))
    return [change for change in changes if change.is_told and change.alarm.thing == "c0"]


def effect_db(cause):
    fade_db, chain_db, pitch_deg = cause
    return chain_db - fade_db + 4.0 * pitch_deg


@settings(max_examples=examples(60), deadline=None)
@given(CAUSE, MINUTE_OF, MINUTE_OF, st.floats(6.0, 15.0), st.sampled_from([-1, 1]), st.integers(0, 99))
def test_what_no_cause_explains_is_told(cause, begin, fault_from, sigmas, sign, seed):
    sigma_db = math.hypot(SIGMA_DB, 0.1 * effect_db(cause))
    offset_db = sign * max(sigmas * sigma_db, 3.6)
    changes = told(cause, begin, offset_db, fault_from, seed)
    assert {change.alarm.condition for change in changes} & {"carrier_level", "carrier_residual"}
    assert all(change.alarm.cause is None for change in changes)


@settings(max_examples=examples(60), deadline=None)
@given(CAUSE, st.integers(1, 20), st.floats(-0.9, 0.9), st.integers(0, 99))
def test_what_a_cause_explains_is_told_nobody(cause, begin, sigmas, seed):
    fade_db, chain_db, pitch_deg = cause
    # the greatest part of the change must come from a cause that alarms
    parts_db = {"fade": fade_db, "chain": abs(chain_db), "angle": 4.0 * pitch_deg if pitch_deg > 0.31 else 0.0}
    assume(max(parts_db.values()) >= abs(effect_db(cause)) / 2.0)
    sigma_db = 0.1 * effect_db(cause)
    assert told(cause, begin, sigmas * sigma_db, begin, seed) == []
