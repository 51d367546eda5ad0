"""Rows leave the spool when the service accounts for them, refused or not; traces come last."""

import itertools
import math
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from scripted_service import Answer, Service, accept, deliver, fill, problem, seqs, uploader
from spooled_rows import NOW_US, row, spool, sweep

from service.frontend.spool.row import SpooledTask
from service.frontend.spool.spool import Spool


@pytest.fixture
def rows(tmp_path: Path) -> Iterator[Spool]:
    """Give a spool that keeps every trace."""
    with spool(tmp_path, trace_period_s=0.0) as made:
        yield made


def test_rows_go_in_order_with_their_first_number(rows: Spool) -> None:
    service = Service()
    fill(rows, 7)
    made = uploader(service, rows, batch_rows=3)
    deliver(made)
    assert seqs(service) == [(1, 3), (4, 3), (7, 1)]
    assert made.counters.accepted == 7
    assert (service.posts[0]["source"], service.posts[0]["plan_id"]) == ("sa-1", 3)
    reported = service.posts[0]["measurements"][0]
    assert reported["power_dbm"] == [-40.0, None]
    assert reported["flags"] == [0, 16]
    assert reported["sigma_db"] == reported["c_n0_db_hz"] == [0.5, 0.5]


def test_a_new_plan_is_fetched_when_the_old_one_is_unknown(rows: Spool) -> None:
    service = Service()

    def forget(_: dict[str, Any]) -> httpx.Response:
        service.plans[9] = service.plans[3]
        return problem(404, "plan.unknown")

    service.script = iter([forget])
    fill(rows)
    deliver(uploader(service, rows))
    assert [post["plan_id"] for post in service.posts] == [3, 9]


def test_rows_of_a_replaced_plan_go_under_the_plan_they_were_measured_for(tmp_path: Path) -> None:
    with spool(tmp_path) as old:
        fill(old, 2)
    service = Service()
    service.plans |= {5: ["d00"]}
    with spool(tmp_path, task=SpooledTask("e" * 64, ("d00", "d01"))) as rows:
        fill(rows, 2, first=2)
        deliver(uploader(service, rows))
    assert [(post["plan_id"], len(post["measurements"])) for post in service.posts] == [(3, 2), (5, 2)]


def test_rows_that_fit_no_plan_wait_and_let_the_other_lane_pass(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with spool(tmp_path, task=SpooledTask("e" * 64, ("x00", "x01"))) as old:
        fill(old, 2)
    service = Service()
    with spool(tmp_path) as rows:
        fill(rows, 2, first=NOW_US)
        made = uploader(service, rows, NOW_US)
        deliver(made, lambda: made.waiting == 2)
        assert rows.waiting == 2
    assert seqs(service) == [(3, 2)]
    assert "no carrier of the task is in plan 3" in caplog.text


def test_lanes_take_turns_while_both_have_rows(rows: Spool) -> None:
    age_us = 300_000_000
    service = Service()
    fill(rows, 6, first=NOW_US - 2 * age_us)
    fill(rows, 10, first=NOW_US)
    made = uploader(service, rows, NOW_US, batch_rows=2)
    deliver(made)
    # numbers 1..6 are old, 7..16 are young: young first, then every second request
    assert [first for first, _ in seqs(service)] == [7, 1, 9, 3, 11, 5, 13, 15]
    assert made.counters.backfill_requests == 3


def test_neither_lane_starves_however_much_the_other_one_has(rows: Spool) -> None:
    service = Service()
    numbers = itertools.count(NOW_US)

    def one_more(body: dict[str, Any]) -> httpx.Response:
        rows.append(row(next(numbers)))
        return accept(body)

    service.script = iter([one_more] * 40)
    fill(rows, 10)
    rows.append(row(next(numbers)))
    made = uploader(service, rows, NOW_US, batch_rows=1)
    deliver(made)
    firsts = [first for first, _ in seqs(service)]
    # ten old rows are through after twenty requests, though there is a new one every time
    assert sorted(firsts[:20])[:10] == list(range(1, 11))
    assert firsts[:20:2] == list(range(11, 21))


def test_a_failure_is_no_turn(rows: Spool) -> None:
    service = Service(lambda _: problem(500, "internal"), accept, lambda _: problem(500, "internal"), accept)
    fill(rows, 1)
    fill(rows, 1, first=NOW_US)
    deliver(uploader(service, rows, NOW_US))
    assert [first for first, _ in seqs(service)] == [2, 2, 1, 1]


def test_the_rows_of_an_earlier_start_are_sent_first(tmp_path: Path) -> None:
    with spool(tmp_path) as earlier:
        fill(earlier, 3)
    service = Service()
    with spool(tmp_path) as rows:
        made = uploader(service, rows, NOW_US)
        deliver(made)
    assert seqs(service) == [(1, 3)]
    assert made.counters.backfill_requests == 1


def test_after_a_stop_the_rest_is_delivered_while_the_service_takes_it(rows: Spool) -> None:
    service = Service()
    fill(rows, 7)
    made = uploader(service, rows, batch_rows=2)
    made.finish()
    made.run()
    assert made.waiting == 0
    assert made.counters.accepted == 7


def test_the_time_to_deliver_after_a_stop_is_bounded(rows: Spool, monkeypatch: pytest.MonkeyPatch) -> None:
    now = {"s": 0.0}
    monkeypatch.setattr("service.frontend.upload.uploader.time", SimpleNamespace(monotonic=lambda: now["s"]))

    def slow(body: dict[str, Any]) -> httpx.Response:
        now["s"] += 3.0
        return accept(body)

    fill(rows, 50)
    made = uploader(Service(*[slow] * 100), rows, batch_rows=1, drain_s=10.0)
    made.finish()
    made.run()
    # sent after 0, 3, 6 and 9 s
    assert made.waiting == 46


def test_requests_that_follow_closely_wait_for_company(rows: Spool) -> None:
    service = Service()
    made = uploader(service, rows, batch_s=30.0)
    loop = threading.Thread(target=made.run)
    loop.start()
    fill(rows, 1)
    while not service.posts:
        loop.join(0.005)
    fill(rows, 19, first=1)
    loop.join(0.1)
    assert [count for _, count in seqs(service)] == [1]
    made.finish()
    loop.join(120.0)
    assert [count for _, count in seqs(service)] == [1, 19]


def test_rows_in_memory_go_without_a_number(tmp_path: Path) -> None:
    (tmp_path / "sa-1.spool").mkdir()
    service = Service()
    with spool(tmp_path) as rows:
        for number in range(3):
            assert not rows.append(row(number))
        made = uploader(service, rows)
        deliver(made)
    assert "first_seq" not in service.posts[0]
    assert made.counters.accepted == 3


def test_an_infinite_level_is_no_level(rows: Spool) -> None:
    spoiled = row(1)
    spoiled.power_dbm[0] = math.inf
    rows.append(spoiled)
    service = Service()
    deliver(uploader(service, rows))
    assert service.posts[0]["measurements"][0]["power_dbm"] == [None, None]


def test_rows_that_wait_over_a_restart_go_under_the_plan_they_were_sent_under(tmp_path: Path) -> None:
    """The answer to the first request is lost, a new plan is put, the front end starts again."""
    service = Service(httpx.ReadTimeout("lost"))
    with spool(tmp_path) as rows:
        fill(rows, 3)
        made = uploader(service, rows)
        made.finish()
        made.run()
    service.plans |= {4: ["c01", "c00"]}
    with spool(tmp_path) as rows:
        fill(rows, 2, first=3)
        made = uploader(service, rows, batch_rows=3)
        deliver(made)
        # once nothing waits that may have been sent, the newest plan holds
        fill(rows, 1, first=5)
        deliver(uploader(service, rows))
    assert service.posts[0]["measurements"] == service.posts[1]["measurements"]
    assert [post["plan_id"] for post in service.posts] == [3, 3, 3, 3]
    with spool(tmp_path) as rows:
        made = uploader(service, rows)
        fill(rows, 1, first=6)
        deliver(made)
        fill(rows, 1, first=7)
        made._finishing.clear()
        made._deadline_s = float("inf")
        deliver(made)
    assert [post["plan_id"] for post in service.posts[4:]] == [3, 4]


def test_a_row_that_was_sent_without_figures_goes_again_without_them(
    rows: Spool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.frontend.upload.uploader._DETAILS_AGAIN_S", 0.0)
    service = Service(
        lambda _: problem(422, "field.unknown", "/measurements/0/sigma_db"), httpx.ReadTimeout("lost"), accept, accept
    )
    fill(rows, 1)
    made = uploader(service, rows)
    made._bare.add(0)
    deliver(made)
    assert ["sigma_db" in post["measurements"][0] for post in service.posts] == [False] * len(service.posts)
    assert made._bare == set()


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


def test_rows_of_a_source_of_another_station_stay_in_the_spool_and_are_warned_of(rows: Spool) -> None:
    seen: list[Any] = []

    def refuse(_: dict[str, Any]) -> httpx.Response:
        seen.append(made.counters.not_accepted)
        return problem(403, "source.not_yours")

    service = Service(refuse, refuse, refuse, accept)
    fill(rows)
    made = uploader(service, rows)
    deliver(made)
    assert seen[0] is None
    assert [each.code for each in seen[1:]] == ["upload.not_accepted"] * 2
    assert "source.not_yours" in seen[1].detail
    # nothing was dropped, and the warning goes when the rows are taken
    assert (made.counters.accepted, made.counters.refused, made.counters.not_accepted) == (5, 0, None)


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


def fill_traces(rows: Spool, count: int) -> None:
    """Append rows with a trace each."""
    for number in range(count):
        rows.append_trace(sweep(number))
        fill(rows, 1, first=number)


def test_traces_go_when_no_row_waits(rows: Spool) -> None:
    service = Service()
    fill_traces(rows, 6)
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
    fill_traces(rows, 2)
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
    fill_traces(rows, 3)
    made = uploader(service, rows)
    deliver(made, lambda: rows.traces_waiting == 0)
    assert (made.traces.sent, made.traces.refused) == (2, 1)
