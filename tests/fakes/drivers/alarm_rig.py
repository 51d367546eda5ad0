"""A desk of alarms over a real archive whose thread is not started: a test looks when it wants to."""

import math
from dataclasses import replace

import numpy as np
from set_clock import SetClock

from db.storage import SqlStorage
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.pipeline.estimation.method import RowEvidence
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.levels.attitude import Axes, Status, row_without_attitude
from service.records.levels.measurement import Measurement, MeasurementBatch
from service.records.operations.work import LinkReport
from service.runtime.alarms.alarm_service import AlarmService
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import StepFailures

S = 1_000_000
MINUTE = 60 * S
HOUR = 60 * MINUTE
START = 1_800_000_000 * S
INERTIA = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
CARRIERS = tuple(Carrier(f"c{k}", "C", "t", 3.7e9 + k * 1e7, 5e6) for k in range(2))
NAN = math.nan
ABSENT = ("carrier_absent", "c1")
RAISED = ("raised", True, *ABSENT)


class Notices:
    """Remembers what is offered."""

    def __init__(self):
        self.reported = []
        self.is_running = False

    def start(self):
        self.is_running = True

    def stop(self):
        self.is_running = False

    def offer(self, change):
        self.reported.append((change.kind.value, change.is_told, change.alarm.condition, change.alarm.thing))


class Rig:
    """A desk over a real archive whose thread is not started: a test looks when it wants to."""

    def __init__(self, path):
        self.storage = SqlStorage(f"sqlite:///{path}")
        self.clock, self.notices, self.events = SetClock(START), Notices(), []
        self.failures = StepFailures()
        self.plan = CarrierPlan(1, "sha", CARRIERS)
        self.restart()

    def restart(self):
        feed = LiveFeed()
        feed.publish = lambda spacecraft_id, events: self.events.extend(events)
        conditions = condition_table(AlarmConfig(), RobustConfig())
        self.desk = AlarmService(self.storage, self.clock, feed, conditions, (self.notices,), failures=self.failures)

    def row(self, minute, *power_dbm, is_late=False, pitch_deg=None):
        epoch_us = START + round(minute * MINUTE)
        self.clock.system = max(self.clock.system, epoch_us)
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, np.array(power_dbm), None, is_late)
        answers = ()
        if pitch_deg is not None:
            plain = row_without_attitude(epoch_us, epoch_us, minute, Method.ROBUST, ())
            answers = (replace(plain, status=Status.ACQUIRED, attitude_deg=Axes(0.0, 0.0, pitch_deg)),)
        facts = RowEvidence(measurement, self.plan, answers, Method.ROBUST, None, {})
        self.desk.on_rows("craft", [facts])
        self.desk._check_rows()

    def rows(self, minutes, *power_dbm):
        for minute in minutes:
            self.row(minute, *power_dbm)

    def poll(self, *, is_thorough=False):
        self.desk._polls = 0 if is_thorough else 1
        self.desk._check_clock()

    def open_alarms(self, spacecraft_id="craft"):
        return {alarm.key: alarm for alarm in self.storage.alarms.open_alarms(spacecraft_id)}

    def reported(self):
        reported, self.notices.reported = self.notices.reported, []
        return reported


def append(rig, minute, source="sa", seqs=None):
    epochs_us = np.array([START + minute * MINUTE])
    powers = np.full((1, 2), -40.0, dtype=np.float32)
    batch = MeasurementBatch("craft", source, 1, 0, np.arange(1), epochs_us, powers, (None,), np.zeros(1, bool), seqs)
    rig.storage.archive.append_measurements(batch).result(120)


def report(state="MEASURE", warnings=(), **more):
    plain = {"id": "sa-1", "kind": "analyzer", "spacecraft_id": "craft", "source": "sa", "detail": {}, "counters": {}}
    return LinkReport(**{**plain, "state": state, "last_good_us": None, "warnings": warnings, "period_s": 10.0, **more})
