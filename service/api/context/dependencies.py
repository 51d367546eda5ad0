"""Dependencies of routes: the context that the composition root fills, and names for its parts.

Routes see ports only; they never import an adapter and never look anything up globally.
"""

import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Annotated, Literal

from fastapi import Depends, Path, Request

from service.api.context.carrier_names import CarrierNameCache
from service.api.context.monitoring_settings import MonitoringSettings
from service.api.limits.rate_limits import RateLimitConfig
from service.errors import NotFoundError
from service.pipeline.config import CalibrationConfig, InterlockConfig
from service.ports import Clock, Storage
from service.records.setting import SettingEntry
from service.runtime.alarms.alarm_service import AlarmService
from service.runtime.control.release_service import ReleaseService
from service.runtime.jobs.alignment_service import Aligner
from service.runtime.jobs.calibration_job import Calibrator
from service.runtime.jobs.flight_analysis_job import FlightAnalyses
from service.runtime.jobs.replay_job import Replayer
from service.runtime.jobs.workers import Workers
from service.runtime.live.live_feed import LiveFeed
from service.runtime.live.supervisor import Supervisor

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


def _ignore(_spacecraft_id: str, _newest_number: int = 0) -> None:
    """Tell nobody."""


def _always() -> bool:
    """Return True."""
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
    flights: FlightAnalyses
    workers: Workers
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
    #: whether the estimator runs
    is_following: Callable[[], bool] = _always
    #: who writes exported levels
    kernels: Literal["numba", "numpy"] = "numba"
    #: called with the spacecraft whenever something of it entered the journal, for rows with their newest number
    on_accepted: Callable[..., None] = _ignore
    on_startup: Callable[[], Awaitable[None]] = _nothing
    on_shutdown: Callable[[], Awaitable[None]] = _nothing


async def context_of(request: Request) -> ApiContext:
    """Return the context of the application that serves a request."""
    context: ApiContext = request.app.state.context
    return context


async def carrier_names_of(request: Request) -> CarrierNameCache:
    """Return the application's memory of carrier ids."""
    names: CarrierNameCache = request.app.state.carrier_names
    return names


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


Context = Annotated[ApiContext, Depends(context_of)]
Names = Annotated[CarrierNameCache, Depends(carrier_names_of)]
SpacecraftId = Annotated[str, Depends(spacecraft_id_of)]
