"""Rate limits: token buckets by key and class of request, and by address for those who have no key.

A bucket holds up to ``burst`` tokens and gains ``per_s`` of them a second; a request takes one. The defaults are far
above what operation needs: they stop a program that runs wild, not people at work.
"""

import math
import time
import zlib
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from http import HTTPStatus
from typing import NamedTuple

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.problems.problems import RequestProblemError, render
from service.records.setting import CHOSEN, setting

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


#: addresses remembered at once; the one longest unheard of goes first
MAX_ADDRESSES = 4096
_SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS"})
#: ends of the paths that stations send to
_INGEST_ENDS = (":batch", ":report", "/traces")
#: ends of the paths that may read the whole archive
_EXPORT_ENDS = (":export", ":manifest")


class RateClass(StrEnum):
    """Rate class of a request by its approximate cost."""

    INGEST = "ingest"
    READ = "read"
    EXPORT = "export"
    CONTROL = "control"
    #: without a valid key, by address
    ANONYMOUS = "anonymous"
    #: files of the console, by address: a page is some dozens of them, and operators may share an address
    STATIC = "static"


@dataclass(frozen=True, slots=True)
class RateLimitConfig:
    """Requests a second and burst of each class; 0 a second = no limit."""

    ingest_per_s: float = setting(
        5000.0, "batches, traces and reports of stations: requests a second of one key; 0 = no limit", CHOSEN
    )
    ingest_burst: int = setting(10_000, "the same: requests at once", CHOSEN)
    read_per_s: float = setting(500.0, "what is read: requests a second of one key; 0 = no limit", CHOSEN)
    read_burst: int = setting(2000, "the same: requests at once", CHOSEN)
    export_per_s: float = setting(10.0, "exports: requests a second of one key; 0 = no limit", CHOSEN)
    export_burst: int = setting(100, "the same: requests at once", CHOSEN)
    control_per_s: float = setting(50.0, "every other change: requests a second of one key; 0 = no limit", CHOSEN)
    control_burst: int = setting(1000, "the same: requests at once", CHOSEN)
    anonymous_per_s: float = setting(
        20.0, "requests without a valid key, by address: requests a second; 0 = no limit", CHOSEN
    )
    anonymous_burst: int = setting(200, "the same: requests at once", CHOSEN)
    static_per_s: float = setting(200.0, "files of the console, by address: requests a second; 0 = no limit", CHOSEN)
    static_burst: int = setting(2000, "the same: requests at once", CHOSEN)


class Allowance(NamedTuple):
    """Answer of a token bucket to one request."""

    is_allowed: bool
    limit: int
    remaining: int
    #: until the bucket is full again, or until the next token when the request is refused
    reset_s: int


class Bucket:
    """One token bucket.

    Parameters
    ----------
    per_s : float
        Tokens gained a second.
    burst : int
        Tokens held at most; a bucket starts full.
    now_s : float
        Monotonic time.
    """

    __slots__ = ("_burst", "_per_s", "_tokens", "_touched_s")

    def __init__(self, per_s: float, burst: int, now_s: float) -> None:
        self._per_s = per_s
        self._burst = max(burst, 1)
        self._tokens = float(self._burst)
        self._touched_s = now_s

    def consume(self, now_s: float) -> Allowance:
        """Take a token when there is one."""
        gained = (now_s - self._touched_s) * self._per_s
        self._tokens = min(self._tokens + gained, self._burst)
        self._touched_s = now_s
        if self._tokens < 1.0:
            return Allowance(False, self._burst, 0, math.ceil((1.0 - self._tokens) / self._per_s))
        self._tokens -= 1.0
        return Allowance(True, self._burst, int(self._tokens), math.ceil((self._burst - self._tokens) / self._per_s))


class RateLimits:
    """The buckets of one process.

    Parameters
    ----------
    config : RateLimitConfig
        Rates and bursts.
    monotonic_s : callable
        Gives the time.
    """

    def __init__(self, config: RateLimitConfig, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._monotonic_s = monotonic_s
        self._rates = {
            each: (float(getattr(config, f"{each}_per_s")), int(getattr(config, f"{each}_burst"))) for each in RateClass
        }
        #: of keys; only valid ones get here, so there are no more than keys times classes
        self._keys: dict[tuple[str, RateClass], Bucket] = {}
        self._addresses: OrderedDict[tuple[str, RateClass], Bucket] = OrderedDict()

    def consume(self, key_id: str, wanted: RateClass) -> Allowance | None:
        """Count a request of a key; None where there is no limit."""
        per_s, burst = self._rates[wanted]
        if per_s <= 0:
            return None
        now_s = self._monotonic_s()
        bucket = self._keys.get((key_id, wanted))
        if bucket is None:
            bucket = self._keys[key_id, wanted] = Bucket(per_s, burst, now_s)
        return bucket.consume(now_s)

    def consume_anonymous(self, address: str, wanted: RateClass = RateClass.ANONYMOUS) -> Allowance | None:
        """Count a request without a valid key; None where there is no limit."""
        per_s, burst = self._rates[wanted]
        if per_s <= 0:
            return None
        now_s = self._monotonic_s()
        name = network_of(address), wanted
        bucket = self._addresses.pop(name, None) or Bucket(per_s, burst, now_s)
        self._addresses[name] = bucket
        if len(self._addresses) > MAX_ADDRESSES:
            self._addresses.popitem(last=False)
        return bucket.consume(now_s)


def class_of(method: str, path: str) -> RateClass:
    """Return the class of a request that has a key.

    Examples
    --------
    >>> str(class_of("POST", "/api/v1/spacecraft/a/measurements:batch"))
    'ingest'
    """
    if method in _SAFE_METHODS:
        return RateClass.EXPORT if path.endswith(_EXPORT_ENDS) else RateClass.READ
    return RateClass.INGEST if path.endswith(_INGEST_ENDS) else RateClass.CONTROL


def network_of(address: str) -> str:
    """Return what is counted as one client: an IPv4 address, or the /64 of an IPv6 address.

    Examples
    --------
    >>> network_of("2001:db8:1:2:3:4:5:6"), network_of("192.0.2.7")
    ('2001:db8:1:2', '192.0.2.7')
    """
    if ":" not in address or "." in address:
        return address
    head, _, tail = address.partition("::")
    groups = head.split(":") if head else []
    missing = 8 - len(groups) - (len(tail.split(":")) if tail else 0)
    return ":".join([*groups, *["0"] * missing][:4])
