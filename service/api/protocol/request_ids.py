"""Request ids: the outermost layer of the interface.

Every request has an id, taken from ``X-Request-ID`` when that is harmless to log, and every answer names it. What the
inside did not expect ends here as a 500 that tells the id and nothing else.
"""

import itertools
import logging
import re
import secrets
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems.problems import RequestProblemError, render
from service.records.operations.access_key import without_secrets
from service.runtime.log_format import REQUEST_ID

_HEADER = "X-Request-ID"
_HARMLESS = re.compile(r"[A-Za-z0-9._:-]{1,64}", re.ASCII)
_LOG = logging.getLogger(__name__)
#: fresh ids count up behind a start of their own: they need to differ, and asking the system for noise costs a request
#: the interpreter's lock, which beside a busy writer takes milliseconds to come back
_START = secrets.token_hex(4)
_NUMBERS = itertools.count(1)


class RequestIds:
    """Give each request an id and answer what nobody else answered.

    Parameters
    ----------
    app : ASGIApp
        What lies inside.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _request_id(scope)
        scope.setdefault("state", {})["request_id"] = request_id
        token = REQUEST_ID.set(request_id)
        is_answered = False

        async def send_with_id(message: Message) -> None:
            nonlocal is_answered
            if message["type"] == "http.response.start":
                is_answered = True
                MutableHeaders(scope=message)[_HEADER] = request_id
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            # the last layer catches all: it logs and answers, or lets the server cut the connection
            _LOG.exception("request %s %s %s failed", request_id, scope["method"], without_secrets(scope["path"]))
            if is_answered:
                raise
            detail = f"the service failed; its log has the reason under request id {request_id}"
            problem = RequestProblemError(HTTPStatus.INTERNAL_SERVER_ERROR, "service.failed", detail)
            await render(HTTPConnection(scope), problem)(scope, receive, send_with_id)
        finally:
            REQUEST_ID.reset(token)


def _request_id(scope: Scope) -> str:
    """Return the id that came with a request when it is harmless, otherwise a fresh one."""
    offered = Headers(scope=scope).get(_HEADER, "")
    return offered if _HARMLESS.fullmatch(offered) else f"{_START}{next(_NUMBERS):08x}"
