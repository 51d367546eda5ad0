"""Events of a stream: lines become events, ends of connections become waits, and the last id goes along.

Law of this file: it reads nothing and waits for nothing; both transports feed it.
"""

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, cast

import httpx

from service.client.backoff import Backoff
from service.client.call import LONGEST_WAIT_S
from service.client.problem import ServiceUnavailableError

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
