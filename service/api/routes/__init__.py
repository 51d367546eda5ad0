"""Routes, one resource a file. ``ROUTERS`` stand under the base path and need a key, ``PUBLIC_ROUTERS`` do neither."""

from fastapi import APIRouter

from service.api.routes import carriers, ephemeris, health, inputs, measurements_ingest, operations, sources, spacecraft

ROUTERS: tuple[APIRouter, ...] = (
    spacecraft.router,
    carriers.router,
    ephemeris.router,
    measurements_ingest.router,
    sources.router,
    inputs.router,
    operations.router,
)
PUBLIC_ROUTERS: tuple[APIRouter, ...] = (health.router,)
