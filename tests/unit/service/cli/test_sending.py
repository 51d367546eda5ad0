"""Powers are sent in pieces, once, whatever interrupts; every row is accounted for."""

import csv
import json
import random
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.cli.importing.sending import SendInterruptedError, SendOrder, SendState, send_powers
from service.client.backoff import Backoff
from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.formats.foreign.columns import PowersStatement, interpret_powers
from service.formats.foreign.table import Container, ForeignTableError, read_table
from service.records.epoch import format_epoch

START_US = 1_795_219_200_000_000
HEADER = "epoch,source,c00_dbm,c01_dbw,note"


class Archive:
    """A service that knows rows by epoch, refuses some, and fails by a script."""

    def __init__(self, *failures: Any) -> None:
        self.failures = list(failures)
        self.rows: dict[str, list[float | None]] = {}
        self.requests = 0
        self.bodies: list[dict[str, Any]] = []

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        if request.method == "GET":
            return httpx.Response(200, json={"plan_id": 4, "carriers": [{"id": "c00"}, {"id": "c01"}, {"id": "c02"}]})
        self.requests += 1
        body = json.loads(request.content)
        self.bodies.append(body)
        failure = self.failures.pop(0) if self.failures else None
        if isinstance(failure, Exception):
            raise failure
        if callable(failure) and (answer := failure(body)) is not None:
            return answer
        refused, duplicates = [], 0
        for position, each in enumerate(body["measurements"]):
            if each["power_dbm"][0] == 9.0:
                refused.append({"index": position, "code": "value.out_of_range", "detail": "99 dBm"})
            elif each["epoch"] in self.rows:
                duplicates += 1
            else:
                self.rows[each["epoch"]] = each["power_dbm"]
        accepted = len(body["measurements"]) - len(refused) - duplicates
        return httpx.Response(
            200, json={"accepted": accepted, "duplicates": duplicates, "late": accepted, "refused": refused}
        )

    def client(self) -> ServiceClient:
        """Return a client of it."""
        return ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(self.handle))


def write(folder: Path, *lines: str, name: str = "levels.csv") -> SendOrder:
    """Write a file and return the order to send it."""
    path = folder / name
    path.write_text("\n".join((HEADER, *lines)) + "\n")
    return SendOrder(path, "sc", "sa-1", batch_rows=3, patience_s=0.0)


def lines(count: int, first: int = 0) -> list[str]:
    """Return lines, one a minute."""
    return [
        f"{format_epoch(START_US + 60_000_000 * k)},sa-1,{-40 - k / 8},{-72.1},n" for k in range(first, first + count)
    ]


def send(service: Archive, order: SendOrder, from_source: str | None = None) -> dict[str, Any]:
    """Send without waiting long."""
    client = service.client()
    state = SendState(order, client.service_url)
    state.plan_id = state.plan_id or 4
    stated = PowersStatement(file=order.path.name, source=order.source, from_source=from_source)
    plan = {name: name for name in ("c00", "c01", "c02")}
    rows = interpret_powers(read_table(order.path, Container()), stated, plan, START_US).rows
    assert rows is not None
    return send_powers(client, order, rows, state, backoff=Backoff(first_s=0.001, limit_s=0.002))


def test_rows_are_sent_in_the_order_of_the_plan_and_dbw_becomes_dbm(tmp_path: Path) -> None:
    service = Archive()
    report = send(service, write(tmp_path, *lines(7), "2026-11-20T23:59:59.999999Z,,,-70,x"))
    assert [len(body["measurements"]) for body in service.bodies] == [3, 3, 2]
    assert service.rows["2026-11-21T00:01:00.000000Z"] == [-40.125, -42.1, None]
    assert service.rows["2026-11-20T23:59:59.999999Z"] == [None, -40.0, None]
    assert all(body["source"] == "sa-1" and "first_seq" not in body for body in service.bodies)
    assert (report["rows"], report["accepted"], report["late"]) == (8, 8, 8)
    assert report["refused_file"] is None


def test_a_second_run_sends_nothing_again(tmp_path: Path) -> None:
    service = Archive()
    order = write(tmp_path, *lines(5))
    first, requests = send(service, order), service.requests
    second = send(service, order)
    assert service.requests == requests
    assert second["resumed_at"] == 5
    assert {**first, "resumed_at": 5, "seconds": 0} == {**second, "seconds": 0}


@pytest.mark.parametrize("seed", range(5))
def test_after_interruptions_at_any_request_it_goes_on_where_it_stopped(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)
    service = Archive()

    def stored_but_cut(body: dict[str, Any]) -> httpx.Response:
        taken = [each for each in body["measurements"] if each["power_dbm"][0] != 9.0]
        service.rows |= {each["epoch"]: each["power_dbm"] for each in taken}
        raise httpx.ReadTimeout("cut")

    service.failures = [
        draw.choice([None, httpx.ConnectError("refused"), stored_but_cut, lambda _: httpx.Response(503)])
        for _ in range(12)
    ]
    order = write(tmp_path, *lines(10), "2026-11-21T00:09:30Z,sa-1,9,,", "no epoch,sa-1,1,2,3", *lines(6, 10))
    runs = 0
    while True:
        runs += 1
        with suppress(SendInterruptedError):
            report = send(service, order)
            break
    assert len(service.rows) == 16
    assert (report["rows"], report["refused"], report["unreadable"]) == (17, 1, 1)
    assert report["accepted"] + report["duplicates"] == 16
    with Path(report["refused_file"]).open() as file:
        found = list(csv.reader(file))
    assert [(each[0], each[1]) for each in found[1:]] == [("13", "row.unreadable"), ("12", "value.out_of_range")]
    assert found[0] == ["line", "code", "detail", "epoch", "c00_dbm", "c01_dbm", "c02_dbm"]
    assert found[2][3:] == ["2026-11-21T00:09:30.000000Z", "9.0", "", ""]
    print(f"{runs} runs, seed {seed}")


def test_a_service_that_stays_away_ends_the_run_and_says_how_to_go_on(tmp_path: Path) -> None:
    service = Archive(httpx.ConnectError("refused"))
    with pytest.raises(SendInterruptedError, match="run the same command again to continue"):
        send(service, write(tmp_path, *lines(4)))


def test_a_service_that_is_away_for_a_while_is_waited_for(tmp_path: Path) -> None:
    service = Archive(
        httpx.ConnectError("refused"), lambda _: httpx.Response(502), lambda _: httpx.Response(200, json=[])
    )
    order = SendOrder(write(tmp_path, *lines(4)).path, "sc", "sa-1", patience_s=5.0)
    assert send(service, order)["accepted"] == 4
    assert service.requests == 4


def test_bodies_that_are_too_long_are_halved_and_rows_at_fault_refused_alone(tmp_path: Path) -> None:
    def judge(body: dict[str, Any]) -> httpx.Response | None:
        if len(body["measurements"]) > 2:
            return httpx.Response(413, json={"code": "body.too_large"})
        for position, each in enumerate(body["measurements"]):
            if each["power_dbm"][0] == -41.0:
                errors = [{"pointer": f"/measurements/{position}/power_dbm/0", "code": "x", "detail": "y"}]
                return httpx.Response(422, json={"code": "value.type", "detail": "bad", "errors": errors})
        return None

    service = Archive(*[judge] * 50)
    order = SendOrder(write(tmp_path, *lines(20)).path, "sc", "sa-1", batch_rows=10)
    report = send(service, order)
    assert (report["accepted"], report["refused"]) == (19, 1)


def test_a_refusal_of_everything_is_told_and_loses_nothing(tmp_path: Path) -> None:
    service = Archive(None, lambda _: httpx.Response(401, json={"code": "key.invalid", "detail": "no"}))
    order = write(tmp_path, *lines(7))
    with pytest.raises(ProblemError, match=r"key\.invalid"):
        send(service, order)
    report = send(service, order)
    assert (report["resumed_at"], report["accepted"], report["duplicates"]) == (3, 7, 0)


def test_rows_of_other_sources_stay_unless_they_are_asked_for(tmp_path: Path) -> None:
    service = Archive()
    order = write(tmp_path, *lines(2), "2026-11-21T10:00:00Z,sa-2,-50,,", "2026-11-21T11:00:00Z,,-51,,")
    assert send(service, order)["other_sources"] == {"sa-2": 1}
    assert len(service.rows) == 3
    other = SendOrder(order.path, "sc", "sa-1", "from sa-2")
    assert send(service, other, from_source="sa-2")["accepted"] == 1


def test_a_changed_file_is_another_sending(tmp_path: Path) -> None:
    service = Archive()
    order = write(tmp_path, *lines(2))
    send(service, order)
    report = send(service, write(tmp_path, *lines(4)))
    assert (report["resumed_at"], report["accepted"], report["duplicates"]) == (0, 2, 2)


def test_a_state_that_was_spoiled_is_told(tmp_path: Path) -> None:
    order = write(tmp_path, *lines(2))
    state = Path(send(Archive(), order)["state_file"])
    state.write_text("{")
    with pytest.raises(ForeignTableError, match="remove it to begin again"):
        send(Archive(), order)


def test_a_resumed_sending_goes_on_under_the_plan_it_began_with(tmp_path: Path) -> None:
    archive = Archive(None, httpx.ReadTimeout("lost"))
    order = write(tmp_path, *lines(5))
    with pytest.raises(SendInterruptedError):
        send(archive, order)
    assert SendState(order, archive.client().service_url).plan_id == 4
    assert send(archive, order)["accepted"] == 5
    assert {body["plan_id"] for body in archive.bodies} == {4}
