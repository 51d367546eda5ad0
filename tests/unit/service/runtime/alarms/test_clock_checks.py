"""What the clock finds: rows that do not come, links, gaps, ages, keys that end, a full disk."""

from dataclasses import replace

from alarm_rig import HOUR, MINUTE, START, S, append, report
from release_service_driver import ReleaseServiceDriver

from service.pipeline.control.release.events import OrderKind
from service.records.catalogue import Ephemeris
from service.records.operations.access_key import AccessKey, Role, StoredKey
from service.records.operations.link import LinkWarning
from service.records.operations.release import ReleaseChange


def test_rows_that_do_not_come_are_missed_after_three_periods_once_they_came_in_time(rig):
    append(rig, 0)
    rig.clock.us = START + HOUR
    rig.poll()
    assert rig.reported() == []
    for minute in range(60, 64):
        append(rig, minute)
        rig.row(minute, -40.0, -40.0)
    rig.poll()
    rig.clock.us = START + 66 * MINUTE
    rig.poll()
    assert rig.reported() == []
    rig.clock.us += 1
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
    rig.clock.us = START + 2 * HOUR
    rig.poll()
    assert rig.reported() == []
    rig.clock.us += 3 * MINUTE
    rig.poll()
    assert rig.reported() == [("raised", True, "data_stale", "sa")]


def test_a_link_that_fails_or_is_silent_alarms_and_one_that_rests_does_not(rig):
    rig.storage.links.report([report("BACKOFF")], rig.clock.us)
    rig.poll()
    rig.clock.us += 31 * S
    rig.storage.links.report([report("BACKOFF")], rig.clock.us)
    rig.poll()
    assert rig.reported() == [("raised", True, "link_down", "sa-1")]
    assert "its state is BACKOFF" in rig.open_alarms()["link_down", "sa-1"].detail
    rig.storage.links.set_enabled("sa-1", enabled=False)
    rig.poll()
    rig.clock.us += 10 * S
    rig.poll()
    assert rig.reported() == [("returned", True, "link_down", "sa-1")]
    rig.storage.links.set_enabled("sa-1", enabled=True)
    rig.storage.links.report([report("MEASURE")], rig.clock.us)
    rig.clock.us += HOUR
    rig.poll()
    assert rig.reported() == [("raised", True, "link_down", "sa-1")]
    rig.storage.links.report([report("STOPPED")], rig.clock.us)
    rig.poll()
    rig.clock.us += HOUR
    rig.poll()
    assert [reported[0] for reported in rig.reported()] == ["returned"]


def test_the_front_end_that_holds_an_analyzer_of_the_craft_is_looked_at_too(rig):
    front = report("RUNNING", id="front", kind="front_end", spacecraft_id=None, detail={"analyzers": ["sa-1"]})
    other = report("RUNNING", id="other", kind="front_end", spacecraft_id=None, detail={"analyzers": ["sa-2"]})
    rig.storage.links.report([report(), front, other], rig.clock.us)
    rig.clock.us += 31 * S
    rig.storage.links.report([report()], rig.clock.us)
    rig.poll()
    assert rig.reported() == [("raised", True, "link_down", "front")]


def test_warnings_of_a_front_end_alarm_while_they_stand(rig):
    rig.storage.links.report([report(warnings=(LinkWarning("spool.full", "1000 rows dropped", rig.clock.us),))], START)
    rig.poll()
    assert rig.reported() == [("raised", True, "link_warning", "sa-1/spool.full")]
    assert "1000 rows dropped" in rig.open_alarms()["link_warning", "sa-1/spool.full"].detail
    rig.storage.links.report([report()], START)
    rig.poll()
    assert rig.reported() == [("returned", True, "link_warning", "sa-1/spool.full")]


def test_rows_that_go_missing_alarm_and_old_losses_do_not(rig):
    append(rig, 1, seqs=1)
    append(rig, 2, seqs=9)
    rig.clock.us = START + 2 * MINUTE
    rig.poll()
    append(rig, 3, seqs=20)
    for minute in (3, 5):
        rig.clock.us = START + minute * MINUTE
        rig.poll()
    assert rig.reported() == [("raised", True, "rows_missing", "sa")]
    assert rig.open_alarms()["rows_missing", "sa"].value == 10.0
    for minute in (70, 72):
        rig.clock.us = START + minute * MINUTE
        rig.poll()
    assert rig.reported() == [("returned", True, "rows_missing", "sa")]


def test_what_the_estimate_rests_on_grows_old(rig):
    rig.storage.catalogue.put_ephemeris("craft", Ephemeris(0, (1, 2), 86_164.0, 0, START + 11 * HOUR, "nodes"))
    rig.poll(is_thorough=True)
    assert rig.reported() == [("raised", True, "ephemeris_ending", "newest")]


def test_a_key_that_ends_and_a_full_disk_concern_the_service(rig, monkeypatch):
    key = AccessKey(
        id="k1", name="station", role=Role.STATION, created_at_us=START, created_by="x", expires_at_us=START + 24 * HOUR
    )
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
    rig.clock.us = sent.stop_us + 600 * S
    keep_release(rig, driver)
    rig.poll()
    assert rig.reported() == []
    rig.clock.us += S
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
