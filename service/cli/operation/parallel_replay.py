"""Replay beside the service, on the archive itself: its spans spread over processes or a cluster.

The version is one of the archive's, and its job is stored with it: nobody reads its rows before every span is stored.
Whatever ends the command leaves a failed version, or, when it is killed, an unfinished one that the next service which
leads computes to its end.
"""

import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, as_completed
from functools import partial
from typing import TYPE_CHECKING

from service.cli.command_group import end
from service.cli.studies import ended_by_signals
from service.composition.bootstrap import build_clock, open_storage, storage_opener
from service.composition.settings import Settings
from service.errors import SooError
from service.records.operations.work import Replay
from service.runtime.jobs.replay import Replayer, ReplayRun, ReplaySpan, run_span_in_process
from service.study.executors import ClusterError, WorkerChoice, do_work, executor_of

if TYPE_CHECKING:
    from service.ports.archive import Outcome
    from service.ports.storage import Storage

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
    """Store a replay, compute it and return it; end the command where it failed."""
    storage = open_storage(settings)
    try:
        clock = build_clock(settings, storage)
        storage.catalogue.spacecraft(spacecraft_id)
        holder = f"command-{uuid.uuid4().hex}"
        replay, job = Replayer(storage, clock, lambda: None).start(spacecraft_id, wanted, holder)
        storage.results.hold_job(job.id, holder)
        try:
            for share in _shares(settings, storage, pool, spacecraft_id, replay.version):
                storage.results.report_job(job.id, holder, share)
                show(share)
        except (BrokenExecutor, ClusterError, SooError, OSError, ValueError, KeyboardInterrupt) as error:
            text = "it was stopped; start it again" if isinstance(error, KeyboardInterrupt) else str(error)
            storage.results.end_job(job.id, text)
            end(f"{replay.version} failed: {text}", 1)
        storage.results.end_job(job.id)
        return replay
    finally:
        storage.close()


def _shares(
    settings: Settings, storage: "Storage", pool: Executor, spacecraft_id: str, version: str
) -> Iterator[float]:
    """Compute the spans of a replay in any order, and store what belongs after former spans in theirs."""
    config = settings.chain_config()
    spans = ReplayRun(storage, config, spacecraft_id, version).spans(LEAST_ENTRIES)
    work = partial(run_span_in_process, storage_opener(settings), config, spacecraft_id, version)
    former: dict[ReplaySpan, list[Outcome]] = {}
    running = {pool.submit(do_work, work, span): span for span in spans}
    for done in as_completed(running):
        former[running[done]] = done.result()
        yield len(former) / len(spans)
    for span in spans:
        storage.results.save_outcomes(spacecraft_id, version, former[span], 0, None)
