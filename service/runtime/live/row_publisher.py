"""Publisher of rows: each goes to subscribers once, in the order of the journal, as soon as it is durable.

The archive's writer publishes rows right after their commit, which saves a subscriber the way over the journal, 3 ms.
It publishes a batch only when it follows directly on the rows published before; otherwise, and for batches of many
rows, the follower of the journal publishes them when it reaches them.
"""

from collections.abc import Iterator, Sequence
from threading import Lock

import numpy as np

from service.records.journal import JournalEntry
from service.records.levels.measurement import BatchReceipt, CarrierDetails, Measurement, MeasurementBatch
from service.runtime.live.live_feed import Cursor, FeedEvent, LiveFeed

#: rows of a batch that the writer tells of; more are a backlog, for which the writer has no time
_ROWS_AT_ONCE = 16


class RowPublisher:
    """Tells listeners of rows; safe from any thread.

    Parameters
    ----------
    feed : LiveFeed
        Listeners.
    """

    def __init__(self, feed: LiveFeed) -> None:
        self._feed = feed
        self._lock = Lock()
        #: journal number up to which all is told, or was in the archive before anybody could listen
        self._reported: dict[str, int] = {}

    def begin(self, spacecraft_id: str, number: int) -> None:
        """Start publishing the rows of a journal after a number."""
        with self._lock:
            self._reported[spacecraft_id] = max(number, self._reported.get(spacecraft_id, 0))

    def stored(self, batch: MeasurementBatch, receipt: BatchReceipt) -> tuple[Measurement, ...] | None:
        """Publish a batch that was committed just now, if it comes next, and return the rows that were published.

        Called in the order of commits.
        """
        if receipt.first_number is None or receipt.accepted > _ROWS_AT_ONCE or not is_whole(batch, receipt):
            return None
        with self._lock:
            if self._reported.get(batch.spacecraft_id) == receipt.first_number - 1:
                self._reported[batch.spacecraft_id] = receipt.first_number + receipt.accepted - 1
                # who subscribes from here on finds the rows in the archive
                if self._feed.has_subscribers(batch.spacecraft_id):
                    rows = tuple(stored_rows(batch, receipt))
                    self._publish(batch.spacecraft_id, rows)
                    return rows
        return None

    def followed(self, spacecraft_id: str, entries: Sequence[JournalEntry]) -> None:
        """Publish those rows among the next entries of a journal that were not published yet."""
        with self._lock:
            reported = self._reported.get(spacecraft_id, 0)
            self._reported[spacecraft_id] = max(reported, entries[-1].number)
            if self._feed.has_subscribers(spacecraft_id):
                rows = (entry.content for entry in entries if entry.number > reported)
                self._publish(spacecraft_id, tuple(row for row in rows if isinstance(row, Measurement)))

    def _publish(self, spacecraft_id: str, rows: Sequence[Measurement]) -> None:
        # a row moves the first part of a listener's place alone
        events = tuple(FeedEvent("measurement", Cursor(row.number, 0), row) for row in rows)
        if events:
            self._feed.publish(spacecraft_id, events)


def is_whole(batch: MeasurementBatch, receipt: BatchReceipt) -> bool:
    """Return whether all rows of a batch were stored as they came, so that what became of each is known."""
    return receipt.accepted == len(batch.index) and not receipt.flagged


def stored_rows(batch: MeasurementBatch, receipt: BatchReceipt) -> Iterator[Measurement]:
    """Yield the rows of a batch that was stored as a whole, as the archive gives them."""
    power_dbm = batch.power_dbm.astype(np.float32).astype(np.float64)
    power_dbm.setflags(write=False)
    is_late = [receipt.late > 0] * len(batch.index) if receipt.is_late is None else receipt.is_late.tolist()
    for position in range(len(batch.index)):
        given = batch.flags[position]
        flags = None if given is None else np.array(given, dtype=np.int64)
        if flags is not None:
            flags.setflags(write=False)
        yield Measurement(
            epoch_us=int(batch.epochs_us[position]),
            received_at_us=batch.received_at_us,
            number=(receipt.first_number or 0) + position,
            source=batch.source,
            plan_id=batch.plan_id,
            power_dbm=power_dbm[position],
            flags=flags,
            is_late=is_late[position],
            feeds_estimator=receipt.feeds_estimator,
            seq=None if batch.first_seq is None else batch.first_seq + int(batch.index[position]),
            details=_details(batch.details, position),
        )


def _details(details: CarrierDetails | None, position: int) -> CarrierDetails | None:
    """Return the details of a row beside its powers, None where it has none."""
    if details is None:
        return None
    statistics = details.row(position).astype(np.float64)
    statistics.setflags(write=False)
    return None if np.isnan(statistics).all() else CarrierDetails(*statistics)
