"""Alarms by cause over worlds of the simulator: one cause is at most three alarms, and of two faults both are seen.

The rows go through the chain that a service runs and the reader of alarms; what counts is what an operator is told.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from driven_world import rain_db, shared_world

from service.pipeline.alarms.alarm_engine import AlarmEngine
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.alarms.readings import RowReader, rain_noise_db
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.inputs.knowledge import JournalDocuments
from service.records.catalogue import Method
from service.records.levels.measurement import CarrierDetails
from service.records.operations.alarms import ChangeKind, EngineMemory
from service.study.estimation.flight.drive import measurements, slow_entries

SEED = 3
BEGIN_H, END_H, LAST_H = 1.0, 2.5, 4.5
TILT, SITE = ("attitude_angle", "pitch"), "receiving site"
FADE, CHAIN_LOST, CHAIN_LEVEL = (("downlink_fade", SITE), ("chain_lost", SITE), ("chain_level", SITE))
CONDITIONS = condition_table(AlarmConfig(), RobustConfig())
#: C/N of every carrier in the dry, dB
CLEAR_C_N_DB = 14.0


@cache
def world():
    print(f"nominal, seed {SEED}")
    return shared_world("nominal", SEED)


class Powers:
    """Powers of the world, changed by faults."""

    def __init__(self):
        self.power_dbm = world().ground.power_dbm.copy()
        self.fade_db = np.zeros(len(world().hours))

    def add(self, change_db, carriers=slice(None), begin_h=BEGIN_H, end_h=END_H):
        rows = np.flatnonzero((world().hours >= begin_h) & (world().hours < end_h))
        block = self.power_dbm[rows]
        block[:, carriers] += change_db
        self.power_dbm[rows] = block
        return self

    def rain(self, depth_db=8.0):
        self.fade_db = rain_db(world().hours, BEGIN_H, depth_db, 0.2, 0.5)
        self.power_dbm -= self.fade_db[:, None]
        return self

    def tilt(self, pitch_deg=1.0, begin_h=BEGIN_H, end_h=END_H):
        rows = np.flatnonzero((world().hours >= begin_h) & (world().hours < end_h))
        hours, truth_deg = world().hours[rows], world().truth.attitude_deg[rows]
        share = np.clip(np.minimum(hours - begin_h, end_h - hours) / 0.25, 0.0, 1.0)
        turned_deg = truth_deg + share[:, None] * np.array([0.0, 0.0, pitch_deg])
        epochs_us = world().ground.epochs_us[rows]
        gain_db = [world().noise_free_dbm(epochs_us, angles_deg) for angles_deg in (turned_deg, truth_deg)]
        self.power_dbm[rows] += gain_db[0] - gain_db[1]
        return self


def told(powers, *, restart_h=None):
    """Return every change of alarms that operators are told, and the engine at the end."""
    ground = replace(world().ground, power_dbm=powers.power_dbm.astype(np.float32).astype(np.float64))
    kept = world().documents
    documents = JournalDocuments(dict(kept.plans), dict(kept.ephemerides), kept.calibrations, kept.alignments)
    chain = world().aligned_chain(documents, methods=(Method.ROBUST, Method.PAPER))
    entries = [entry for entry in slow_entries(ground, documents) if entry.epoch_us >= world().start_us]
    hours = world().hours
    rows = np.flatnonzero(ground.is_measured & (hours >= 0.0) & (hours < LAST_H))
    engine = AlarmEngine("craft", CONDITIONS)
    reader, changes, plain_dbm = RowReader(engine, EngineMemory()), [], world().ground.power_dbm
    bandwidth_db = 10.0 * np.log10([carrier.bandwidth_hz for carrier in ground.carriers])
    for k, row in zip(rows, measurements(chain, ground, documents, entries, rows), strict=True):
        if restart_h is not None and hours[k] >= restart_h:
            memory = EngineMemory(engine.watches(), reader.newest_row_us, reader.row_period_s)
            engine = AlarmEngine("craft", CONDITIONS, None, tuple(engine.open_alarms.values()), memory)
            reader, restart_h = RowReader(engine, memory), None
        ratio_db = CLEAR_C_N_DB + row.power_dbm - plain_dbm[k] - rain_noise_db(powers.fade_db[k]) + bandwidth_db
        blank = np.full(len(ratio_db), np.nan)
        row = replace(row, details=CarrierDetails(blank, ratio_db.astype(np.float32), blank, blank))
        changes += reader.read_row(chain.facts(*chain.rows([row])))
    return [change for change in changes if change.is_told], engine


ANNOUNCING = (ChangeKind.RAISED, ChangeKind.RELEASED)


def announced(changes):
    """Return the alarms that were told as new: raised, or let go by their cause."""
    return {change.alarm.key for change in changes if change.kind in ANNOUNCING}


CAUSES = {
    "nothing": (lambda: Powers(), set()),
    "rain": (lambda: Powers().rain(10.0), {FADE}),
    "rain and the drift after it": (lambda: Powers().rain(8.0).tilt(0.6, 2.5, 4.0), {FADE, TILT}),
    "tilt": (lambda: Powers().tilt(), {TILT}),
    "tilt of half a degree": (lambda: Powers().tilt(0.5), {TILT}),
    "chain off the air": (lambda: Powers().add(np.nan), {CHAIN_LOST}),
    "gain of the chain falls": (lambda: Powers().add(-8.0), {FADE}),
    "gain of the chain rises": (lambda: Powers().add(8.0), {CHAIN_LEVEL}),
}


@pytest.mark.parametrize("name", CAUSES)
def test_a_cause_is_at_most_three_alarms(name):
    powers, expected = CAUSES[name]
    changes, engine = told(powers())
    print(f"{name}: {sorted(announced(changes))}, {len(changes)} notices")
    assert expected <= announced(changes)
    assert len(announced(changes)) <= 3 * max(len(expected), 1) if expected else not changes
    assert not any(key[0] in ("carrier_level", "carrier_absent", "carrier_c_n0") for key in announced(changes))
    assert all(alarm.cause is None or engine.stands(alarm.cause) for alarm in engine.open_alarms.values())


ODD = 5
DEAD, LEVEL, RESIDUAL = (("carrier_absent", "c05"), ("carrier_level", "c05"), ("carrier_residual", "c05"))
PAIRS = {
    "rain and a dead carrier": (lambda: Powers().rain().add(np.nan, ODD), {FADE, DEAD}),
    "rain and a carrier that dies in it": (lambda: Powers().rain().add(np.nan, ODD, 1.6), {FADE, DEAD}),
    "rain and a carrier raised by 6 dB": (lambda: Powers().rain().add(6.0, ODD, end_h=4.4), {FADE, RESIDUAL}),
    "rain and a carrier 6 dB further down": (lambda: Powers().rain().add(-6.0, ODD), {FADE, LEVEL}),
    "tilt and a step of 5 dB": (lambda: Powers().tilt().add(-5.0, ODD), {TILT, LEVEL}),
    "tilt and a dead carrier": (lambda: Powers().tilt().add(np.nan, ODD), {TILT, DEAD}),
    "rain and a tilt": (lambda: Powers().rain(6.0).tilt(0.8), {FADE, TILT}),
    "tilt and the chain off the air": (lambda: Powers().tilt().add(np.nan, begin_h=2.0), {TILT, CHAIN_LOST}),
    "chain raised and a dead carrier": (lambda: Powers().add(8.0).add(np.nan, ODD), {CHAIN_LEVEL, DEAD}),
    "chain raised and a step of 5 dB": (lambda: Powers().add(8.0).add(5.0, ODD), {CHAIN_LEVEL, LEVEL}),
    "chain off the air, a carrier dead after it": (
        lambda: Powers().add(np.nan).add(np.nan, ODD, END_H, LAST_H),
        {CHAIN_LOST, DEAD},
    ),
    "chain off the air, rain before it": (lambda: Powers().rain().add(np.nan, begin_h=2.0), {FADE, CHAIN_LOST}),
}


@pytest.mark.parametrize("name", PAIRS)
def test_of_two_faults_both_are_seen(name):
    powers, expected = PAIRS[name]
    changes, _ = told(powers())
    print(f"{name}: {sorted(announced(changes))}")
    assert expected <= announced(changes)
    assert len(announced(changes)) <= 6
    # an absence is no guess: it is told once
    assert [change.alarm.key for change in changes if change.kind in ANNOUNCING].count(DEAD) == (DEAD in expected)


def test_a_restart_within_rain_lets_nothing_go():
    through, _ = told(Powers().rain(10.0))
    again, _ = told(Powers().rain(10.0), restart_h=1.8)
    assert [(change.kind, change.alarm.key) for change in again] == [
        (change.kind, change.alarm.key) for change in through
    ]
