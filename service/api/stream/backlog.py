"""Backlog of a stream, read from the archive: pages of events after a position, and the gaps left by retention.

Journal numbers and result sequences have no gaps, so a missing number is one that is no longer kept.
"""

from typing import NamedTuple

from service.api.context.carrier_names import CarrierNameCache
from service.api.stream.event_ids import DroppedAnswer, lost_to_retention
from service.ports import Storage
from service.records.levels.attitude import AttitudeRow
from service.records.levels.measurement import Measurement
from service.runtime.live.live_feed import Cursor, FeedEvent

#: journal entries and results read in one go
_AT_ONCE = 200
#: sequences looked through in one go where nothing is kept
_MOST_AT_ONCE = 10_000


class Page(NamedTuple):
    """The next events beyond a place."""

    events: list[FeedEvent]
    #: where the page ends
    position: Cursor
    #: what is no longer kept of what the page spans
    lost: DroppedAnswer | None


class ArchiveReader:
    """Reads one spacecraft's events; called outside the event loop.

    Parameters
    ----------
    storage : Storage
        Archive and results.
    names : CarrierNameCache
        Learns the plans of rows that are read.
    spacecraft_id : str
        An existing spacecraft.
    """

    def __init__(self, storage: Storage, names: CarrierNameCache, spacecraft_id: str) -> None:
        self._storage = storage
        self._names = names
        self._spacecraft_id = spacecraft_id
        self._results_at_once = _AT_ONCE

    def present_and_end(self) -> tuple[Cursor, Cursor]:
        """Return the place of the present, and the greatest place that an id can name."""
        head = self._storage.archive.head(self._spacecraft_id)
        alarm = self._storage.alarms.newest_sequence()
        present = Cursor(head.consumed_number, head.result_sequence, alarm)
        return present, present._replace(number=head.newest_number)

    def next_page(self, position: Cursor) -> Page:
        """Return the next measurements, results and changes of alarms beyond a place, in this order."""
        head = self._storage.archive.head(self._spacecraft_id)
        rows, number, lost_rows = self._rows(position)
        # no result comes before its row: one that was stored after the rows were read waits for the next page
        last = number if number > position.number else head.newest_number
        results, sequence, lost_results = self._results(position._replace(number=number), head.result_sequence, last)
        lost = lost_to_retention(lost_rows, lost_results) if lost_rows or lost_results else None
        changes = self._changes(position._replace(number=number, sequence=sequence))
        reached = changes[-1].cursor if changes else position._replace(number=number, sequence=sequence)
        return Page([*rows, *results, *changes], reached, lost)

    def _changes(self, position: Cursor) -> list[FeedEvent]:
        """Return the next changes of alarms; their numbers are shared by all spacecraft, so none is missed in a gap."""
        found = self._storage.alarms.changes_after(self._spacecraft_id, position.alarm, _AT_ONCE)
        return [FeedEvent("alarm", position._replace(alarm=change.sequence), change) for change in found]

    def _rows(self, position: Cursor) -> tuple[list[FeedEvent], int, int]:
        """Return the next measurements, the number that they reach to, and how many numbers are missing."""
        events, number, lost = [], position.number, 0
        for entry in self._storage.archive.journal(self._spacecraft_id, number, _AT_ONCE):
            lost += entry.number - number - 1
            number = entry.number
            if isinstance(entry.content, Measurement):
                self._names.of(self._spacecraft_id, entry.content.plan_id)
                events.append(FeedEvent("measurement", position._replace(number=number), entry.content))
        return events, number, lost

    def _results(self, position: Cursor, newest: int, last_number: int) -> tuple[list[FeedEvent], int, int]:
        """Return the next results of rows up to a number, the sequence that they reach to, and how many are missing."""
        events, sequence, lost = [], position.sequence, 0
        results = self._storage.results
        found = results.results_after(self._spacecraft_id, sequence, self._results_at_once)
        carriers = results.carriers_after(self._spacecraft_id, found[0][0] - 1, found[-1][0]) if found else {}
        for at, result in found:
            if result.number > last_number:
                break
            lost += at - sequence - 1
            sequence = at
            kind = "attitude" if isinstance(result, AttitudeRow) else "torque"
            events.append(FeedEvent(kind, position._replace(sequence=sequence), result, carriers.get(sequence)))
        for plan_id in {each.plan_id for each in carriers.values()}:
            self._names.of(self._spacecraft_id, plan_id)
        if found or sequence >= newest:
            self._results_at_once = _AT_ONCE
            return events, sequence, lost
        # nothing is kept of this stretch: look further each time
        reached = min(newest, sequence + self._results_at_once)
        self._results_at_once = min(2 * self._results_at_once, _MOST_AT_ONCE)
        return events, reached, reached - sequence
