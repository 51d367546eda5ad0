"""Replays: the same chain over the same journal, written as a new version of the results.

In order of the journal a replay of a live span gives the live rows bit for bit. In order of epoch, or with another
calibration or alignment, it gives what would have been, with late rows in their place.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import takewhile

from service.errors import ConflictError, InvalidInputError
from service.pipeline.chain import METHODS, Chain
from service.pipeline.config import ChainConfig
from service.ports import Clock, Outcome, Storage
from service.records.calibration import Alignment, Calibration, Window
from service.records.inputs import AlignmentSet
from service.records.journal import JournalEntry
from service.records.operations.job import Job, Replay
from service.records.storage.checkpoint import Checkpoint
from service.runtime.jobs.job_runner import JobRunner, Progress
from service.runtime.live.chain_restart import restored_checkpoint
from service.runtime.live.journal_consumer import (
    DocumentCache,
    consume,
    trips_after,
    update_before,
    without_torque_after,
)

_ENTRIES_AT_ONCE = 512
_OUTCOMES_AT_ONCE = 500


class Replayer:
    """Starts replays."""

    def __init__(self, storage: Storage, clock: Clock, jobs: JobRunner, config: ChainConfig) -> None:
        self._storage = storage
        self._clock = clock
        self._jobs = jobs
        self._config = config

    def start(self, spacecraft_id: str, wanted: Replay) -> tuple[Replay, Job]:
        """Store a replay and queue it; id and job of ``wanted`` are ignored, alignment 0 = the one that held.

        Raises
        ------
        InvalidInputError
            ``range.invalid``: nothing between start and stop.
        ConflictError
            ``replay.not_aligned``: no alignment to start from.
        """
        if wanted.start_us >= wanted.stop_us:
            raise InvalidInputError("range.invalid", "start must lie before stop")
        alignment = self._alignment(spacecraft_id, wanted)
        calibration = self._calibration(spacecraft_id, wanted.calibration_id)
        job = self._jobs.add("replay")
        is_other_alignment = wanted.alignment_id != 0
        replay = self._storage.results.add_replay(
            spacecraft_id,
            replace(wanted, alignment_id=alignment.id, job_id=job.id, created_at_us=self._clock.system_us()),
        )
        plan = _Plan(spacecraft_id, replay, alignment, calibration, is_other_alignment)
        self._jobs.run(job, lambda report: self._run(plan, report))
        return replay, job

    def _alignment(self, spacecraft_id: str, wanted: Replay) -> Alignment:
        """Return the alignment to start from: the one asked for, or the newest before the start, or the first."""
        if wanted.alignment_id:
            return self._storage.results.alignment(spacecraft_id, wanted.alignment_id)
        newest_first = self._storage.results.alignments(spacecraft_id)
        if not newest_first:
            detail = f"{spacecraft_id} was never aligned, so there is nothing to replay from; align it first"
            raise ConflictError("replay.not_aligned", detail)
        earlier = [alignment for alignment in newest_first if alignment.epoch_us <= wanted.start_us]
        held = (
            one for one in earlier if wanted.order == "epoch" or not self._came_after_rows(spacecraft_id, one, wanted)
        )
        return next(held, newest_first[-1])

    def _came_after_rows(self, spacecraft_id: str, alignment: Alignment, wanted: Replay) -> bool:
        """Return whether rows of the span were stored, and so consumed under a former alignment, before this one.

        What the live run made of them stands; only a replay that starts with the former alignment makes it again.
        """
        number = self._storage.results.alignment_number(spacecraft_id, alignment.id)
        first = next(self._storage.archive.measurements_after(spacecraft_id, wanted.start_us - 1, number), None)
        return first is not None and first.epoch_us < wanted.stop_us

    def _calibration(self, spacecraft_id: str, calibration_id: int | None) -> Calibration | None:
        """Return the calibration that replaces the journal's, if one was asked for."""
        if calibration_id is None:
            return None
        calibration = self._storage.results.calibration(spacecraft_id, calibration_id)
        if calibration.result is None:
            raise ConflictError("calibration.unfinished", f"calibration {calibration_id} has no result")
        return calibration

    def _run(self, plan: "_Plan", report: Progress) -> None:
        """Run one replay and store what falls into its span."""
        replay, results = plan.replay, self._storage.results
        # deleted while it waited
        results.replay(plan.spacecraft_id, replay.version)
        documents = DocumentCache(self._storage.catalogue, results, plan.spacecraft_id)
        methods = METHODS if replay.method is None else (replay.method,)
        chain = Chain(documents, self._config, plan.calibration, methods, has_commands=replay.commands)
        newest_number = self._storage.archive.head(plan.spacecraft_id).newest_number
        outcomes = self._by_epoch if replay.order == "epoch" else self._by_journal
        chosen: list[Outcome] = []
        for progress, outcome in outcomes(chain, plan, newest_number):
            kept = _within(outcome, replay)
            if kept is not None:
                chosen.append(kept)
            if len(chosen) >= _OUTCOMES_AT_ONCE:
                results.save_outcomes(plan.spacecraft_id, replay.version, chosen, 0, None)
                chosen = []
                report(progress)
        results.save_outcomes(plan.spacecraft_id, replay.version, chosen, 0, None)

    def _by_journal(self, chain: Chain, plan: "_Plan", newest_number: int) -> Iterator[tuple[float, Outcome]]:
        """Yield progress and outcomes in the order of the journal, as far as it can give a row of the span."""
        archive, newest_number = self._storage.archive, min(newest_number, self._last_number(plan))
        first = self._storage.results.alignment_number(plan.spacecraft_id, plan.alignment.id)
        kept = self._restored_checkpoint(chain, plan, first, newest_number)
        if kept is None:
            update_before(chain, archive, plan.spacecraft_id, first, plan.alignment.epoch_us)
        position = first - 1 if kept is None else kept.number
        trips = trips_after(archive, plan.spacecraft_id, first)
        while position < newest_number:
            entries = archive.journal(plan.spacecraft_id, position, _ENTRIES_AT_ONCE)
            if not entries:
                return
            for entry in entries:
                if plan.heeds(entry) and entry.number <= newest_number:
                    progress = (entry.number - first) / max(1, newest_number - first)
                    found = consume(chain, entry, archive, plan.spacecraft_id)
                    yield from ((progress, without_torque_after(trips, outcome)) for outcome in found)
            position = entries[-1].number

    def _last_number(self, plan: "_Plan") -> int:
        """Return the journal number of the last entry that can give a row of the span: a row or an alignment."""
        results, spacecraft_id = self._storage.results, plan.spacecraft_id
        window = Window(plan.replay.start_us, plan.replay.stop_us)
        aligned = [each.id for each in results.alignments(spacecraft_id) if each.epoch_us < window.stop_us]
        numbers = [results.alignment_number(spacecraft_id, alignment_id) for alignment_id in aligned]
        return max(self._storage.archive.last_number(spacecraft_id, window), *numbers, 0)

    def _restored_checkpoint(self, chain: Chain, plan: "_Plan", first: int, newest_number: int) -> Checkpoint | None:
        """Restore the chain from the newest checkpoint before the span, and return the checkpoint.

        None where the replay has another calibration or alignment than the live run: no checkpoint holds for it.
        """
        if plan.calibration is not None or plan.is_fixed_alignment:
            return None
        return restored_checkpoint(
            self._storage, plan.spacecraft_id, chain, self._config, first, newest_number, plan.replay.start_us
        )

    def _by_epoch(self, chain: Chain, plan: "_Plan", newest_number: int) -> Iterator[tuple[float, Outcome]]:
        """Yield progress and outcomes in order of epoch; what is known now holds from the alignment on."""
        archive = self._storage.archive
        update_before(chain, archive, plan.spacecraft_id, newest_number + 1, plan.alignment.epoch_us)
        chain.update(AlignmentSet(plan.alignment.id))
        start_us, stop_us = plan.alignment.epoch_us, plan.replay.stop_us
        newest_us = archive.head(plan.spacecraft_id).newest_epoch_us
        span_us = max(1, min(stop_us, newest_us or stop_us) - start_us)
        rows = archive.measurements_after(plan.spacecraft_id, start_us, newest_number + 1)
        for measurement in takewhile(lambda row: row.epoch_us < stop_us, rows):
            progress = min(1.0, (measurement.epoch_us - start_us) / span_us)
            entry = JournalEntry(measurement.number, replace(measurement, is_late=False))
            yield from ((progress, o) for o in consume(chain, entry, archive, plan.spacecraft_id))


@dataclass(frozen=True)
class _Plan:
    """Inputs of one replay."""

    spacecraft_id: str
    replay: Replay
    alignment: Alignment
    calibration: Calibration | None
    #: whether the alignment was requested, so that later ones of the journal do not replace it
    is_fixed_alignment: bool

    def heeds(self, entry: JournalEntry) -> bool:
        """Return whether an entry of the journal counts in this replay."""
        content = entry.content
        is_other = isinstance(content, AlignmentSet) and content.alignment_id != self.alignment.id
        return not (self.is_fixed_alignment and is_other)


def _within(outcome: Outcome, replay: Replay) -> Outcome | None:
    """Return the part of an outcome that a replay keeps."""
    rows = tuple(
        row
        for row in outcome.rows
        if replay.start_us <= row.epoch_us < replay.stop_us and replay.method in (None, row.method)
    )
    return Outcome(rows, outcome.command) if rows else None
