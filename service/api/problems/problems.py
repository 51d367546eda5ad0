"""Problems: the one shape in which the interface says that something went wrong (RFC 9457)."""

from collections.abc import Mapping, Sequence
from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, HTTPConnection

from service.api.problems.next_steps import NEXT_STEPS
from service.errors import (
    BusyError,
    ConflictError,
    FieldError,
    ForbiddenError,
    GoneError,
    InvalidInputError,
    NotFoundError,
    SooError,
    StorageError,
    UnavailableError,
)
from service.records.field_faults import fault_sentence
from service.records.operations.access import without_secrets

PROBLEM_MEDIA_TYPE = "application/problem+json"
#: seconds after which a client may try again when the archive was not ready, and when too much was computed
RETRY_AFTER_S = 5
_RETRIED = frozenset({HTTPStatus.TOO_MANY_REQUESTS, HTTPStatus.SERVICE_UNAVAILABLE})

_STATUS_OF: tuple[tuple[type[SooError], int], ...] = (
    (ForbiddenError, HTTPStatus.FORBIDDEN),
    (NotFoundError, HTTPStatus.NOT_FOUND),
    (ConflictError, HTTPStatus.CONFLICT),
    (GoneError, HTTPStatus.GONE),
    (InvalidInputError, HTTPStatus.UNPROCESSABLE_ENTITY),
    (BusyError, HTTPStatus.TOO_MANY_REQUESTS),
    (UnavailableError, HTTPStatus.SERVICE_UNAVAILABLE),
    (StorageError, HTTPStatus.SERVICE_UNAVAILABLE),
)


class FaultSchema(BaseModel):
    """One fault in one field."""

    pointer: str = Field(description="JSON pointer into the body; parameters stand under /query, /path and /header")
    code: str
    detail: str


class ProblemSchema(BaseModel):
    """Problem of RFC 9457; its media type is application/problem+json."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    next_step: str = Field(description="What to do next; the same for every problem of this code.")
    request_id: str
    errors: list[FaultSchema]


class RequestProblemError(Exception):
    """A request that the interface itself refuses.

    Parameters
    ----------
    status : int
        HTTP status.
    code : str
        Stable machine-readable code.
    detail : str
        What happened, to which thing; `NEXT_STEPS` has what to do next.
    fields : sequence of FieldError
        The faulty fields.
    headers : mapping, optional
        Further headers of the answer.
    """

    def __init__(
        self,
        status: int,
        code: str,
        detail: str,
        fields: Sequence[FieldError] = (),
        headers: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(f"{status} {code}: {detail}")
        self.status = status
        self.code = code
        self.detail = detail
        self.fields = tuple(fields)
        self.headers = dict(headers or {})


def invalid_request(fields: Sequence[FieldError]) -> RequestProblemError:
    """Return the 422 that names faulty fields."""
    if len(fields) == 1:
        return RequestProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, fields[0].code, fields[0].detail, fields)
    detail = f"{len(fields)} fields of the request are invalid"
    return RequestProblemError(HTTPStatus.UNPROCESSABLE_ENTITY, "request.invalid", detail, fields)


def from_soo_error(error: SooError) -> RequestProblemError:
    """Return the problem that tells an error of the service."""
    status = next((status for kind, status in _STATUS_OF if isinstance(error, kind)), HTTPStatus.INTERNAL_SERVER_ERROR)
    headers = {"Retry-After": str(RETRY_AFTER_S)} if status in _RETRIED else None
    return RequestProblemError(status, error.code, error.detail, error.fields, headers)


def request_id_of(connection: HTTPConnection) -> str:
    """Return the id under which a request is logged and answered."""
    return str(connection.scope.get("state", {}).get("request_id", ""))


def render(connection: HTTPConnection, error: RequestProblemError) -> JSONResponse:
    """Return the answer that carries a problem."""
    content = {
        "type": f"urn:soo:problem:{error.code}",
        "title": HTTPStatus(error.status).phrase,
        "status": int(error.status),
        "detail": without_secrets(error.detail),
        "code": error.code,
        "next_step": NEXT_STEPS.get(error.code, ""),
        "request_id": request_id_of(connection),
        "errors": [{"pointer": f.pointer, "code": f.code, "detail": without_secrets(f.detail)} for f in error.fields],
    }
    return JSONResponse(content, status_code=int(error.status), headers=error.headers, media_type=PROBLEM_MEDIA_TYPE)


#: an answer names at most so many faults; the rest would only make it long
MAX_FAULTS = 50

_CODE_OF = {
    "extra_forbidden": "field.unknown",
    "missing": "field.missing",
    "finite_number": "value.not_finite",
    "too_short": "value.length",
    "too_long": "value.length",
    "string_too_short": "value.length",
    "string_too_long": "value.length",
    "string_pattern_mismatch": "value.pattern",
    "literal_error": "value.choice",
    "enum": "value.choice",
    "greater_than": "value.range",
    "greater_than_equal": "value.range",
    "less_than": "value.range",
    "less_than_equal": "value.range",
    "int_parsing_size": "value.range",
}


def faults_of(errors: Sequence[Mapping[str, Any]], prefix: str = "") -> tuple[FieldError, ...]:
    """Return the field errors of a pydantic validation, the first ``MAX_FAULTS`` of them."""
    shown = errors[:MAX_FAULTS]
    return tuple(_fault(error, prefix) for error in shown if not _is_echo(error, shown))


def _is_echo(error: Mapping[str, Any], errors: Sequence[Mapping[str, Any]]) -> bool:
    """Return whether a sequence is called too short only because its elements failed and were not counted."""
    position = tuple(error["loc"])
    if error["type"] != "too_short":
        return False
    return any(
        len(other["loc"]) > len(position) and tuple(other["loc"])[: len(position)] == position for other in errors
    )


def pointer_of(location: Sequence[str | int]) -> str:
    """Return the JSON pointer of RFC 6901 to a place.

    Examples
    --------
    >>> pointer_of(("carriers", 3, "a/b"))
    '/carriers/3/a~1b'
    """
    return "".join(f"/{str(part).replace('~', '~0').replace('/', '~1')[:100]}" for part in location)


def _fault(error: Mapping[str, Any], prefix: str) -> FieldError:
    kind = str(error["type"])
    code = kind if "." in kind else _CODE_OF.get(kind, "value.type")
    return FieldError(prefix + pointer_of(error["loc"]), code, fault_sentence(error))


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
