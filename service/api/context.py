"""Context of a request: dependencies and what routes look up in common."""

import asyncio
import re
import threading
from collections import OrderedDict, deque
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from threading import Lock
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from fastapi import Depends, Path, Query, Request
from starlette.concurrency import run_in_threadpool

from service.api.limits.rate_limits import RateLimitConfig
from service.errors import ConflictError, InvalidInputError, NotFoundError
from service.pipeline.config import CalibrationConfig, InterlockConfig
from service.pipeline.ingest_screening import EpochBounds, data_bounds, system_bounds
from service.ports.archive import LIVE, SMOOTHED, Archive, Results
from service.ports.storage import Catalogue, Clock, Storage
from service.records.catalogue import LIVE_METHODS, Method
from service.records.epoch import US_PER_S
from service.records.operations.work import JobState, ReplayVersion
from service.records.setting import SettingEntry
from service.runtime.alarms.alarm_service import AlarmService
from service.runtime.control.release_service import ReleaseService
from service.runtime.jobs.calibration import Aligner, Calibrator
from service.runtime.jobs.replay import Replayer
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor


class CarrierNameCache:
    """Carrier ids of the plans asked for so far; safe from any thread.

    Parameters
    ----------
    catalogue : Catalogue
        Where plans are looked up once.
    """

    def __init__(self, catalogue: Catalogue) -> None:
        self._catalogue = catalogue
        self._lock = threading.Lock()
        self._names: dict[tuple[str, int], tuple[str, ...]] = {}

    def knows(self, spacecraft_id: str, plan_id: int) -> bool:
        """Return whether the carrier ids of a plan need no look-up."""
        with self._lock:
            return (spacecraft_id, plan_id) in self._names

    def of(self, spacecraft_id: str, plan_id: int) -> tuple[str, ...]:
        """Return the carrier ids in the order of a row's powers; NotFoundError ``plan.unknown``."""
        key = (spacecraft_id, plan_id)
        with self._lock:
            known = self._names.get(key)
        if known is None:
            known = self._catalogue.plan(spacecraft_id, plan_id).carrier_ids
            with self._lock:
                self._names[key] = known
        return known


Result = TypeVar("Result")
_Waiter = asyncio.Future[None]


class CommitWaiter:
    """Waiters of one event loop for commits of the writer's thread."""

    def __init__(self) -> None:
        self._landed: deque[_Waiter] = deque()
        self._lock = Lock()
        self._is_woken = False

    async def of(self, future: Future[Result]) -> Result:
        """Return the result of a future of another thread or raise its error; a cancelled waiter does not cancel it."""
        if not future.done():
            loop = asyncio.get_running_loop()
            waiter: _Waiter = loop.create_future()
            future.add_done_callback(lambda _: self._land(loop, waiter))
            await waiter
        return future.result()

    def _land(self, loop: asyncio.AbstractEventLoop, waiter: _Waiter) -> None:
        """Note that something is done, on the thread that did it."""
        with self._lock:
            self._landed.append(waiter)
            if self._is_woken or loop.is_closed():
                return
            self._is_woken = True
        loop.call_soon_threadsafe(self._report)

    def _report(self) -> None:
        """Let all go on whose work is done."""
        with self._lock:
            landed, self._landed = self._landed, deque()
            self._is_woken = False
        for waiter in landed:
            if not waiter.done():
                waiter.set_result(None)


@dataclass(frozen=True, slots=True, kw_only=True)
class MonitoringSettings:
    """Settings of readiness, metrics and access log."""

    #: whether /metrics wants a key
    metrics_need_key: bool = False
    #: whether a line is written of every request
    access_log: bool = True
    #: entries by which the estimator may lie behind the journal and yet be ready
    ready_lag: int = 1000
    #: free space beside the database below which the service is not ready
    min_free_disk_bytes: int = 200_000_000


#: id of a spacecraft as it stands in paths
SPACECRAFT_ID_PATTERN = r"^[a-z0-9][a-z0-9-]{0,63}$"
_SPACECRAFT_ID = re.compile(SPACECRAFT_ID_PATTERN.rstrip("$") + r"\Z", re.ASCII)
_DAY_S = 86_400.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of requests, and lifetimes of answers."""

    #: how far ahead of the system clock an epoch may lie
    future_tolerance_s: float = 5.0
    #: how far ahead of the data clock an epoch may lie
    future_tolerance_data_s: float = 30 * _DAY_S
    #: age from which a row counts as late under the system clock
    late_after_s: float = 300.0
    #: age from which a row is refused; None = nothing is too old
    retention_s: float | None = None
    max_body_bytes: int = 8 * 1024 * 1024
    max_rows_per_batch: int = 10_000
    #: requests a second, by key and class or by address
    rates: RateLimitConfig = field(default_factory=RateLimitConfig)
    #: age from which the newest attitude is no longer valid under the system clock: three row periods and 30 s
    expired_after_s: float = 210.0
    #: a silent stream says so this often
    #: a stream ends within this and two seconds after its key was revoked
    stream_heartbeat_s: float = 2.5
    #: a client of a stream that takes nothing for so long is gone
    stream_stall_s: float = 60.0
    #: live streams at once
    max_streams: int = 500
    #: sources that rows of one key may come under first
    max_sources_per_key: int = 500
    #: connections at once, and of one address unless it is among the trusted proxies
    max_connections: int = 2000
    max_connections_per_address: int = 64
    trusted_proxies: str = ""
    #: whether a browser on another machine may open a session without TLS
    plain_sessions: bool = False
    #: origins of other pages that may read with a Bearer key
    allowed_origins: tuple[str, ...] = ()
    #: evidence traces kept of one source, and bytes that their points may take
    evidence_traces: int = 2880
    evidence_bytes: int = 64 * 1024 * 1024


class PresentMemory:
    """Memory of what was read of each spacecraft, each part with the position that it had; safe from any thread."""

    def __init__(self) -> None:
        self._parts: dict[tuple[str, str], tuple[object, Any]] = {}

    def part(self, spacecraft_id: str, name: str, numbers: object, read: Callable[[], Result]) -> Result:
        """Return a part; it is read where it has never been, or where other numbers say that it has moved."""
        known = self.known(spacecraft_id, name)
        if known is None or known[0] != numbers:
            # it is as new as the numbers or newer: they were read before it
            known = self.put(spacecraft_id, name, numbers, read())
        value: Result = known[1]
        return value

    def known(self, spacecraft_id: str, name: str) -> tuple[Any, Any] | None:
        """Return the numbers of a part and the part, None where it was never read."""
        return self._parts.get((spacecraft_id, name))

    def put(self, spacecraft_id: str, name: str, numbers: object, value: Any) -> tuple[object, Any]:
        """Take over a part with its numbers."""
        self._parts[spacecraft_id, name] = known = (numbers, value)
        return known


def _ignore(_spacecraft_id: str, _about: object = None) -> None:
    """Tell nobody."""


def _always() -> bool:
    return True


async def _nothing() -> None:
    """Do nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ApiContext:
    """Dependencies of the interface: storage, clock, feed and settings."""

    storage: Storage
    clock: Clock
    #: knows the newest carriers, and is told when a journal has grown
    supervisor: Supervisor
    alarms: AlarmService
    #: source of live streams
    feed: LiveFeed
    calibrator: Calibrator
    aligner: Aligner
    replayer: Replayer
    #: interlock and commands
    release_service: ReleaseService
    #: how harmonics are fitted and carriers judged on demand
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    #: limits of the estimator
    interlock: InterlockConfig = field(default_factory=InterlockConfig)
    #: administrator's key; None = every request is refused
    bootstrap_key: str | None = field(default=None, repr=False)
    limits: Limits = field(default_factory=Limits)
    monitoring: MonitoringSettings = field(default_factory=MonitoringSettings)
    #: in force, without secrets
    settings: tuple[SettingEntry, ...] = ()
    clock_kind: Literal["system", "data"] = "system"
    #: name of the process that leads each spacecraft, where the archive knows it
    leaders: Callable[[], dict[str, str]] = dict
    leader_silent_s: Callable[[], float] = float
    #: whether the estimator runs
    is_following: Callable[[], bool] = _always
    #: called with the spacecraft whenever something of it entered the journal, for rows with their newest number
    on_accepted: Callable[..., None] = _ignore
    on_startup: Callable[[], Awaitable[None]] = _nothing
    on_shutdown: Callable[[], Awaitable[None]] = _nothing
    #: what was read of each spacecraft
    memory: PresentMemory = field(default_factory=PresentMemory)


SpacecraftIdText = Annotated[
    str, Path(description="Id of a spacecraft", json_schema_extra={"pattern": SPACECRAFT_ID_PATTERN})
]


def checked_spacecraft_id(spacecraft_id: str) -> str:
    """Return the spacecraft's id of a path; an id that cannot exist is as unknown as one that does not."""
    if _SPACECRAFT_ID.match(spacecraft_id) is None:
        detail = f"no spacecraft {spacecraft_id[:64]!r}"
        raise NotFoundError("spacecraft.unknown", detail)
    return spacecraft_id


async def spacecraft_id_of(spacecraft_id: SpacecraftIdText) -> str:
    """Return the checked id of a path, for a dependency."""
    return checked_spacecraft_id(spacecraft_id)


def of_application(name: str) -> Any:
    """Return the dependency that gives a part of the application's state."""

    async def read(request: Request) -> Any:
        return getattr(request.app.state, name)

    return Depends(read)


Context = Annotated[ApiContext, of_application("context")]
Names = Annotated[CarrierNameCache, of_application("carrier_names")]
SpacecraftId = Annotated[str, Depends(spacecraft_id_of)]


class _Known(NamedTuple):
    """Reading of a spacecraft's clock and retention limit."""

    read_at_us: int
    is_data: bool
    now_us: int | None
    #: below it rows were dropped
    kept_from_us: int


class EpochLimits:
    """Bounds of epochs by spacecraft.

    Parameters
    ----------
    clock : Clock
        Clock of the service.
    limits : Limits
        Tolerances.
    archive : Archive
        Tells what it has dropped.
    """

    def __init__(self, clock: Clock, limits: Limits, archive: Archive) -> None:
        self._clock = clock
        self._archive = archive
        self._limits = limits
        self._known: dict[str, _Known] = {}
        #: spacecraft that are just asked about
        self._asking: dict[str, asyncio.Task[EpochBounds]] = {}

    async def known(self, spacecraft_id: str) -> EpochBounds:
        """Return bounds at most a second old."""
        known = self._known.get(spacecraft_id)
        now_us = self._clock.system_us()
        # before its first row nothing bounds a spacecraft, so that is never remembered
        if known is None or known.now_us is None or not 0 <= now_us - known.read_at_us < US_PER_S:
            return await self._asked_together(spacecraft_id)
        return self._bounds(known if known.is_data else known._replace(now_us=now_us))

    async def present(self, spacecraft_id: str) -> EpochBounds:
        """Return the bounds of this moment."""
        known = await run_in_threadpool(self._read, spacecraft_id)
        self._known[spacecraft_id] = known
        return self._bounds(known)

    def forget(self, spacecraft_id: str) -> None:
        """Forget a spacecraft that was changed: it may live under another clock now."""
        self._known.pop(spacecraft_id, None)
        self._asking.pop(spacecraft_id, None)

    async def _asked_together(self, spacecraft_id: str) -> EpochBounds:
        """Return what one asks for all that want it at once; each by itself would wait for a thread and the others."""
        asking = self._asking.get(spacecraft_id)
        if asking is None:
            asking = self._asking[spacecraft_id] = asyncio.ensure_future(self.present(spacecraft_id))
            asking.add_done_callback(lambda task: self._asked(spacecraft_id, task))
        # who gives up does not spoil it for the others
        return await asyncio.shield(asking)

    def _asked(self, spacecraft_id: str, task: "asyncio.Task[EpochBounds]") -> None:
        if self._asking.get(spacecraft_id) is task:
            del self._asking[spacecraft_id]
        if not task.cancelled():
            # looked at, in case nobody waits any more
            task.exception()

    def _read(self, spacecraft_id: str) -> _Known:
        """Ask the clock and the archive."""
        clock, kept_from_us = self._clock, self._archive.kept_from_us(spacecraft_id, "measurements")
        return _Known(clock.system_us(), clock.is_data(spacecraft_id), clock.now_us(spacecraft_id), kept_from_us)

    def _bounds(self, known: _Known) -> EpochBounds:
        """Return what the clock's word means for epochs; what was dropped does not come in again."""
        limits = self._limits
        if known.is_data or known.now_us is None:
            bounds = data_bounds(known.now_us, limits.future_tolerance_data_s, limits.retention_s)
        else:
            bounds = system_bounds(known.now_us, limits.future_tolerance_s, limits.late_after_s, limits.retention_s)
        return bounds._replace(earliest_us=max(bounds.earliest_us, known.kept_from_us))


Epochs = Annotated[EpochLimits, of_application("epoch_limits")]


async def present_bounds(spacecraft_id: SpacecraftId, epochs: Epochs) -> EpochBounds:
    """Return the bounds of epochs at this moment."""
    return await epochs.present(spacecraft_id)


PresentBounds = Annotated[EpochBounds, Depends(present_bounds)]
MethodParameter = Annotated[Method | None, Query(description="Default: the method that drives control")]
VersionParameter = Annotated[
    str, Query(max_length=64, description="`live`, `smoothed` (live rows of robust_smoothed), or that of a replay")
]


def wanted_method(spacecraft_id: SpacecraftId, context: Context, method: MethodParameter = None) -> Method:
    """Return the method asked for, or the one that drives control of the spacecraft."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    return spacecraft.control.method if method is None else method


def wanted_version(spacecraft_id: SpacecraftId, context: Context, version: VersionParameter = LIVE) -> str:
    """Return the version asked for; NotFoundError ``replay.unknown``, ConflictError ``replay.unfinished``."""
    check_version(context.storage.results, spacecraft_id, version)
    return version


def stored_method(
    method: Annotated[Method, Depends(wanted_method)], version: Annotated[str, Depends(wanted_version)]
) -> Method:
    """Return the method asked for, which the version has."""
    check_method(method, version)
    return method


def check_method(method: Method, version: str) -> None:
    """Raise InvalidInputError ``method.smoothed`` for smoothed rows of the live version, or others of `smoothed`."""
    if version == LIVE and method not in LIVE_METHODS:
        detail = f"{method} exists only in version {SMOOTHED}, and in versions of replays with smooth=true"
        raise InvalidInputError("method.smoothed", detail)
    if version == SMOOTHED and method is not Method.ROBUST_SMOOTHED:
        detail = f"version {SMOOTHED} has rows of method {Method.ROBUST_SMOOTHED} alone"
        raise InvalidInputError("method.smoothed", detail)


def check_version(results: Results, spacecraft_id: str, version: str) -> None:
    """Raise NotFoundError unless a version exists, ConflictError unless every row of it is stored."""
    if version not in (LIVE, SMOOTHED):
        _check_done(results.replay(spacecraft_id, version))


def _check_done(found: ReplayVersion) -> None:
    """Raise ConflictError ``replay.unfinished`` unless every row of a replay is stored."""
    if found.state is JobState.DONE:
        return
    version = found.replay.version
    detail = f"{version} is {found.state} ({found.progress:.0%}); its job is {found.replay.job_id}"
    if found.state is JobState.FAILED:
        detail = f"{version} failed and has no complete rows; delete it and start another one. {found.error or ''}"
    raise ConflictError("replay.unfinished", detail.rstrip())


WantedMethod = Annotated[Method, Depends(wanted_method)]
WantedVersion = Annotated[str, Depends(wanted_version)]
#: of a version
StoredMethod = Annotated[Method, Depends(stored_method)]


class PlanWidths:
    """Widths of the plans asked for last.

    Parameters
    ----------
    catalogue : Catalogue
        Where plans are looked up once.
    capacity : int
        Plans kept; the one unused longest makes room.
    """

    def __init__(self, catalogue: Catalogue, capacity: int = 4096) -> None:
        self._catalogue = catalogue
        self._capacity = capacity
        self._widths: OrderedDict[tuple[str, int], int] = OrderedDict()

    async def width(self, spacecraft_id: str, plan_id: int) -> int:
        """Return the number of carriers; NotFoundError ``spacecraft.unknown`` or ``plan.unknown``."""
        key = (spacecraft_id, plan_id)
        known = self._widths.get(key)
        if known is not None:
            self._widths.move_to_end(key)
            return known
        plan = await run_in_threadpool(self._catalogue.plan, spacecraft_id, plan_id)
        if plan.is_withdrawn:
            raise NotFoundError("plan.unknown", f"Plan {plan_id} of {spacecraft_id!r} was withdrawn.")
        self._widths[key] = len(plan.carriers)
        if len(self._widths) > self._capacity:
            self._widths.popitem(last=False)
        return len(plan.carriers)

    def forget(self, spacecraft_id: str) -> None:
        """Forget the plans of a spacecraft: it was deleted, or one of them withdrawn."""
        for key in [key for key in self._widths if key[0] == spacecraft_id]:
            self._widths.pop(key, None)


Widths = Annotated[PlanWidths, of_application("plan_widths")]
