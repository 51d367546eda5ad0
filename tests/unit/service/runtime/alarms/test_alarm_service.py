"""The desk: rows and the clock in, stored, published and told changes out; orders; faults of the archive."""

import logging
from contextlib import contextmanager

import numpy as np
import pytest
from alarm_rig import (
    ABSENT,
    HOUR,
    MINUTE,
    NAN,
    RAISED,
    START,
)

from service.errors import ConflictError, InvalidInputError, NotFoundError, StorageError
from service.pipeline.estimation.row_evidence import RowEvidence
from service.records.catalogue import Method
from service.records.levels.measurement import Measurement
from service.records.operations.alarm_limits import AlarmLimits


@contextmanager
def archive_away(rig, monkeypatch):
    def fail(_changes):
        raise StorageError("storage.unavailable", "on purpose")

    with monkeypatch.context() as patch:
        patch.setattr(rig.storage.alarms, "save", fail)
        yield


def test_an_alarm_is_stored_then_published_then_told(rig):
    rig.rows(range(1, 3), -40.0, -40.0)
    rig.rows(range(3, 6), -40.0, NAN)
    alarm = rig.open_alarms()[ABSENT]
    assert (alarm.since_us, alarm.raised_at_us) == (START + 3 * MINUTE, START + 5 * MINUTE)
    (event,) = rig.events
    assert (event.kind, event.cursor.alarm, event.content.alarm) == ("alarm", 1, alarm)
    assert rig.reported() == [RAISED]


def test_late_rows_raise_none(rig):
    for minute in range(1, 50):
        rig.row(minute, NAN, NAN, is_late=True)
    rig.poll()
    assert (rig.open_alarms(), rig.reported()) == ({}, [])


def test_a_restart_forgets_nothing_and_repeats_nothing(rig):
    rig.rows(range(1, 4), -40.0, NAN)
    rig.row(4, NAN, NAN)
    rig.poll()
    rig.reported()
    rig.restart()
    rig.poll()
    rig.row(5, NAN, NAN)
    assert rig.reported() == []
    # what was about to alarm before the restart does so in its time: absent since minute 4
    rig.row(6, NAN, NAN)
    assert rig.reported() == [("raised", True, "carrier_absent", "c0")]
    rig.rows(range(7, 10), -40.0, -40.0)
    assert [reported[0] for reported in rig.reported()] == ["returned", "returned"]


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
    rig.reported()
    rig.clock.us += HOUR
    rig.poll()
    assert rig.reported() == [("unshelved", True, *ABSENT)]


def test_limits_that_are_put_hold_at_once(rig):
    rig.row(1, -40.0, -40.0)
    stated = AlarmLimits(0, 5, "anna", sets={"normal": {"carrier_absent": {"warning": 0.0}}})
    assert rig.desk.put_limits("craft", stated).version == 1
    rig.row(2, -40.0, NAN)
    assert rig.reported() == [RAISED]
    rig.desk.put_limits("craft", AlarmLimits(0, 6, "anna", sets={"normal": {"carrier_absent": {"suppressed": True}}}))
    assert rig.reported() == [("suppressed", False, *ABSENT)]


def test_changes_wait_in_order_while_the_archive_is_away(rig, monkeypatch, caplog):
    with archive_away(rig, monkeypatch), caplog.at_level(logging.ERROR):
        rig.rows(range(1, 4), NAN, NAN)
        rig.rows(range(4, 8), -40.0, NAN)
    assert rig.reported() == []
    assert len(caplog.records) == 1
    rig.poll()
    reported = [(kind, thing) for kind, _, _, thing in rig.reported()]
    assert reported == [("raised", "c0"), ("raised", "c1"), ("returned", "c0")]
    assert rig.open_alarms()["carrier_absent", "c0"].state == "returned"


def test_an_order_that_cannot_be_stored_is_not_carried_out(rig, monkeypatch):
    rig.rows(range(1, 4), -40.0, NAN)
    alarm_id = rig.open_alarms()[ABSENT].id
    rig.poll()
    rig.reported()
    with archive_away(rig, monkeypatch), pytest.raises(StorageError):
        rig.desk.clear(alarm_id, "anna", "")
    rig.row(4, -40.0, NAN)
    assert rig.reported() == []
    assert rig.desk.acknowledge(alarm_id, "anna", "").state == "acknowledged"


def test_a_fault_in_one_look_is_logged_and_the_next_one_goes_on(rig, monkeypatch, caplog):
    rig.rows(range(1, 4), -40.0, NAN)
    rig.poll()
    with monkeypatch.context() as patch:
        patch.setattr(rig.desk._persisted("craft").reader, "read_row", lambda _: 1 / 0)
        rig.row(4, -40.0, NAN)
    assert "alarms are reloaded from the archive" in caplog.text
    rig.reported()
    rig.rows(range(5, 8), -40.0, -40.0)
    assert rig.reported() == [("returned", True, *ABSENT)]


def test_an_alarm_that_stands_is_not_written_down_again_and_again(rig, monkeypatch):
    rig.rows(range(1, 6), -40.0, NAN)
    rig.poll()
    written = []
    monkeypatch.setattr(rig.storage.alarms, "save_memory", lambda *memory: written.append(memory))
    for minute in range(6, 15):
        rig.row(minute + 0.001 * (minute % 2), -40.0, NAN)
        rig.poll()
    # what was read from the archive is the same as what was written there
    rig.restart()
    rig.poll()
    assert written == []
    rig.row(40, -40.0, NAN)
    rig.poll()
    assert len(written) == 1


def test_too_many_rows_at_once_are_counted_not_kept(rig):
    rig.row(1, -40.0, -40.0)
    seen = [object()] * 6000
    rig.desk.on_rows("craft", seen)
    assert rig.desk.rows_skipped == 1000
    rig.desk._queue.clear()


def test_the_thread_looks_by_itself_and_a_stop_looks_a_last_time(rig):
    rig.desk._check_period_s = 0.05
    rig.desk.start()
    epoch_us = START + MINUTE
    for minute in range(1, 4):
        epoch_us = START + minute * MINUTE
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, np.array([-40.0, NAN]), None)
        rig.desk.on_rows("craft", [RowEvidence(measurement, rig.plan, (), Method.ROBUST, None, {})])
    rig.desk.stop()
    assert rig.reported() == [RAISED]
    assert rig.storage.alarms.memory("craft").newest_row_us == epoch_us


def test_rows_are_handed_over_and_judged_by_another_thread(rig):
    seen = [object()]
    for _ in range(1000):
        rig.desk.on_rows("craft", seen)
    assert len(rig.desk._queue) == 1000
    rig.desk._queue.clear()
