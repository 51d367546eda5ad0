"""Run of one replay: from its start or its last checkpoint to the end of its span, stored piece by piece.

What a piece computed and the state after it are stored in one transaction, so that a run that was killed goes on from
there and gives the same rows, bit for bit.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import takewhile
from typing import NamedTuple

from service.pipeline.chain import METHODS, Chain
from service.pipeline.checkpoints.chain_state import ChainState, fingerprint
from service.pipeline.config import ChainConfig
from service.ports import Outcome, Storage
from service.records.calibration import Window
from service.records.inputs import AlignmentSet
from service.records.journal import JournalEntry
from service.records.levels.measurement import Measurement
from service.records.operations.job import JobState, Replay
from service.records.storage.checkpoint import Checkpoint
from service.runtime.jobs.job_runner import Progress
from service.runtime.live.chain_restart import KNOWN_US, checkpoint_of, restored_checkpoint, state_of
from service.runtime.live.journal_consumer import (
    DocumentCache,
    consume,
    trips_after,
    update_before,
    without_torque_after,
)

_ENTRIES_AT_ONCE = 512
#: outcomes of one transaction: a longer one keeps live rows waiting
_OUTCOMES_AT_ONCE = 100
#: between two checkpoints, which take as long as five rows, s
_CHECKPOINT_S = 2.0


class _Passed(NamedTuple):
    """Position of a run, and the outcome of a row."""

    progress: float
    #: None at the end of an entry
    outcome: Outcome | None
    #: journal number and epoch up to which the chain has consumed; None within an entry
    position: tuple[int, int] | None


class ReplayRun:
    """Run of a replay that is stored.

    Parameters
    ----------
    storage : Storage
        Journal to read, results to write.
    config : ChainConfig
        Configuration of the chain.
    spacecraft_id, version : str
        The replay.

    Raises
    ------
    NotFoundError
        ``replay.unknown``: it was deleted while it waited.
    """

    def __init__(self, storage: Storage, config: ChainConfig, spacecraft_id: str, version: str) -> None:
        self._storage, self._config, self._id = storage, config, spacecraft_id
        results = storage.results
        self._replay: Replay = results.replay(spacecraft_id, version).replay
        self._alignment = results.alignment(spacecraft_id, self._replay.alignment_id)
        number = self._replay.calibration_id
        calibration = None if number is None else results.calibration(spacecraft_id, number)
        methods = METHODS if self._replay.method is None else (self._replay.method,)
        documents = DocumentCache(storage.catalogue, results, spacecraft_id)
        self._chain = Chain(documents, config, calibration, methods, has_commands=self._replay.commands)
        until = self._replay.until_number
        self._newest_number = storage.archive.head(spacecraft_id).newest_number if until is None else until

    def run(self, report: Progress) -> None:
        """Compute and store the rows of the span; ConflictError ``replay.deleted`` if it is deleted meanwhile."""
        kept = self._storage.results.replay_checkpoint(self._id, self._replay.version, fingerprint(self._config))
        passed = self._by_epoch if self._replay.order == "epoch" else self._by_journal
        chosen: list[Outcome] = []
        kept_s = time.monotonic()
        for each in passed(kept):
            if each.outcome is not None and (within := _within(each.outcome, self._replay)) is not None:
                chosen.append(within)
            is_due = each.position is not None and time.monotonic() - kept_s >= _CHECKPOINT_S
            if is_due or len(chosen) >= _OUTCOMES_AT_ONCE:
                self._save(chosen, each.position if is_due else None)
                chosen = []
                kept_s = time.monotonic() if is_due else kept_s
                report(each.progress)
        self._save(chosen, None)

    def _save(self, outcomes: list[Outcome], position: tuple[int, int] | None) -> None:
        checkpoint = None if position is None else checkpoint_of(self._chain, self._config, *position)
        self._storage.results.save_outcomes(self._id, self._replay.version, outcomes, 0, None, checkpoint)

    def _by_journal(self, own: Checkpoint | None) -> Iterator[_Passed]:
        """Pass the entries in the order of the journal, as far as they can give a row of the span."""
        archive, newest_number = self._storage.archive, min(self._newest_number, self._last_number())
        first = self._storage.results.alignment_number(self._id, self._alignment.id)
        kept = self._restored(own) or self._restored_live(first, newest_number)
        if kept is None:
            update_before(self._chain, archive, self._id, first, self._alignment.epoch_us)
        position = first - 1 if kept is None else kept.number
        newest_us = self._alignment.epoch_us if kept is None else kept.epoch_us
        trips = trips_after(archive, self._id, first)
        while position < newest_number:
            entries = archive.journal(self._id, position, _ENTRIES_AT_ONCE)
            if not entries:
                return
            for entry in entries:
                if not self._heeds(entry) or entry.number > newest_number:
                    continue
                progress = (entry.number - first) / max(1, newest_number - first)
                for outcome in consume(self._chain, entry, archive, self._id):
                    yield _Passed(progress, without_torque_after(trips, outcome), None)
                if isinstance(entry.content, Measurement):
                    newest_us = max(newest_us, entry.content.epoch_us)
                yield _Passed(progress, None, (entry.number, newest_us))
            position = entries[-1].number

    def _by_epoch(self, own: Checkpoint | None) -> Iterator[_Passed]:
        """Pass the rows in order of epoch; what is known now holds from the alignment on."""
        archive, start_us, stop_us = self._storage.archive, self._alignment.epoch_us, self._replay.stop_us
        update_before(self._chain, archive, self._id, self._newest_number + 1, start_us)
        state = self._state_of(own)
        if own is None or state is None:
            self._chain.update(AlignmentSet(self._alignment.id))
            after = (start_us, self._newest_number)
        else:
            self._chain.restore(state)
            after = (own.epoch_us, own.number)
        newest_us = archive.head(self._id).newest_epoch_us
        span_us = max(1, min(stop_us, newest_us or stop_us) - start_us)
        rows = archive.measurements_after(self._id, after[0] - 1, self._newest_number + 1)
        for row in takewhile(lambda row: row.epoch_us < stop_us, rows):
            if (row.epoch_us, row.number) <= after:
                continue
            progress = min(1.0, (row.epoch_us - start_us) / span_us)
            for outcome in consume(
                self._chain, JournalEntry(row.number, replace(row, is_late=False)), archive, self._id
            ):
                yield _Passed(progress, outcome, None)
            yield _Passed(progress, None, (row.number, row.epoch_us))

    def _state_of(self, own: Checkpoint | None) -> ChainState | None:
        return None if own is None else state_of(self._id, own)

    def _restored(self, own: Checkpoint | None) -> Checkpoint | None:
        """Restore the chain from the replay's own checkpoint, and return it."""
        state = self._state_of(own)
        if own is None or state is None:
            return None
        update_before(self._chain, self._storage.archive, self._id, own.number + 1, own.epoch_us - KNOWN_US)
        self._chain.restore(state)
        return own

    def _restored_live(self, first: int, newest_number: int) -> Checkpoint | None:
        """Restore the chain from the newest checkpoint of the live run before the span, and return the checkpoint.

        None where the replay has another calibration or alignment than the live run: no checkpoint holds for it.
        """
        if self._replay.calibration_id is not None or self._replay.is_fixed_alignment:
            return None
        start_us = self._replay.start_us
        return restored_checkpoint(self._storage, self._id, self._chain, self._config, first, newest_number, start_us)

    def _last_number(self) -> int:
        """Return the journal number of the last entry that can give a row of the span: a row or an alignment."""
        results, window = self._storage.results, Window(self._replay.start_us, self._replay.stop_us)
        aligned = [each.id for each in results.alignments(self._id) if each.epoch_us < window.stop_us]
        numbers = [results.alignment_number(self._id, alignment_id) for alignment_id in aligned]
        return max(self._storage.archive.last_number(self._id, window), *numbers, 0)

    def _heeds(self, entry: JournalEntry) -> bool:
        """Return whether an entry of the journal counts in this replay."""
        content = entry.content
        is_other = isinstance(content, AlignmentSet) and content.alignment_id != self._alignment.id
        return not (self._replay.is_fixed_alignment and is_other)


def replay_in_process(
    open_storage: Callable[[], Storage], config: ChainConfig, spacecraft_id: str, version: str
) -> None:
    """Run a replay from where it is to its end in a process that has no storage yet; its job shows how far it is."""
    storage = open_storage()
    try:
        job_id = storage.results.replay(spacecraft_id, version).replay.job_id
        report = partial(storage.results.update_job, job_id, JobState.RUNNING)
        ReplayRun(storage, config, spacecraft_id, version).run(report)
    finally:
        storage.close()


def _within(outcome: Outcome, replay: Replay) -> Outcome | None:
    """Return the part of an outcome that a replay keeps."""
    kept = [
        k
        for k, row in enumerate(outcome.rows)
        if replay.start_us <= row.epoch_us < replay.stop_us and replay.method in (None, row.method)
    ]
    if not kept:
        return None
    carriers = tuple(outcome.carriers[k] for k in kept) if outcome.carriers else ()
    return Outcome(tuple(outcome.rows[k] for k in kept), outcome.command, carriers=carriers)
