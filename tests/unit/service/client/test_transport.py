"""One request: key, errors, and repetition only where it cannot do harm."""

import json
from typing import Any

import httpx
import pytest

from service.client.backoff import Backoff
from service.client.problem import ProblemError, ServiceUnavailableError
from service.client.transport import Transport

PROBLEM = {
    "type": "about:blank",
    "title": "Not found",
    "status": 404,
    "detail": "there is no plan 9",
    "code": "plan.unknown",
    "request_id": "r-1",
    "errors": [{"pointer": "/plan_id", "code": "plan.unknown", "detail": "9"}],
}


def transport(*answers: httpx.Response | Exception, retries: int = 3) -> tuple[Transport, list[httpx.Request]]:
    """Return a transport that gets these answers, and the requests it makes."""
    requests: list[httpx.Request] = []
    script = iter(answers)

    def handle(request: httpx.Request) -> httpx.Response:
        requests.append(request)
        answer = next(script)
        if isinstance(answer, Exception):
            raise answer
        return answer

    made = Transport(
        "http://service/", "secret", http=httpx.MockTransport(handle), retries=retries, sleep=lambda _: None
    )
    return made, requests


def test_key_and_body_go_with_the_request() -> None:
    made, requests = transport(httpx.Response(200, json={"a": 1}))
    assert made.request("PUT", "/x", {"b": 2}, params={"c": 3, "d": None}) == {"a": 1}
    assert requests[0].headers["authorization"] == "Bearer secret"
    assert json.loads(requests[0].content) == {"b": 2}
    assert str(requests[0].url) == "http://service/api/v1/x?c=3"


def test_health_stands_outside_the_base_path() -> None:
    made, requests = transport(httpx.Response(204))
    assert made.request("GET", "/healthz") is None
    assert requests[0].url.path == "/healthz"


def test_a_problem_is_an_error_with_all_its_parts() -> None:
    made, requests = transport(httpx.Response(404, json=PROBLEM))
    with pytest.raises(ProblemError, match="r-1") as caught:
        made.request("GET", "/x")
    error = caught.value
    assert (error.status, error.code, error.detail, error.request_id) == (404, "plan.unknown", PROBLEM["detail"], "r-1")
    assert error.errors[0]["pointer"] == "/plan_id"
    assert len(requests) == 1


def test_a_page_of_a_proxy_is_an_error_too() -> None:
    made, _ = transport(httpx.Response(404, text="<html>"))
    with pytest.raises(ProblemError) as caught:
        made.request("GET", "/x")
    assert caught.value.code == "http.404"


@pytest.mark.parametrize(
    ("method", "is_keyed", "attempts"), [("GET", False, 4), ("PUT", False, 4), ("POST", True, 4), ("POST", False, 1)]
)
@pytest.mark.parametrize("failure", [httpx.Response(503), httpx.ReadTimeout("slow"), httpx.RemoteProtocolError("cut")])
def test_only_what_may_be_repeated_is(
    method: str, is_keyed: bool, attempts: int, failure: httpx.Response | Exception
) -> None:
    made, requests = transport(*[failure] * 9)
    with pytest.raises(ServiceUnavailableError):
        made.request(method, "/x", is_keyed=is_keyed)
    assert len(requests) == attempts


def test_a_request_that_was_never_sent_is_repeated() -> None:
    made, requests = transport(httpx.ConnectError("refused"), httpx.Response(201, json={}))
    assert made.request("POST", "/x", {}) == {}
    assert len(requests) == 2


def test_the_services_own_waiting_time_is_kept() -> None:
    waits: list[float] = []
    answers = iter([httpx.Response(429, headers={"retry-after": "7"}), httpx.Response(200, json={})])
    made = Transport("http://s", None, http=httpx.MockTransport(lambda _: next(answers)), sleep=waits.append)
    made.request("GET", "/x")
    assert waits == [7.0]


def test_a_good_answer_that_is_no_json_is_unavailable() -> None:
    made, _ = transport(httpx.Response(200, text="<html>"), retries=0)
    with pytest.raises(ServiceUnavailableError, match="not JSON"):
        made.request("GET", "/x")


def test_nan_is_not_sent() -> None:
    made, requests = transport()
    with pytest.raises(ValueError, match="not JSON compliant"):
        made.request("PUT", "/x", {"a": float("nan")})
    assert requests == []


def test_no_key_no_header() -> None:
    seen: list[Any] = []

    def handle(request: httpx.Request) -> httpx.Response:
        seen.append(request.headers.get("authorization"))
        return httpx.Response(200, json={})

    with Transport("http://s", None, http=httpx.MockTransport(handle)) as made:
        made.request("GET", "/x")
    assert seen == [None]


def test_jitter_shortens_and_reset_starts_again() -> None:
    backoff = Backoff(first_s=1.0, limit_s=4.0, jitter=0.5, draw=lambda: 1.0)
    # powers of two times one half: exact in float64
    assert [backoff.next_s() for _ in range(4)] == [0.5, 1.0, 2.0, 2.0]
    backoff.reset()
    assert backoff.next_s() == 0.5


def test_a_download_is_given_piece_by_piece_and_asked_once() -> None:
    made, requests = transport(httpx.Response(200, content=iter([b"epoch,", b"source\r\n"])))
    with made:
        chunks = list(made.download("/archive", {"format": "csv", "version": None}))
    assert b"".join(chunks) == b"epoch,source\r\n"
    assert [str(request.url) for request in requests] == ["http://service/api/v1/archive?format=csv"]


def test_a_refused_download_is_its_problem_and_a_broken_one_says_so() -> None:
    made, _ = transport(httpx.Response(404, json=PROBLEM), httpx.ReadError("gone"))
    with made:
        with pytest.raises(ProblemError, match="no plan 9"):
            list(made.download("/archive"))
        with pytest.raises(ServiceUnavailableError, match="broke off"):
            list(made.download("/archive"))
