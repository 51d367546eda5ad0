"""Events of a batch: sequences are those of the archive, or subscribers are sent there to read."""

import numpy as np

from service.ports import Outcome
from service.records.catalogue import Method
from service.records.inputs import AlignmentSet, SpacecraftChange
from service.records.journal import JournalEntry
from service.records.levels.attitude import AttitudeRow, row_without_attitude
from service.records.levels.measurement import Measurement
from service.runtime.live.live_feed import Cursor
from service.runtime.live.step_results import result_events


def entry(number: int) -> JournalEntry:
    """Return a journal entry with a row of powers."""
    return JournalEntry(number, Measurement(number, number, number, "sa-1", 1, np.zeros(2), None))


def row(number: int) -> AttitudeRow:
    """Return a result of a row."""
    return row_without_attitude(number, number, number, Method.PAPER, ("late",))


def reported(entries: list[JournalEntry], *rest: object) -> list[tuple[str, Cursor]]:
    """Return kind and cursor of each event of a batch."""
    found = result_events(entries[-1].number, entries, *rest)  # type: ignore[arg-type]
    return [(event.kind, event.cursor) for event in found]


def test_results_stand_under_their_sequences_and_the_newest_row():
    outcomes = [Outcome((row(5),), None), Outcome((row(6),), None)]
    assert reported([entry(5), entry(6)], outcomes, 10, 12) == [
        ("attitude", Cursor(6, 11)),
        ("attitude", Cursor(6, 12)),
    ]


def test_results_stored_before_are_not_published_under_sequences_of_others():
    alignment = JournalEntry(6, AlignmentSet(2))
    # two rows run again were stored by an earlier alignment; of three results only one is new
    outcomes = [Outcome((row(number),), None) for number in (5, 3, 4)]
    assert reported([entry(5), alignment], outcomes, 10, 11) == [("status", Cursor(6, 11))]


def test_alignment_is_news_of_its_own():
    assert reported([JournalEntry(6, AlignmentSet(2))], [], 10, 10) == [("status", Cursor(6, 10))]


def test_other_slow_inputs_are_silent():
    assert reported([JournalEntry(6, SpacecraftChange(None, 2))], [], 10, 10) == []  # type: ignore[arg-type]
