"""Session of a browser: a key in, a cookie out; who holds the key of this request."""

from http import HTTPStatus
from ipaddress import ip_address
from typing import Annotated

from fastapi import APIRouter, Request, Response

from service.api.access.audit_context import address_of
from service.api.access.auth import CurrentPrincipal, holder_of, refusal_of_key
from service.api.access.session_cookie import close_session, offered_key, open_session
from service.api.context.dependencies import Context
from service.api.problems.problems import RequestProblemError
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.session import SessionAnswer, SessionDocument

router = APIRouter(prefix="/api/v1/session", tags=["access"])


@router.post("", openapi_extra=accepts(SessionDocument))
async def open_browser_session(
    body: Annotated[SessionDocument, body_of(SessionDocument)], context: Context, request: Request, response: Response
) -> SessionAnswer:
    """Open a session: the answer sets a cookie that carries the key for twelve hours, or until the key expires."""
    if not (request.url.scheme == "https" or context.limits.plain_sessions or _is_loopback(request)):
        detail = "a key would cross the network unprotected"
        raise RequestProblemError(HTTPStatus.FORBIDDEN, "session.plain_http", detail)
    principal = await holder_of(request, body.key)
    if principal is None:
        raise refusal_of_key("this key is not known, expired or revoked")
    ends_at_us = open_session(request, response, principal, body.key, context.clock.system_us())
    response.headers["Cache-Control"] = "no-store"
    return SessionAnswer.of(principal, ends_at_us)


@router.get("")
async def get_session(principal: CurrentPrincipal, request: Request, response: Response) -> SessionAnswer:
    """Return who holds the key of this request, what it may do, and until when."""
    offered = offered_key(request)
    response.headers["Cache-Control"] = "no-store"
    return SessionAnswer.of(principal, None if offered is None else offered.ends_at_us)


@router.delete("", status_code=HTTPStatus.NO_CONTENT)
async def close_browser_session(_: CurrentPrincipal, request: Request, response: Response) -> None:
    """Close the session: the cookie is taken away; the key stays valid."""
    close_session(request, response)


def _is_loopback(request: Request) -> bool:
    """Return whether a request comes from this machine."""
    try:
        return ip_address(address_of(request.scope)).is_loopback
    except ValueError:
        return False
