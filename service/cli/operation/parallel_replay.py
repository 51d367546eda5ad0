"""Replay beside the service, on the archive itself: its spans spread over processes or a cluster.

The version is one of the archive's, and its job is stored with it: nobody reads its rows before every span is stored.
Whatever ends the command leaves a failed version, or, when it is killed, an unfinished one that the next service which
leads computes to its end.
"""

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, as_completed
from functools import partial
from typing import TYPE_CHECKING

from service.cli.command_group import end
from service.cli.studies.screen import ended_by_signals
from service.composition.bootstrap import build_clock, open_storage, storage_opener
from service.composition.settings import Settings
from service.errors import SooError
from service.records.operations.work import JobState, Replay
from service.runtime.jobs.job_runner import JobAbortedError, JobRunner
from service.runtime.jobs.replay_job import Replayer
from service.runtime.jobs.replay_run import ReplayRun, ReplaySpan, run_span_in_process
from service.study.executors import ClusterError, SerialExecutor, WorkerChoice, do_work, executor_of

if TYPE_CHECKING:
    from service.ports.archive import Outcome
    from service.ports.storage import Storage
    from service.runtime.jobs.job_runner import Progress

#: entries of the journal in a span: ten seconds of computing, beside which the start of a piece of work is little
LEAST_ENTRIES = 10_000


def replay_in_parts(
    settings: Settings, spacecraft_id: str, wanted: Replay, workers: WorkerChoice, show: Callable[[float], None]
) -> Replay:
    """Compute a replay and return it as it is stored; end the command where it cannot be computed."""
    try:
        with ended_by_signals(), executor_of(workers) as pool:
            return _replayed(settings, spacecraft_id, wanted, pool, show)
    except KeyboardInterrupt:
        end("stopped")
    except (ClusterError, SooError, OSError, ValueError) as error:
        end(str(error), 1, error)


def _replayed(
    settings: Settings, spacecraft_id: str, wanted: Replay, pool: Executor, show: Callable[[float], None]
) -> Replay:
    """Store a replay, compute it and return it; JobAbortedError where it failed."""
    storage = open_storage(settings)
    try:
        clock = build_clock(settings, storage)
        run = partial(_run, settings, storage, pool, show)
        replayer = Replayer(storage, clock, JobRunner(storage.results, clock, SerialExecutor()), run)
        storage.catalogue.spacecraft(spacecraft_id)
        replay, job = replayer.start(spacecraft_id, wanted)
        ended = storage.results.job(job.id)
        if ended.state is not JobState.DONE:
            end(f"{replay.version} failed: {ended.error}", 1)
        return replay
    finally:
        storage.close()


def _run(
    settings: Settings,
    storage: "Storage",
    pool: Executor,
    show: Callable[[float], None],
    spacecraft_id: str,
    version: str,
    report: "Progress",
) -> None:
    """Compute the spans of a replay in any order, and store what belongs after former spans in theirs."""
    config = settings.chain_config()
    spans = ReplayRun(storage, config, spacecraft_id, version).spans(LEAST_ENTRIES)
    work = partial(run_span_in_process, storage_opener(settings), config, spacecraft_id, version)
    former: dict[ReplaySpan, list[Outcome]] = {}
    try:
        running = {pool.submit(do_work, work, span): span for span in spans}
        for done in as_completed(running):
            former[running[done]] = done.result()
            report(len(former) / len(spans))
            show(len(former) / len(spans))
    except (BrokenExecutor, ClusterError, OSError, ValueError) as error:
        raise JobAbortedError(str(error)) from error
    except KeyboardInterrupt:
        message = "it was stopped; start it again"
        raise JobAbortedError(message) from None
    for span in spans:
        storage.results.save_outcomes(spacecraft_id, version, former[span], 0, None)
