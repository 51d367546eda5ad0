"""Requests that mean no good, over real sockets: each gets a clear 4xx, soon, and the service does not swell."""

import gzip
import json
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest

from service.api.limits.http_protocol import SPARE_PLACES

pytestmark = pytest.mark.system

KEY = "a-key-for-tests-only"
SC = "/api/v1/spacecraft"
BODY_LIMIT = 1_000_000
#: beyond what the widest body within the limit takes, which the allocator keeps; a bomb would take 100 MB and more
MAX_GROWTH_BYTES = 40_000_000
#: far above what a whole request takes on a busy machine
REQUEST_TIMEOUT_S = 2.0


class Target:
    """One service and raw connections to it."""

    def __init__(self, url: str, process_id: int) -> None:
        address = urlsplit(url)
        self.address = (str(address.hostname), int(address.port or 0))
        self.url = url
        self._status = Path(f"/proc/{process_id}/status")

    def resident_bytes(self) -> int:
        """Return how much memory the service holds."""
        line = next(line for line in self._status.read_text().splitlines() if line.startswith("VmRSS"))
        return int(line.split()[1]) * 1024

    def connect(self) -> socket.socket:
        """Return a connection."""
        return socket.create_connection(self.address, timeout=120)

    def answer(self, *parts: bytes, pause_s: float = 0.0) -> tuple[int, dict[str, Any]]:
        """Send pieces and return status and problem of what comes back."""
        with closing(self.connect()) as connection:
            try:
                for part in parts:
                    connection.sendall(part)
                    time.sleep(pause_s)
            except (BrokenPipeError, ConnectionResetError):
                # it was refused before all was sent, as it should be
                pass
            return read_answer(connection)


def read_answer(connection: socket.socket) -> tuple[int, dict[str, Any]]:
    """Return status and JSON of an answer; others may follow at once."""
    received = b""
    while b"\r\n\r\n" not in received:
        part = connection.recv(1)
        assert part, f"the connection was closed after {received[:200]!r}"
        received += part
    names = dict(line.lower().split(b": ", 1) for line in received.strip().split(b"\r\n")[1:])
    assert names[b"content-type"] == b"application/problem+json", received
    body = b""
    while len(body) < int(names[b"content-length"]):
        body += connection.recv(int(names[b"content-length"]) - len(body))
    return int(received.split()[1]), json.loads(body)


def head(method: str, path: str, *headers: str, host: bool = True) -> bytes:
    """Return the head of a request with the key."""
    lines = [f"{method} {path} HTTP/1.1", *(["Host: x"] if host else []), f"Authorization: Bearer {KEY}", *headers]
    return ("\r\n".join(lines) + "\r\n\r\n").encode("latin-1")


@pytest.fixture(scope="module")
def target(
    service_process: Any, compiled_environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Target]:
    """A service with small limits, for all tests of this file; at the end it still answers and has not grown."""
    folder = tmp_path_factory.mktemp("hostile")
    limits = {"SOO_MAX_BODY_BYTES": str(BODY_LIMIT), "SOO_REQUEST_TIMEOUT_S": str(REQUEST_TIMEOUT_S)}
    own = {"SOO_BOOTSTRAP_KEY": KEY, **limits}
    service = service_process(folder, folder / "soo.db", ["--port", "0"], {**compiled_environment, **own})
    try:
        found = Target(service.url, service.process.pid)
        with service.client() as client:
            for _ in range(20):
                assert client.get(SC).status_code == 200
        for _ in range(3):
            assert found.answer(wide_body())[0] == 422
        before = found.resident_bytes()
        yield found
        with service.client() as client:
            assert client.get(SC).json() == {"rows": [], "next": None}
        grown = found.resident_bytes() - before
        print(f"grown by {grown / 1e6:.0f} MB")
        assert grown < MAX_GROWTH_BYTES
        assert service.end()[0] == 0
        assert "Traceback" not in service.written()
    finally:
        service.process.kill()
        service.process.wait()


def test_an_address_with_all_its_connections_keeps_health_and_its_keys(start_service):
    """64 silent ones made its own /healthz 429 for 10 s. A spare place is for one request, which comes at once."""
    limits = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_MAX_CONNECTIONS_PER_ADDRESS": "4"}
    service = start_service("--port", "0", environment=limits)
    target, slow = Target(service.url, service.process.pid), head("POST", SC, "Content-Length: 10")
    held = [target.connect() for _ in range(4)]
    try:
        for each in held:
            each.sendall(slow)
        for path, headers in (("/healthz", {}), ("/readyz?", {}), (SC, {"Authorization": f"Bearer {KEY}"})):
            answer = httpx.get(target.url + path, headers=headers, timeout=120, trust_env=False)
            assert (answer.status_code, answer.headers["connection"]) == (200, "close")
        for path in (SC, "/console/", "/healthzz"):
            answer = httpx.get(target.url + path, timeout=120, trust_env=False)
            assert (answer.status_code, answer.json()["code"]) == (429, "connection.too_many")
        status, problem = target.answer(b"GET /healthz HTTP/1.1\r\nHost: x\r\n")
        assert (status, problem["code"]) == (408, "request.too_slow")
        assert "after 1 s" in problem["detail"]
    finally:
        for each in held:
            each.close()


def sized(body: bytes, *headers: str) -> bytes:
    """Return a POST with a body."""
    return head("POST", SC, f"Content-Length: {len(body)}", "Content-Type: application/json", *headers) + body


def wide_body() -> bytes:
    """Return a POST of as many fields as the limit of a body lets through: 80 MB of faults while it is judged."""
    return sized(b"{" + b",".join(b'"f%d":1' % k for k in range(90_000)) + b"}")


def chunked(*chunks: bytes) -> bytes:
    """Return a POST whose body comes in chunks."""
    framed = b"".join(b"%x\r\n%b\r\n" % (len(chunk), chunk) for chunk in chunks)
    return head("POST", SC, "Transfer-Encoding: chunked") + framed + b"0\r\n\r\n"


REFUSED: list[tuple[str, Callable[[], bytes], int, str]] = [
    ("body above the limit", lambda: sized(b" " * (BODY_LIMIT + 1)), 413, "body.too_large"),
    ("said to be huge", lambda: head("POST", SC, f"Content-Length: {2**62}"), 413, "body.too_large"),
    ("chunks above the limit", lambda: chunked(*[b" " * 65536] * 20), 413, "body.too_large"),
    ("gzip bomb", lambda: sized(gzip.compress(b"\0" * 200_000_000), "Content-Encoding: gzip"), 413, "body.gzip_ratio"),
    ("many gzip members", lambda: sized(gzip.compress(b"") * 20_000, "Content-Encoding: gzip"), 400, "json.malformed"),
    ("not gzip", lambda: sized(b"{}", "Content-Encoding: gzip"), 400, "body.gzip"),
    ("unknown packing", lambda: sized(b"{}", "Content-Encoding: br"), 415, "encoding.unsupported"),
    ("nested lists", lambda: sized(b"[" * 500_000), 400, "json.malformed"),
    ("nested and closed", lambda: sized(b"[" * 100_000 + b"]" * 100_000), 400, "json.malformed"),
    ("nested objects", lambda: sized(b'{"a":' * 100_000), 400, "json.malformed"),
    ("a number of 900 kB", lambda: sized(b'{"longitude_deg":' + b"9" * 900_000 + b"}"), 400, "json.malformed"),
    ("90 000 fields", wide_body, 422, ""),
    ("invalid UTF-8", lambda: sized(b'{"id":"\xff\xfe"}'), 400, "json.malformed"),
    ("half a surrogate", lambda: sized(b'{"id":"\\ud800"}'), 400, "json.malformed"),
    ("a NUL", lambda: sized(b'{"id":"a\\u0000"}'), 422, "request.invalid"),
    ("other content", lambda: head("POST", SC, "Content-Length: 2", "Content-Type: text/xml") + b"{}", 415, ""),
    ("one huge header", lambda: head("GET", SC, "X-Filler: " + "a" * 100_000), 431, "head.too_large"),
    ("5000 headers", lambda: head("GET", SC, *[f"X-{k}: 1" for k in range(5000)]), 431, "head.too_large"),
    ("a path of 100 kB", lambda: head("GET", f"{SC}/{'a' * 100_000}"), 431, "head.too_large"),
    ("a path of 20 kB", lambda: head("GET", f"{SC}/{'a' * 20_000}"), 404, "spacecraft.unknown"),
    ("2000 parameters", lambda: head("GET", SC + "?" + "&".join(["a=1"] * 2000)), 400, "query.too_many"),
    ("a parameter of 20 kB", lambda: head("GET", f"/api/v1/audit?start={'1' * 20_000}"), 422, "value.length"),
    ("a path that is no ASCII", lambda: head("GET", f"{SC}/\xe9"), 400, "http.malformed"),
    ("a path that is no UTF-8", lambda: head("GET", f"{SC}/%ff%fe"), 404, "spacecraft.unknown"),
    ("a NUL in the path", lambda: head("GET", f"{SC}/%00"), 404, "spacecraft.unknown"),
    ("no HTTP", lambda: b"\x16\x03\x01\x02\x00" * 20 + b"\r\n\r\n", 400, "http.malformed"),
    ("two lengths", lambda: head("POST", SC, "Content-Length: 2", "Content-Length: 3") + b"{}", 400, "http.malformed"),
    ("length and chunks", lambda: head("POST", SC, "Content-Length: 2", "Transfer-Encoding: chunked"), 400, ""),
    ("a length that is none", lambda: head("POST", SC, "Content-Length: -1"), 400, "http.malformed"),
    ("a chunk that is none", lambda: head("POST", SC, "Transfer-Encoding: chunked") + b"zz\r\n", 400, ""),
    ("a method of its own", lambda: head("BREW", SC), 400, "http.malformed"),
    ("a web socket", lambda: head("GET", "/ws", "Connection: Upgrade", "Upgrade: websocket"), 404, "path.unknown"),
]


@pytest.mark.parametrize(("request_of", "status", "code"), [case[1:] for case in REFUSED], ids=[c[0] for c in REFUSED])
def test_what_cannot_be_meant_is_refused(target, request_of, status, code):
    answered, problem = target.answer(request_of())
    assert (answered, problem["status"]) == (status, status), problem
    assert problem["code"] == code or not code, problem
    assert len(json.dumps(problem)) < 20_000


@pytest.mark.parametrize(
    "part",
    [b"GET /api/v1/spacecraft HTTP/1.1\r\nX-Slow: ", head("POST", SC, "Content-Length: 1000"), b"G"],
    ids=["a head", "a body", "a letter"],
)
def test_what_stops_in_the_middle_is_ended(target, part):
    began = time.monotonic()
    status, problem = target.answer(part)
    assert (status, problem["code"]) == (408, "request.too_slow")
    assert time.monotonic() - began > REQUEST_TIMEOUT_S * 0.9


def test_what_comes_drop_by_drop_is_ended_and_holds_up_nobody(target):
    with closing(target.connect()) as slow:
        slow.sendall(head("POST", SC, "Content-Length: 1000"))
        began = time.monotonic()
        while time.monotonic() - began < 120.0:
            try:
                slow.sendall(b" ")
            except (BrokenPipeError, ConnectionResetError):
                break
            time.sleep(0.05)
            assert httpx.get(target.url + "/healthz", trust_env=False, timeout=60).status_code == 200
        assert time.monotonic() - began < 120.0


def test_who_says_nothing_is_let_go(target):
    with closing(target.connect()) as silent:
        assert silent.recv(100) == b""


def test_a_body_that_breaks_off_stores_nothing(target):
    for length in (1, 500):
        with closing(target.connect()) as connection:
            connection.sendall(head("POST", SC, "Content-Length: 1000") + b" " * length)
    with httpx.Client(headers={"Authorization": f"Bearer {KEY}"}, trust_env=False, timeout=120) as client:
        assert client.get(target.url + SC).json()["rows"] == []


def connect_from(target: Target, address: str) -> socket.socket:
    """Return a connection from another address of this machine."""
    return socket.create_connection(target.address, timeout=120, source_address=(address, 0))


def test_200_silent_connections_of_one_address_keep_nobody_out_and_are_told(target):
    held = [connect_from(target, "127.0.0.2") for _ in range(200)]
    try:
        # those that were admitted are closed when their time is over, without a word
        heard = Counter(connection.recv(65536)[:12] for connection in held)
        assert heard.keys() == {b"HTTP/1.1 429", b""}
        refused = heard[b"HTTP/1.1 429"]
        # the spare places are free again after a second, on a busy machine for some of these too
        assert refused >= 200 - 64 - 3 * SPARE_PLACES
        answer = httpx.get(target.url + SC, headers={"Authorization": f"Bearer {KEY}"}, trust_env=False, timeout=120)
        assert answer.status_code == 200
        reported = httpx.get(target.url + "/metrics", trust_env=False, timeout=120).text
        assert f'soo_connections_refused_total{{reason="address"}} {refused}.0' in reported
        assert 'soo_connections_refused_total{reason="slow"}' in reported
    finally:
        for connection in held:
            connection.close()


def test_a_small_request_after_another_in_one_piece_is_answered(target):
    """The bounds count each request for itself."""
    filler = "X-Filler: " + "a" * 20_000
    with closing(target.connect()) as connection:
        for _ in range(5):
            connection.sendall(head("GET", f"{SC}/unknown", filler))
            assert read_answer(connection)[0] == 404
        connection.sendall(head("GET", f"{SC}/unknown") * 3)
        assert [read_answer(connection)[0] for _ in range(3)] == [404] * 3
