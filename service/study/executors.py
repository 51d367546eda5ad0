"""Where the pieces of a study or of a replay are computed: here, in processes of this machine, or on a Dask cluster.

Each is a ``concurrent.futures.Executor``, and all give the same results to the bit: a piece is computed from its
arguments alone, with one thread a matrix product. A worker of a cluster whose programs differ from those of the caller
is refused, because its last digits could differ. A piece whose worker is lost is computed again by another.
"""

import multiprocessing
import os
import platform
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib import import_module
from importlib.metadata import version
from types import FrameType
from typing import Any, NamedTuple, NoReturn, TypeVar

_Asked = TypeVar("_Asked")
_Result = TypeVar("_Result")

_THREADS = "OPENBLAS_NUM_THREADS"
_PROGRAMS = ("soo", "numpy", "scipy", "numba")
#: for the answer of a scheduler, s
_CONNECT_TIMEOUT_S = 10.0


class ClusterError(Exception):
    """The cluster cannot compute the work; the text gives the reason and the remedy."""


class WorkerChoice(NamedTuple):
    """Processes of this machine, or the cluster of a scheduler."""

    processes: int = 2
    #: address, as tcp://host:8786; None = processes of this machine
    scheduler: str | None = None


def executor_of(workers: WorkerChoice) -> AbstractContextManager[Executor]:
    """Give the executor of some workers; work that was submitted ends with it.

    Raises
    ------
    ClusterError
        The scheduler does not answer, or has no worker.
    ModuleNotFoundError
        A scheduler is named and the extra ``soo[cluster]`` is not installed.
    """
    return _process_pool(workers.processes) if workers.scheduler is None else _cluster(workers.scheduler)


def do_work(run: Callable[[_Asked], _Result], asked: _Asked) -> _Result:
    """Do one piece of work in a process of the pool, which would take its end for a result and go on."""
    try:
        return run(asked)
    except SystemExit:
        os._exit(1)


@contextmanager
def _process_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Give processes, one thread a matrix product; end them with what they have started when the work ends early."""
    former = os.environ.get(_THREADS)
    os.environ[_THREADS] = "1"
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(max_workers=workers, mp_context=context, initializer=_prepare_worker)
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        # waits for the pool's own thread, which the interpreter would otherwise meet half gone at its end
        pool.shutdown(wait=True, cancel_futures=True)
        if former is None:
            del os.environ[_THREADS]
        else:
            os.environ[_THREADS] = former


def _prepare_worker() -> None:
    """Leave Ctrl-C to the parent; asked to end, unwind, so that a simulator that runs is ended too."""

    def end(_number: int, _frame: FrameType | None) -> NoReturn:
        sys.exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, end)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Wait for the end of a parent that was killed, which could ask nobody to end, and end."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _cluster(scheduler: str) -> Iterator[Executor]:
    """Give the workers of a Dask cluster; what they have not begun is cancelled when the work ends early."""
    # an extra, and half a second
    distributed: Any = import_module("distributed")
    try:
        client = distributed.Client(scheduler, timeout=_CONNECT_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError, TimeoutError) as error:
        message = f"no scheduler answers at {scheduler}: start `dask scheduler`, or correct the address ({error})"
        raise ClusterError(message) from error
    try:
        if not client.ncores():
            message = f"the scheduler at {scheduler} has no worker: start `dask worker {scheduler} --nthreads 1`"
            raise ClusterError(message)
        lost = distributed.KilledWorker, import_module("distributed.scheduler").NoWorkerError
        yield _ClusterExecutor(client.get_executor(pure=False), lost)
    finally:
        # what no worker has begun is cancelled with the client
        client.close()


class _ClusterExecutor(Executor):
    """Executor whose workers compute only with the programs of this process, and whose failures are told in words."""

    def __init__(self, executor: Executor, lost: tuple[type[Exception], type[Exception]]) -> None:
        self._executor = executor
        self._killed, self._unserved = lost
        self._programs = _programs()

    def submit(self, run: Callable[..., _Result], /, *args: Any, **kwargs: Any) -> Future[_Result]:
        """Submit a piece of work; its future raises ClusterError where the cluster, not the work, fails."""
        reported: Future[_Result] = Future()

        def report(done: Future[_Result]) -> None:
            try:
                reported.set_result(done.result())
            except self._unserved as error:
                message = f"no worker is left, for {error.args[1]:g} s: see the log of `dask worker` and start it again"
                reported.set_exception(ClusterError(message))
            except (CancelledError, ModuleNotFoundError, self._killed) as error:
                reported.set_exception(ClusterError(_reason(error)))
            except BaseException as error:  # noqa: BLE001 - whatever the work raises is the caller's
                reported.set_exception(error)

        self._executor.submit(_run_checked, self._programs, partial(run, *args, **kwargs)).add_done_callback(report)
        return reported


def _reason(error: BaseException) -> str:
    """Return why a cluster failed, and what to do."""
    if isinstance(error, CancelledError):
        return "the scheduler is gone, and the work with it: start it and its workers, then run this again"
    if isinstance(error, ModuleNotFoundError):
        return f"scheduler and workers need soo as it is installed here; one misses {error.name}"
    return f"worker after worker ended over the same piece, for lack of memory or by a fault: see their logs ({error})"


def _run_checked(expected: dict[str, str], run: Callable[[], _Result]) -> _Result:
    """Do a piece of work on a worker; ClusterError where its last digits could differ from those of the caller."""
    found = _programs()
    differing = [f"{name} {found[name]} in place of {own}" for name, own in expected.items() if found[name] != own]
    if os.environ.get(_THREADS) != "1":
        differing.append(f"{_THREADS} not set to 1")
    if differing:
        message = f"the worker on {platform.node()} has {', '.join(differing)}: bring it to the state of this machine"
        raise ClusterError(message)
    return run()


def _programs() -> dict[str, str]:
    """Return the versions on which the digits of a result depend."""
    machine = {"python": platform.python_version(), "processor": platform.machine()}
    return machine | {name: version(name) for name in _PROGRAMS}
