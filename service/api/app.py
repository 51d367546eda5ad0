"""The application: routes, layers and handlers put together, nothing else.

Layers from outside in: reading by pages of other origins, request ids (and the last 500), figures and access log,
access (rates, audit), packing of answers, body limit, routes.
"""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from fastapi import FastAPI
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware

from service.api.access.access_middleware import AccessLayer
from service.api.access.auth import BASE_PATH, MAY_READ, CrossOriginReading
from service.api.access.housekeeping import AccessHousekeeping, Refusals, StoredKeys
from service.api.context import (
    ApiContext,
    CarrierNameCache,
    CommitWaiter,
    EpochLimits,
    Limits,
    MonitoringSettings,
    PlanWidths,
)
from service.api.limits.http_protocol import Connections
from service.api.limits.rate_limits import BodyLimit, RateLimits
from service.api.monitoring.access_log import RequestLog, RequestMetrics
from service.api.monitoring.metrics import Metrics, SharedReadiness
from service.api.problems.problems import add_handlers
from service.api.protocol import openapi
from service.api.protocol.requests import KNOWN_PARAMETERS, RequestIds, describe_bodies
from service.api.routes import PUBLIC_ROUTERS, ROUTERS
from service.api.stream.event_stream import OpenStreams, StreamParts
from service.runtime.control.release_service import AutomaticRelease

#: answers shorter than this are sent as they are
_PACK_FROM_BYTES = 1024
#: answers of samples that are made at once
_SAMPLED_AT_ONCE = 2
#: half the time of level 9 at nearly its size
_PACK_LEVEL = 5


def create_app(context: ApiContext) -> FastAPI:
    """Return the application that serves one context.

    Parameters
    ----------
    context : ApiContext
        Ports, limits, key and hooks. ``on_startup`` and ``on_shutdown`` run inside the server's event loop.
    """
    statistics = RequestMetrics()
    app = _bare_app(context.limits, statistics, context.monitoring)
    app.state.context = context
    app.state.plan_widths = PlanWidths(context.storage.catalogue)
    app.state.carrier_names = CarrierNameCache(context.storage.catalogue)
    app.state.epoch_limits = EpochLimits(context.clock, context.limits, context.storage.archive)
    app.state.waiter = CommitWaiter()
    app.state.automatic_release = AutomaticRelease(context.storage.catalogue)
    app.state.open_streams = streams = OpenStreams(context.limits.max_streams)
    app.state.stream_parts = StreamParts(context, app.state.carrier_names, streams)
    app.state.request_statistics = statistics
    app.state.connections = connections = Connections(
        context.limits.max_connections, context.limits.max_connections_per_address, context.limits.trusted_proxies
    )
    app.state.metrics = Metrics(context, statistics, streams, connections)
    app.state.service_id = service_id = context.storage.keys.service_id()
    keys = StoredKeys(context.storage.keys, context.bootstrap_key, context.clock.system_us, service_id)
    app.state.key_ring = app.state.stored_keys = keys
    app.state.readiness = SharedReadiness(context)
    app.state.large_body = asyncio.Lock()
    # samples are made of many rows, and other requests wait for the processor meanwhile
    app.state.sampling = asyncio.Semaphore(_SAMPLED_AT_ONCE)
    app.state.rate_limits = RateLimits(context.limits.rates)
    app.state.refusals = Refusals()
    return app


def render_openapi() -> str:
    """Return the OpenAPI document as it is committed in docs/reference/openapi.json."""
    document: dict[str, Any] = _bare_app(Limits(), RequestMetrics(), MonitoringSettings()).openapi()
    return openapi.as_text(document)


@asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    """Run the hooks of the context around the time of serving."""
    context: ApiContext = app.state.context
    storage = context.storage
    keeping = AccessHousekeeping(
        app.state.stored_keys, app.state.refusals, storage.audit, storage.archive.journal_heads
    )
    await context.on_startup()
    keeping.start()
    try:
        yield
    finally:
        await keeping.stop()
        await context.on_shutdown()


class _Application(FastAPI):
    """FastAPI whose OpenAPI document is ours."""

    def openapi(self) -> dict[str, Any]:
        """Return the OpenAPI document, made once."""
        if self.openapi_schema is None:
            self.openapi_schema = openapi.describe(self)
        return self.openapi_schema


def _bare_app(limits: Limits, statistics: RequestMetrics, monitoring: MonitoringSettings) -> FastAPI:
    """Return the application without a context."""
    app = _Application(
        title="SOO",
        docs_url=None,
        redoc_url=None,
        openapi_url="/openapi.json",
        redirect_slashes=False,
        lifespan=_lifespan,
    )
    # the layer added last is the outermost
    app.add_middleware(BodyLimit, max_body_bytes=limits.max_body_bytes)
    app.add_middleware(
        GZipMiddleware,
        minimum_size=_PACK_FROM_BYTES,
        compresslevel=_PACK_LEVEL,
        # Parquet is packed inside
        exclude_content_types=(*DEFAULT_EXCLUDED_CONTENT_TYPES, "application/vnd.apache.parquet"),
    )
    app.add_middleware(AccessLayer)
    app.add_middleware(RequestLog, statistics=statistics, base_path=BASE_PATH, is_writing=monitoring.access_log)
    app.add_middleware(RequestIds)
    if limits.allowed_origins:
        app.add_middleware(CrossOriginReading, origins=limits.allowed_origins)
    add_handlers(app)
    # each router by itself: a router of routers would be searched on every request
    for router in ROUTERS:
        describe_bodies(router)
        app.include_router(router, prefix=BASE_PATH, dependencies=[MAY_READ, KNOWN_PARAMETERS])
    for router in PUBLIC_ROUTERS:
        describe_bodies(router)
        app.include_router(router, dependencies=[KNOWN_PARAMETERS])
    return app
