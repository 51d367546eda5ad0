"""One set of routes for all applications of a session."""

from fastapi import APIRouter, FastAPI

_ROUTERS: list[APIRouter] = []


def with_shared_routes(app: FastAPI) -> FastAPI:
    """Return an application with the routes of the first one.

    Routes know no application; FastAPI works out their hundred dependencies at the first request of each application,
    which takes longer than most tests of the interface.
    """
    if not _ROUTERS:
        _ROUTERS.append(app.router)
    app.router = _ROUTERS[0]
    return app
