"""Replays: the same chain over the same journal, written as a new version of the results.

In order of the journal a replay of a live span gives the live rows bit for bit. In order of epoch, or with another
calibration or alignment, it gives what would have been, with late rows in their place. It runs from its start or its
last checkpoint to the end of its span.

What a piece computed and the state after it are stored in one transaction, so that a run that was killed goes on from
there and gives the same rows, bit for bit.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import islice, takewhile, zip_longest
from typing import NamedTuple

from service.errors import ConflictError, InvalidInputError
from service.pipeline.chain import METHODS, Chain
from service.pipeline.checkpoints import ChainState, fingerprint
from service.pipeline.config import ChainConfig
from service.pipeline.estimation.smoothed import SmoothedRows
from service.ports.archive import Outcome
from service.ports.storage import Clock, Storage
from service.records.calibration import Alignment, Window
from service.records.catalogue import Method
from service.records.inputs import AlignmentSet, JournalEntry
from service.records.levels.measurement import Measurement
from service.records.operations.work import Job, JobKind, Replay
from service.records.storage import Checkpoint
from service.runtime.jobs.job_runner import WorkerConfig, calm_collector, new_job
from service.runtime.live.journal_consumer import (
    BLOCK_ROWS,
    KNOWN_US,
    DocumentCache,
    checkpoint_of,
    consume,
    consume_rows,
    numbered_alignments,
    restored_checkpoint,
    state_of,
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
    """Position of a run, and the outcomes of some rows."""

    progress: float
    outcomes: Sequence[Outcome]
    #: journal number and epoch up to which the chain has consumed; None within an entry
    position: tuple[int, int] | None


class ReplaySpan(NamedTuple):
    """Part of a replay: entries of the journal of which it computes the rows."""

    #: journal number behind which it begins; None = where the replay begins
    after: int | None
    #: journal number of the last entry
    until: int


class Replayer:
    """Starts replays.

    Parameters
    ----------
    storage : Storage
        The archive.
    clock : Clock
        For times of creation.
    notify : callable
        Tells that there is a job.
    most : int
        Replays that wait or run at once.
    """

    def __init__(
        self, storage: Storage, clock: Clock, notify: Callable[[], None], most: int = WorkerConfig().max_replays
    ) -> None:
        self._storage, self._clock, self._notify, self._most = storage, clock, notify, most

    def start(self, spacecraft_id: str, wanted: Replay, holder: str | None = None) -> tuple[Replay, Job]:
        """Store a replay and queue it; id and job of ``wanted`` are ignored, alignment 0 = the one that held.

        With a holder the job is in the hands of who runs it beside the service.

        Raises
        ------
        InvalidInputError
            ``range.invalid``: nothing between start and stop.
        ConflictError
            ``replay.not_aligned``: no alignment to start from.
        BusyError
            ``replay.busy``: too many wait or run already.
        """
        if wanted.start_us >= wanted.stop_us:
            raise InvalidInputError("range.invalid", "start must lie before stop")
        alignment = self._alignment(spacecraft_id, wanted)
        self._check_calibration(spacecraft_id, wanted.calibration_id)
        job = new_job(JobKind.REPLAY, spacecraft_id, self._clock)
        stated = replace(
            wanted,
            alignment_id=alignment.id,
            is_fixed_alignment=wanted.alignment_id != 0,
            until_number=self._storage.archive.head(spacecraft_id).newest_number,
            job_id=job.id,
            created_at_us=job.created_at_us,
        )
        replay = self._storage.results.add_replay(spacecraft_id, stated, job, self._most, holder)
        self._notify()
        return replay, job

    def _alignment(self, spacecraft_id: str, wanted: Replay) -> Alignment:
        """Return the alignment to start from: the one asked for, or the newest before the start, or the first."""
        if wanted.alignment_id:
            return self._storage.results.alignment(spacecraft_id, wanted.alignment_id)
        newest_first = self._storage.results.alignments(spacecraft_id)
        if not newest_first:
            detail = f"{spacecraft_id} was never aligned, so there is nothing to replay from"
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

    def _check_calibration(self, spacecraft_id: str, calibration_id: int | None) -> None:
        """Refuse a calibration in place of the journal's that has no result."""
        if (
            calibration_id is not None
            and self._storage.results.calibration(spacecraft_id, calibration_id).result is None
        ):
            raise ConflictError("calibration.unfinished", f"calibration {calibration_id} has no result")


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
        self._smoothed = SmoothedRows() if self._replay.smooth else None
        recorder = None if self._smoothed is None else self._smoothed.recorder
        commands = self._replay.commands
        self._chain = Chain(documents, config, calibration, methods, has_commands=commands, recorder=recorder)
        until = self._replay.until_number
        self._newest_number = storage.archive.head(spacecraft_id).newest_number if until is None else until

    def pieces(self) -> Iterator[float]:
        """Compute and store the rows of the span, and yield how far it is whenever some were stored.

        ConflictError ``replay.deleted`` if it is deleted meanwhile.
        """
        # no state holds the rows that a smoother goes back over: a run that was killed begins again
        is_kept = self._smoothed is None
        found = self._storage.results.replay_checkpoint(self._id, self._replay.version, fingerprint(self._config))
        kept = found if is_kept else None
        chosen: list[Outcome] = []
        kept_s = time.monotonic()
        for each in self._passed(kept, ReplaySpan(None, self._last_number())):
            chosen += self._within(each.outcomes)
            is_due = is_kept and each.position is not None and time.monotonic() - kept_s >= _CHECKPOINT_S
            if is_due or len(chosen) >= _OUTCOMES_AT_ONCE:
                self._save(chosen, each.position if is_due else None)
                chosen = []
                kept_s = time.monotonic() if is_due else kept_s
                yield each.progress
        self._save(chosen, None)

    def spans(self, least_entries: int) -> tuple[ReplaySpan, ...]:
        """Divide the replay where its chain can begin: at alignments, and at checkpoints of the live run that fit.

        One span where it cannot: in order of epoch, with an alignment in place of the journal's, with smoothed rows.

        Parameters
        ----------
        least_entries : int
            Entries of the journal in a span, at least.
        """
        last = self._last_number()
        is_divisible = self._replay.order == "journal" and not (self._replay.is_fixed_alignment or self._replay.smooth)
        begin, *possible = self._beginnings(last) if is_divisible else [0]
        cuts: list[int] = []
        for cut in possible:
            if min(cut - max([begin, *cuts]), last - cut) >= least_entries:
                cuts.append(cut)
        return tuple(ReplaySpan(after, until) for after, until in zip([None, *cuts], [*cuts, last], strict=True))

    def run_span(self, span: ReplaySpan) -> list[Outcome]:
        """Compute and store the rows of a span; return outcomes of rows of former spans, which are stored after those.

        An alignment computes rows that were stored before it. Those that have angles by then keep them, and only who
        has computed the former spans knows which have.
        """
        chosen: list[Outcome] = []
        former: list[Outcome] = []
        for each in self._passed(None, span):
            for outcome in self._within(each.outcomes):
                (former if outcome.rows[0].number <= (span.after or 0) else chosen).append(outcome)
            if len(chosen) >= _OUTCOMES_AT_ONCE:
                self._save(chosen, None)
                chosen = []
        self._save(chosen, None)
        return former

    def _passed(self, own: Checkpoint | None, span: ReplaySpan) -> Iterator[_Passed]:
        """Pass the rows of a span, and behind each the rows that could be smoothed by then."""
        for each in self._by_epoch(own) if self._replay.order == "epoch" else self._by_journal(own, span):
            yield each
            if self._smoothed is not None:
                made = [self._smoothed.push(outcome.rows) for outcome in each.outcomes]
                yield _Passed(each.progress, [Outcome(tuple(rows), None) for rows in made if rows], None)
        if self._smoothed is not None:
            yield from (_Passed(1.0, [Outcome((row,), None)], None) for row in self._smoothed.rest())

    def _within(self, outcomes: Sequence[Outcome]) -> Iterator[Outcome]:
        """Yield the parts of outcomes that a replay keeps: rows of its span and method, and smoothed ones."""
        replay = self._replay
        for outcome in outcomes:
            kept = [
                (row, carriers)
                for row, carriers in zip_longest(outcome.rows, outcome.carriers)
                if replay.start_us <= row.epoch_us < replay.stop_us
                and (replay.method in (None, row.method) or row.method is Method.ROBUST_SMOOTHED)
            ]
            if kept:
                rows, carriers = zip(*kept, strict=True)
                yield Outcome(rows, outcome.command, carriers=carriers)

    def _save(self, outcomes: list[Outcome], position: tuple[int, int] | None) -> None:
        checkpoint = None if position is None else checkpoint_of(self._chain, self._config, *position)
        self._storage.results.save_outcomes(self._id, self._replay.version, outcomes, 0, None, checkpoint)

    def _by_journal(self, own: Checkpoint | None, span: ReplaySpan) -> Iterator[_Passed]:
        """Pass the entries of a span in the order of the journal; the chain goes on from the newest state before it."""
        number, epoch_us = self._first_number(), self._alignment.epoch_us
        if span.after is None:
            begun = self._restored(own) or self._restored_live(number, span.until, self._replay.start_us)
        else:
            number, epoch_us = max(each for each in self._alignments() if each[0] <= span.after + 1)
            begun = self._restored_live(number, span.after, None)
        if begun is None:
            update_before(self._chain, self._storage.archive, self._id, number, epoch_us)
            begun = number - 1, epoch_us
        return self._consumed(begun, span)

    def _consumed(self, begun: tuple[int, int], span: ReplaySpan) -> Iterator[_Passed]:
        """Pass what the chain makes of the entries of a span, from the number and epoch where its state is on."""
        archive, first, after, until = self._storage.archive, self._first_number(), span.after or 0, span.until
        position, newest_us = begun
        trips = trips_after(archive, self._id, first)
        while position < until:
            entries = archive.journal(self._id, position, _ENTRIES_AT_ONCE)
            if not entries:
                return
            position = entries[-1].number
            heard = [entry for entry in entries if self._heeds(entry) and entry.number <= until]
            for rows, entry in _blocks(heard):
                last = rows[-1].number if entry is None else entry.number
                progress = (last - first) / max(1, until - first)
                made = self._outcomes(rows, entry)
                while block := list(islice(made, BLOCK_ROWS)):
                    later = [without_torque_after(trips, outcome) for number, outcome in block if number > after]
                    yield _Passed(progress, later, None)
                newest_us = max([newest_us, *(row.epoch_us for row in rows)])
                yield _Passed(progress, (), (last, newest_us))

    def _outcomes(self, rows: list[Measurement], entry: JournalEntry | None) -> Iterator[tuple[int, Outcome]]:
        """Yield what comes of rows, or of an entry that is none, with the journal number of what it came of."""
        if entry is None:
            return ((row.number, outcome) for row, outcome in consume_rows(self._chain, rows))
        found = consume(self._chain, entry, self._storage.archive, self._id)
        return ((entry.number, outcome) for outcome in found)

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
        within = takewhile(lambda row: row.epoch_us < stop_us, rows)
        ahead = (replace(row, is_late=False) for row in within if (row.epoch_us, row.number) > after)
        while block := list(islice(ahead, BLOCK_ROWS)):
            last = block[-1]
            progress = min(1.0, (last.epoch_us - start_us) / span_us)
            outcomes = [outcome for _, outcome in consume_rows(self._chain, block)]
            yield _Passed(progress, outcomes, (last.number, last.epoch_us))

    def _state_of(self, own: Checkpoint | None) -> ChainState | None:
        return None if own is None else state_of(self._id, own)

    def _restored(self, own: Checkpoint | None) -> tuple[int, int] | None:
        """Restore the chain from the replay's own checkpoint, and return its number and epoch."""
        state = self._state_of(own)
        if own is None or state is None:
            return None
        update_before(self._chain, self._storage.archive, self._id, own.number + 1, own.epoch_us - KNOWN_US)
        self._chain.restore(state)
        return own.number, own.epoch_us

    def _restored_live(self, first: int, newest_number: int, before_us: int | None) -> tuple[int, int] | None:
        """Restore the chain from the newest checkpoint of the live run before an epoch; return its number and epoch.

        None where the replay has another calibration or alignment than the live run: no checkpoint holds for it.
        """
        if not self._is_live():
            return None
        place = self._storage, self._id, self._chain, self._config
        kept = restored_checkpoint(*place, first, newest_number, before_us)
        return None if kept is None else (kept.number, kept.epoch_us)

    def _is_live(self) -> bool:
        """Return whether the chain of this replay has the states of the live one."""
        return self._replay.calibration_id is None and not self._replay.is_fixed_alignment

    def _first_number(self) -> int:
        """Return the journal number of the alignment that the replay starts from."""
        return self._storage.results.alignment_number(self._id, self._alignment.id)

    def _last_number(self) -> int:
        """Return the journal number of the last entry that can give a row of the span: a row or an alignment."""
        window = Window(self._replay.start_us, self._replay.stop_us)
        numbers = [number for number, epoch_us in self._alignments() if epoch_us < window.stop_us]
        last = max(self._storage.archive.last_number(self._id, window), *numbers, 0)
        return min(self._newest_number, last)

    def _alignments(self) -> list[tuple[int, int]]:
        return numbered_alignments(self._storage.results, self._id)

    def _beginnings(self, last: int) -> list[int]:
        """Return the journal numbers up to the last one behind which the chain can begin, in order.

        The first is where the replay begins.
        """
        begin, found = self._first_number() - 1, []
        if self._is_live():
            for state in self._storage.results.checkpoints(self._id, fingerprint(self._config), last):
                if state.number <= begin:
                    break
                if state.epoch_us < self._replay.start_us:
                    begin = state.number
                    break
                found.append(state.number)
        found += [number - 1 for number, _ in self._alignments() if begin < number - 1 < last]
        return [begin, *sorted(set(found))]

    def _heeds(self, entry: JournalEntry) -> bool:
        """Return whether an entry of the journal counts in this replay."""
        content = entry.content
        is_other = isinstance(content, AlignmentSet) and content.alignment_id != self._alignment.id
        return not (self._replay.is_fixed_alignment and is_other)


def _blocks(entries: Sequence[JournalEntry]) -> Iterator[tuple[list[Measurement], JournalEntry | None]]:
    """Yield entries as rows that follow one another, `BLOCK_ROWS` at the most, or as one that is no row."""
    rows: list[Measurement] = []
    for entry in entries:
        is_row = isinstance(entry.content, Measurement)
        if rows and (not is_row or len(rows) >= BLOCK_ROWS):
            yield rows, None
            rows = []
        if isinstance(entry.content, Measurement):
            rows.append(entry.content)
        else:
            yield [], entry
    if rows:
        yield rows, None


def replay_work(storage: Storage, config: ChainConfig, job: Job) -> Iterator[float]:
    """Run the replay of a job from where it is."""
    return ReplayRun(storage, config, job.spacecraft_id or "", job.subject or "").pieces()


def run_span_in_process(
    open_storage: Callable[[], Storage], config: ChainConfig, spacecraft_id: str, version: str, span: ReplaySpan
) -> list[Outcome]:
    """Run a span of a replay, as `ReplayRun.run_span` does, in a process that has no storage yet."""
    storage = open_storage()
    calm_collector()
    try:
        return ReplayRun(storage, config, spacecraft_id, version).run_span(span)
    finally:
        storage.close()
