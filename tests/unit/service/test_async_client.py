"""Both clients have the same methods and send the same requests; streams go on where they broke off in both."""

import asyncio
import inspect
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from service.client.async_service_client import AsyncServiceClient
from service.client.problem import ProblemError, ServiceUnavailableError
from service.client.service_client import JobFailedError, ServiceClient

pytestmark = pytest.mark.anyio


#: what each parameter is called with
GIVEN = {"plan_id": 3, "limit": 5, "calibration_id": 7, "start": 0, "stop": 9}
LISTS = {"carriers", "measurements", "traces", "links", "references", "corrections"}
#: are no single request
OTHERS = {"close", "download", "follow", "pages", "request", "send", "stream", "wait_job"}


def methods(kind: type) -> dict[str, Callable[..., Any]]:
    """Return the public methods of a class."""
    return {name: method for name, method in inspect.getmembers(kind, inspect.isfunction) if not name.startswith("_")}


def test_both_have_the_same_methods_and_parameters():
    one, other = methods(ServiceClient), methods(AsyncServiceClient)
    assert one.keys() == other.keys()
    for name in one.keys() - {"download"}:
        assert list(inspect.signature(one[name]).parameters) == list(inspect.signature(other[name]).parameters), name
        assert name in {"follow", "send"} or one[name].__doc__ == other[name].__doc__, name


@pytest.mark.parametrize("name", sorted(methods(ServiceClient).keys() - OTHERS))
async def test_both_send_the_same(name):
    reported: list[tuple[str, str, bytes]] = []

    def answer(request: httpx.Request) -> httpx.Response:
        reported.append((request.method, str(request.url), request.content))
        return httpx.Response(200, json={"rows": [{"a": 1}], "links": [], "next": None})

    parameters = [p for p in inspect.signature(getattr(ServiceClient, name)).parameters if p != "self"]
    given = {
        p: GIVEN.get(p, [{"x": 1}] if p in LISTS else {"x": 1} if p.startswith(name.split("_")[-1]) else p)
        for p in parameters
    }
    with ServiceClient("http://service", "key", http=httpx.MockTransport(answer)) as client:
        plain = getattr(client, name)(**given)
        plain = list(plain) if inspect.isgenerator(plain) else plain
    async with AsyncServiceClient("http://service", "key", http=httpx.MockTransport(answer)) as client:
        awaited = getattr(client, name)(**given)
        awaited = [row async for row in awaited] if inspect.isasyncgen(awaited) else await awaited
    assert plain == awaited
    assert reported[0] == reported[1]


async def test_a_busy_service_is_asked_again_and_a_refusal_is_not():
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    answers = iter([httpx.Response(503, headers={"Retry-After": "3"}), httpx.Response(200, json={"id": "x"})])
    transport = httpx.MockTransport(lambda _: next(answers))
    async with AsyncServiceClient("http://service", "key", http=transport, sleep=sleep) as client:
        assert await client.spacecraft("x") == {"id": "x"}
    assert waits == [3.0]
    transport = httpx.MockTransport(lambda _: httpx.Response(404, json={"code": "spacecraft.unknown", "detail": "no"}))
    async with AsyncServiceClient("http://service", "key", http=transport, sleep=sleep) as client:
        with pytest.raises(ProblemError, match=r"spacecraft\.unknown"):
            await client.spacecraft("x")
    transport = httpx.MockTransport(lambda _: httpx.Response(503))
    async with AsyncServiceClient("http://service", "key", http=transport, sleep=sleep, retries=2) as client:
        with pytest.raises(ServiceUnavailableError):
            await client.create_spacecraft({})
    assert len(waits) == 1, "a POST that may have been carried out was repeated"


async def test_a_job_is_waited_for():
    states = iter(["running", "done", "failed"])
    transport = httpx.MockTransport(lambda _: httpx.Response(200, json={"state": next(states), "progress": 0.5}))
    async with AsyncServiceClient("http://service", http=transport) as client:
        assert (await client.wait_job("j", poll_s=0.0))["state"] == "done"
        with pytest.raises(JobFailedError):
            await client.wait_job("j", poll_s=0.0)


def connections(asked: list[str | None]) -> Callable[[httpx.Request], httpx.Response]:
    """Return a service whose every connection ends after one event and the beginning of the next."""

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.headers.get("last-event-id"))
        number = len(asked)
        if number == 2:
            return httpx.Response(503)
        body = f"id: a:{number}.0.0\nevent: measurement\ndata: {{}}\n\nid: a:99.0.0\nevent: mea"
        return httpx.Response(200, text=body)

    return answer


async def test_streams_go_on_behind_the_last_event_they_gave():
    asked: list[str | None] = []
    client = ServiceClient("http://service", http=httpx.MockTransport(connections(asked)), sleep=lambda _: None)
    with client:
        events = client.stream("a")
        assert [next(events).id for _ in range(3)] == ["a:1.0.0", "a:3.0.0", "a:4.0.0"]
        events.close()  # type: ignore[attr-defined]
    assert asked == [None, "a:1.0.0", "a:1.0.0", "a:3.0.0"]
    asked.clear()

    async def sleep(_: float) -> None:
        await asyncio.sleep(0)

    transport = httpx.MockTransport(connections(asked))
    async with AsyncServiceClient("http://service", http=transport, sleep=sleep) as client:
        events = client.stream("a")
        assert [(await anext(events)).id for _ in range(3)] == ["a:1.0.0", "a:3.0.0", "a:4.0.0"]
        await events.aclose()
    assert asked == [None, "a:1.0.0", "a:1.0.0", "a:3.0.0"]


def test_kinds_of_events_are_chosen():
    asked = []

    def answer(request: httpx.Request) -> httpx.Response:
        asked.append(request.url.query)
        return httpx.Response(200, content=b"id: a:1.0.0\nevent: note\ndata: {}\n\n")

    with ServiceClient("http://service", http=httpx.MockTransport(answer)) as client:
        assert next(client.stream("a", events=["note", "alarm"])).kind == "note"
        assert next(client.stream("a")).kind == "note"
    assert asked == [b"events=note&events=alarm", b""]


def test_a_refused_stream_ends_with_the_problem():
    answer = httpx.Response(422, json={"code": "cursor.invalid", "detail": "no id"})
    with (
        ServiceClient("http://service", http=httpx.MockTransport(lambda _: answer)) as client,
        pytest.raises(ProblemError, match=r"cursor\.invalid"),
    ):
        next(client.stream("a", last_event_id="x"))
