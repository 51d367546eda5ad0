"""Traces go when no row waits, and none of them keeps the rows from going."""

from typing import Any

import httpx
from scripted_service import Service, deliver, fill, problem, uploader
from spooled_rows import sweep

from service.frontend.spool.spool import Spool


def test_traces_go_when_no_row_waits(rows: Spool) -> None:
    service = Service()
    for number in range(6):
        rows.append_trace(sweep(number))
        fill(rows, 1, first=number)
    made = uploader(service, rows, batch_rows=2, batch_traces=4)
    deliver(made, lambda: made.traces.sent == 6)
    assert len(service.posts) == 3
    assert [len(body["traces"]) for body in service.traces] == [4, 2]
    first = service.traces[0]["traces"][0]
    assert first["power_dbm"] == [-60.0] * 10 + [None]
    assert (first["sweep"], first["start_hz"], first["step_hz"]) == ("ku", 950e6, 1e6)
    assert rows.traces_waiting == 0


def test_traces_that_the_service_refuses_are_accounted_for(rows: Spool) -> None:
    """A trace from the future is refused by itself; it must not come back for ever."""
    service = Service()
    refused = [{"index": 0, "code": "time.future", "detail": "ahead"}]
    service.take_traces = lambda body: httpx.Response(
        200, json={"received": 2, "accepted": len(body["traces"]) - 1, "duplicates": 0, "refused": refused}
    )
    for number in range(2):
        rows.append_trace(sweep(number))
        fill(rows, 1, first=number)
    made = uploader(service, rows)
    deliver(made, lambda: made.traces.refused > 0)
    assert (made.traces.sent, made.traces.refused, rows.traces_waiting) == (1, 1, 0)


def test_a_service_without_traces_is_left_alone(rows: Spool) -> None:
    service = Service()
    service.take_traces = lambda _: problem(404, "http.404")
    rows.append_trace(sweep(0))
    fill(rows, 1)
    made = uploader(service, rows)
    deliver(made, lambda: bool(service.traces))
    fill(rows, 5, first=1)
    made = uploader(service, rows)
    deliver(made)
    assert rows.traces_waiting == 1
    assert made.counters.failures == 0
    assert len(service.traces) <= 2


def test_a_trace_that_cannot_be_read_is_given_up_and_the_others_go(rows: Spool) -> None:
    def judge(body: dict[str, Any]) -> httpx.Response:
        is_bad = any(each["epoch"].endswith("01Z") for each in body["traces"])
        count = len(body["traces"])
        return problem(422, "value") if is_bad else httpx.Response(200, json={"accepted": count, "duplicates": 0})

    service = Service()
    service.take_traces = judge
    for number in range(3):
        rows.append_trace(sweep(number))
        fill(rows, 1, first=number)
    made = uploader(service, rows)
    deliver(made, lambda: rows.traces_waiting == 0)
    assert (made.traces.sent, made.traces.refused) == (2, 1)
