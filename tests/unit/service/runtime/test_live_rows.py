"""Live rows: an alignment's rows are stored in parts, each entry is consumed once, the newest rows are cached."""

import asyncio
from contextlib import closing
from types import SimpleNamespace
from unittest.mock import Mock, patch

import pytest
import synthetic_payload as synthetic
from storage_parts import with_part
from stored_records import zeros

import service.runtime.live.live_feed as module
import service.runtime.live.supervisor as supervisor_module
from service.errors import StorageError
from service.pipeline.chain import Chain
from service.pipeline.checkpoints import fingerprint
from service.pipeline.config import ChainConfig
from service.records.inputs import (
    AlignmentSet,
    Correction,
    JournalEntry,
    Operation,
    PlanChange,
    PolarizationRecord,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import Axes
from service.records.levels.measurement import BatchReceipt, Measurement
from service.runtime.live.journal_consumer import MOTION_KINDS, STANDING_KINDS, DocumentCache, consume, update_before
from service.runtime.live.live_feed import CommittedRows, LiveFeed, Subscription


@pytest.fixture
def waiting(new_ground):
    """Two stations with rows that wait for an alignment."""
    stations = new_ground(), new_ground()
    for station in stations:
        station.append(range(1, 61))
        station.align()
    with stations[0].supervised() as supervisor:
        stations[0].settle(supervisor)
    return stations


def results_of(station):
    return [sequence for sequence, _ in station.storage.results.results_after(station.id, 0, 10_000)]


def ending(storage, calls, end):
    """Return a storage whose n-th call to save some outcomes ends something first."""
    save, left = storage.results.submit_outcomes, calls

    def submit_outcomes(*arguments):
        nonlocal left
        left -= bool(arguments[1])
        if left == 0:
            left = -1
            end()
        return save(*arguments)

    return with_part(storage, "results", submit_outcomes=submit_outcomes)


def full():
    raise StorageError("storage.unavailable", "the disk is full; make room")


@pytest.mark.parametrize("calls", [2, 4, 7])
def test_a_full_disk_between_two_parts_loses_and_doubles_no_row(waiting, calls):
    whole, broken = waiting
    storage = ending(broken.storage, calls, full)
    with (
        patch.object(supervisor_module, "_RETRY_S", 0.02),
        patch.object(supervisor_module, "_ENTRIES_AT_ONCE", 10),
        broken.supervised(storage) as supervisor,
    ):
        broken.settle(supervisor)
    assert repr(broken.rows()) == repr(whole.rows())
    assert results_of(broken) == results_of(whole) == list(range(1, 1 + len(results_of(whole))))


def test_a_stop_between_two_parts_keeps_no_state_within_the_alignment(waiting, wait):
    whole, broken = waiting
    made = []
    storage = ending(broken.storage, 3, lambda: stop(made[0]))

    def stop(supervisor):
        supervisor._is_stopping = True

    with patch.object(supervisor_module, "_ENTRIES_AT_ONCE", 10):
        with broken.supervised(storage) as supervisor:
            made.append(supervisor)
            supervisor.notify(broken.id)
            wait(lambda: not supervisor.is_running)
        head = broken.storage.archive.head(broken.id)
        assert 0 < len(results_of(broken)) < len(results_of(whole))
        kept = broken.storage.results.checkpoints(broken.id, fingerprint(broken.config), 1 << 40)
        assert all(each.number <= head.consumed_number for each in kept)
        with broken.supervised() as supervisor:
            broken.settle(supervisor)
    assert repr(broken.rows()) == repr(whole.rows())
    assert results_of(broken) == list(range(1, 1 + len(results_of(whole))))


@pytest.fixture
def opened(payload):
    """A chain that knows everything but its alignment, one hour after the start."""
    aligned_us = synthetic.START_US + synthetic.HOUR
    chain = Chain(synthetic.FixedDocuments(payload, aligned_us), ChainConfig())
    contents = synthetic.opening(payload.spacecraft())[:-1]
    stored = [payload.measurement(aligned_us + k * synthetic.MINUTE) for k in range(1, 21)]
    archive = Mock()
    archive.measurements_after.return_value = stored
    archive.slow_inputs_before.return_value = [JournalEntry(k, content) for k, content in enumerate(contents)]
    # a port that gave a row among the slow inputs would not confuse the chain
    archive.slow_inputs_before.return_value.append(JournalEntry(40, stored[0]))
    update_before(chain, archive, "y", 50, None)
    return SimpleNamespace(chain=chain, archive=archive, stored=stored, aligned_us=aligned_us)


def test_a_row_before_the_alignment_has_no_outcome(opened):
    assert list(consume(opened.chain, JournalEntry(60, opened.stored[0]), opened.archive, "y")) == []


def test_an_alignment_runs_the_rows_stored_after_its_epoch(opened):
    outcomes = list(consume(opened.chain, JournalEntry(60, AlignmentSet(1)), opened.archive, "y"))
    opened.archive.measurements_after.assert_called_once_with("y", opened.aligned_us, 60)
    assert [outcome.rows[0].number for outcome in outcomes] == [row.number for row in opened.stored]
    assert all("catch_up" in outcome.rows[0].inhibitions for outcome in outcomes)


def test_other_inputs_have_no_outcome_and_no_catching_up(opened):
    entry = JournalEntry(60, Operation(1, "other", 1, None))
    assert list(consume(opened.chain, entry, opened.archive, "y")) == []
    opened.archive.measurements_after.assert_not_called()


def test_standing_inputs_are_asked_for_without_alignments(opened):
    opened.archive.slow_inputs_before.assert_called_once_with("y", 50, STANDING_KINDS)
    assert "alignment" not in STANDING_KINDS
    assert not opened.chain.is_running


def test_commanded_motion_is_told_as_far_as_it_reaches_beyond_the_alignment_in_the_order_of_the_journal(payload):
    chain, archive = Mock(), Mock()
    plan, correction, reported = (
        PlanChange(1),
        Correction(100, 200, Axes(0.1, 0.0, 0.0)),
        TelemetryRecord(140, "FORECAST"),
    )
    rain = WeatherReport("radar", "Kyiv", 140, 1.0)
    angle = PolarizationRecord("p", 140, -15.0)
    archive.slow_inputs_before.return_value = [JournalEntry(7, plan)]
    pages = {
        "correction": [JournalEntry(5, correction), JournalEntry(60, correction)],
        "telemetry": [JournalEntry(6, reported), JournalEntry(61, reported)],
        "weather": [JournalEntry(8, rain)],
        "polarization": [JournalEntry(9, angle)],
    }
    archive.inputs.side_effect = lambda _spacecraft, kind, *_, is_compared: pages.get(kind, [])
    update_before(chain, archive, "y", 50, 150)
    assert [call.args[0] for call in chain.update.call_args_list] == [correction, reported, plan, rain, angle]
    starts_us = {call.args[1]: call.args[2].window.start_us for call in archive.inputs.call_args_list}
    # what telemetry told in the hours before may still hold
    hours_us = 6 * 3600 * 1_000_000
    assert starts_us == {
        **dict.fromkeys(MOTION_KINDS, 150),
        "telemetry": 150 - hours_us,
        "weather": 150 - hours_us,
        "polarization": 150 - hours_us // 12,
    }


def test_each_document_is_read_once():
    catalogue, results = Mock(), Mock()
    documents = DocumentCache(catalogue, results, "y")
    for port, name in (
        (catalogue, "plan"),
        (catalogue, "ephemeris"),
        (results, "calibration"),
        (results, "alignment"),
    ):
        read = getattr(documents, name)
        assert read(7) is read(7) is getattr(port, name).return_value
        getattr(port, name).assert_called_once_with("y", 7)


@pytest.fixture
def fresh():
    return CommittedRows(LiveFeed())


def store(fresh: CommittedRows, first: int | None, rows: int, *, accepted: int | None = None, sc: str = "sc") -> None:
    """Keep a batch that was stored under the numbers from ``first`` on."""
    fresh.stored(zeros(rows, sc), BatchReceipt(rows if accepted is None else accepted, 0, 0, (), first_number=first))


def after(fresh: CommittedRows, number: int, limit: int = 100) -> list[int]:
    """Return the journal numbers that follow."""
    entries = fresh.after("sc", number, limit)
    assert all(entry.number == entry.content.number for entry in entries)
    return [entry.number for entry in entries]


def test_what_follows_is_given_once_and_in_order(fresh):
    store(fresh, 11, 2)
    store(fresh, 13, 3)
    store(fresh, 1, 5, sc="other")
    assert after(fresh, 10) == [11, 12, 13, 14, 15]
    assert after(fresh, 10) == after(fresh, 15) == []


def test_rows_that_a_listener_was_given_are_not_built_again(fresh):
    fresh.begin("sc", 10)
    loop = asyncio.new_event_loop()
    with closing(loop):
        subscription = loop.run_until_complete(_subscribed(fresh._feed))
        store(fresh, 11, 2)
        events, _ = loop.run_until_complete(subscription.next_events(60.0))
    assert [id(entry.content) for entry in fresh.after("sc", 10, 100)] == [id(event.content) for event in events]


async def _subscribed(feed: LiveFeed) -> Subscription:
    return feed.subscribe("sc")


def test_nothing_behind_a_gap_is_given_before_the_gap_is_read_elsewhere(fresh):
    store(fresh, 11, 2)
    # 13 is a slow input, or a row of another service
    store(fresh, 14, 2)
    assert after(fresh, 10) == [11, 12]
    assert after(fresh, 12) == []
    assert after(fresh, 13) == [14, 15]


def test_rows_that_were_read_elsewhere_are_left_out(fresh):
    store(fresh, 11, 2)
    store(fresh, 13, 4)
    assert after(fresh, 14) == [15, 16]


def test_a_limit_ends_with_the_batch_that_reaches_it(fresh):
    for first in (11, 14, 17):
        store(fresh, first, 3)
    assert after(fresh, 10, limit=4) == [11, 12, 13, 14, 15, 16]
    assert after(fresh, 16, limit=4) == [17, 18, 19]


@pytest.mark.parametrize(("first", "accepted"), [(11, 1), (None, 0)], ids=["a part", "nothing"])
def test_batches_that_were_not_stored_whole_are_not_kept(fresh, first, accepted):
    store(fresh, first, 2, accepted=accepted)
    assert after(fresh, 10) == []


def test_the_oldest_go_when_there_are_too_many(fresh, monkeypatch):
    monkeypatch.setattr(module, "_MOST_ROWS", 5)
    store(fresh, 1, 6)
    for first in (7, 9, 11):
        store(fresh, first, 2)
    assert after(fresh, 0) == after(fresh, 6) == []
    assert after(fresh, 8) == [9, 10, 11, 12]


def test_the_chain_is_fed_with_the_rows_that_were_just_written(ground, monkeypatch, wait):
    read: list[object] = []
    archive = ground.storage.archive
    original = archive.journal

    def journal(*position: object) -> list[JournalEntry]:
        entries: list[JournalEntry] = original(*position)
        read.extend(entry.content for entry in entries)
        return entries

    are_read_back = []
    # a look that is under way between commit and news finds the rows in the journal, which is as good
    monkeypatch.setattr(supervisor_module, "_POLL_S", 60.0)
    with ground.supervised() as supervisor:
        ground.settle(supervisor)
        monkeypatch.setattr(archive, "journal", journal)
        for first in range(1, 31, 3):
            read.clear()
            receipt = ground.append(range(first, first + 3))
            supervisor.notify(ground.id, receipt.first_number + 2)
            wait(ground.is_settled)
            # commands that count as applied are slow inputs, behind the rows
            are_read_back.append(any(isinstance(content, Measurement) for content in read))
    assert not all(are_read_back)
    assert len(ground.rows()) == 30
