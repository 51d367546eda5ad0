"""Live rows: an alignment's rows are stored in parts, each entry is consumed once, the newest rows are cached."""

from types import SimpleNamespace
from unittest.mock import Mock, patch

import pytest
import synthetic_payload as synthetic
from storage_parts import with_part

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
from service.runtime.live.journal_consumer import MOTION_KINDS, STANDING_KINDS, DocumentCache, consume, update_before


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
