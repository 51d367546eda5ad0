"""Worker processes: fits, replays and smoothing beside the serving process, bounded in number and in time.

Each worker is a pool of one process, so that ending one that takes too long harms no other. A process is started when
the first work needs it, and replaced when it has died or was ended. Workers yield the processor to the service.
"""

import logging
import os
import signal
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from queue import LifoQueue
from threading import TIMEOUT_MAX, Lock, Thread, Timer
from typing import ParamSpec, TypeVar

from service.errors import InvalidInputError, UnavailableError
from service.records.setting import CHOSEN, setting
from service.runtime.jobs.job_runner import JobInterruptedError

_LOG = logging.getLogger("soo.workers")

P = ParamSpec("P")
Found = TypeVar("Found")

#: a process that has not begun by then never will, s
_START_TIMEOUT_S = 300.0
#: processes that may die over work that goes on where it was
_ATTEMPTS = 4
#: by so much the system's scheduler prefers the service
_NICENESS = 10
_STOPPING = "the service is stopping; start it again"
_DIED = "its worker process ended unexpectedly; start it again"


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerConfig:
    """Bounds of the computations in worker processes."""

    processes: int = setting(2, "worker processes that compute calibrations", CHOSEN)
    max_calibrations: int = setting(8, "calibrations that wait or run; one more is 429", CHOSEN)
    max_replays: int = setting(8, "replays that wait or run; one more is 429", CHOSEN)
    job_timeout_s: float = setting(600.0, "a calibration is ended after this, s", CHOSEN)

    def __post_init__(self) -> None:
        """Refuse bounds under which nothing is computed."""
        least = min(self.processes, self.max_calibrations, self.max_replays)
        if least < 1 or self.job_timeout_s <= 0:
            raise ValueError("at least one process, one calibration, one replay and more than 0 s are needed")


class Workers:
    """The worker processes of one service.

    Parameters
    ----------
    config : WorkerConfig
        Bounds.
    """

    def __init__(self, config: WorkerConfig) -> None:
        self._config = config
        #: one thread a worker waits for it, so that a queue of threads is the queue of the workers
        self._threads = ThreadPoolExecutor(config.processes, thread_name_prefix="soo-worker")
        self._idle: LifoQueue[_Worker] = LifoQueue()
        self._all = [_Worker() for _ in range(config.processes)]
        for worker in self._all:
            self._idle.put(worker)
        self._lock = Lock()
        self._preparing: Timer | None = None
        self._is_stopping = False

    def run(self, work: Callable[P, Found], *args: P.args, **kwargs: P.kwargs) -> Found:
        """Return the result of a job's work, or raise its error.

        Raises
        ------
        InvalidInputError
            ``analysis.too_long``: the work took longer than it may; its process was ended.
        UnavailableError
            ``analysis.ended``: the process died, or was ended with the service.
        """
        try:
            return self._submit(self._config.job_timeout_s, work, *args, **kwargs).result()
        except CancelledError:
            raise UnavailableError("analysis.ended", _STOPPING) from None

    def complete(self, work: Callable[P, None], *args: P.args, **kwargs: P.kwargs) -> None:
        """Run work that goes on where it was, without a limit of time; a process that dies is replaced a few times.

        Raises
        ------
        JobInterruptedError
            The service stops.
        UnavailableError
            ``analysis.ended``: the process died again and again.
        """
        for attempt in range(1, _ATTEMPTS + 1):
            try:
                return self._submit(TIMEOUT_MAX, work, *args, **kwargs).result()
            except (CancelledError, UnavailableError):
                if self._is_stopping:
                    raise JobInterruptedError from None
                if attempt == _ATTEMPTS:
                    raise
                _LOG.warning("a worker process ended unexpectedly; its work goes on in another one", exc_info=True)
        return None

    def prepare(self, delay_s: float, work: Callable[[], None]) -> None:
        """Start a process after some time and do some work in it, so that the next work finds imports and code loaded.

        A later call changes nothing.
        """

        def begin() -> None:
            # the service may have begun to stop
            with suppress(UnavailableError):
                self._submit(TIMEOUT_MAX, work)

        with self._lock:
            if self._preparing is None and not self._is_stopping:
                self._preparing = Timer(delay_s, begin)
                self._preparing.daemon = True
                self._preparing.start()

    def stop(self) -> None:
        """End what is computed and what waits; futures of both tell it."""
        with self._lock:
            self._is_stopping = True
            if self._preparing is not None:
                self._preparing.cancel()
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._all:
            worker.end()
        self._threads.shutdown(wait=True)

    def _submit(self, timeout_s: float, work: Callable[P, Found], *args: P.args, **kwargs: P.kwargs) -> Future[Found]:
        def computed() -> Found:
            worker = self._idle.get()
            try:
                return worker.result(timeout_s, lambda pool: pool.submit(work, *args, **kwargs))
            finally:
                self._idle.put(worker)

        try:
            return self._threads.submit(computed)
        except RuntimeError:
            raise UnavailableError("analysis.ended", _STOPPING) from None


class _Worker:
    """One process, or none yet; used by one thread at a time, ended by any."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._process_id: int | None = None
        self._is_ended = False

    def result(self, timeout_s: float, start: "_Start[Found]") -> Found:
        """Return the result of one computation."""
        try:
            future = self._begun(start)
            if wait([future], timeout_s).done:
                return future.result()
        except (BrokenProcessPool, CancelledError):
            self._kill()
            raise UnavailableError("analysis.ended", _STOPPING if self._is_ended else _DIED) from None
        self._kill()
        detail = f"it was ended after {timeout_s:g} s of computing"
        raise InvalidInputError("analysis.too_long", detail)

    def end(self) -> None:
        """End the process; no other one follows."""
        self._is_ended = True
        self._kill()

    def _begun(self, start: "_Start[Found]") -> Future[Found]:
        """Return a piece of work that has begun, in a new process where there is none, or none that lives."""
        if self._pool is not None:
            with suppress(BrokenProcessPool):
                return start(self._pool)
            self._kill()
        self._pool = pool = ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_begin)
        # starting a process is no part of the work's time
        self._process_id = pool.submit(os.getpid).result(_START_TIMEOUT_S)
        if self._is_ended:
            raise BrokenProcessPool
        return start(pool)

    def _kill(self) -> None:
        pool, process_id, self._pool, self._process_id = self._pool, self._process_id, None, None
        if process_id is not None:
            with suppress(ProcessLookupError):
                os.kill(process_id, signal.SIGKILL)
        if pool is not None:
            pool.shutdown(wait=False, cancel_futures=True)


_Start = Callable[[ProcessPoolExecutor], Future[Found]]


def _begin() -> None:
    """Begin a worker: it yields to the service, leaves Ctrl-C to it, and ends when it has ended."""
    os.nice(_NICENESS)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    Thread(target=_end_with_service, daemon=True).start()


def _end_with_service() -> None:
    service = parent_process()
    if service is not None:
        service.join()
    os._exit(1)
