"""One request as a value, and when it may be sent again; both clients send these, one waits and one awaits.

Law of this file: GET, PUT and DELETE are repeated, and POSTs that the service keys by content (``:batch``); any other
POST only when the connection was never made. A request that may have been carried out is never sent twice.
"""

import json
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, Literal, TypeVar, cast

import httpx

from service.client.backoff import Backoff
from service.client.documents import JobReply, Json
from service.client.problem import ClientError, ServiceUnavailableError, error_of
from service.records.epoch import format_epoch

EventKind = Literal[
    "measurement", "attitude", "torque", "alarm", "status", "command", "job", "link", "note", "smoothed", "dropped"
]
STREAM_HEADERS = {"Accept": "text/event-stream", "Cache-Control": "no-store"}
#: the service says something every 15 s; a connection that is silent for three times as long is dead
SILENCE_S = 45.0


@dataclass(frozen=True, slots=True)
class StreamEvent:
    """One event of a stream."""

    #: give it to ``stream(last_event_id=...)`` to go on behind this event
    id: str
    kind: EventKind
    #: the document that the REST interface tells for the same thing; of attitude with the carriers of the row
    data: dict[str, Any]


@dataclass
class Follower:
    """State of one reader of a stream across its connections.

    Parameters
    ----------
    last_event_id : str or None
        Where to go on; None: with the present.
    patience_s : float or None
        How long the service may be away at a stretch; None: for ever.
    clock : callable
        Monotonic seconds.
    """

    last_event_id: str | None = None
    patience_s: float | None = None
    clock: Callable[[], float] = time.monotonic
    _rest: bytes = b""
    _fields: dict[str, str] = field(default_factory=dict)
    _data: list[str] = field(default_factory=list)
    _backoff: Backoff = field(default_factory=lambda: Backoff(first_s=0.2, limit_s=15.0))
    _away_since_s: float | None = None

    def headers(self) -> dict[str, str]:
        """Return the headers that make the service go on where the reader is; what was cut off is forgotten."""
        self._rest, self._fields, self._data = b"", {}, []
        return STREAM_HEADERS if self.last_event_id is None else {**STREAM_HEADERS, "Last-Event-ID": self.last_event_id}

    def timeout(self, usual: httpx.Timeout) -> httpx.Timeout:
        """Return the time-outs of a connection: silence is longer than for other answers."""
        return httpx.Timeout(connect=usual.connect, write=usual.write, pool=usual.pool, read=SILENCE_S)

    def consume(self, chunk: bytes) -> Iterator[StreamEvent]:
        """Consume received bytes and yield the events that they complete.

        Lines end with a line feed only: texts may hold other characters that some call ends of lines.
        """
        *lines, self._rest = (self._rest + chunk).split(b"\n")
        for line in lines:
            event = self._read_line(line.removesuffix(b"\r").decode())
            if event is not None:
                yield event

    def _read_line(self, line: str) -> StreamEvent | None:
        """Take one line without its end and return the event that it completes, if any."""
        if line:
            self._read_field(line)
            return None
        fields, data = self._fields, self._data
        self._fields, self._data = {}, []
        # an id alone: of events that were not chosen
        self.last_event_id = fields.get("id", self.last_event_id)
        if not data:
            return None
        self._backoff.reset()
        self._away_since_s = None
        kind = cast("EventKind", fields.get("event", "message"))
        return StreamEvent(self.last_event_id or "", kind, json.loads("\n".join(data)))

    def wait_after(self, fault: ServiceUnavailableError) -> float:
        """Return how long to wait before the next connection, s; raise the fault when patience has ended."""
        now_s = self.clock()
        if self._away_since_s is None:
            self._away_since_s = now_s
        if self.patience_s is not None and now_s - self._away_since_s > self.patience_s:
            raise fault
        return min(fault.retry_after_s or self._backoff.next_s(), LONGEST_WAIT_S)

    def _read_field(self, line: str) -> None:
        """Keep one field; comments keep the connection alive and say nothing."""
        name, _, value = line.partition(":")
        value = value.removeprefix(" ")
        if name == "data":
            self._data.append(value)
        elif name:
            self._fields[name] = value


Result = TypeVar("Result")
#: RFC 3339 text or int64 microseconds UTC
Epoch = str | int

#: base path of the API, version 1
BASE_PATH = "/api/v1"
#: what stands outside of it
_OUTSIDE = frozenset({"/healthz", "/readyz", "/metrics", "/openapi.json"})
_REPEATABLE = frozenset({"GET", "HEAD", "PUT", "DELETE"})
#: no answer makes a client wait longer than this before it tries again, s
LONGEST_WAIT_S = 60.0


def epoch_text(epoch: Epoch) -> str:
    """Return RFC 3339 text of an epoch given as text or as microseconds UTC."""
    return format_epoch(epoch) if isinstance(epoch, int) else epoch


@dataclass(frozen=True, slots=True)
class Call(Generic[Result]):
    """One request; ``Result`` is what its answer holds.

    Parameters
    ----------
    method : str
        HTTP method.
    path : str
        Below ``/api/v1`` unless it names one of the endpoints outside (``/healthz``).
    body : mapping, optional
        Sent as JSON; NaN is refused here already.
    params : mapping
        Query; None values are left out.
    is_keyed : bool
        The service recognises a repetition of this request by its content.
    member : str
        Member of the answer that is returned; empty: the whole answer.
    """

    method: str
    path: str
    body: Mapping[str, Any] | None = None
    params: Mapping[str, Any] = field(default_factory=dict)
    is_keyed: bool = False
    member: str = ""

    @property
    def url(self) -> str:
        """Path on the server."""
        return self.path if self.path in _OUTSIDE else BASE_PATH + self.path

    @property
    def query(self) -> dict[str, Any]:
        """Parameters that are set, epochs as text."""
        return {name: value for name, value in self.params.items() if value is not None}

    @property
    def content(self) -> bytes | None:
        """Body as it is sent."""
        if self.body is None:
            return None
        return json.dumps(self.body, allow_nan=False, separators=(",", ":")).encode()

    @property
    def headers(self) -> dict[str, str]:
        """Headers of its own."""
        return {} if self.body is None else {"Content-Type": "application/json"}

    @property
    def is_safe(self) -> bool:
        """Return whether sending it twice does what sending it once does."""
        return self.is_keyed or self.method in _REPEATABLE


class Attempts:
    """Decides after a failed attempt whether there is another one, and when.

    Parameters
    ----------
    is_safe : bool
        Whether a request that may have been carried out may be repeated.
    retries : int
        Further attempts after the first.
    first_wait_s : float
        Waiting time before the second attempt; doubles.
    """

    def __init__(self, retries: int, first_wait_s: float, *, is_safe: bool) -> None:
        self._left = retries
        self._is_safe = is_safe
        self._backoff = Backoff(first_s=first_wait_s, limit_s=10.0)

    def wait_after(self, error: ServiceUnavailableError) -> float:
        """Return how long to wait before the next attempt, s; raise the error when there is none."""
        was_never_sent = isinstance(error.__cause__, httpx.ConnectError)
        if self._left == 0 or not (self._is_safe or was_never_sent):
            raise error
        self._left -= 1
        return min(error.retry_after_s or self._backoff.next_s(), LONGEST_WAIT_S)


def page_of(path: str, params: Mapping[str, Any] | None, cursor: str | None) -> Call[Any]:
    """Return the request for one page of a list."""
    return Call("GET", path, params={**(params or {}), "cursor": cursor})


def decoded(response: httpx.Response, member: str = "") -> Any:
    """Return the JSON of an answer, or a member of it; None for an empty one.

    Raises
    ------
    ProblemError
        The service refused.
    ServiceUnavailableError
        Try later, or the answer is not JSON.
    """
    if not response.is_success:
        raise error_of(response)
    if not response.content:
        return None
    try:
        answer = response.json()
    except ValueError as error:
        message = f"{response.request.url} answered {response.status_code} with something that is not JSON"
        raise ServiceUnavailableError(message, response.status_code) from error
    return answer[member] if member else answer


def no_answer(address: object, method: str, url: str, error: httpx.TransportError) -> ServiceUnavailableError:
    """Return the error that a request without an answer stands for."""
    what = type(error).__name__
    return ServiceUnavailableError(f"no answer from {address} to {method} {url}: {what} {error}".rstrip())


def broke_off(path: str, error: httpx.TransportError) -> ServiceUnavailableError:
    """Return the error of a download that ended before its end."""
    return ServiceUnavailableError(f"the download of {path} broke off: {type(error).__name__} {error}".rstrip())


def default_headers(key: str | None) -> dict[str, str]:
    """Return the headers of every request."""
    headers = {"Accept": "application/json", "User-Agent": "soo-client/1"}
    return {**headers, "Authorization": f"Bearer {key}"} if key else headers


def given(**members: Any) -> Json:
    """Return the members that are not None."""
    return {name: value for name, value in members.items() if value is not None}


def epochs(**epochs: Epoch | None) -> Json:
    """Return the epochs that are given, as text."""
    return {name: epoch_text(at) for name, at in epochs.items() if at is not None}


def window(start: Epoch | None, stop: Epoch | None, limit: int) -> Json:
    """Return the query of a history."""
    return {**epochs(start=start, stop=stop), "limit": limit}


class JobFailedError(ClientError):
    """A job of the service ended with an error, or made no progress for long."""


class JobWatch:
    """Judges one look at a job after another.

    Parameters
    ----------
    job_id : str
        Names the job in errors.
    timeout_s : float
        Bound on the wait without progress: a replay of years takes longer than any bound on the whole.
    on_progress : callable, optional
        Gets the progress 0..1 at every look.
    """

    def __init__(self, job_id: str, timeout_s: float, on_progress: Callable[[float], None] | None) -> None:
        self._job_id = job_id
        self._timeout_s = timeout_s
        self._deadline_s = time.monotonic() + timeout_s
        self._on_progress = on_progress
        self._progress = 0.0

    def is_done(self, job: JobReply) -> bool:
        """Return whether a job is done; JobFailedError when it failed or stands still."""
        progress = float(job.get("progress") or 0.0)
        if progress > self._progress:
            self._progress, self._deadline_s = progress, time.monotonic() + self._timeout_s
        if self._on_progress is not None:
            self._on_progress(progress)
        if job["state"] == "failed":
            message = f"job {self._job_id} failed: {job.get('error')}"
            raise JobFailedError(message)
        if job["state"] != "done" and time.monotonic() > self._deadline_s:
            message = f"job {self._job_id} is {job['state']}, without progress for {self._timeout_s:g} s"
            raise JobFailedError(message)
        return job["state"] == "done"
