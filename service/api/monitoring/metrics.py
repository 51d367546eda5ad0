"""Metrics: the figures of the service in the text form of Prometheus, gathered when they are asked for.

Nothing is kept between two looks but counts. A database that does not answer leaves out what stands in it; the rest is
told all the same, with ``soo_ready{part="database"} 0``.

Metrics by name: what each tells, in which unit, by which labels. The dashboard and the alert rules use these names.

Every label has a bound: axes, methods, states and codes are words of the service; of spacecraft, sources, carriers and
links no more than the limits below are told, in order of their ids.
"""

import asyncio
import logging
import math
import os
import resource
import sys
from collections.abc import Iterable, Iterator
from http import HTTPStatus
from pathlib import Path
from typing import Any, Literal, NamedTuple

from starlette.concurrency import run_in_threadpool

from service.api.context import ApiContext
from service.api.limits.http_protocol import Connections
from service.api.monitoring.access_log import DURATION_BOUNDS_S, RequestMetrics
from service.api.problems.problems import RETRY_AFTER_S, RequestProblemError
from service.api.stream.event_stream import OpenStreams
from service.api.views.present import SpacecraftNow, link_answers, present_of
from service.api.views.shipped import program_version
from service.errors import FieldError, StorageError
from service.ports.archive import SMOOTHED
from service.records.catalogue import LIVE_METHODS, Method, Spacecraft
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import AttitudeRow
from service.records.storage import StorageState

_STATUS = Path("/proc/self/statm")
_STAT = Path("/proc/self/stat")
#: places of the start in that file behind the name, which may hold spaces
_START_FIELD = 19
#: descriptors above which none are asked for: more than any number of connections that is served
_ENOUGH_DESCRIPTORS = 65_536


class ProcessMetrics(NamedTuple):
    """Figures of this process."""

    #: memory in use, bytes; the greatest so far where the system does not tell the present
    rss_bytes: int
    cpu_s: float
    #: None where the system does not tell
    open_files: int | None
    threads: int | None


def raised_descriptor_limit() -> int:
    """Raise the limit of open files and sockets as far as the system lets this process; return it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = _ENOUGH_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, _ENOUGH_DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
    return wanted


def process_statistics() -> ProcessMetrics:
    """Return the figures of this process."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    try:
        rss_bytes = int(_STATUS.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        threads = int(_STAT.read_text().rpartition(")")[2].split()[_START_FIELD - 2])
        open_files = len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - counts, paths are of no use
    except OSError:
        unit_bytes = 1 if sys.platform == "darwin" else 1024
        return ProcessMetrics(used.ru_maxrss * unit_bytes, used.ru_utime + used.ru_stime, None, None)
    return ProcessMetrics(rss_bytes, used.ru_utime + used.ru_stime, open_files, threads)


#: things of each kind that are told at most
MAX_SPACECRAFT = 50
MAX_SOURCES = 20
MAX_CARRIERS = 128
MAX_LINKS = 200

#: what a status is told as: the four states of the mission-control world
STATUS_NUMBERS = {"NOT_RECEIVED": 0, "ACQUIRED": 1, "INVALID": 2, "EXPIRED": 3}


class Family(NamedTuple):
    """One metric."""

    kind: Literal["gauge", "counter", "histogram"]
    help: str
    labels: tuple[str, ...] = ()


_STATES = "0 not received, 1 acquired, 2 invalid, 3 expired"

FAMILIES: dict[str, Family] = {
    # the spacecraft
    "soo_sample_age_seconds": Family(
        "gauge", "age of the newest measurement of a source, by the spacecraft's clock", ("spacecraft", "source")
    ),
    "soo_series_status": Family("gauge", f"newest power of a carrier: {_STATES}", ("spacecraft", "carrier")),
    "soo_attitude_deg": Family(
        "gauge", "newest attitude, degrees; absent while there is none", ("spacecraft", "method", "axis")
    ),
    "soo_attitude_sigma_deg": Family(
        "gauge", "one standard deviation of the newest attitude, degrees", ("spacecraft", "method", "axis")
    ),
    "soo_attitude_status": Family("gauge", f"newest attitude: {_STATES}", ("spacecraft", "method")),
    "soo_control_allowed": Family(
        "gauge", "1 when a torque may go now: neither interlock nor newest attitude forbids it", ("spacecraft",)
    ),
    "soo_journal_lag": Family(
        "gauge", "entries of the journal that the estimator has not consumed yet", ("spacecraft",)
    ),
    "soo_smoothed_lag_seconds": Family(
        "gauge", "newest consumed row less newest smoothed row of the live series, by epochs", ("spacecraft",)
    ),
    "soo_filter_rows_total": Family(
        "counter",
        "rows of the robust method since its chain began, by kind: ordinary, or event (something found or declared)",
        ("spacecraft", "kind"),
    ),
    # rows on their way in
    "soo_rows_total": Family(
        "counter", "rows received, by outcome: accepted, duplicates, late (accepted too)", ("spacecraft", "outcome")
    ),
    "soo_rows_refused_total": Family("counter", "rows refused, by code", ("spacecraft", "code")),
    "soo_rows_missing": Family(
        "gauge", "rows that the numbers of a source count and the archive does not hold", ("spacecraft", "source")
    ),
    "soo_link_state": Family("gauge", "1 for the present state of a link", ("link", "state")),
    "soo_link_last_good_age_seconds": Family("gauge", "age of the newest good row of a link", ("link",)),
    # the interface
    "soo_http_requests_total": Family("counter", "requests answered", ("method", "route", "status")),
    "soo_http_request_duration_seconds": Family(
        "histogram", "time from the request to the end of its answer, streams left out", ("route",)
    ),
    "soo_http_requests_in_progress": Family("gauge", "requests being answered, open streams among them"),
    "soo_connections": Family("gauge", "connections that are open"),
    "soo_connections_refused_total": Family(
        "counter",
        "connections refused (address, total: too many) or ended (slow: no whole request in time)",
        ("reason",),
    ),
    "soo_stream_clients": Family("gauge", "live streams that are open"),
    "soo_stream_events_total": Family("counter", "events sent to clients of live streams", ("kind",)),
    "soo_stream_dropped_total": Family("counter", "events that clients were too slow for; they follow from history"),
    # the service
    "soo_ready": Family("gauge", "1 when a part of the service is ready; /readyz says why not", ("part",)),
    "soo_writer_queue": Family("gauge", "writes that wait for the database's writer"),
    "soo_disk_free_bytes": Family("gauge", "free space beside the database; absent where it is on another machine"),
    "soo_process_resident_memory_bytes": Family("gauge", "memory in use"),
    "soo_process_cpu_seconds_total": Family("counter", "processor time used"),
    "soo_process_open_files": Family("gauge", "files and sockets open"),
    "soo_process_threads": Family("gauge", "threads"),
    "soo_build_info": Family("gauge", "always 1; the version stands in its label", ("version",)),
}


MEDIA_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_LOG = logging.getLogger(__name__)
#: name of a metric, values of its labels, value
Sample = tuple[str, tuple[str, ...], float]


class Metrics:
    """Prometheus metrics of one application.

    Parameters
    ----------
    context : ApiContext
        Archive, clock and supervisor.
    statistics : RequestMetrics
        Counts of requests and rows.
    streams : OpenStreams
        Live streams.
    connections : Connections
        Open connections and those refused.
    """

    def __init__(
        self, context: ApiContext, statistics: RequestMetrics, streams: OpenStreams, connections: Connections
    ) -> None:
        self._context = context
        self._statistics = statistics
        self._streams = streams
        self._connections = connections

    def render(self) -> bytes:
        """Return all metrics as text."""
        # imported when somebody asks for the first time: 50 ms and 5 MB that many installations never need
        from prometheus_client import CollectorRegistry, generate_latest

        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)
        return generate_latest(registry)

    def collect(self) -> Iterator[Any]:
        """Yield every metric that has a value, as prometheus_client wants them."""
        from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily

        kinds = {"gauge": GaugeMetricFamily, "counter": CounterMetricFamily}
        made: dict[str, Any] = {}
        for name, labels, value in self._samples():
            family = FAMILIES[name]
            if name not in made:
                made[name] = kinds[family.kind](name, family.help, labels=family.labels)
            if not math.isnan(value):
                made[name].add_metric([_label(label) for label in labels], value)
        yield from made.values()
        yield self._durations()

    def _samples(self) -> Iterator[Sample]:
        """Yield all samples but the histograms."""
        yield from self._process()
        yield from self._requests()
        parts = parts_of(self._context)
        yield from (("soo_ready", (part.name,), float(part.fault is None)) for part in parts)
        yield from self._readable(self._archive())
        try:
            catalogue = self._context.storage.catalogue.all_spacecraft()[:MAX_SPACECRAFT]
        except StorageError:
            catalogue = ()
        for spacecraft in catalogue:
            families = (self._sources(spacecraft.id), self._rows(spacecraft.id), self._attitude(spacecraft))
            for family in families:
                yield from self._readable(family)
        yield from self._readable(self._links())

    def _readable(self, family: Iterator[Sample]) -> Iterable[Sample]:
        """Return the samples of a family as a whole, none where it fails: the other families go on."""
        try:
            return list(family)
        except Exception as error:  # noqa: BLE001 a look at the service outlives every fault of it
            _LOG.warning("metrics lack a family: %s", error)
            return ()

    def _process(self) -> Iterator[Sample]:
        statistics = process_statistics()
        yield "soo_build_info", (program_version(),), 1.0
        yield "soo_process_resident_memory_bytes", (), float(statistics.rss_bytes)
        yield "soo_process_cpu_seconds_total", (), statistics.cpu_s
        for name, value in (("open_files", statistics.open_files), ("threads", statistics.threads)):
            if value is not None:
                yield f"soo_process_{name}", (), float(value)

    def _requests(self) -> Iterator[Sample]:
        """Yield counts of requests, rows and events; copies, for the event loop goes on counting."""
        statistics = self._statistics
        for (method, route, status), count in sorted(statistics.requests.copy().items()):
            yield "soo_http_requests_total", (method, route, str(status)), float(count)
        yield "soo_http_requests_in_progress", (), float(statistics.in_progress)
        for key, count in sorted(statistics.rows.copy().items()):
            yield "soo_rows_total", key, float(count)
        for key, count in sorted(statistics.refused.copy().items()):
            yield "soo_rows_refused_total", key, float(count)
        yield "soo_connections", (), float(self._connections.count)
        for kind, count in sorted(self._connections.refused.copy().items()):
            yield "soo_connections_refused_total", (kind,), float(count)
        yield "soo_stream_clients", (), float(self._streams.count)
        for kind, count in sorted(self._streams.sent.copy().items()):
            yield "soo_stream_events_total", (kind,), float(count)
        yield "soo_stream_dropped_total", (), float(self._streams.dropped)

    def _durations(self) -> Any:
        from prometheus_client.core import HistogramMetricFamily

        name = "soo_http_request_duration_seconds"
        family = HistogramMetricFamily(name, FAMILIES[name].help, labels=FAMILIES[name].labels)
        bounds = (*map(str, DURATION_BOUNDS_S), "+Inf")
        for route, durations in sorted(self._statistics.durations.copy().items()):
            counts = list(durations.counts)
            buckets = [(bound, float(sum(counts[: position + 1]))) for position, bound in enumerate(bounds)]
            family.add_metric([route], buckets, durations.total_s)
        return family

    def _archive(self) -> Iterator[Sample]:
        """Yield the samples of the archive as a whole."""
        state = self._context.storage.state()
        yield "soo_writer_queue", (), float(state.queued_writes)
        if state.free_bytes is not None:
            yield "soo_disk_free_bytes", (), float(state.free_bytes)

    def _sources(self, spacecraft_id: str) -> Iterator[Sample]:
        """Yield age and gaps of each source, and the lags of the estimates."""
        archive, now_us = self._context.storage.archive, self._context.clock.now_us(spacecraft_id)
        head = archive.head(spacecraft_id)
        yield "soo_journal_lag", (spacecraft_id,), float(head.newest_number - head.consumed_number)
        smoothed = self._context.storage.results.newest_attitude(spacecraft_id, SMOOTHED, Method.ROBUST_SMOOTHED)
        if smoothed is not None and head.consumed_epoch_us is not None:
            lag_s = (head.consumed_epoch_us - smoothed.epoch_us) / US_PER_S
            yield "soo_smoothed_lag_seconds", (spacecraft_id,), lag_s
        for source in archive.sources(spacecraft_id)[:MAX_SOURCES]:
            key = (spacecraft_id, source.id)
            if now_us is not None and source.newest_epoch_us is not None:
                yield "soo_sample_age_seconds", key, max(0.0, (now_us - source.newest_epoch_us) / US_PER_S)
            if source.rows_missing is not None:
                yield "soo_rows_missing", key, float(source.rows_missing)

    def _rows(self, spacecraft_id: str) -> Iterator[Sample]:
        """Yield the rows that the filter has taken, and the state of each carrier of the newest one."""
        for is_ordinary, rows in self._context.supervisor.rows_by_kind(spacecraft_id).items():
            yield "soo_filter_rows_total", (spacecraft_id, "ordinary" if is_ordinary else "event"), float(rows)
        known = self._context.supervisor.carrier_states(spacecraft_id)
        now_us = self._context.clock.now_us(spacecraft_id)
        if known is None:
            return
        row, states = known
        limit_us = self._context.limits.expired_after_s * US_PER_S
        is_data = self._context.clock.is_data(spacecraft_id)
        is_old = not is_data and now_us is not None and now_us - row.epoch_us > limit_us
        for state in states[:MAX_CARRIERS]:
            word = {"absent": "NOT_RECEIVED", "excluded": "INVALID"}.get(state.state, "ACQUIRED")
            yield "soo_series_status", (spacecraft_id, state.carrier), STATUS_NUMBERS["EXPIRED" if is_old else word]

    def _attitude(self, spacecraft: Spacecraft) -> Iterator[Sample]:
        """Yield the newest attitude of each method."""
        now = SpacecraftNow(self._context, spacecraft.id)
        for method in LIVE_METHODS:
            row = now.row(method)
            if row is not None:
                yield from _angles(spacecraft.id, row)
        yield "soo_control_allowed", (spacecraft.id,), float(present_of(self._context, now).verdict.is_allowed)

    def _links(self) -> Iterator[Sample]:
        for link in link_answers(self._context, self._context.storage.links.links()[:MAX_LINKS]):
            yield "soo_link_state", (link.id, link.state), 1.0
            if link.last_good_age_s is not None:
                yield "soo_link_last_good_age_seconds", (link.id,), link.last_good_age_s


def _angles(spacecraft_id: str, row: AttitudeRow) -> Iterable[Sample]:
    """Yield one attitude; axes without an angle are left out."""
    method = row.method.value
    yield "soo_attitude_status", (spacecraft_id, method), float(STATUS_NUMBERS[row.status.value])
    for axis in ("yaw", "roll", "pitch"):
        yield "soo_attitude_deg", (spacecraft_id, method, axis), getattr(row.attitude_deg, axis)
        yield "soo_attitude_sigma_deg", (spacecraft_id, method, axis), getattr(row.sigma_deg, axis)


def _label(text: str) -> str:
    """Return a label's value of bounded length."""
    return text[:128]


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
