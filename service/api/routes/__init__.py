"""Routes, one resource a file. ``ROUTERS`` stand under the base path and need a key, ``PUBLIC_ROUTERS`` do neither."""

from fastapi import APIRouter

from service.api.routes import (
    alignments,
    attitude,
    calibrations,
    carrier_selection,
    carriers,
    ephemeris,
    export,
    harmonics,
    health,
    inputs,
    jobs,
    links,
    measurements,
    measurements_ingest,
    operations,
    replays,
    sources,
    spacecraft,
    status,
    stream,
    torques,
    traces,
)

ROUTERS: tuple[APIRouter, ...] = (
    # the first router is matched first: this one takes nearly all requests
    measurements_ingest.router,
    spacecraft.router,
    carriers.router,
    ephemeris.router,
    sources.router,
    inputs.router,
    operations.router,
    calibrations.router,
    alignments.router,
    harmonics.router,
    carrier_selection.router,
    status.router,
    measurements.router,
    traces.router,
    attitude.router,
    torques.router,
    stream.router,
    export.router,
    replays.router,
    jobs.router,
    links.report_router,
    links.router,
)
PUBLIC_ROUTERS: tuple[APIRouter, ...] = (health.router,)
