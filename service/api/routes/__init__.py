"""Routes, one resource a file. ``ROUTERS`` stand under the base path and need a key, ``PUBLIC_ROUTERS`` do neither."""

from fastapi import APIRouter

from service.api.routes import health, spacecraft

ROUTERS: tuple[APIRouter, ...] = (spacecraft.router,)
PUBLIC_ROUTERS: tuple[APIRouter, ...] = (health.router,)
