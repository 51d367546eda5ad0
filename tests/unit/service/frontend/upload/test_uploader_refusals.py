"""Whatever a service refuses or fails at, rows are sent again, named, or wait; none is lost without a word."""

import time
from typing import Any

import httpx
import pytest
from scripted_service import Answer, Service, accept, deliver, fill, problem, seqs, uploader

from service.frontend.spool.spool import Spool


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
        lambda _: problem(422, "value.type", "/measurements/99/power_dbm"),
        lambda _: httpx.Response(200, text="<html>proxy</html>"),
        lambda _: httpx.Response(200, json=[]),
        lambda _: httpx.Response(200, json={"accepted": 1, "duplicates": 0, "refused": []}),
        lambda _: httpx.Response(
            200,
            json={"accepted": 3, "duplicates": 0, "refused": [{"index": 1, "code": "a", "detail": "b"}] * 2},
        ),
    ],
)
def test_whatever_fails_the_same_batch_goes_again(
    rows: Spool, failure: Answer | Exception, caplog: pytest.LogCaptureFixture
) -> None:
    service = Service(failure, failure)
    fill(rows)
    made = uploader(service, rows)
    deliver(made)
    assert service.posts[0] == service.posts[1] == service.posts[2]
    assert len(service.posts) == 3
    assert (made.counters.accepted, made.counters.failures, made.waiting) == (5, 2, 0)
    assert "5 rows wait" in caplog.text


def test_failures_are_followed_by_waits_and_retry_after_is_obeyed(rows: Spool) -> None:
    def later(_: dict[str, Any]) -> httpx.Response:
        return httpx.Response(429, json={"code": "rate", "detail": "slow"}, headers={"Retry-After": "1"})

    service = Service(later)
    fill(rows)
    made = uploader(service, rows)
    begun_s = time.monotonic()
    deliver(made)
    assert time.monotonic() - begun_s > 0.9
    assert len(service.posts) == 2


def test_refused_rows_are_named_counted_and_kept(rows: Spool, caplog: pytest.LogCaptureFixture) -> None:
    def refuse_one(body: dict[str, Any]) -> httpx.Response:
        refused = [{"index": 2, "seq": 3, "code": "time.future", "detail": "ahead"}]
        return httpx.Response(
            200, json={"accepted": len(body["measurements"]) - 1, "duplicates": 0, "refused": refused}
        )

    fill(rows)
    made = uploader(Service(refuse_one), rows)
    deliver(made)
    assert (made.counters.accepted, made.counters.refused, rows.state.refused) == (4, 1, 1)
    assert "row 3 of 1970-01-01T00:00:00.000002Z refused: time.future" in caplog.text


def test_a_row_that_cannot_be_read_does_not_block_the_others(rows: Spool) -> None:
    def judge(body: dict[str, Any]) -> httpx.Response:
        for position, each in enumerate(body["measurements"]):
            if each["epoch"].endswith("03Z"):
                return problem(422, "value.type", f"/measurements/{position}/power_dbm/0")
        return accept(body)

    service = Service(*[judge] * 10)
    fill(rows)
    made = uploader(service, rows)
    deliver(made)
    assert [text[-4:] for text in service.accepted] == ["000Z", "001Z", "002Z", "004Z"]
    assert (made.counters.refused, rows.state.refused) == (1, 1)
    assert seqs(service) == [(1, 5), (1, 3), (4, 2), (5, 1)]


@pytest.mark.parametrize(("status", "code"), [(413, "body.too_large"), (422, "batch.too_long")])
def test_too_long_a_body_is_halved(rows: Spool, status: int, code: str) -> None:
    def limit(body: dict[str, Any]) -> httpx.Response:
        return accept(body) if len(body["measurements"]) <= 2 else problem(status, code, "/measurements")

    service = Service(*[limit] * 10)
    fill(rows, 8)
    made = uploader(service, rows, batch_rows=8)
    deliver(made)
    assert [count for _, count in seqs(service)] == [8, 4, 2, 2, 2, 2]
    assert made.counters.accepted == len(service.accepted) == 8


def test_one_row_that_is_too_long_waits_and_is_not_lost(rows: Spool) -> None:
    service = Service(*[lambda _: problem(413, "body.too_large")] * 4)
    fill(rows, 1)
    made = uploader(service, rows)
    deliver(made)
    assert made.counters.failures == 4
    assert made.counters.accepted == 1


def test_a_service_that_does_not_know_the_further_figures_gets_the_rows_without_them(rows: Spool) -> None:
    def old_service(body: dict[str, Any]) -> httpx.Response:
        if "sigma_db" in body["measurements"][0]:
            return problem(422, "field.unknown", "/measurements/0/sigma_db")
        return accept(body)

    service = Service(*[old_service] * 10)
    fill(rows)
    made = uploader(service, rows, batch_rows=3)
    deliver(made)
    assert made.counters.accepted == 5
    assert (made.counters.refused, made.counters.failures) == (0, 0)
    assert seqs(service) == [(1, 3), (1, 3), (4, 2)]


def test_after_a_stop_a_service_that_is_away_is_not_waited_for(rows: Spool, caplog: pytest.LogCaptureFixture) -> None:
    service = Service(*[httpx.ConnectError("refused")] * 10_000)
    fill(rows)
    made = uploader(service, rows, drain_s=240.0)
    made.finish()
    begun_s = time.monotonic()
    made.run()
    assert time.monotonic() - begun_s < 120.0
    assert (made.waiting, len(service.posts)) == (5, 1)
    assert "5 rows stay in the spool" in caplog.text
