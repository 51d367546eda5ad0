"""Restart of a live chain: from its newest checkpoint, or from the last alignment where that is later or none fits.

From either on the journal is consumed again, silently, to where results were stored. Both ways give the same chain, bit
for bit.
"""

import logging
import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator
from tokenize import TokenError
from typing import NamedTuple

from service.pipeline.chain import Chain
from service.pipeline.checkpoints import ChainState, fingerprint, pack_state, unpack_state
from service.pipeline.config import ChainConfig
from service.ports.archive import Archive, Results
from service.ports.storage import Storage
from service.records.epoch import US_PER_S
from service.records.inputs import AlignmentSet
from service.records.storage import Checkpoint
from service.runtime.live.journal_consumer import DocumentCache, consume, update_before

_LOG = logging.getLogger("soo.restart")

#: of data between two checkpoints, us
PERIOD_US = 3600 * US_PER_S
#: an alignment may reach back so far before a checkpoint, us
KNOWN_US = 7 * 86_400 * US_PER_S
#: between two looks at whether the service stops: a third of a second of the processor at most
_ENTRIES_AT_ONCE = 64
#: what zip, deflate, JSON and numpy say of damaged bytes
_UNREADABLE = (
    *(ArithmeticError, AttributeError, EOFError, LookupError, OSError, RuntimeError, TypeError, ValueError),
    *(SyntaxError, TokenError, struct.error, zipfile.BadZipFile, zlib.error),
)


def checkpoint_of(chain: Chain, config: ChainConfig, number: int, epoch_us: int) -> Checkpoint | None:
    """Return the state of a chain after an entry of the journal; None where it cannot be saved now."""
    state = chain.saved()
    return None if state is None else Checkpoint(number, epoch_us, fingerprint(config), pack_state(state))


class Restarting(NamedTuple):
    """Restart under way."""

    spacecraft_id: str
    #: entries of the journal that are still to be consumed again
    entries_left: int
    #: at the pace so far; None = nothing is consumed yet
    seconds_left: float | None


class ChainRestarts:
    """Restarts of the chains of a service, one at a time.

    Parameters
    ----------
    storage : Storage
        Journal and checkpoints.
    config : ChainConfig
        Configuration of every chain.
    is_stopping : callable
        Whether the service stops: a restart then ends before its time.
    """

    def __init__(self, storage: Storage, config: ChainConfig, is_stopping: Callable[[], bool]) -> None:
        self._storage = storage
        self._config = config
        self._is_stopping = is_stopping
        #: restart that is under way
        self.under_way: Restarting | None = None

    def chain(self, spacecraft_id: str, consumed_number: int) -> tuple[Chain, int | None] | None:
        """Return the chain as it was after a journal number, and the newest epoch of the checkpoint that it began with.

        Microseconds UTC, None where it began at an alignment. None in place of both if the service stops before.
        """
        storage = self._storage
        chain = Chain(DocumentCache(storage.catalogue, storage.results, spacecraft_id), self._config)
        number, aligned_us = _last_alignment(storage, spacecraft_id, consumed_number)
        kept = restored_checkpoint(storage, spacecraft_id, chain, self._config, number or 0, consumed_number)
        if kept is None:
            update_before(chain, storage.archive, spacecraft_id, number or consumed_number + 1, aligned_us)
        position = kept.number if kept is not None else consumed_number if number is None else number - 1
        began_s, first = time.monotonic(), consumed_number - position
        try:
            for left in _entries_left(chain, storage.archive, spacecraft_id, position, consumed_number):
                passed_s = time.monotonic() - began_s
                seconds_left = passed_s * left / (first - left) if left < first else None
                self.under_way = Restarting(spacecraft_id, left, seconds_left)
                if self._is_stopping():
                    return None
        finally:
            self.under_way = None
        return chain, None if kept is None else kept.epoch_us


def _entries_left(
    chain: Chain, archive: Archive, spacecraft_id: str, position: int, consumed_number: int
) -> Iterator[int]:
    """Let a chain consume the entries behind a position, and yield how many are left; nothing is stored."""
    while position < consumed_number:
        yield consumed_number - position
        entries = archive.journal(spacecraft_id, position, _ENTRIES_AT_ONCE)
        for entry in entries:
            if entry.number <= consumed_number:
                for row, _ in enumerate(consume(chain, entry, archive, spacecraft_id), start=1):
                    if row % _ENTRIES_AT_ONCE == 0:
                        # an alignment brings all rows after its epoch
                        yield consumed_number - position
        position = entries[-1].number if entries else consumed_number


def restored_checkpoint(
    storage: Storage,
    spacecraft_id: str,
    chain: Chain,
    config: ChainConfig,
    after_number: int,
    until_number: int,
    before_us: int | None = None,
) -> Checkpoint | None:
    """Restore a new chain from the newest checkpoint that fits and can be read, and return the checkpoint.

    Parameters
    ----------
    storage, spacecraft_id, chain, config
        Where it is kept, and the chain that goes on from it.
    after_number, until_number : int
        It must be later than the first and not later than the second.
    before_us : int, optional
        Its newest epoch must be earlier, microseconds UTC.
    """
    for found in storage.results.checkpoints(spacecraft_id, fingerprint(config), until_number, before_us):
        if found.number <= after_number:
            break
        state = state_of(spacecraft_id, found)
        if state is not None:
            update_before(chain, storage.archive, spacecraft_id, found.number + 1, found.epoch_us - KNOWN_US)
            chain.restore(state)
            return found
    return None


def numbered_alignments(results: Results, spacecraft_id: str) -> list[tuple[int, int]]:
    """Return journal number and epoch of every alignment of a spacecraft."""
    alignments = results.alignments(spacecraft_id)
    return [(results.alignment_number(spacecraft_id, each.id), each.epoch_us) for each in alignments]


def state_of(spacecraft_id: str, found: Checkpoint) -> ChainState | None:
    """Return the state of a checkpoint; None where it cannot be read."""
    try:
        return unpack_state(found.content)
    except _UNREADABLE as fault:
        _LOG.warning("checkpoint %d of %s cannot be read: %s", found.number, spacecraft_id, fault)
        return None


def _last_alignment(storage: Storage, spacecraft_id: str, consumed_number: int) -> tuple[int | None, int | None]:
    """Return journal number and epoch of the newest consumed alignment."""
    entries = storage.archive.slow_inputs_before(spacecraft_id, consumed_number + 1, ("alignment",))
    for entry in reversed(entries):
        if isinstance(entry.content, AlignmentSet):
            alignment = storage.results.alignment(spacecraft_id, entry.content.alignment_id)
            return entry.number, alignment.epoch_us
    return None, None
