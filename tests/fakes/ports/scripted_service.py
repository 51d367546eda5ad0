"""A service that answers uploads by a script and then accepts, and what tests of the uploader do with it."""

import json
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
from spooled_rows import row

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.spool.spool import Spool
from service.frontend.upload.uploader import Uploader, UploadSettings

Answer = Callable[[dict[str, Any]], httpx.Response]


def accept(body: dict[str, Any]) -> httpx.Response:
    """Accept everything."""
    return httpx.Response(200, json={"accepted": len(body["measurements"]), "duplicates": 0, "late": 0, "refused": []})


def problem(status: int, code: str, pointer: str | None = None) -> httpx.Response:
    """Return an RFC 9457 problem."""
    errors = [] if pointer is None else [{"pointer": pointer, "code": code, "detail": "bad"}]
    return httpx.Response(status, json={"status": status, "code": code, "detail": "because", "errors": errors})


class Service:
    """Service that answers by a script and then accepts; keeps what it accepted."""

    def __init__(self, *script: Answer | Exception) -> None:
        self.script: Iterator[Answer | Exception] = iter(script)
        self.posts: list[dict[str, Any]] = []
        self.traces: list[dict[str, Any]] = []
        self.accepted: list[str] = []
        self.plans = {3: ["c00", "c01"]}
        self.take_traces: Answer = lambda body: httpx.Response(
            200, json={"received": len(body["traces"]), "accepted": len(body["traces"]), "duplicates": 0}
        )

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        if request.method == "GET":
            plan_id = int(request.url.params.get("plan_id", max(self.plans)))
            if plan_id not in self.plans:
                return problem(404, "plan.unknown")
            return httpx.Response(
                200, json={"plan_id": plan_id, "carriers": [{"id": each} for each in self.plans[plan_id]]}
            )
        body = json.loads(request.content)
        if request.url.path.endswith("/traces"):
            self.traces.append(body)
            return self.take_traces(body)
        self.posts.append(body)
        answer = next(self.script, accept)
        if isinstance(answer, Exception):
            raise answer
        response = answer(body)
        if response.status_code == 200 and b'"duplicates":0,"late"' in response.content:
            self.accepted += [each["epoch"] for each in body["measurements"]]
        return response

    def client(self) -> ServiceClient:
        """Return a client of it."""
        return ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(self.handle))


def uploader(service: Service, rows: Spool, now_us: int = 0, **settings: Any) -> Uploader:
    """Return an uploader in a hurry."""
    chosen = UploadSettings("sc", "sa-1", **({"batch_s": 0.0} | settings))
    return Uploader(service.client(), chosen, rows, lambda: now_us, Backoff(first_s=0.001, limit_s=0.004))


def deliver(made: Uploader, is_done: Callable[[], bool] | None = None) -> None:
    """Run until nothing waits, or something else is so, and end."""
    done = is_done or (lambda: made.waiting == 0)
    loop = threading.Thread(target=made.run)
    loop.start()
    deadline = time.monotonic() + 120.0
    while not done() and time.monotonic() < deadline:
        time.sleep(0.002)
    assert done()
    made.finish()
    loop.join(120.0)
    assert not loop.is_alive()


def fill(rows: Spool, count: int = 5, first: int = 0) -> None:
    """Append rows."""
    for number in range(first, first + count):
        assert rows.append(row(number))


def seqs(service: Service) -> list[tuple[int, int]]:
    """Return first number and rows of every request."""
    return [(post["first_seq"], len(post["measurements"])) for post in service.posts]
