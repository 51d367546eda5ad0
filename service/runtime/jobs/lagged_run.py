"""Run that makes smoothed rows at a fixed lag: a span of the journal again, from a state of the live chain before it.

It begins with the newest checkpoint that is older than the first row wanted, or with an alignment where none is, and
consumes the journal as the live chain did. It writes nothing: what it made is stored by the process that leads.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from service.pipeline.chain import Chain
from service.pipeline.checkpoints.chain_state import fingerprint
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.smoothed.lagged_rows import GRID_US, LaggedRows, grid_us
from service.ports import Storage
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import AttitudeRow
from service.records.levels.measurement import Measurement
from service.runtime.live.chain_restart import restored_checkpoint
from service.runtime.live.journal_consumer import DocumentCache, consume, update_before

_ENTRIES_AT_ONCE = 512
#: instants that one run passes, us: at a row a second their rows take three minutes
_PART_US = 6 * 3600 * US_PER_S
#: a run may begin so long before the first row that it makes, us; the last checkpoint of each day is kept
_REACH_US = 2 * 86_400 * US_PER_S


class LaggedOrder(NamedTuple):
    """Smoothed rows that are wanted."""

    #: instant of the grid up to which they are made already, microseconds UTC
    after_us: int
    #: journal number of the last entry that the live chain has consumed
    until_number: int
    lag_us: int


class LaggedPart(NamedTuple):
    """Smoothed rows that a run has made."""

    rows: tuple[AttitudeRow, ...]
    #: instant of the grid up to which they are made now, microseconds UTC
    made_us: int
    #: whether the instants up to there have no rows because no state of the chain is kept that is old enough
    is_skipped: bool


class LaggedRun:
    """Run of one part.

    Parameters
    ----------
    storage : Storage
        Journal and checkpoints.
    config : ChainConfig
        Configuration of the chain.
    spacecraft_id : str
        Spacecraft.
    order : LaggedOrder
        What is wanted.
    """

    def __init__(self, storage: Storage, config: ChainConfig, spacecraft_id: str, order: LaggedOrder) -> None:
        self._storage, self._config, self._id, self._order = storage, config, spacecraft_id, order
        self._lagged = LaggedRows(order.lag_us, order.after_us)
        documents = DocumentCache(storage.catalogue, storage.results, spacecraft_id)
        # torques are nobody's here: those that counted as applied stand in the journal
        self._chain = Chain(
            documents, config, methods=(Method.ROBUST,), has_commands=False, recorder=self._lagged.recorder
        )

    def run(self) -> LaggedPart:
        """Make the rows of the next instants, of six hours at most."""
        after_us = self._order.after_us
        position = self._begun()
        if position is None:
            first_us = self._first_us()
            made_us = after_us if first_us is None else grid_us(first_us + GRID_US - 1)
            return LaggedPart((), made_us, made_us > after_us)
        rows: list[AttitudeRow] = []
        for made in self._made(position):
            rows += made
            if self._lagged.made_us >= after_us + _PART_US:
                break
        return LaggedPart(tuple(rows), self._lagged.made_us, is_skipped=False)

    def _made(self, position: int) -> Iterator[list[AttitudeRow]]:
        """Yield the smoothed rows that are due with each row of the journal behind a number."""
        archive, until = self._storage.archive, self._order.until_number
        while entries := archive.journal(self._id, position, _ENTRIES_AT_ONCE):
            for entry in entries:
                if entry.number > until:
                    return
                for outcome in consume(self._chain, entry, archive, self._id):
                    yield self._lagged.push(outcome.rows[0].epoch_us, outcome.rows)
                content = entry.content
                # also where no method runs: an instant without rows is passed
                if isinstance(content, Measurement) and content.feeds_estimator:
                    yield self._lagged.push(content.epoch_us, ())
            position = entries[-1].number

    def _begun(self) -> int | None:
        """Bring the chain to a state before the first row wanted and return its journal number; None = there is none.

        A checkpoint comes first: an alignment that came after rows gives other states than they had.
        """
        after_us, until = self._order.after_us, self._order.until_number
        kept = restored_checkpoint(self._storage, self._id, self._chain, self._config, 0, until, after_us + 1)
        if kept is not None:
            return kept.number if kept.epoch_us >= after_us - _REACH_US else None
        standing = [each for each in self._alignments() if after_us - _REACH_US <= each[1] <= after_us]
        if not standing:
            return None
        number, epoch_us = max(standing)
        update_before(self._chain, self._storage.archive, self._id, number, epoch_us)
        return number - 1

    def _first_us(self) -> int | None:
        """Return the earliest epoch after the wanted instant at which a run can begin, microseconds UTC."""
        results, after_us = self._storage.results, self._order.after_us
        kept = results.checkpoints(self._id, fingerprint(self._config), self._order.until_number)
        found = [*(each.epoch_us for each in kept), *(epoch_us for _, epoch_us in self._alignments())]
        return min((epoch_us for epoch_us in found if epoch_us > after_us), default=None)

    def _alignments(self) -> list[tuple[int, int]]:
        """Return journal number and epoch of every alignment that the live chain has consumed."""
        results = self._storage.results
        found = [(results.alignment_number(self._id, each.id), each.epoch_us) for each in results.alignments(self._id)]
        return [each for each in found if each[0] <= self._order.until_number]


def lagged_in_process(
    open_storage: Callable[[], Storage], config: ChainConfig, spacecraft_id: str, order: LaggedOrder
) -> LaggedPart:
    """Make a part in a process that has no storage yet."""
    storage = open_storage()
    try:
        return LaggedRun(storage, config, spacecraft_id, order).run()
    finally:
        storage.close()
