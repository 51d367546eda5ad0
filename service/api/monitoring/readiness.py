"""Readiness: whether the service can keep what it is sent and computes from it, and what stands in the way if not.

Parts are looked at one after another and each says for itself whether it is ready; what cannot be known because the
database does not answer is not told.
"""

import asyncio
from collections.abc import Iterator
from http import HTTPStatus
from typing import NamedTuple

from starlette.concurrency import run_in_threadpool

from service.api.context import ApiContext
from service.api.problems.problems import RETRY_AFTER_S, RequestProblemError
from service.errors import FieldError, StorageError
from service.records.epoch import format_epoch
from service.records.storage import StorageState

#: an archive without a leader for longer is not estimated, s; a standby takes over after half of it
_SILENT_S = 30.0


class Part(NamedTuple):
    """One part of the service."""

    name: str
    #: code of the fault, None = ready
    fault: str | None
    detail: str


class SharedReadiness:
    """Shared check of all parts: requests for it have no rate limit, so one check runs at a time.

    Parameters
    ----------
    context : ApiContext
        What is looked at.
    """

    def __init__(self, context: ApiContext) -> None:
        self._context = context
        self._poll: asyncio.Task[tuple[Part, ...]] | None = None

    async def parts(self) -> tuple[Part, ...]:
        """Return every part whose state can be known, as the look finds it that runs, or a new one."""
        if self._poll is None or self._poll.done():
            self._poll = asyncio.create_task(run_in_threadpool(parts_of, self._context))
        # a client that goes takes the look from nobody
        return await asyncio.shield(self._poll)


def parts_of(context: ApiContext) -> tuple[Part, ...]:
    """Return every part of the service whose state can be known."""
    try:
        state = context.storage.state()
    except StorageError as error:
        return (Part("database", error.code, error.detail),)
    database = Part("database", None, "the database answers")
    return (database, *_disk(state, context), *_consumers(context))


def require_ready(parts: tuple[Part, ...]) -> None:
    """Raise the 503 that names every part that is not ready."""
    faults = [part for part in parts if part.fault is not None]
    if not faults:
        return
    fields = [FieldError(f"/{part.name}", part.fault or "", part.detail) for part in faults]
    code = fields[0].code if len(fields) == 1 else "service.not_ready"
    detail = "; ".join(f"{part.name}: {part.detail}" for part in faults)
    headers = {"Retry-After": str(RETRY_AFTER_S)}
    raise RequestProblemError(HTTPStatus.SERVICE_UNAVAILABLE, code, detail, fields, headers)


def _disk(state: StorageState, context: ApiContext) -> Iterator[Part]:
    """Yield whether there is room beside the database, where that can be known."""
    if state.free_bytes is None:
        return
    free_mb, least_mb = state.free_bytes // 10**6, context.monitoring.min_free_disk_bytes // 10**6
    if not state.is_writable:
        yield Part("disk", "disk.read_only", "the database's file or its folder cannot be written")
    elif free_mb < least_mb:
        yield Part("disk", "disk.full", f"{free_mb} MB are free beside the database, {least_mb} MB are wanted")
    else:
        yield Part("disk", None, f"{free_mb} MB free")


def _consumers(context: ApiContext) -> Iterator[Part]:
    """Yield whether the estimator runs and how far it lies behind."""
    if not context.is_following():
        yield Part("consumers", "consumers.stopped", "the estimator does not run")
        return
    silent_s = context.leader_silent_s()
    if silent_s > _SILENT_S:
        yield Part("leader", "leader.silent", f"no service has been seen to estimate for {silent_s:.0f} s")
    for failure in context.supervisor.failures.lasting():
        since = f"{failure.times} times since {format_epoch(failure.since_us)}"
        yield Part("estimator", "estimator.failed", f"{failure.spacecraft_id} failed {since}, first: {failure.error}")
    archive, limit = context.storage.archive, context.monitoring.ready_lag
    heads = {spacecraft.id: archive.head(spacecraft.id) for spacecraft in context.storage.catalogue.all_spacecraft()}
    lags = {name: head.newest_number - head.consumed_number for name, head in heads.items()}
    restarting = context.supervisor.restarts.under_way
    # a restart ends by itself, what is sent meanwhile is kept; others wait for the same thread
    behind = [] if restarting else [f"{name} by {lag}" for name, lag in lags.items() if lag > limit]
    if behind:
        detail = f"the estimator is behind the journal of {', '.join(behind[:10])} entries; {limit} are allowed"
        yield Part("consumers", "consumers.behind", detail)
    else:
        yield Part("consumers", None, f"{len(lags)} spacecraft, at most {max(lags.values(), default=0)} entries behind")
