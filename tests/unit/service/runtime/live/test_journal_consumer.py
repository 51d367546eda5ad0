"""Consumption: one entry in, its outcomes out; documents are read once."""

from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import synthetic_payload as synthetic

from service.pipeline.chain import Chain
from service.pipeline.config import ChainConfig
from service.records.inputs import (
    AlignmentSet,
    Correction,
    Operation,
    PlanChange,
    PolarizationRecord,
    TelemetryRecord,
    WeatherReport,
)
from service.records.journal import JournalEntry
from service.records.levels.attitude import Axes
from service.runtime.live.journal_consumer import MOTION_KINDS, STANDING_KINDS, DocumentCache, consume, update_before


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
    archive.inputs.side_effect = lambda _spacecraft, kind, _window, _limit, _after: pages.get(kind, [])
    update_before(chain, archive, "y", 50, 150)
    assert [call.args[0] for call in chain.update.call_args_list] == [correction, reported, plan, rain, angle]
    starts_us = {call.args[1]: call.args[2].start_us for call in archive.inputs.call_args_list}
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
