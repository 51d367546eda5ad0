"""Rows leave the spool only when the service accounts for them; lanes take turns; traces come last."""

import itertools
import math
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from scripted_service import Service, accept, deliver, fill, problem, seqs, uploader
from spooled_rows import NOW_US, row, spool

from service.frontend.spool.row import SpooledTask
from service.frontend.spool.spool import Spool


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
