"""The desk: rows and the clock in, stored, published and told changes out; orders; faults of the archive."""

import logging
import math
import shutil
import time
from contextlib import contextmanager

import numpy as np
import pytest

from db.storage import SqlStorage
from service.errors import ConflictError, InvalidInputError, NotFoundError, StorageError
from service.pipeline.alarm_conditions import condition_table
from service.pipeline.alarm_readings import RowFacts
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.access_key import AccessKey, Role, StoredKey
from service.records.alarm_limits import AlarmLimits
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Method, Site, Spacecraft
from service.records.link import LinkReport, LinkWarning
from service.records.measurement import Measurement, MeasurementBatch
from service.runtime.alarm_desk import AlarmDesk
from service.runtime.alarm_notices import NoticeChannels
from service.runtime.live_feed import LiveFeed

S = 1_000_000
MINUTE = 60 * S
HOUR = 60 * MINUTE
START = 1_800_000_000 * S
INERTIA = ((4000.0, 0.0, 0.0), (0.0, 2000.0, 0.0), (0.0, 0.0, 4000.0))
CARRIERS = tuple(Carrier(f"c{k}", "C", "t", 3.7e9 + k * 1e7, 5e6) for k in range(2))
NAN = math.nan


class Clock:
    """A clock that a test turns."""

    def __init__(self):
        self.us = START

    def now_us(self, spacecraft_id):
        return self.us

    def is_data(self, spacecraft_id):
        return False

    def system_us(self):
        return self.us


class Notices(NoticeChannels):
    """Remembers what is offered."""

    def __init__(self):
        super().__init__()
        self.told = []

    def offer(self, change):
        self.told.append((change.kind.value, change.is_told, change.alarm.condition, change.alarm.thing))


class Rig:
    """A desk over a real archive whose thread is not started: a test looks when it wants to."""

    def __init__(self, path):
        self.storage = SqlStorage(f"sqlite:///{path}")
        self.clock, self.notices, self.events = Clock(), Notices(), []
        self.plan = CarrierPlan(1, "sha", CARRIERS)
        self.restart()

    def restart(self):
        feed = LiveFeed()
        feed.publish = lambda spacecraft_id, events: self.events.extend(events)
        conditions = condition_table(AlarmConfig(), RobustConfig())
        self.desk = AlarmDesk(self.storage, self.clock, feed, conditions, self.notices)

    def row(self, minute, *power_dbm, is_late=False):
        epoch_us = START + round(minute * MINUTE)
        self.clock.us = max(self.clock.us, epoch_us)
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, np.array(power_dbm), None, is_late)
        facts = RowFacts(measurement, self.plan, (), Method.ROBUST, None, {})
        self.desk.see("craft", [facts])
        self.desk._look_at_rows()

    def rows(self, minutes, *power_dbm):
        for minute in minutes:
            self.row(minute, *power_dbm)

    def look(self, *, is_thorough=False):
        self.desk._looks = 0 if is_thorough else 1
        self.desk._look_at_clock()

    def open_alarms(self, spacecraft_id="craft"):
        return {alarm.key: alarm for alarm in self.storage.alarms.open_alarms(spacecraft_id)}

    def told(self):
        told, self.notices.told = self.notices.told, []
        return told


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    """An archive with one craft; every test gets a copy."""
    path = tmp_path_factory.mktemp("archive") / "soo.db"
    storage = SqlStorage(f"sqlite:///{path}")
    storage.migrate()
    storage.catalogue.add_spacecraft(Spacecraft("craft", "craft", 90.0, Site(55.0, 38.0), INERTIA, 0.05))
    storage.catalogue.put_plan("craft", CARRIERS, "sha")
    storage.close()
    return path


@pytest.fixture
def rig(archive, tmp_path):
    shutil.copy(archive, tmp_path / "soo.db")
    rig = Rig(tmp_path / "soo.db")
    yield rig
    rig.storage.close()


ABSENT = ("carrier_absent", "c1")
RAISED = ("raised", True, *ABSENT)


def test_an_alarm_is_stored_then_published_then_told(rig):
    rig.rows(range(1, 3), -40.0, -40.0)
    rig.rows(range(3, 6), -40.0, NAN)
    alarm = rig.open_alarms()[ABSENT]
    assert (alarm.since_us, alarm.raised_at_us) == (START + 3 * MINUTE, START + 5 * MINUTE)
    (event,) = rig.events
    assert (event.kind, event.cursor.alarm, event.content.alarm) == ("alarm", 1, alarm)
    assert rig.told() == [RAISED]


def test_late_rows_raise_none(rig):
    for minute in range(1, 50):
        rig.row(minute, NAN, NAN, is_late=True)
    rig.look()
    assert (rig.open_alarms(), rig.told()) == ({}, [])


def test_a_restart_forgets_nothing_and_repeats_nothing(rig):
    rig.rows(range(1, 4), -40.0, NAN)
    rig.row(4, NAN, NAN)
    rig.look()
    rig.told()
    rig.restart()
    rig.look()
    rig.row(5, NAN, NAN)
    assert rig.told() == []
    # what was about to alarm before the restart does so in its time: absent since minute 4
    rig.row(6, NAN, NAN)
    assert rig.told() == [("raised", True, "carrier_absent", "c0")]
    rig.rows(range(7, 10), -40.0, -40.0)
    assert [told[0] for told in rig.told()] == ["returned", "returned"]


def test_operators_acknowledge_shelve_and_clear_what_stands(rig):
    rig.rows(range(1, 4), -40.0, NAN)
    alarm_id = rig.open_alarms()[ABSENT].id
    seen = rig.desk.acknowledge(alarm_id, "anna", "on it")
    assert (seen.state, seen.acknowledged.by, seen.acknowledged.comment) == ("acknowledged", "anna", "on it")
    with pytest.raises(ConflictError, match="not shelved"):
        rig.desk.unshelve(alarm_id, "anna", "")
    for until_us in (rig.clock.us, rig.clock.us + 24 * HOUR + 1):
        with pytest.raises(InvalidInputError, match="24 h"):
            rig.desk.shelve(alarm_id, "anna", "", until_us)
    assert rig.desk.shelve(alarm_id, "anna", "", rig.clock.us + 24 * HOUR).state == "shelved"
    assert rig.desk.unshelve(alarm_id, "anna", "").state == "acknowledged"
    assert rig.desk.clear(alarm_id, "boris", "").cleared.by == "boris"
    with pytest.raises(ConflictError) as caught:
        rig.desk.acknowledge(alarm_id, "anna", "")
    assert caught.value.code == "alarm.closed"
    with pytest.raises(NotFoundError):
        rig.desk.clear(999, "anna", "")
    kinds = [change.kind.value for change in rig.storage.alarms.changes(alarm_id)]
    assert kinds == ["raised", "acknowledged", "shelved", "unshelved", "cleared"]


def test_a_shelving_ends_by_the_clock_also_over_a_restart(rig):
    rig.rows(range(1, 4), -40.0, NAN)
    alarm_id = rig.open_alarms()[ABSENT].id
    rig.desk.shelve(alarm_id, "anna", "", rig.clock.us + HOUR)
    rig.restart()
    rig.told()
    rig.clock.us += HOUR
    rig.look()
    assert rig.told() == [("unshelved", True, *ABSENT)]


def test_limits_that_are_put_hold_at_once(rig):
    rig.row(1, -40.0, -40.0)
    stated = AlarmLimits(0, 5, "anna", sets={"normal": {"carrier_absent": {"warning": 0.0}}})
    assert rig.desk.put_limits("craft", stated).version == 1
    rig.row(2, -40.0, NAN)
    assert rig.told() == [RAISED]
    rig.desk.put_limits("craft", AlarmLimits(0, 6, "anna", sets={"normal": {"carrier_absent": {"suppressed": True}}}))
    assert rig.told() == [("suppressed", False, *ABSENT)]


def append(rig, minute, source="sa", seqs=None):
    epochs_us = np.array([START + minute * MINUTE])
    powers = np.full((1, 2), -40.0, dtype=np.float32)
    batch = MeasurementBatch("craft", source, 1, 0, np.arange(1), epochs_us, powers, (None,), np.zeros(1, bool), seqs)
    rig.storage.archive.append_measurements(batch).result(5)


def test_rows_that_do_not_come_are_missed_after_three_periods_once_they_came_in_time(rig):
    append(rig, 0)
    rig.clock.us = START + HOUR
    rig.look()
    assert rig.told() == []
    for minute in range(60, 64):
        append(rig, minute)
        rig.row(minute, -40.0, -40.0)
    rig.look()
    rig.clock.us = START + 66 * MINUTE
    rig.look()
    assert rig.told() == []
    rig.clock.us += 1
    rig.look()
    assert rig.told() == [("raised", True, "data_stale", "sa")]
    detail = rig.open_alarms()["data_stale", "sa"].detail
    assert "the newest row is 180 s old, rows come every 60 s" in detail
    append(rig, 66)
    rig.look()
    assert rig.told()[0][0] == "returned"


def test_a_service_that_was_away_itself_does_not_blame_the_source_at_once(rig):
    for minute in range(1, 6):
        append(rig, minute)
        rig.row(minute, -40.0, -40.0)
    rig.look()
    rig.restart()
    rig.clock.us = START + 2 * HOUR
    rig.look()
    assert rig.told() == []
    rig.clock.us += 3 * MINUTE
    rig.look()
    assert rig.told() == [("raised", True, "data_stale", "sa")]


def report(state="MEASURE", warnings=(), **more):
    plain = {"id": "sa-1", "kind": "analyzer", "spacecraft_id": "craft", "source": "sa", "detail": {}, "counters": {}}
    return LinkReport(**{**plain, "state": state, "last_good_us": None, "warnings": warnings, "period_s": 10.0, **more})


def test_a_link_that_fails_or_is_silent_alarms_and_one_that_rests_does_not(rig):
    rig.storage.links.report([report("BACKOFF")], rig.clock.us)
    rig.look()
    rig.clock.us += 31 * S
    rig.storage.links.report([report("BACKOFF")], rig.clock.us)
    rig.look()
    assert rig.told() == [("raised", True, "link_down", "sa-1")]
    assert "its state is BACKOFF" in rig.open_alarms()["link_down", "sa-1"].detail
    rig.storage.links.set_enabled("sa-1", enabled=False)
    rig.look()
    rig.clock.us += 10 * S
    rig.look()
    assert rig.told() == [("returned", True, "link_down", "sa-1")]
    rig.storage.links.set_enabled("sa-1", enabled=True)
    rig.storage.links.report([report("MEASURE")], rig.clock.us)
    rig.clock.us += HOUR
    rig.look()
    assert rig.told() == [("raised", True, "link_down", "sa-1")]
    rig.storage.links.report([report("STOPPED")], rig.clock.us)
    rig.look()
    rig.clock.us += HOUR
    rig.look()
    assert [told[0] for told in rig.told()] == ["returned"]


def test_the_front_end_that_holds_an_analyzer_of_the_craft_is_looked_at_too(rig):
    front = report("RUNNING", id="front", kind="front_end", spacecraft_id=None, detail={"analyzers": ["sa-1"]})
    other = report("RUNNING", id="other", kind="front_end", spacecraft_id=None, detail={"analyzers": ["sa-2"]})
    rig.storage.links.report([report(), front, other], rig.clock.us)
    rig.clock.us += 31 * S
    rig.storage.links.report([report()], rig.clock.us)
    rig.look()
    assert rig.told() == [("raised", True, "link_down", "front")]


def test_warnings_of_a_front_end_alarm_while_they_stand(rig):
    rig.storage.links.report([report(warnings=(LinkWarning("spool.full", "1000 rows dropped", rig.clock.us),))], START)
    rig.look()
    assert rig.told() == [("raised", True, "link_warning", "sa-1/spool.full")]
    assert "1000 rows dropped" in rig.open_alarms()["link_warning", "sa-1/spool.full"].detail
    rig.storage.links.report([report()], START)
    rig.look()
    assert rig.told() == [("returned", True, "link_warning", "sa-1/spool.full")]


def test_rows_that_go_missing_alarm_and_old_losses_do_not(rig):
    append(rig, 1, seqs=1)
    append(rig, 2, seqs=9)
    rig.clock.us = START + 2 * MINUTE
    rig.look()
    append(rig, 3, seqs=20)
    for minute in (3, 5):
        rig.clock.us = START + minute * MINUTE
        rig.look()
    assert rig.told() == [("raised", True, "rows_missing", "sa")]
    assert rig.open_alarms()["rows_missing", "sa"].value == 10.0
    for minute in (70, 72):
        rig.clock.us = START + minute * MINUTE
        rig.look()
    assert rig.told() == [("returned", True, "rows_missing", "sa")]


def test_what_the_estimate_rests_on_grows_old(rig):
    rig.storage.catalogue.put_ephemeris("craft", Ephemeris(0, (1, 2), 86_164.0, 0, START + 11 * HOUR, "nodes"))
    rig.look(is_thorough=True)
    assert rig.told() == [("raised", True, "ephemeris_ending", "newest")]


def test_a_key_that_ends_and_a_full_disk_concern_the_service(rig, monkeypatch):
    key = AccessKey(
        id="k1", name="station", role=Role.STATION, created_at_us=START, created_by="x", expires_at_us=START + 24 * HOUR
    )
    rig.storage.keys.add(StoredKey(key, b"digest"))
    rig.look(is_thorough=True)
    assert rig.told() == [("raised", True, "key_ending", "station (k1)")]
    (alarm,) = rig.storage.alarms.open_alarms(None)
    assert alarm.spacecraft_id is None
    # a service-wide alarm is published on the stream of every craft
    assert [event.content.alarm.id for event in rig.events] == [alarm.id]
    state = rig.storage.state()
    monkeypatch.setattr(rig.storage, "state", lambda: type(state)(state.schema, state.wanted_schema, 0, 100 * 10**6))
    rig.look(is_thorough=True)
    assert rig.told() == [("raised", True, "disk_full", "archive")]


@contextmanager
def archive_away(rig, monkeypatch):
    def fail(_changes):
        raise StorageError("storage.unavailable", "on purpose")

    with monkeypatch.context() as patch:
        patch.setattr(rig.storage.alarms, "save", fail)
        yield


def test_changes_wait_in_order_while_the_archive_is_away(rig, monkeypatch, caplog):
    with archive_away(rig, monkeypatch), caplog.at_level(logging.ERROR):
        rig.rows(range(1, 4), NAN, NAN)
        rig.rows(range(4, 8), -40.0, NAN)
    assert rig.told() == []
    assert len(caplog.records) == 1
    rig.look()
    told = [(kind, thing) for kind, _, _, thing in rig.told()]
    assert told == [("raised", "c0"), ("raised", "c1"), ("returned", "c0")]
    assert rig.open_alarms()["carrier_absent", "c0"].state == "returned"


def test_an_order_that_cannot_be_stored_is_not_carried_out(rig, monkeypatch):
    rig.rows(range(1, 4), -40.0, NAN)
    alarm_id = rig.open_alarms()[ABSENT].id
    rig.look()
    rig.told()
    with archive_away(rig, monkeypatch), pytest.raises(StorageError):
        rig.desk.clear(alarm_id, "anna", "")
    rig.row(4, -40.0, NAN)
    assert rig.told() == []
    assert rig.desk.acknowledge(alarm_id, "anna", "").state == "acknowledged"


def test_a_fault_in_one_look_is_logged_and_the_next_one_goes_on(rig, monkeypatch, caplog):
    rig.rows(range(1, 4), -40.0, NAN)
    rig.look()
    with monkeypatch.context() as patch:
        patch.setattr(rig.desk._case("craft").reader, "read_row", lambda _: 1 / 0)
        rig.row(4, -40.0, NAN)
    assert "alarms are read anew" in caplog.text
    rig.told()
    rig.rows(range(5, 8), -40.0, -40.0)
    assert rig.told() == [("returned", True, *ABSENT)]


def test_an_alarm_that_stands_is_not_written_down_again_and_again(rig, monkeypatch):
    rig.rows(range(1, 6), -40.0, NAN)
    rig.look()
    written = []
    monkeypatch.setattr(rig.storage.alarms, "save_memory", lambda *memory: written.append(memory))
    for minute in range(6, 15):
        rig.row(minute + 0.001 * (minute % 2), -40.0, NAN)
        rig.look()
    assert written == []
    rig.row(40, -40.0, NAN)
    rig.look()
    assert len(written) == 1


def test_too_many_rows_at_once_are_counted_not_kept(rig):
    rig.row(1, -40.0, -40.0)
    seen = [object()] * 6000
    rig.desk.see("craft", seen)
    assert rig.desk.rows_skipped == 1000
    rig.desk._queue.clear()


def test_the_thread_looks_by_itself_and_a_stop_looks_a_last_time(rig):
    rig.desk._check_period_s = 0.05
    rig.desk.start()
    epoch_us = START + MINUTE
    for minute in range(1, 4):
        epoch_us = START + minute * MINUTE
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, np.array([-40.0, NAN]), None)
        rig.desk.see("craft", [RowFacts(measurement, rig.plan, (), Method.ROBUST, None, {})])
    rig.desk.stop()
    assert rig.told() == [RAISED]
    assert rig.storage.alarms.memory("craft").newest_row_us == epoch_us


def test_handing_over_rows_costs_the_chain_next_to_nothing(rig):
    seen = [object()]
    began = time.perf_counter()
    for _ in range(1000):
        rig.desk.see("craft", seen)
    assert time.perf_counter() - began < 0.1
    rig.desk._queue.clear()
