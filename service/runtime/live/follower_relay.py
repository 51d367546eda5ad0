"""Relay: tells the live feed of a service that does not lead what the leading one has stored.

It looks at the archive some times a second. Rows and changes of alarms are told themselves; of results it is told
where they stand, and each stream reads them from the archive, as it does after a gap.
"""

from collections.abc import Mapping

from service.ports import Storage
from service.records.levels.measurement import Measurement
from service.records.levels.series import HeadState
from service.runtime.live.live_feed import Cursor, FeedEvent, LiveFeed

#: entries and changes read in one go
_AT_ONCE = 256


class Relay:
    """Follower of the stored rows of each spacecraft.

    Parameters
    ----------
    storage : Storage
        The archive.
    feed : LiveFeed
        Where it is told.
    """

    def __init__(self, storage: Storage, feed: LiveFeed) -> None:
        self._storage = storage
        self._feed = feed
        self._positions: dict[str, Cursor] = {}

    def forget(self, spacecraft_id: str) -> None:
        """Begin with the present when it is needed again."""
        self._positions.pop(spacecraft_id, None)

    def behind(self, heads: Mapping[str, HeadState]) -> set[str]:
        """Return the spacecraft with subscribers of which something may have been stored since their last poll."""
        alarm = self._storage.alarms.newest_sequence()
        present = {name: Cursor(head.newest_number, head.result_sequence, alarm) for name, head in heads.items()}
        # who subscribes from here on finds in the archive what was stored up to this present
        quiet = {name for name in present if not self._feed.has_subscribers(name)}
        self._positions |= {name: present[name] for name in quiet}
        return {name for name in present.keys() - quiet if self._positions.get(name) != present[name]}

    def poll(self, spacecraft_id: str) -> None:
        """Publish the entries since the last poll."""
        present = self._present(spacecraft_id)
        position = self._positions.setdefault(spacecraft_id, present)
        # who subscribes from here on finds in the archive what was stored up to this present
        if not self._feed.has_subscribers(spacecraft_id):
            self._positions[spacecraft_id] = present
            return
        while events := self._events(spacecraft_id, position):
            position = self._positions[spacecraft_id] = events[-1].cursor
            self._feed.publish(spacecraft_id, tuple(events))

    def _present(self, spacecraft_id: str) -> Cursor:
        head = self._storage.archive.head(spacecraft_id)
        return Cursor(head.newest_number, head.result_sequence, self._storage.alarms.newest_sequence())

    def _events(self, spacecraft_id: str, position: Cursor) -> list[FeedEvent]:
        """Return the next events; the last one stands where all that was read ends."""
        entries = self._storage.archive.journal(spacecraft_id, position.number, _AT_ONCE)
        rows = [entry.content for entry in entries if isinstance(entry.content, Measurement)]
        events = [FeedEvent("measurement", position._replace(number=row.number), row) for row in rows]
        changes = self._storage.alarms.changes_after(spacecraft_id, position.alarm, _AT_ONCE)
        events += [FeedEvent("alarm", position._replace(alarm=change.sequence), change) for change in changes]
        sequence = self._storage.archive.head(spacecraft_id).result_sequence
        end = Cursor(
            entries[-1].number if entries else position.number,
            sequence,
            changes[-1].sequence if changes else position.alarm,
        )
        return [] if end == position else [*events, FeedEvent("status", end, None)]
