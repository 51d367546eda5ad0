"""Sequence numbers of a source in the archive, kept as intervals in the transaction that stores the rows.

A front end numbers its rows in the order in which it takes them. Numbers that start again while epochs go on are a new
run, and so are numbers that jump by more than ``MAX_JUMP``; a late row that far off its run is not counted. A row of
an earlier epoch belongs to the run that had begun by then, so rows sent later find their gap. Of the
newest run the newest interval stands with the source (the ``Tail``), which costs a batch that follows the one before
no statement more; intervals below it stand in ``sequence_interval``. What is missing is counted as intervals change:
span of each run minus the numbers held in it. What lies before the first row ever held is not known to be missing.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from sqlalchemy import ColumnElement, Connection, and_, delete, func, select

from db.tables import sequence_interval

_TABLE = sequence_interval
#: before every epoch
BEFORE_ALL_US = -(1 << 62)
#: runs whose intervals are kept: rows sent later than that no longer find their gap
RUNS_KEPT = 16
_MAX_MISSING = 1 << 62
#: numbers between which no gap is counted: no source measures so many rows, a counter was set or overran
MAX_JUMP = 1_000_000_000


class Tail(NamedTuple):
    """Newest run of a source and its newest interval; kept in columns of ``source``."""

    run: int
    #: rows up to this epoch belong to earlier runs
    after_us: int
    start: int
    last: int
    rows_missing: int


class Block(NamedTuple):
    """Numbers without gap that a batch adds."""

    first: int
    last: int
    #: epoch of the first
    epoch_us: int
    #: later than every row of the source before the batch
    is_ahead: bool


class NumberedRow(NamedTuple):
    """One row of a batch that the archive holds after it."""

    seq: int
    epoch_us: int
    #: stored by this batch, else held already
    is_new: bool


def blocks_of(rows: Iterable[NumberedRow], newest_us: int | None) -> Iterator[Block]:
    """Yield the blocks of numbers that new rows add.

    A row that was held already carries a block on, whatever number it had then, but neither begins nor ends one.

    Parameters
    ----------
    rows : iterable of NumberedRow
        In the order of the batch.
    newest_us : int or None
        Newest epoch of the source before the batch.
    """
    block: Block | None = None
    seq = 0
    for row in rows:
        is_ahead = newest_us is None or row.epoch_us > newest_us
        is_next = block is not None and row.seq == seq + 1 and (not row.is_new or is_ahead == block.is_ahead)
        if block is not None and not is_next:
            yield block
            block = None
        if row.is_new:
            block = Block(row.seq, row.seq, row.epoch_us, is_ahead) if block is None else block._replace(last=row.seq)
        seq = row.seq
    if block is not None:
        yield block


@dataclass
class SequenceNumbers:
    """The numbers of one source inside a write transaction.

    Parameters
    ----------
    connection : Connection
        Of the writer.
    spacecraft_key, source_key : int
        The source.
    """

    connection: Connection
    spacecraft_key: int
    source_key: int

    def added(self, tail: Tail | None, block: Block, newest_us: int | None) -> Tail:
        """Return where a source stands after a block.

        Parameters
        ----------
        tail : Tail or None
            Where it stood; None before its first number.
        block : Block
            Numbers to count in.
        newest_us : int or None
            Newest epoch of the source before the block.
        """
        if tail is None:
            return Tail(1, BEFORE_ALL_US, block.first, block.last, 0)
        is_jump = block.first - tail.last > MAX_JUMP
        if block.first > tail.last and not is_jump:
            return self._advanced(tail, block)
        if block.is_ahead:
            return self._begun(tail, block, BEFORE_ALL_US if newest_us is None else newest_us)
        if block.epoch_us > tail.after_us:
            return self._filled(tail, block, tail.run)
        run = self._run_at(tail, block.epoch_us)
        # a run whose intervals are no longer kept has no gap to fill
        return tail if run is None else self._filled(tail, block, run)

    def _advanced(self, tail: Tail, block: Block) -> Tail:
        """Go on behind the newest number."""
        if block.first == tail.last + 1:
            return tail._replace(last=block.last)
        self._insert(tail.run, tail.after_us, tail.start, tail.last)
        missing = _bounded(tail.rows_missing + block.first - tail.last - 1)
        return tail._replace(start=block.first, last=block.last, rows_missing=missing)

    def _begun(self, tail: Tail, block: Block, after_us: int) -> Tail:
        """Begin a run: numbers start again while epochs go on."""
        self._insert(tail.run, tail.after_us, tail.start, tail.last)
        run = tail.run + 1
        self.connection.execute(delete(_TABLE).where(self._is_mine(), _TABLE.c.run <= run - RUNS_KEPT))
        return Tail(run, after_us, block.first, block.last, tail.rows_missing)

    def _run_at(self, tail: Tail, epoch_us: int) -> int | None:
        """Return the run before the newest that had begun at an epoch."""
        had_begun = (_TABLE.c.run < tail.run, _TABLE.c.after_us < epoch_us)
        run: int | None = self.connection.scalar(select(func.max(_TABLE.c.run)).where(self._is_mine(), *had_begun))
        return run

    def _filled(self, tail: Tail, block: Block, run: int) -> Tail:
        """Merge a block with the intervals of a run that it overlaps or adjoins."""
        is_newest = run == tail.run
        low, high, after_us = self._bounds(tail, run)
        if block.first - high > MAX_JUMP or low - block.last > MAX_JUMP:
            return tail
        touched = self._taken(block, run)
        does_reach_tail = is_newest and block.last + 1 >= tail.start
        if does_reach_tail:
            touched.append((tail.start, tail.last))
        first = min([block.first, *(start for start, _ in touched)])
        last = max([block.last, *(stop for _, stop in touched)])
        gained = last - first + 1 - sum(stop - start + 1 for start, stop in touched)
        widened = max(high, last) - min(low, first) - (high - low)
        tail = tail._replace(rows_missing=_bounded(tail.rows_missing + widened - gained))
        if does_reach_tail:
            return tail._replace(start=first, last=last)
        self._insert(run, after_us, first, last)
        return tail

    def _bounds(self, tail: Tail, run: int) -> tuple[int, int, int]:
        """Return the first and last number of a run, and the epoch after which it began."""
        columns = func.min(_TABLE.c.first_seq), func.max(_TABLE.c.last_seq), func.max(_TABLE.c.after_us)
        low, high, after_us = self.connection.execute(
            select(*columns).where(self._is_mine(), _TABLE.c.run == run)
        ).one()
        if run != tail.run:
            return low, high, after_us
        return tail.start if low is None else low, tail.last, tail.after_us

    def _taken(self, block: Block, run: int) -> list[tuple[int, int]]:
        """Take the closed intervals of a run that overlap or adjoin a block out of the table and return them."""
        first, last = _TABLE.c.first_seq, _TABLE.c.last_seq
        is_its = and_(self._is_mine(), _TABLE.c.run == run)
        # intervals do not overlap, so of those that begin before the block only the last can reach it
        lower = self.connection.scalar(select(func.max(first)).where(is_its, first <= block.first))
        bounds = (first >= (block.first if lower is None else lower), first <= block.last + 1, last >= block.first - 1)
        found = [(row[0], row[1]) for row in self.connection.execute(select(first, last).where(is_its, *bounds))]
        if found:
            self.connection.execute(delete(_TABLE).where(is_its, *bounds))
        return found

    def _insert(self, run: int, after_us: int, first: int, last: int) -> None:
        """Put an interval among the closed ones."""
        values = {"run": run, "first_seq": first, "last_seq": last, "after_us": after_us}
        keys = {"spacecraft_key": self.spacecraft_key, "source_key": self.source_key}
        self.connection.execute(_TABLE.insert().values({**keys, **values}))

    def _is_mine(self) -> ColumnElement[bool]:
        return and_(_TABLE.c.spacecraft_key == self.spacecraft_key, _TABLE.c.source_key == self.source_key)


def _bounded(rows: int) -> int:
    """Return a count that the column can hold."""
    return max(0, min(rows, _MAX_MISSING))
