"""Reading by pages of other origins: the origins of a list, GET and HEAD, Bearer key.

The answer to an origin that is not listed, and to a method that changes something, has no header of this protocol, so
the browser keeps it from the page. Cookies are never admitted: no answer has ``Access-Control-Allow-Credentials``.
"""

import re
from collections.abc import Sequence

from starlette.datastructures import Headers
from starlette.middleware.cors import CORSMiddleware
from starlette.types import ASGIApp, Receive, Scope, Send

_METHODS = ("GET", "HEAD")
#: headers of answers that a page may read besides those that every page may
_EXPOSED = ("ETag", "RateLimit-Limit", "RateLimit-Remaining", "RateLimit-Reset", "Retry-After", "X-Request-ID")
#: as browsers send it: lower case, no default port, no path
_ORIGIN = re.compile(r"(?!http:.*:80$|https:.*:443$)https?://(?:[a-z0-9_.-]+|\[[0-9a-f:]+\])(?::[0-9]{1,5})?", re.ASCII)


def origins_of(text: str | None) -> tuple[str, ...]:
    """Return the origins of a list by commas; ValueError for a part that no browser sends as ``Origin``."""
    origins = tuple(part.strip() for part in (text or "").split(",") if part.strip())
    for origin in origins:
        if not _ORIGIN.fullmatch(origin):
            message = (
                f"{origin!r} is not an origin as browsers send it; write scheme, host in lower case and the port "
                "unless it is the default one, without a path: https://grafana.example or http://localhost:3000"
            )
            raise ValueError(message)
    return origins


class CrossOriginReading:
    """Let pages of listed origins read; the outermost layer, so that 401, 429 and 500 are readable too.

    Parameters
    ----------
    app : ASGIApp
        What lies inside.
    origins : sequence of str
        Origins as `origins_of` returns them; none: nothing is admitted.
    """

    def __init__(self, app: ASGIApp, origins: Sequence[str]) -> None:
        self._app = app
        self._origins = frozenset(origins)
        # a GET may carry any header: what a header may do is decided by its reader
        self._admitting = CORSMiddleware(
            app, allow_origins=origins, allow_methods=_METHODS, allow_headers=("*",), expose_headers=_EXPOSED
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        is_admitted = scope["type"] == "http" and self._is_admitted(scope["method"], Headers(scope=scope))
        await (self._admitting if is_admitted else self._app)(scope, receive, send)

    def _is_admitted(self, method: str, headers: Headers) -> bool:
        """Return whether a request reads, or asks whether it may, from a listed origin."""
        asked = headers.get("access-control-request-method", "") if method == "OPTIONS" else method
        return headers.get("origin") in self._origins and asked in _METHODS
