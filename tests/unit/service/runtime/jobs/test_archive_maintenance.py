"""Upkeep seals and drops what is due, step by step, and goes on after a fault."""

import threading
from types import SimpleNamespace

import pytest

from service.errors import StorageError
from service.records.storage.archive_maintenance import (
    SERIES,
    RetentionConfig,
    RetiredRows,
    SealedPart,
    SealedResults,
    SealingConfig,
)
from service.runtime.jobs.archive_maintenance import ArchiveMaintenance

DAY_US = 86_400_000_000
NOW_US = 20_000 * DAY_US
PART = SealedPart("sa-1", 1, NOW_US - DAY_US, NOW_US, 10, 10)
FAST = SealingConfig(quiet_s=900.0, period_s=0.01, pause_s=0.0)


class Archive:
    """Records what it is asked; seals one part and drops two rows each time."""

    def __init__(self):
        self.asked, self.faults, self.fitting, self.results = [], {}, None, Results()
        self.sealed = threading.Event()

    def seal(self, name, before_us, received_before_us):
        self.asked.append(("seal", name, before_us, received_before_us))
        if name in self.faults:
            raise self.faults.pop(name)
        yield PART
        self.sealed.set()

    def drop_before(self, name, series, before_us):
        self.asked.append(("drop", series, before_us))
        yield RetiredRows(series, 2, before_us)

    def drop_replays(self, name, created_before_us):
        if created_before_us is not None:
            self.asked.append(("replays", name, created_before_us))
            yield 7

    def fitting_us(self, name, series, size_bytes):
        self.asked.append(("fit", series, size_bytes))
        return self.fitting


class Results:
    """Seals results of a replay each time; keeps until when."""

    def __init__(self):
        self.before_us, self.summarised_us, self.marked = [], [], []

    def seal(self, _name, before_us):
        self.before_us.append(before_us)
        yield SealedResults("attitude", "replay-1", "paper", NOW_US - DAY_US, 7, 9)

    def complete_summaries(self, _name, before_us):
        self.summarised_us.append(before_us)
        yield 1

    def alignments(self, _name):
        return ()

    def mark_complete(self, name, methods):
        self.marked.append((name, methods))


class Clock:
    def __init__(self, now_us=NOW_US):
        self.now = now_us

    def now_us(self, _name):
        return self.now

    def system_us(self):
        return NOW_US + 5


@pytest.fixture
def archive():
    return Archive()


def maintainer(archive, retention=None, clock=None, names=("a",)):
    catalogue = SimpleNamespace(all_spacecraft=lambda: [SimpleNamespace(id=name) for name in names])
    archive.results.drop_replays = archive.drop_replays
    storage = SimpleNamespace(catalogue=catalogue, archive=archive, results=archive.results)
    return ArchiveMaintenance(storage, clock or Clock(), FAST, retention or RetentionConfig())


def test_days_are_sealed_after_the_quiet_time_and_nothing_is_dropped_by_default(archive):
    made = maintainer(archive)
    made.poll_once()
    quiet_us = 900_000_000
    assert archive.asked == [("seal", "a", NOW_US - quiet_us, NOW_US + 5 - quiet_us)]
    assert archive.results.before_us == [NOW_US - quiet_us]
    assert (made.sealed_rows, made.sealed_results) == (10, 7)
    assert set(made.dropped_rows.values()) == {0}


def test_versions_are_dropped_by_the_age_of_the_replay(archive):
    made = maintainer(archive, RetentionConfig(replays_days=2.0))
    made.poll_once()
    assert archive.asked[0] == ("replays", "a", NOW_US + 5 - 2 * DAY_US)
    assert made.dropped_rows["replays"] == 7


def test_closed_days_are_summarised_and_the_rows_without_pending_results_marked(archive):
    made = maintainer(archive)
    made.poll_once()
    assert made.summarised_days == 1
    results = made._storage.results
    assert (results.summarised_us, results.marked) == ([NOW_US - 900_000_000], [("a", ())])


def test_series_are_dropped_by_age_and_by_size(archive, monkeypatch):
    archive.fitting = NOW_US - 3 * DAY_US
    made = maintainer(archive, RetentionConfig(measurements_days=30.0, attitude_bytes=1000))
    made.poll_once()
    assert archive.asked[:3] == [
        ("drop", "measurements", NOW_US - 30 * DAY_US),
        ("fit", "attitude", 1000),
        ("drop", "attitude", NOW_US - 3 * DAY_US),
    ]
    assert {name: rows for name, rows in made.dropped_rows.items() if rows} == {"measurements": 2, "attitude": 2}
    archive.asked.clear()
    made.poll_once()
    assert ("fit", "attitude", 1000) not in archive.asked, "sizes are looked at once an hour"
    monkeypatch.setattr("service.runtime.jobs.archive_maintenance.SIZING_S", 0.0)
    archive.fitting = None
    made.poll_once()
    assert ("fit", "attitude", 1000) in archive.asked
    assert not [asked for asked in archive.asked if asked[:2] == ("drop", "attitude")]


@pytest.mark.parametrize("series", SERIES)
def test_every_series_has_its_age(archive, series):
    maintainer(archive, RetentionConfig(**{f"{series}_days": 1.5})).poll_once()
    assert archive.asked[0] == ("drop", series, NOW_US - 3 * DAY_US // 2)


def test_a_clock_that_knows_no_time_yet_seals_nothing(archive):
    maintainer(archive, clock=Clock(None)).poll_once()
    assert archive.asked == []


def test_a_fault_of_one_spacecraft_is_logged_and_keeps_no_other_from_its_turn(archive, caplog):
    archive.faults["a"] = StorageError("storage.unavailable", "the disk is full")
    made = maintainer(archive, names=("a", "b"))
    made.poll_once()
    assert [asked[1] for asked in archive.asked] == ["a", "b"]
    assert "the disk is full" in caplog.text
    made.poll_once()
    assert made.sealed_rows == 30


def test_the_thread_looks_again_and_again_until_it_is_stopped(archive):
    made = maintainer(archive)
    made.start()
    assert archive.sealed.wait(120)
    archive.sealed.clear()
    assert archive.sealed.wait(120)
    made.stop()
    count = len(archive.asked)
    made.poll_once()
    assert len(archive.asked) == count


def test_alarms_and_notes_are_dropped_by_age_of_each_spacecraft_and_of_the_service(archive):
    asked = []

    def log(kind):
        def drop_before(name, before_us):
            asked.append((kind, name, before_us))
            yield 3

        return SimpleNamespace(drop_before=drop_before)

    work = maintainer(archive, RetentionConfig(alarms_days=2.0, notes_days=1.0))
    work._storage.alarms, work._storage.notes = log("alarms"), log("notes")
    work.poll_once()
    of_service = [("alarms", None, NOW_US + 5 - 2 * DAY_US), ("notes", None, NOW_US + 5 - DAY_US)]
    assert asked == [("alarms", "a", NOW_US - 2 * DAY_US), ("notes", "a", NOW_US - DAY_US), *of_service]
    assert (work.dropped_rows["alarms"], work.dropped_rows["notes"]) == (6, 6)
