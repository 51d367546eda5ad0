"""Jobs: long work of one spacecraft, done piece by piece in one worker process, the most urgent first.

A job is a row of the archive. One thread takes the open ones of the spacecraft that this process leads, lets the worker
do a piece of the first, stores how far it is, and looks again: so a calibration waits for a piece of a replay, not for
the replay. What a piece has done is stored by its end, so a job goes on from there after whatever ended a process.
"""

import gc
import logging
import os
import signal
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import CancelledError, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context, parent_process
from typing import Any

from service.errors import InvalidInputError, SooError, UnavailableError
from service.pipeline.calibration.geometry_rows import CalibrationError
from service.ports.storage import Clock, LeaseLoan, Storage, Term
from service.records.operations.work import Job, JobKind, JobState
from service.records.setting import CHOSEN, setting
from service.runtime.live.leadership import always, is_moving

_LOG = logging.getLogger("soo.jobs")
#: between two looks for jobs that nobody has announced, and for work that has come due, s
POLL_S = 1.0
#: a job yields to others after this, s
PIECE_S = 0.5
#: a piece of any other job than a calibration is ended after this, s; the longest take three minutes
_PIECE_TIMEOUT_S = 3600.0
#: processes that may die over one job
_ATTEMPTS = 4
#: a process that has not begun by then never will, s
_START_TIMEOUT_S = 300.0
#: by so much the system's scheduler prefers the service
_NICENESS = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerConfig:
    """Bounds of jobs."""

    max_calibrations: int = setting(8, "calibrations that wait or run; one more is 429", CHOSEN)
    max_replays: int = setting(8, "replays that wait or run; one more is 429", CHOSEN)
    job_timeout_s: float = setting(600.0, "a calibration is ended after this, s", CHOSEN)

    def __post_init__(self) -> None:
        """Refuse bounds under which nothing is computed."""
        if min(self.max_calibrations, self.max_replays) < 1 or self.job_timeout_s <= 0:
            raise ValueError("at least one calibration, one replay and more than 0 s are needed")


#: does a job, and yields how far it is, 0..1, wherever it can rest; what it has not stored it does again after a kill
Work = Callable[[Job], Iterator[float]]


class JobPieces:
    """Jobs that have begun, each ready for its next piece; used by one thread.

    Parameters
    ----------
    works : mapping
        What does a job, by kind.
    """

    def __init__(self, works: Mapping[str, Work]) -> None:
        self._works = works
        self._begun: dict[str, Iterator[float]] = {}

    def advance(self, job: Job, open_ids: frozenset[str]) -> float | None:
        """Do the next piece of a job and return how far it is; None: it is done.

        Jobs that are not among the open ones are forgotten.
        """
        self._begun = {name: begun for name, begun in self._begun.items() if name in open_ids}
        pieces = self._begun.pop(job.id, None) or self._works[job.kind](job)
        until_s = time.monotonic() + PIECE_S
        for progress in pieces:
            if time.monotonic() >= until_s:
                self._begun[job.id] = pieces
                return progress
        return None


#: does the next piece of a job, as `JobPieces.advance`
Advance = Callable[[Job, frozenset[str]], float | None]


@dataclass(frozen=True, slots=True)
class Standing:
    """Work that comes again and again."""

    kind: JobKind
    #: names the spacecraft of which some is due
    due: Callable[[], Iterable[str]]
    #: is told of one whose work has failed
    failed: Callable[[str], None] = field(default=lambda _: None)


def new_job(kind: JobKind, spacecraft_id: str, clock: Clock) -> Job:
    """Return a job that nobody has begun."""
    name = f"{kind.value}-{uuid.uuid4().hex[:12]}"
    return Job(name, kind.value, JobState.QUEUED, 0.0, clock.system_us(), spacecraft_id=spacecraft_id)


class JobRunner:
    """Runs the jobs of the spacecraft that this process leads, one at a time.

    Parameters
    ----------
    storage : Storage
        Where jobs are kept.
    clock : Clock
        For times of creation.
    advance : callable
        Does a piece of a job.
    turn : Term, optional
        Tells which spacecraft this process leads.
    standing : iterable, optional
        Work that comes again and again.
    prepare : callable, optional
        Called once, when there is nothing else to do some seconds after the start.
    """

    #: from the start of the thread to the preparation, so that it delays no start, s
    prepared_after_s = 10.0

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        advance: Advance,
        turn: Term = always,
        standing: Iterable[Standing] = (),
        prepare: Callable[[], None] | None = None,
    ) -> None:
        self._results, self._clock, self._advance, self._turn = storage.results, clock, advance, turn
        self._standing = {each.kind.value: each for each in standing}
        self._prepare = prepare
        #: this runner's name in the rows of its jobs
        self.holder = uuid.uuid4().hex
        #: jobs in the hands of this runner
        self._held: set[str] = set()
        #: pieces done, and with how many of them each kind had its newest turn
        self._pieces, self._turns = 0, dict[str, int]()
        #: processes that have died over a job
        self._deaths: dict[str, int] = {}
        #: whether the process of the newest piece ended: what ended it may end the next one too
        self._has_process_ended = False
        self._polled_s = self._began_s = time.monotonic()
        self._wake = threading.Event()
        self._is_stopping = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start the thread, which runs until stopped."""
        self._thread = threading.Thread(target=self._run, name="soo-jobs", daemon=True)
        self._thread.start()

    def stop(self, end_piece: Callable[[], None] = lambda: None) -> None:
        """End the piece in hand and then the thread; jobs stay open."""
        self._is_stopping = True
        self._wake.set()
        end_piece()
        if self._thread is not None:
            self._thread.join()

    def notify(self) -> None:
        """Look for jobs now; safe from any thread."""
        self._wake.set()

    def take_over(self) -> None:
        """Let the jobs of processes that have ended go on; called when this process begins to lead the archive."""
        if count := self._results.free_jobs(self.holder):
            _LOG.info("%d jobs that other processes have left go on", count)
        self.notify()

    def poll_once(self) -> bool:
        """Queue what is due, do a piece of the first job; return whether there was one."""
        self._queue_due()
        jobs = self._results.open_jobs(self.holder)
        job = next((each for each in sorted(jobs, key=self._last_turn) if self._is_ours(each)), None)
        if job is None:
            return False
        self._pieces += 1
        self._turns[job.kind] = self._pieces
        self._do_piece(job, frozenset(each.id for each in jobs))
        return True

    def _last_turn(self, job: Job) -> int:
        """Return when a kind had its turn: calibrations go first, the others do a piece each, however much waits."""
        return -1 if job.kind == JobKind.CALIBRATION else self._turns.get(job.kind, 0)

    def _run(self) -> None:
        """Do pieces until stopped; rest while there are none, and after a process that ended."""
        while not self._is_stopping:
            self._wake.clear()
            try:
                is_busy = self.poll_once()
                is_settled = time.monotonic() - self._began_s >= self.prepared_after_s
                if not is_busy and self._prepare is not None and is_settled and self._turn(""):
                    prepare, self._prepare = self._prepare, None
                    prepare()
            except Exception as error:  # noqa: BLE001 the thread outlives every fault; jobs stay where they are
                is_busy = False
                if not self._is_stopping:
                    _LOG.warning("jobs cannot go on now, they are tried again: %s", error, exc_info=error)
            if (self._has_process_ended or not is_busy) and not self._is_stopping:
                self._wake.wait(POLL_S)

    def _queue_due(self) -> None:
        """Queue standing work that has come due."""
        if time.monotonic() - self._polled_s < POLL_S:
            return
        self._polled_s = time.monotonic()
        for standing in self._standing.values():
            for name in standing.due():
                job = new_job(standing.kind, name, self._clock)
                self._results.queue_job(replace(job, id=f"{standing.kind.value}-{name or 'service'}"))

    def _is_ours(self, job: Job) -> bool:
        """Return whether this process leads the spacecraft of a job, and has the job in its hands now."""
        is_led = bool(self._turn(job.spacecraft_id or ""))
        if is_led and job.id not in self._held and self._results.hold_job(job.id, self.holder):
            self._held.add(job.id)
        elif not is_led and job.id in self._held:
            self._let_go(job)
        return job.id in self._held

    def _let_go(self, job: Job) -> None:
        self._held.discard(job.id)
        self._results.let_go_of_job(job.id, self.holder)

    def _do_piece(self, job: Job, open_ids: frozenset[str]) -> None:
        """Do a piece of a job, and store how far it is or how it ended."""
        self._has_process_ended = False
        try:
            progress = self._advance(job, open_ids)
        except Exception as error:  # noqa: BLE001 a job's fault must reach its operator, whatever it is
            self._on_fault(job, error)
            return
        if progress is None:
            self._end(job, None)
        elif not self._results.report_job(job.id, self.holder, progress):
            # a person has ended it
            self._held.discard(job.id)

    def _on_fault(self, job: Job, error: Exception) -> None:
        """Let a job go on later, or store why it failed."""
        if isinstance(error, UnavailableError):
            self._has_process_ended = True
            self._deaths[job.id] = self._deaths.get(job.id, 0) + 1
            if self._is_stopping or self._deaths[job.id] < _ATTEMPTS:
                _LOG.warning("%s goes on in another process: %s", job.id, error)
                return
        if is_moving(error):
            self._let_go(job)
        elif isinstance(error, CalibrationError | SooError):
            self._fail(job, str(error))
        else:
            _LOG.error("job %s failed by an internal error", job.id, exc_info=error)
            self._fail(job, f"internal error, see the log: {error!r}")

    def _end(self, job: Job, error: str | None) -> None:
        self._deaths.pop(job.id, None)
        self._held.discard(job.id)
        self._results.end_job(job.id, error)

    def _fail(self, job: Job, error: str) -> None:
        self._end(job, error)
        if job.kind in self._standing:
            _LOG.warning("%s failed, it is tried again: %s", job.id, error)
            self._standing[job.kind].failed(job.spacecraft_id or "")


class JobWorker:
    """The process that does pieces of jobs: started with the first one, replaced when it has died.

    Parameters
    ----------
    make : callable
        Makes, in the process, storage and works.
    lend : callable
        Gives the leases under which the process may write.
    job_timeout_s : float
        A calibration is ended after this.
    """

    def __init__(
        self,
        make: Callable[[], tuple[Storage, Mapping[str, Work]]],
        lend: Callable[[], LeaseLoan | None] = lambda: None,
        job_timeout_s: float = WorkerConfig().job_timeout_s,
    ) -> None:
        self._make, self._lend, self._job_timeout_s = make, lend, job_timeout_s
        self._pool: ProcessPoolExecutor | None = None
        self._process_id: int | None = None
        self._is_ended = False

    def advance(self, job: Job, open_ids: frozenset[str]) -> float | None:
        """Do the next piece of a job in the process.

        Raises
        ------
        InvalidInputError
            ``analysis.too_long``: the piece took longer than it may; the process was ended.
        UnavailableError
            ``analysis.ended``: the process died, or was ended with the service.
        """
        timeout_s = self._job_timeout_s if job.kind == JobKind.CALIBRATION else _PIECE_TIMEOUT_S
        result: float | None = self.call(partial(_advance, self._make, job, open_ids, self._lend()), timeout_s)
        return result

    def call(self, work: Callable[[], Any], timeout_s: float = _PIECE_TIMEOUT_S) -> Any:
        """Return what a function gives in the process; called by one thread."""
        try:
            future = self._begun().submit(work)
            if wait([future], timeout_s).done:
                return future.result()
        except (BrokenProcessPool, CancelledError):
            self._kill()
            detail = "the service is stopping" if self._is_ended else "its worker process ended unexpectedly"
            raise UnavailableError("analysis.ended", f"{detail}; start it again") from None
        self._kill()
        raise InvalidInputError("analysis.too_long", f"it was ended after {timeout_s:g} s of computing")

    def stop(self) -> None:
        """End the process; no other one follows."""
        self._is_ended = True
        self._kill()

    def _begun(self) -> ProcessPoolExecutor:
        """Return the process, a new one where there is none."""
        if self._pool is None and not self._is_ended:
            self._pool = pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin)
            # starting a process is no part of the work's time
            self._process_id = pool.submit(os.getpid).result(_START_TIMEOUT_S)
        if self._is_ended or self._pool is None:
            raise BrokenProcessPool
        return self._pool

    def _kill(self) -> None:
        pool, process_id, self._pool, self._process_id = self._pool, self._process_id, None, None
        if process_id is not None:
            with suppress(ProcessLookupError):
                os.kill(process_id, signal.SIGKILL)
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)


#: of the collector: new objects from which the young are looked at, and rounds of that from which older ones are
#: (rows on their way are many objects without a cycle; at the 700, 10, 10 of Python looking took a fifth of ingest,
#: and of a replay)
_COLLECTOR_THRESHOLDS = (10_000, 20, 20)


def calm_collector() -> None:
    """Let the collector leave alone for good what is there now, and look at the rest more rarely; pauses stay short."""
    gc.freeze()
    gc.set_threshold(*_COLLECTOR_THRESHOLDS)


#: of a worker process: its storage, and the jobs that it has begun
_in_process: tuple[Storage, JobPieces] | None = None


def _advance(
    make: Callable[[], tuple[Storage, Mapping[str, Work]]],
    job: Job,
    open_ids: frozenset[str],
    loan: LeaseLoan | None,
) -> float | None:
    """Do the next piece of a job in this process."""
    global _in_process
    if _in_process is None:
        storage, works = make()
        _in_process = storage, JobPieces(works)
        calm_collector()
    storage, pieces = _in_process
    storage.leases.borrow(loan)
    return pieces.advance(job, open_ids)


def _begin() -> None:
    """Begin a worker: it yields to the service, leaves Ctrl-C to it, and ends when it has ended."""
    os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_service, daemon=True).start()


def _end_with_service() -> None:
    service = parent_process()
    if service is not None:
        service.join()
    os._exit(1)
