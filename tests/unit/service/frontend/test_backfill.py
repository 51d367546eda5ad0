"""An archive is surveyed and sent in pieces, once, whatever interrupts; every row is accounted for."""

import csv
import json
import random
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet

from service.client.backoff import Backoff
from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.frontend.backfill import survey as module
from service.frontend.backfill.backfill import ArchiveOrder, SendInterruptedError, check_archive, send_archive
from service.frontend.backfill.columns import ArchiveError, CellError, match_columns, read_epoch, read_levels
from service.frontend.backfill.reader import CsvArchive
from service.frontend.backfill.survey import MOST_SHOWN, Survey
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
            if each["power_dbm"][0] == 99.0:
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


def write(folder: Path, *lines: str, name: str = "levels.csv") -> ArchiveOrder:
    """Write a file and return the order to send it."""
    path = folder / name
    path.write_text("\n".join((HEADER, *lines)) + "\n")
    return ArchiveOrder(path, "sc", "sa-1", batch_rows=3, patience_s=0.0)


def lines(count: int, first: int = 0) -> list[str]:
    """Return lines, one a minute."""
    return [
        f"{format_epoch(START_US + 60_000_000 * k)},sa-1,{-40 - k / 8},{-72.1},n" for k in range(first, first + count)
    ]


def send(service: Archive, order: ArchiveOrder) -> dict[str, Any]:
    """Send without waiting long."""
    return send_archive(service.client(), order, backoff=Backoff(first_s=0.001, limit_s=0.002))


def test_rows_are_sent_in_the_order_of_the_plan_and_dbw_becomes_dbm(tmp_path: Path) -> None:
    service = Archive()
    report = send(service, write(tmp_path, *lines(7), f"{START_US - 1},,,-70,x"))
    assert [len(body["measurements"]) for body in service.bodies] == [3, 3, 2]
    assert service.rows["2026-11-21T00:01:00.000000Z"] == [-40.125, -42.1, None]
    assert service.rows["2026-11-20T23:59:59.999999Z"] == [None, -40.0, None]
    assert all(body["source"] == "sa-1" and "first_seq" not in body for body in service.bodies)
    assert (report["rows"], report["accepted"], report["late"]) == (8, 8, 8)
    assert report["columns"] == {"sent": ["c00_dbm", "c01_dbw"], "left_out": ["note"], "absent": ["c02"]}
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
        taken = [each for each in body["measurements"] if each["power_dbm"][0] != 99.0]
        service.rows |= {each["epoch"]: each["power_dbm"] for each in taken}
        raise httpx.ReadTimeout("cut")

    service.failures = [
        draw.choice([None, httpx.ConnectError("refused"), stored_but_cut, lambda _: httpx.Response(503)])
        for _ in range(12)
    ]
    order = write(tmp_path, *lines(10), "2026-11-21T09:00:00Z,sa-1,99,,", "no epoch,sa-1,1,2,3", *lines(6, 10))
    runs = 0
    while True:
        runs += 1
        with suppress(SendInterruptedError):
            report = send(service, order)
            break
    assert len(service.rows) == 16
    assert (report["rows"], report["refused"], report["unreadable"]) == (18, 1, 1)
    assert report["accepted"] + report["duplicates"] == 16
    with Path(report["refused_file"]).open() as file:
        found = list(csv.reader(file))
    assert [(each[0], each[1]) for each in found[1:]] == [("12", "value.out_of_range"), ("13", "row.unreadable")]
    assert found[0] == ["line", "code", "detail", *HEADER.split(",")]
    assert found[2][3:] == ["no epoch", "sa-1", "1", "2", "3"]
    print(f"{runs} runs, seed {seed}")


def test_a_service_that_stays_away_ends_the_run_and_says_how_to_go_on(tmp_path: Path) -> None:
    service = Archive(httpx.ConnectError("refused"))
    with pytest.raises(SendInterruptedError, match="run the same command again to continue"):
        send(service, write(tmp_path, *lines(4)))


def test_a_service_that_is_away_for_a_while_is_waited_for(tmp_path: Path) -> None:
    service = Archive(
        httpx.ConnectError("refused"), lambda _: httpx.Response(502), lambda _: httpx.Response(200, json=[])
    )
    order = ArchiveOrder(write(tmp_path, *lines(4)).path, "sc", "sa-1", patience_s=5.0)
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
    order = ArchiveOrder(write(tmp_path, *lines(20)).path, "sc", "sa-1", batch_rows=10)
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
    other = ArchiveOrder(order.path, "sc", "sa-1", from_source="sa-2")
    assert send(service, other)["accepted"] == 1


def test_a_changed_file_is_another_sending(tmp_path: Path) -> None:
    service = Archive()
    order = write(tmp_path, *lines(2))
    send(service, order)
    report = send(service, write(tmp_path, *lines(4)))
    assert (report["resumed_at"], report["accepted"], report["duplicates"]) == (0, 2, 2)


def test_a_check_tells_rows_span_columns_and_the_first_faults(tmp_path: Path) -> None:
    service = Archive()
    order = write(tmp_path, *lines(3), "nonsense,sa-1,1,2,3", "2026-11-21T09:00:00Z,sa-1,loud,,", "1,2", *lines(1))
    report = check_archive(service.client(), order, START_US)
    assert service.requests == 0
    assert (report["rows"], report["unreadable"], report["is_in_order"]) == (4, 3, False)
    assert (report["start"], report["stop"]) == ("2026-11-21T00:00:00.000000Z", "2026-11-21T00:02:00.000000Z")
    assert [fault["line"] for fault in report["faults"]] == [5, 6, 7]
    assert "'loud' is no number" in report["faults"][1]["detail"]
    assert "2 cells, the header has 5" in report["faults"][2]["detail"]


def test_unknown_columns_are_refused_when_asked(tmp_path: Path) -> None:
    order = ArchiveOrder(write(tmp_path, *lines(1)).path, "sc", "sa-1", refuse_unknown_columns=True)
    with pytest.raises(ArchiveError, match="no carrier of plan 4: note"):
        send(Archive(), order)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (["time", "c00_dbm"], "no column 'epoch'"),
        (["epoch", "c00_dbm", "c00_dbm"], "occur twice"),
        (["epoch", "c00_dbm", "c00_dbw"], "have two columns: c00"),
        (["epoch", "c99_dbm"], "no column is a carrier"),
    ],
)
def test_headers_that_mean_nothing_are_refused(header: list[str], message: str) -> None:
    with pytest.raises(ArchiveError, match=message):
        match_columns(header, ["c00", "c01"])


def test_cells_are_read_as_they_are_meant() -> None:
    columns = match_columns(["epoch", "c00_dbm", "c01_dbw"], ["c00", "c01"])
    assert read_levels(["", "-42.1", " NaN "], columns) == [-42.1, None]
    assert read_levels([0, None, float("nan")], columns) == [None, None]
    assert read_levels([0, 1, -72.1], columns) == [1.0, -42.1]
    with pytest.raises(CellError, match="infinite"):
        read_levels(["", "inf", ""], columns)
    assert read_epoch(" 2026-11-21T03:00:00+03:00 ") == read_epoch(str(START_US)) == read_epoch(START_US) == START_US
    with pytest.raises(CellError, match="not an RFC 3339 instant"):
        read_epoch("2026-11-21 00:00:00")


def test_files_of_spreadsheets_are_read(tmp_path: Path) -> None:
    path = tmp_path / "levels.csv"
    path.write_bytes(b"\xef\xbb\xbfepoch;c00_dbm\r\n2026-11-21T00:00:00Z;-42\r\n\r\n2026-11-21T00:01:00Z;-43\r\n")
    service = Archive()
    report = send(service, ArchiveOrder(path, "sc", "sa-1"))
    assert (report["accepted"], report["unreadable"]) == (2, 0)


@pytest.mark.parametrize(
    ("content", "message"),
    [(b"", "no column 'epoch'"), (b"epoch,c00_dbm\n\xff\xfe,1\n", "line 2 is not UTF-8")],
)
def test_files_that_cannot_be_read_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "levels.csv"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match=message):
        send(Archive(), ArchiveOrder(path, "sc", "sa-1"))


def test_a_state_that_was_spoiled_is_told(tmp_path: Path) -> None:
    order = write(tmp_path, *lines(2))
    state = Path(send(Archive(), order)["state_file"])
    state.write_text("{")
    with pytest.raises(ArchiveError, match="remove it to begin again"):
        send(Archive(), order)


def test_what_is_no_parquet_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "levels.parquet"
    path.write_bytes(b"epoch,c00_dbm")
    with pytest.raises(ArchiveError, match="is no Parquet file"):
        send(Archive(), ArchiveOrder(path, "sc", "sa-1"))


def test_nothing_but_a_parquet_file_costs_the_import_of_pyarrow() -> None:
    program = "import sys, service.cli.station.send; sys.exit('pyarrow' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False, timeout=120).returncode == 0


def test_parquet_is_sent_as_csv_is(tmp_path: Path) -> None:
    levels = pa.array([-40.0, None, -42.0], pa.float32())
    whole = pa.array([START_US, START_US + 1, START_US + 2], pa.int64())
    for number, epochs in enumerate((whole, whole.cast(pa.timestamp("us", tz="UTC")))):
        path = tmp_path / f"levels-{number}.parquet"
        parquet.write_table(pa.table({"epoch": epochs, "c00_dbm": levels}), path)
        service = Archive()
        report = send(service, ArchiveOrder(path, "sc", "sa-1", batch_rows=2))
        assert report["accepted"] == 3
        assert list(service.rows.values()) == [[-40.0, None, None], [None, None, None], [-42.0, None, None]]
    path = tmp_path / "naive.parquet"
    parquet.write_table(pa.table({"epoch": whole.cast(pa.timestamp("us")), "c00_dbm": levels}), path)
    with pytest.raises(ArchiveError, match="without a time zone"):
        send(Archive(), ArchiveOrder(path, "sc", "sa-1"))


def test_a_leap_second_reaches_the_service_as_it_stands_in_the_file(tmp_path: Path) -> None:
    archive = Archive()
    texts = ["2016-12-31T23:59:59.5Z", "2016-12-31T23:59:60.5Z", "2017-01-01T00:00:00.5Z"]
    order = write(tmp_path, *(f"{text},sa-1,-40.0,-72.1,n" for text in texts))
    assert send_archive(archive.client(), order)["accepted"] == 3
    assert [each["epoch"] for each in archive.bodies[0]["measurements"]] == [
        "2016-12-31T23:59:59.500000Z",
        "2016-12-31T23:59:60.5Z",
        "2017-01-01T00:00:00.500000Z",
    ]


def test_a_resumed_sending_goes_on_under_the_plan_it_began_with(tmp_path: Path) -> None:
    archive = Archive(httpx.ReadTimeout("lost"))
    order = write(tmp_path, *lines(2))
    with pytest.raises(SendInterruptedError):
        send_archive(archive.client(), order)
    plans: list[str | None] = []

    def later(request: httpx.Request) -> httpx.Response:
        if request.method == "GET":
            plans.append(request.url.params.get("plan_id"))
        return archive.handle(request)

    client = ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(later))
    assert send_archive(client, order)["accepted"] == 2
    assert plans == ["4"]


def test_refused_cells_are_no_formulas_and_are_read_back(tmp_path: Path) -> None:
    path = tmp_path / "levels.csv"
    path.write_text("epoch,=note,c00_dbm\n=2026-11-21T00:00:00Z,@x,-42.5\n2026-11-21T00:01:00Z,x,-43\n")
    report = send(Archive(), ArchiveOrder(path, "sc", "sa-1"))
    assert (report["accepted"], report["unreadable"]) == (1, 1)
    refused = Path(report["refused_file"])
    assert refused.read_text().splitlines()[0].endswith("epoch,'=note,c00_dbm")
    assert refused.read_text().splitlines()[1].endswith("'=2026-11-21T00:00:00Z,'@x,-42.5")
    archive = CsvArchive(refused)
    assert archive.header[-3:] == ["epoch", "=note", "c00_dbm"]
    assert [row.cells[-3:] for row in archive.rows()] == [["=2026-11-21T00:00:00Z", "@x", "-42.5"]]
    archive.close()


MINUTE_US = 60_000_000


def surveyed(epochs_us: list[int]) -> dict[str, Any]:
    """Return the survey of epochs with one level each."""
    survey = Survey(["c00", "c01"])
    for epoch_us in epochs_us:
        survey.add(epoch_us, [-60.0, None])
    return survey.as_document(START_US)


@given(st.integers(3, 300), st.integers(0, 2**32 - 1))
def test_gaps_and_duplicates_do_not_depend_on_the_order_of_the_rows(rows: int, seed: int) -> None:
    draw = random.Random(seed)
    minutes = sorted(draw.choices(range(rows * 2), k=rows))
    epochs_us = [START_US + MINUTE_US * minute for minute in minutes]
    ordered = surveyed(epochs_us)
    draw.shuffle(epochs_us)
    mixed = surveyed(epochs_us)
    assert {**mixed, "is_in_order": None} == {**ordered, "is_in_order": None}
    assert ordered["duplicate_epochs"] == rows - len(set(minutes))
    steps = [step for step in np.diff(minutes) if step]
    assert ordered["gaps"] == sum(step > 2.5 * np.median(steps) for step in steps)
    assert ordered["is_in_order"] == (len(set(minutes)) == rows)


def test_the_longest_gap_comes_first_with_its_ends() -> None:
    minutes = [*range(100), *range(110, 200), *range(400, 500)]
    found = surveyed([START_US + MINUTE_US * minute for minute in minutes])
    assert found["gaps"] == 2
    assert found["longest_gaps"][0] == {
        "start": "2026-11-21T03:19:00.000000Z",
        "stop": "2026-11-21T06:40:00.000000Z",
        "duration_s": 201 * 60.0,
    }
    assert found["usual_step_s"] == 60.0
    assert found["age_s"] == -499 * 60.0


def test_levels_and_empty_cells_of_each_carrier() -> None:
    survey = Survey(["c00", "c01"])
    for k, levels in enumerate(([-60.0, None], [-62.5, None], [None, None])):
        survey.add(START_US + k, levels)
    document = survey.as_document(START_US)
    assert document["levels"] == {
        "c00": {"least_dbm": -62.5, "greatest_dbm": -60.0, "empty": 1},
        "c01": {"least_dbm": None, "greatest_dbm": None, "empty": 3},
    }
    assert document["mean_dbm"] == -61.25


def test_equal_faults_are_one_group_and_every_row_is_counted() -> None:
    survey = Survey(["c00"])
    for line in range(6334):
        survey.faults.add("epoch without offset; state --tz", line, f"line {line}")
    for kind in range(100):
        survey.faults.add(f"kind {kind}", kind, "other")
    document = survey.as_document(START_US)
    assert document["unreadable"] == 6434
    assert len(document["faults"]) == MOST_SHOWN
    assert document["faults"][0] == {
        "line": 0,
        "rows": 6334,
        "kind": "epoch without offset; state --tz",
        "detail": "line 0",
    }


def test_epochs_beyond_the_bound_are_counted_but_not_kept(monkeypatch: Any) -> None:
    monkeypatch.setattr(module, "MOST_EPOCHS", 10)
    found = surveyed([START_US + MINUTE_US * (k // 2) for k in range(40)])
    assert (found["rows"], found["duplicate_epochs"]) == (40, 5)
