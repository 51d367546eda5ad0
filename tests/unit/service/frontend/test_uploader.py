"""Rows leave the queue only when the service accounts for them."""

import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.evaluation import MeasuredRow
from service.frontend.uploader import Uploader, UploadSettings

Answer = Callable[[dict[str, Any]], httpx.Response]


def row(number: int) -> MeasuredRow:
    """Return a row with its number as epoch."""
    unknown = np.array([np.nan])
    return MeasuredRow(
        number, np.array([-40.0]), np.zeros(1, dtype=np.int64), np.array([0.1]), unknown, unknown, unknown
    )


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
        self.accepted: list[str] = []
        self.plan_id = 3

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        if request.method == "GET":
            return httpx.Response(200, json={"plan_id": self.plan_id, "carriers": [{"id": "c00"}]})
        body = json.loads(request.content)
        self.posts.append(body)
        answer = next(self.script, accept)
        if isinstance(answer, Exception):
            raise answer
        response = answer(body)
        if response.status_code == 200 and b'"duplicates":0,"late"' in response.content:
            self.accepted += [each["epoch"] for each in body["measurements"]]
        return response


def upload(service: Service, rows: int = 5, **settings: Any) -> Uploader:
    """Queue rows, deliver them, and return the uploader after its end."""
    client = ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(service.handle))
    chosen = UploadSettings("sc", "sa-1", **({"drain_s": 0.5} | settings))
    uploader = Uploader(client, chosen, ["c00"], threading.Event(), Backoff(first_s=0.001, limit_s=0.004))
    for number in range(rows):
        assert uploader.put(row(number))
    uploader.finish()
    uploader.run()
    return uploader


def test_rows_go_in_order_with_their_first_number() -> None:
    service = Service()
    uploader = upload(service, 7, batch_rows=3)
    assert [post["first_seq"] for post in service.posts] == [1, 4, 7]
    assert [len(post["measurements"]) for post in service.posts] == [3, 3, 1]
    assert uploader.counters.accepted == 7
    assert service.posts[0]["source"] == "sa-1"
    assert service.posts[0]["plan_id"] == 3


@pytest.mark.parametrize(
    "failure",
    [
        httpx.ConnectError("refused"),
        httpx.ReadTimeout("slow"),
        httpx.RemoteProtocolError("cut"),
        lambda _: problem(500, "internal"),
        lambda _: problem(503, "storage.unavailable"),
        lambda _: problem(429, "rate"),
        lambda _: problem(401, "key.invalid"),
        lambda _: problem(403, "role.missing"),
        lambda _: problem(404, "spacecraft.unknown"),
        lambda _: problem(422, "body.invalid"),
        lambda _: httpx.Response(200, text="<html>proxy</html>"),
        lambda _: httpx.Response(200, json=[]),
        lambda _: httpx.Response(200, json={"accepted": 1, "duplicates": 0, "refused": []}),
    ],
)
def test_whatever_fails_the_same_batch_goes_again(
    failure: Answer | Exception, caplog: pytest.LogCaptureFixture
) -> None:
    service = Service(failure, failure)
    uploader = upload(service)
    assert service.posts[0] == service.posts[2]
    assert len(service.posts) == 3
    assert uploader.counters.accepted == 5
    assert uploader.counters.failures == 2
    assert uploader.waiting == 0
    assert "5 rows wait" in caplog.text


def test_a_new_plan_is_fetched_when_the_old_one_is_unknown() -> None:
    service = Service()

    def forget(_: dict[str, Any]) -> httpx.Response:
        service.plan_id = 9
        return problem(404, "plan.unknown")

    service.script = iter([forget])
    upload(service)
    assert [post["plan_id"] for post in service.posts] == [3, 9]


def test_refused_rows_are_named_and_counted(caplog: pytest.LogCaptureFixture) -> None:
    def refuse_one(body: dict[str, Any]) -> httpx.Response:
        refused = [{"index": 2, "seq": 3, "code": "time.future", "detail": "ahead"}]
        return httpx.Response(
            200, json={"accepted": len(body["measurements"]) - 1, "duplicates": 0, "refused": refused}
        )

    uploader = upload(Service(refuse_one))
    assert (uploader.counters.accepted, uploader.counters.refused) == (4, 1)
    assert "row 3 of 1970-01-01T00:00:00.000002Z refused: time.future" in caplog.text


def test_a_row_that_cannot_be_read_does_not_block_the_others() -> None:
    def judge(body: dict[str, Any]) -> httpx.Response:
        for place, each in enumerate(body["measurements"]):
            if each["epoch"].endswith("03Z"):
                return problem(422, "value.type", f"/measurements/{place}/power_dbm/0")
        return accept(body)

    service = Service(*[judge] * 10)
    uploader = upload(service)
    assert [text[-4:] for text in service.accepted] == ["000Z", "001Z", "002Z", "004Z"]
    assert uploader.counters.refused == 1
    assert all(post["first_seq"] in {1, 4, 5} for post in service.posts)


def test_too_long_a_body_is_halved() -> None:
    def limit(body: dict[str, Any]) -> httpx.Response:
        return accept(body) if len(body["measurements"]) <= 2 else problem(413, "body.too_large")

    service = Service(*[limit] * 10)
    uploader = upload(service, 8, batch_rows=8)
    assert uploader.counters.accepted == 8
    assert len(service.accepted) == 8


def test_what_cannot_be_delivered_in_time_is_said() -> None:
    uploader = upload(Service(*[httpx.ConnectError("refused")] * 10_000), drain_s=0.05)
    assert uploader.waiting == 5
    assert uploader.counters.accepted == 0


def test_a_full_queue_holds_the_sweeping_back_and_loses_nothing() -> None:
    is_open = threading.Event()

    def gate(body: dict[str, Any]) -> httpx.Response:
        return accept(body) if is_open.wait(5.0) else problem(503, "shut")

    service = Service(gate)
    client = ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(service.handle))
    uploader = Uploader(client, UploadSettings("sc", "sa-1", queue_rows=3), ["c00"], threading.Event())
    loop = threading.Thread(target=uploader.run)
    loop.start()
    produced = []

    def produce() -> None:
        produced.extend(uploader.put(row(number)) for number in range(10))

    sweeping = threading.Thread(target=produce)
    sweeping.start()
    sweeping.join(0.3)
    assert sweeping.is_alive()
    assert len(produced) == 3
    is_open.set()
    sweeping.join(5.0)
    uploader.finish()
    loop.join(5.0)
    assert produced == [True] * 10
    assert len(service.accepted) == 10


def test_after_a_stop_a_row_without_room_is_given_up_and_said(caplog: pytest.LogCaptureFixture) -> None:
    stop = threading.Event()
    stop.set()
    client = ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(Service().handle))
    uploader = Uploader(client, UploadSettings("sc", "sa-1", queue_rows=1, drain_s=0.05), ["c00"], stop)
    assert uploader.put(row(0))
    assert not uploader.put(row(1))
    assert "is lost" in caplog.text


def test_requests_that_follow_closely_wait_for_company() -> None:
    service = Service()
    client = ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(service.handle))
    uploader = Uploader(client, UploadSettings("sc", "sa-1", batch_s=0.3), ["c00"], threading.Event())
    loop = threading.Thread(target=uploader.run)
    loop.start()
    uploader.put(row(0))
    while not service.posts:
        loop.join(0.005)
    for number in range(1, 20):
        uploader.put(row(number))
    loop.join(0.1)
    assert [len(post["measurements"]) for post in service.posts] == [1]
    uploader.finish()
    loop.join(5.0)
    assert [len(post["measurements"]) for post in service.posts] == [1, 19]
