"""A server of the live stream in a thread, a reader of its events, and a source that plays the supervisor."""

import json
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import httpx
import pytest
import uvicorn
from waiting import wait_until

from service.api.server_process import StreamingServer
from service.ports.archive import Outcome
from service.runtime.live.live_feed import Cursor, FeedEvent

STREAM = "/api/v1/spacecraft/yamal-202/stream"
#: small buffers, so that a client that does not read is felt by the service after some hundred events
BUFFER_BYTES = 8192


@dataclass(frozen=True)
class Event:
    """One event as a client sees it."""

    id: str
    kind: str
    data: Any


class Reader:
    """One client of a stream."""

    def __init__(self, response: httpx.Response) -> None:
        self._lines = response.iter_lines()

    def consume(self, count: int, *kinds: str) -> list[Event]:
        """Return the next events of some kinds, of all but status by default."""
        events: list[Event] = []
        while len(events) < count:
            event = self._next()
            if event.kind in kinds or (not kinds and event.kind != "status"):
                events.append(event)
        return events

    def has_heartbeat(self) -> bool:
        """Read on to the next heartbeat; False where the stream ends before."""
        return any(line.startswith(":") for line in self._lines)

    def _next(self) -> Event:
        fields: dict[str, str] = {}
        for line in self._lines:
            if line.startswith(":"):
                continue
            if line:
                name, _, value = line.partition(": ")
                fields[name] = value
            elif "data" in fields:
                return Event(fields["id"], fields["event"], json.loads(fields["data"]))
            else:
                fields.clear()
        pytest.fail("the stream ended")


@dataclass
class Served:
    """A server in a thread."""

    url: str
    key: str
    server: StreamingServer
    thread: threading.Thread

    @contextmanager
    def open(self, last_event_id: str | None = None, *events: str) -> Iterator[httpx.Response]:
        """Give a stream's response while it is open, of some kinds of events or of all."""
        headers = {"Authorization": f"Bearer {self.key}"}
        if last_event_id is not None:
            headers["Last-Event-ID"] = last_event_id
        transport = httpx.HTTPTransport(socket_options=[(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)])
        with (
            httpx.Client(transport=transport, timeout=120) as client,
            client.stream("GET", self.url + STREAM, headers=headers, params={"events": events}) as response,
        ):
            yield response


@contextmanager
def serving(app: Any, key: str) -> Iterator[Served]:
    """Serve an application in a thread, and end it."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES)
    server = StreamingServer(uvicorn.Config(app, log_level="warning", access_log=False), app)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    wait_until(lambda: server.started)
    try:
        yield Served(f"http://127.0.0.1:{listener.getsockname()[1]}", key, server, thread)
    finally:
        server.should_exit = True
        thread.join(120)
        listener.close()
    assert not thread.is_alive()


class Source:
    """Plays the supervisor: stores rows with their results and publishes them."""

    def __init__(self, bench: Any, make: Any) -> None:
        self._bench = bench
        self._make = make
        self._count = 0

    def store(self, rows: int) -> tuple[FeedEvent, ...]:
        """Store rows, one attitude and one command each, and return the events that tell them."""
        make, count = self._make, self._count
        measured = self._bench.append([make.now_us + (count + k) * 60 * make.s for k in range(rows)])
        self._count += rows
        first = self._bench.storage.archive.head(make.sc).result_sequence
        outcomes = [Outcome((make.row(row),), make.command(row)) for row in measured]
        self._bench.consume(outcomes)
        last = measured[-1].number
        events = [FeedEvent("measurement", Cursor(row.number, first), row) for row in measured]
        for k, outcome in enumerate(outcomes):
            events.append(FeedEvent("attitude", Cursor(last, first + 2 * k + 1), outcome.rows[0]))
            events.append(FeedEvent("torque", Cursor(last, first + 2 * k + 2), outcome.command))
        return tuple(events)

    def publish(self, *batches: tuple[FeedEvent, ...]) -> None:
        """Tell subscribers."""
        for batch in batches:
            self._bench.context.feed.publish(self._make.sc, batch)

    def subscribers(self) -> int:
        """Return how many streams are open."""
        return len(self._bench.context.feed._subscribers.get(self._make.sc, ()))
