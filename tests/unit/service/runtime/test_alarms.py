"""Alarms: rows and the clock in, changes stored and published; orders of operators; faults of the archive."""

import logging
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from alarm_rig import ABSENT, HOUR, MINUTE, NAN, RAISED, START, S, append, report
from release_service_driver import ReleaseServiceDriver

from service.errors import ConflictError, InvalidInputError, NotFoundError, StorageError
from service.pipeline.control.release.events import OrderKind
from service.pipeline.estimation.method import RowEvidence
from service.records.catalogue import Ephemeris, Method
from service.records.levels.measurement import Measurement
from service.records.operations.access import AccessKey, Role, StoredKey
from service.records.operations.alarms import AlarmLimits
from service.records.operations.release import ReleaseChange
from service.records.operations.work import LinkWarning


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
    assert rig.reported() == [
        ("raised", True, "chain_lost", "receiving site"),
        ("raised", False, "carrier_absent", "c0"),
        ("suppressed", False, "carrier_absent", "c1"),
    ]
    # nor does it let go of what follows
    rig.restart()
    rig.poll()
    rig.row(7, NAN, NAN)
    assert rig.reported() == []
    assert rig.open_alarms()["carrier_absent", "c0"].cause == ("chain_lost", "receiving site")
    rig.rows(range(8, 11), -40.0, -40.0)
    assert [(kind, is_told) for kind, is_told, *_ in rig.reported()] == [
        ("returned", told) for told in (True, False, False)
    ]


def test_operators_acknowledge_shelve_and_clear_what_stands(rig):
    rig.rows(range(1, 4), -40.0, NAN)
    alarm_id = rig.open_alarms()[ABSENT].id
    seen = rig.desk.acknowledge(alarm_id, "anna", "on it")
    assert (seen.state, seen.acknowledged.by, seen.acknowledged.comment) == ("acknowledged", "anna", "on it")
    with pytest.raises(ConflictError, match="not shelved"):
        rig.desk.unshelve(alarm_id, "anna", "")
    for until_us in (rig.clock.system, rig.clock.system + 24 * HOUR + 1):
        with pytest.raises(InvalidInputError, match="24 h"):
            rig.desk.shelve(alarm_id, "anna", "", until_us)
    assert rig.desk.shelve(alarm_id, "anna", "", rig.clock.system + 24 * HOUR).state == "shelved"
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
    rig.desk.shelve(alarm_id, "anna", "", rig.clock.system + HOUR)
    rig.restart()
    rig.reported()
    rig.clock.system += HOUR
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
    site = "receiving site"
    assert reported == [
        *(("raised", thing) for thing in (site, "c0", "c1")),
        *(("returned", thing) for thing in (site, "c0")),
    ]
    # what only followed needs nobody to acknowledge it
    assert ("carrier_absent", "c0") not in rig.open_alarms()


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


def test_the_thread_looks_by_itself_and_a_stop_looks_a_last_time(rig):
    rig.desk._check_period_s = 0.05
    rig.desk.start()
    assert rig.notices.is_running
    epoch_us = START + MINUTE
    for minute in range(1, 4):
        epoch_us = START + minute * MINUTE
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 1, np.array([-40.0, NAN]), None)
        rig.desk.on_rows("craft", [RowEvidence(measurement, rig.plan, (), Method.ROBUST, None, {})])
    rig.desk.stop()
    assert not rig.notices.is_running
    assert rig.reported() == [RAISED]
    assert rig.storage.alarms.memory("craft").newest_row_us == epoch_us


def test_rows_that_do_not_come_are_missed_after_three_periods_once_they_came_in_time(rig):
    append(rig, 0)
    rig.clock.system = START + HOUR
    rig.poll()
    assert rig.reported() == []
    for minute in range(60, 64):
        append(rig, minute)
        rig.row(minute, -40.0, -40.0)
    rig.poll()
    rig.clock.system = START + 66 * MINUTE
    rig.poll()
    assert rig.reported() == []
    rig.clock.system += 1
    rig.poll()
    assert rig.reported() == [("raised", True, "data_stale", "sa")]
    detail = rig.open_alarms()["data_stale", "sa"].detail
    assert "the newest row is 180 s old, rows come every 60 s" in detail
    append(rig, 66)
    rig.poll()
    assert rig.reported()[0][0] == "returned"


def test_a_service_that_was_away_itself_does_not_blame_the_source_at_once(rig):
    for minute in range(1, 6):
        append(rig, minute)
        rig.row(minute, -40.0, -40.0)
    rig.poll()
    rig.restart()
    rig.clock.system = START + 2 * HOUR
    rig.poll()
    assert rig.reported() == []
    rig.clock.system += 3 * MINUTE
    rig.poll()
    assert rig.reported() == [("raised", True, "data_stale", "sa")]


def test_a_link_that_fails_or_is_silent_alarms_and_one_that_rests_does_not(rig):
    rig.storage.links.report([report("BACKOFF")], rig.clock.system)
    rig.poll()
    rig.clock.system += 31 * S
    rig.storage.links.report([report("BACKOFF")], rig.clock.system)
    rig.poll()
    assert rig.reported() == [("raised", True, "link_down", "sa-1")]
    assert "its state is BACKOFF" in rig.open_alarms()["link_down", "sa-1"].detail
    rig.storage.links.set_enabled("sa-1", enabled=False)
    rig.poll()
    rig.clock.system += 10 * S
    rig.poll()
    assert rig.reported() == [("returned", True, "link_down", "sa-1")]
    rig.storage.links.set_enabled("sa-1", enabled=True)
    rig.storage.links.report([report("MEASURE")], rig.clock.system)
    rig.clock.system += HOUR
    rig.poll()
    assert rig.reported() == [("raised", True, "link_down", "sa-1")]
    rig.storage.links.report([report("STOPPED")], rig.clock.system)
    rig.poll()
    rig.clock.system += HOUR
    rig.poll()
    assert [reported[0] for reported in rig.reported()] == ["returned"]


def test_the_front_end_that_holds_an_analyzer_of_the_craft_is_looked_at_too(rig):
    front = report("RUNNING", id="front", kind="front_end", spacecraft_id=None, detail={"analyzers": ["sa-1"]})
    other = report("RUNNING", id="other", kind="front_end", spacecraft_id=None, detail={"analyzers": ["sa-2"]})
    rig.storage.links.report([report(), front, other], rig.clock.system)
    rig.clock.system += 31 * S
    rig.storage.links.report([report()], rig.clock.system)
    rig.poll()
    assert rig.reported() == [("raised", True, "link_down", "front")]
    # what comes through it follows from it
    rig.clock.system += 2 * MINUTE
    rig.poll()
    assert rig.reported() == [("raised", False, "link_down", "sa-1")]
    assert rig.open_alarms()["link_down", "sa-1"].cause == ("link_down", "front")


def ending_key():
    return AccessKey(
        id="k1", name="station", role=Role.STATION, created_at_us=START, created_by="x", expires_at_us=START + 24 * HOUR
    )


def test_a_link_that_is_down_is_one_alarm_and_angle_chain_and_key_beside_it_are_seen(rig):
    key = ending_key()
    rig.storage.keys.add(StoredKey(key, b"digest"))
    for minute in range(12):
        append(rig, minute)
        rig.storage.links.report([report(period_s=60.0)], rig.clock.system)
        powers = (-40.0, -40.0) if minute < 8 else (NAN, NAN)
        rig.row(minute, *powers, pitch_deg=0.5)
        rig.poll(is_thorough=True)
    for minute in range(12, 40):
        rig.clock.system = START + minute * MINUTE
        rig.poll(is_thorough=True)
    reported = rig.reported()
    raised = [key for kind, is_told, *key in reported if kind == "raised" and is_told]
    assert sorted(condition for condition, _ in raised) == ["attitude_angle", "chain_lost", "key_ending", "link_down"]
    assert rig.open_alarms()["data_stale", "sa"].cause == ("link_down", "sa-1")


def test_warnings_of_a_front_end_alarm_while_they_stand(rig):
    rig.storage.links.report(
        [report(warnings=(LinkWarning("spool.full", "1000 rows dropped", rig.clock.system),))], START
    )
    rig.poll()
    assert rig.reported() == [("raised", True, "link_warning", "sa-1/spool.full")]
    assert "1000 rows dropped" in rig.open_alarms()["link_warning", "sa-1/spool.full"].detail
    rig.storage.links.report([report()], START)
    rig.poll()
    assert rig.reported() == [("returned", True, "link_warning", "sa-1/spool.full")]


def test_rows_that_go_missing_alarm_and_old_losses_do_not(rig):
    append(rig, 1, seqs=1)
    append(rig, 2, seqs=9)
    rig.clock.system = START + 2 * MINUTE
    rig.poll()
    append(rig, 3, seqs=20)
    for minute in (3, 5):
        rig.clock.system = START + minute * MINUTE
        rig.poll()
    assert rig.reported() == [("raised", True, "rows_missing", "sa")]
    assert rig.open_alarms()["rows_missing", "sa"].value == 10.0
    for minute in (70, 72):
        rig.clock.system = START + minute * MINUTE
        rig.poll()
    assert rig.reported() == [("returned", True, "rows_missing", "sa")]


def test_what_the_estimate_rests_on_grows_old(rig):
    rig.storage.catalogue.put_ephemeris("craft", Ephemeris(0, (1, 2), 86_164.0, 0, START + 11 * HOUR, "nodes"))
    rig.poll(is_thorough=True)
    assert rig.reported() == [("raised", True, "ephemeris_ending", "newest")]


def test_a_key_that_ends_and_a_full_disk_concern_the_service(rig, monkeypatch):
    key = ending_key()
    rig.storage.keys.add(StoredKey(key, b"digest"))
    rig.poll(is_thorough=True)
    assert rig.reported() == [("raised", True, "key_ending", "station (k1)")]
    (alarm,) = rig.storage.alarms.open_alarms(None)
    assert alarm.spacecraft_id is None
    # a service-wide alarm is published on the stream of every craft
    assert [event.content.alarm.id for event in rig.events] == [alarm.id]
    state = rig.storage.state()
    monkeypatch.setattr(rig.storage, "state", lambda: replace(state, free_bytes=100 * 10**6))
    rig.poll(is_thorough=True)
    assert rig.reported() == [("raised", True, "disk_full", "archive")]


def test_a_trip_alarms_until_it_is_reset_and_a_report_that_does_not_come_as_well(rig):
    driver = ReleaseServiceDriver().armed()
    sent = driver.sent()
    rig.clock.system = sent.stop_us + 600 * S
    keep_release(rig, driver)
    rig.poll()
    assert rig.reported() == []
    rig.clock.system += S
    rig.poll()
    assert rig.reported() == [("raised", True, "report_late", "command 1")]
    driver.order(OrderKind.STOP)
    driver.report(1)
    keep_release(rig, driver)
    rig.poll()
    assert {reported[2:] for reported in rig.reported()} == {("report_late", "command 1"), ("control_tripped", "stop")}
    driver.order(OrderKind.RESET)
    keep_release(rig, driver)
    rig.poll()
    assert rig.reported() == [("returned", True, "control_tripped", "stop")]


def keep_release(rig, driver):
    """Store what a release service has stored."""
    releases, document = rig.storage.releases, driver.releases.stored_release.document
    releases.save(
        "craft",
        releases.stored("craft").version,
        ReleaseChange(document, "test", tuple(driver.releases.views.values())),
    )


def test_balance_of_the_known_torque_alarms_while_it_lasts(rig):
    driver = ReleaseServiceDriver().engaged()
    driver.rows(1, downlink_fade=True, inhibitions=("downlink_fade",), control_allowed=False)
    rig.clock.system = driver.clock.now + S
    keep_release(rig, driver)
    rig.poll()
    assert rig.reported() == [("raised", True, "control_balance", "torque")]
    driver.order(OrderKind.STOP)
    keep_release(rig, driver)
    rig.poll()
    assert {reported[2:] for reported in rig.reported()} == {("control_balance", "torque"), ("control_tripped", "stop")}
