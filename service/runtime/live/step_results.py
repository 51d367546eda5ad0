"""Results of some entries of the journal, as the supervisor stores them and tells of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest

from service.pipeline.chain import Chain
from service.pipeline.control.release.events import StoredRow
from service.ports import Outcome
from service.records.inputs import AlignmentSet, AttitudeReference, CalibrationActivation
from service.records.journal import JournalEntry
from service.records.levels.attitude import AttitudeRow
from service.records.levels.carrier_results import CarrierResults
from service.records.levels.command import TorqueCommand
from service.records.levels.measurement import Measurement
from service.runtime.live.journal_consumer import Trip, without_torque_after
from service.runtime.live.live_feed import Cursor, FeedEvent
from service.runtime.live.row_watchers import Seen

#: what makes results of another kind than those before
_RESTARTING = (AlignmentSet, CalibrationActivation)


@dataclass(slots=True)
class StepResults:
    """Results of some entries of the journal."""

    outcomes: list[Outcome] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    released: list[StoredRow] = field(default_factory=list)

    @property
    def has_applied(self) -> bool:
        """Return whether the newest command counts as applied."""
        return bool(self.outcomes) and self.outcomes[-1].applied is not None

    def withhold(self, trips: Sequence[Trip]) -> None:
        """Remove the torque from rows that are later than a trip."""
        self.outcomes = [without_torque_after(trips, outcome) for outcome in self.outcomes]
        self.released = [one._replace(outcome=without_torque_after(trips, one.outcome)) for one in self.released]


def seen_of(chain: Chain, entry: JournalEntry, outcomes: Sequence[Outcome]) -> tuple[Seen, ...]:
    """Return the input of alarms in an entry; late rows, and rows that an alignment recomputed, are none."""
    content = entry.content
    if isinstance(content, AttitudeReference):
        return (content,)
    if not isinstance(content, Measurement) or content.is_late or not content.feeds_estimator:
        return ()
    return (chain.facts(content, outcomes[0] if outcomes else None),)


def result_events(
    number: int, entries: Sequence[JournalEntry], outcomes: Sequence[Outcome], first: int, last: int
) -> tuple[FeedEvent, ...]:
    """Return the events of the results of entries up to a journal number, stored under the sequences after ``first``.

    Of rows that an alignment ran again some results may have been stored before. Which ones the archive knows alone, so
    subscribers are told, by a status event without content, to read there; the same says that a new alignment or
    calibration holds.
    """
    events: list[FeedEvent] = []
    results = [result for outcome in outcomes for result in _results(outcome)]
    is_whole = len(results) == last - first
    if is_whole:
        events += [
            FeedEvent(_kind(result), Cursor(number, sequence), result, carriers)
            for sequence, (result, carriers) in enumerate(results, start=first + 1)
        ]
    if not is_whole or any(isinstance(entry.content, _RESTARTING) for entry in entries):
        events.append(FeedEvent("status", Cursor(number, last), None))
    return tuple(events)


def _results(outcome: Outcome) -> Iterator[tuple[AttitudeRow | TorqueCommand, CarrierResults | None]]:
    """Yield the results of a row in the order in which they are stored, with what is known of the carriers."""
    # nothing is known of the carriers of a late row
    yield from zip_longest(outcome.rows, outcome.carriers)
    if outcome.command is not None:
        yield outcome.command, None


def _kind(result: AttitudeRow | TorqueCommand) -> str:
    """Return the kind of event that tells a result."""
    return "attitude" if isinstance(result, AttitudeRow) else "torque"
