"""Body limit: no request makes the service hold more than the limit, packed or unpacked.

Sizes are counted as bytes arrive, so a body without a length or with a false one is stopped all the same. Bodies with
``Content-Encoding: gzip`` are unpacked here, never further than one byte beyond the limit, nor beyond a hundred times
what came, and the inside sees a plain body.
"""

import zlib
from http import HTTPStatus

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems.problems import RequestProblemError, render

#: zlib's word for "expect a gzip header"
_GZIP_WBITS = 16 + zlib.MAX_WBITS
#: rows of measured powers pack to a fifth; a body that packs further holds zeros
MAX_RATIO = 100
#: unpacked whatever the ratio
_FREE_BYTES = 256 * 1024
#: unpacked between two looks at the ratio
_STEP_BYTES = 64 * 1024


class BodyLimit:
    """Refuse bodies above a size and unpack gzip.

    Parameters
    ----------
    app : ASGIApp
        What lies inside.
    max_body_bytes : int
        Greatest size of a body, before and after unpacking.
    """

    def __init__(self, app: ASGIApp, max_body_bytes: int) -> None:
        self._app = app
        self._max_body_bytes = max_body_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        encoding = headers.get("content-encoding", "identity").strip().lower()
        problem = self._refusal(headers.get("content-length", ""), encoding)
        if problem is not None:
            await render(HTTPConnection(scope), problem)(scope, receive, send)
            return
        unpacker = None
        if encoding in {"gzip", "x-gzip"}:
            unpacker = _Unpacker(self._max_body_bytes)
            mutable = MutableHeaders(scope=scope)
            del mutable["content-encoding"]
            del mutable["content-length"]
        await self._app(scope, _Counter(receive, self._max_body_bytes, unpacker), send)

    def _refusal(self, length: str, encoding: str) -> RequestProblemError | None:
        """Return why a request is refused by its headers alone."""
        if encoding not in {"identity", "gzip", "x-gzip", ""}:
            detail = "Content-Encoding may be gzip or identity"
            status = HTTPStatus.UNSUPPORTED_MEDIA_TYPE
            return RequestProblemError(status, "encoding.unsupported", detail, headers={"Accept-Encoding": "gzip"})
        if length.isascii() and length.isdigit() and int(length[:20]) > self._max_body_bytes:
            return too_large(self._max_body_bytes)
        return None


class _Counter:
    """Receive channel that counts the bytes of the body."""

    def __init__(self, receive: Receive, max_body_bytes: int, unpacker: "_Unpacker | None") -> None:
        self._receive = receive
        self._max_body_bytes = max_body_bytes
        self._unpacker = unpacker
        self._received_bytes = 0

    async def __call__(self) -> Message:
        """Return the next message."""
        message = await self._receive()
        if message["type"] != "http.request":
            return message
        body = message.get("body", b"")
        self._received_bytes += len(body)
        if self._received_bytes > self._max_body_bytes:
            raise too_large(self._max_body_bytes)
        if self._unpacker is None:
            return message
        is_last = not message.get("more_body", False)
        return {**message, "body": self._unpacker.unpack(body, is_last=is_last)}


class _Unpacker:
    """Gzip unpacked piece by piece, members one after another."""

    def __init__(self, max_body_bytes: int) -> None:
        self._member = zlib.decompressobj(_GZIP_WBITS)
        self._left = max_body_bytes
        #: what the ratio yet allows
        self._allowed = _FREE_BYTES
        self._max_body_bytes = max_body_bytes
        self._is_started = False

    def unpack(self, packed: bytes, *, is_last: bool) -> bytes:
        """Return the unpacked bytes of a chunk."""
        chunks, is_pending = [], False
        while packed or is_pending:
            if self._member.eof:
                self._member = zlib.decompressobj(_GZIP_WBITS)
            self._is_started = True
            chunk = self._next(packed)
            chunks.append(chunk)
            rest = self._member.unconsumed_tail or self._member.unused_data
            self._left -= len(chunk)
            self._allowed += MAX_RATIO * (len(packed) - len(rest)) - len(chunk)
            if self._left < 0:
                raise too_large(self._max_body_bytes)
            if self._allowed < 0:
                detail = f"the body unpacks to more than {MAX_RATIO} times its size"
                raise RequestProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body.gzip_ratio", detail)
            # what was read may hold more than a step
            packed, is_pending = rest, len(chunk) == _STEP_BYTES and not self._member.eof
        if is_last and self._is_started and not self._member.eof:
            raise _broken_gzip()
        return b"".join(chunks)

    def _next(self, packed: bytes) -> bytes:
        """Return some more, at most one byte beyond the limit: what packs too far is found out soon."""
        try:
            return self._member.decompress(packed, min(self._left + 1, _STEP_BYTES))
        except zlib.error:
            raise _broken_gzip() from None


def too_large(max_body_bytes: int) -> RequestProblemError:
    """Return the problem of a body above the limit."""
    detail = f"the body exceeds the limit of {max_body_bytes} bytes (after unpacking)"
    return RequestProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body.too_large", detail)


def _broken_gzip() -> RequestProblemError:
    """Return the problem of a body that gzip cannot unpack."""
    detail = "the body is not whole gzip data although Content-Encoding says so"
    return RequestProblemError(HTTPStatus.BAD_REQUEST, "body.gzip", detail)
