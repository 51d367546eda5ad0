"""Cache of the rows stored last, for the followers of the journal.

Reading back what this process has written a moment ago was two thirds of what following cost, at 256 rows a step of the
database each. The cache is bounded; missing rows stand in the archive. Rows are given only where they
come next in the journal.
"""

from collections import deque
from threading import Lock
from typing import NamedTuple

from service.records.journal import JournalEntry
from service.records.levels.measurement import BatchReceipt, Measurement, MeasurementBatch
from service.runtime.live.row_publisher import is_whole, stored_rows

#: rows of one spacecraft, 200 bytes each at 32 carriers; fewer would not outlast a stop of a second
_KEPT_ROWS = 16_384


class _Stored(NamedTuple):
    """A batch that was stored as a whole."""

    first: int
    last: int
    batch: MeasurementBatch
    receipt: BatchReceipt
    #: built already for a listener
    rows: tuple[Measurement, ...] | None


class _Kept:
    """The newest batches of one spacecraft."""

    def __init__(self) -> None:
        self.batches: deque[_Stored] = deque()
        self.rows = 0

    def add(self, stored: _Stored) -> None:
        """Add the newest and let go of the oldest."""
        self.batches.append(stored)
        self.rows += stored.receipt.accepted
        while self.rows > _KEPT_ROWS:
            self.drop_first()

    def pop_next(self, number: int) -> _Stored | None:
        """Give away the batch with the row behind a number, if it is here; what lies before it is let go of."""
        while self.batches and self.batches[0].last <= number:
            self.drop_first()
        if not self.batches or self.batches[0].first > number + 1:
            return None
        return self.drop_first()

    def drop_first(self) -> _Stored:
        """Let go of the oldest."""
        stored = self.batches.popleft()
        self.rows -= stored.receipt.accepted
        return stored


class FreshRows:
    """Rows by spacecraft; safe from any thread."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: dict[str, _Kept] = {}

    def stored(
        self, batch: MeasurementBatch, receipt: BatchReceipt, rows: tuple[Measurement, ...] | None = None
    ) -> None:
        """Keep a batch that was committed just now, if it was stored as a whole; called in the order of commits.

        ``rows`` are its records where somebody has built them already.
        """
        if receipt.first_number is not None and is_whole(batch, receipt) and receipt.accepted <= _KEPT_ROWS:
            last = receipt.first_number + receipt.accepted - 1
            with self._lock:
                kept = self._kept.setdefault(batch.spacecraft_id, _Kept())
                kept.add(_Stored(receipt.first_number, last, batch, receipt, rows))

    def after(self, spacecraft_id: str, number: int, limit: int) -> list[JournalEntry]:
        """Return some entries that follow a journal number without gap, none where they are not here.

        What is given is no longer kept. A batch more than ``limit`` entries may come, never a part of one.
        """
        taken: list[_Stored] = []
        reached = number
        with self._lock:
            kept = self._kept.setdefault(spacecraft_id, _Kept())
            while reached < number + limit and (stored := kept.pop_next(reached)) is not None:
                taken.append(stored)
                reached = stored.last
        rows = (row for each in taken for row in each.rows or stored_rows(each.batch, each.receipt))
        return [JournalEntry(row.number, row) for row in rows if row.number > number]
