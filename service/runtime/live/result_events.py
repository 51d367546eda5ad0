"""Result events: what subscribers of the live feed get of results that were stored."""

from service.ports import Outcome
from service.records.inputs import AlignmentSet, CalibrationActivation
from service.records.journal import JournalEntry
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.runtime.live.live_feed import Cursor, FeedEvent

#: what makes results of another kind than those before
_RESTARTING = (AlignmentSet, CalibrationActivation)


def result_events(entries: list[JournalEntry], outcomes: list[Outcome], first: int, last: int) -> tuple[FeedEvent, ...]:
    """Return the events of the results of a batch, stored under the sequences after ``first``.

    Of rows that an alignment ran again some results may have been stored before. Which ones the archive knows alone, so
    subscribers are told, by a status event without content, to read there; the same says that a new alignment or
    calibration holds.
    """
    number = entries[-1].number
    events: list[FeedEvent] = []
    results = [result for outcome in outcomes for result in (*outcome.rows, outcome.command) if result is not None]
    is_whole = len(results) == last - first
    if is_whole:
        events += [
            FeedEvent(_kind(result), Cursor(number, sequence), result)
            for sequence, result in enumerate(results, start=first + 1)
        ]
    if not is_whole or any(isinstance(entry.content, _RESTARTING) for entry in entries):
        events.append(FeedEvent("status", Cursor(number, last), None))
    return tuple(events)


def _kind(result: AttitudeRow | TorqueCommand) -> str:
    """Return the kind of event that tells a result."""
    return "attitude" if isinstance(result, AttitudeRow) else "torque"
