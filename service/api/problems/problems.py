"""Problems: the one shape in which the interface says that something went wrong (RFC 9457).

Every answer with a status of 400 or more is made here. ``code`` is stable and machine-readable; when exactly one field
is at fault, it is the code of that fault, otherwise ``request.invalid``. A problem never carries a body: it may hold
keys, and it may be large. A key that stands in a path is left out.
"""

from collections.abc import Mapping, Sequence
from http import HTTPStatus

from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.requests import HTTPConnection

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
from service.records.operations.access_key import without_secrets

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
