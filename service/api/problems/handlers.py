"""Handlers: every exception that leaves a route becomes a problem here.

What no handler knows is caught by the request-id layer (``request_ids.py``), logged with its traceback and answered
with a 500 that says nothing of the inside.
"""

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from service.api.problems.problems import RequestProblemError, from_soo_error, invalid_request, render
from service.api.problems.validation_errors import faults_of
from service.errors import SooError

_HTTP_CODES = {
    HTTPStatus.NOT_FOUND: ("path.unknown", "there is no such path"),
    HTTPStatus.METHOD_NOT_ALLOWED: (
        "method.not_allowed",
        "this path does not support this method",
    ),
}


def add_handlers(app: FastAPI) -> None:
    """Register the handlers of all exceptions that this interface expects."""
    app.add_exception_handler(RequestProblemError, _on_problem)
    app.add_exception_handler(SooError, _on_soo_error)
    app.add_exception_handler(RequestValidationError, _on_parameters)
    app.add_exception_handler(HTTPException, _on_http)
    app.add_exception_handler(ClientDisconnect, _on_disconnect)


async def _on_problem(request: Request, error: Any) -> Response:
    return render(request, error)


async def _on_soo_error(request: Request, error: Any) -> Response:
    return render(request, from_soo_error(error))


async def _on_parameters(request: Request, error: Any) -> Response:
    return render(request, invalid_request(faults_of(error.errors())))


async def _on_http(request: Request, error: Any) -> Response:
    status = HTTPStatus(error.status_code)
    code, detail = _HTTP_CODES.get(status, ("request.refused", str(error.detail)))
    return render(request, RequestProblemError(status, code, detail, headers=error.headers))


async def _on_disconnect(request: Request, _error: Any) -> Response:
    detail = "the connection closed before the body was complete"
    return render(request, RequestProblemError(HTTPStatus.BAD_REQUEST, "body.incomplete", detail))
