"""``soo send`` with foreign files: what is stated, asked for and refused, and what reaches the service."""

import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path

import httpx
import pytest
import typer
from foreign_files import Truth, Writing, table, truth, write_table
from typer.testing import CliRunner, Result

from service.cli.station import send as module
from service.client.service_client import ServiceClient
from service.records.epoch import format_epoch

CARRIERS = ("c00", "c01", "c02")
UTC_DBM = ("--tz", "UTC", "--unit", "dBm")


class Service:
    """A service that keeps rows by epoch."""

    def __init__(self, *, simulated: bool = False) -> None:
        self.rows: dict[str, list[float | None]] = {}
        self.simulated = simulated
        #: answers of the state of the estimates, rows that wait
        self.pending = [3, 1, 0]

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        if request.url.path.endswith("/carriers"):
            return httpx.Response(200, json={"plan_id": 1, "carriers": [{"id": each} for each in CARRIERS]})
        if request.url.path.endswith("/status"):
            pending = self.pending.pop(0) if len(self.pending) > 1 else self.pending[0]
            ids = {"calibration_id": 1, "alignment_id": 1, "newest_attitude": "2026-03-01T00:00:00.000000Z"}
            return httpx.Response(200, json={"aligned": True, "pending": pending, **ids})
        if request.method == "GET":
            return httpx.Response(200, json={"id": "sc", "simulated": self.simulated})
        rows = json.loads(request.content)["measurements"]
        known = sum(each["epoch"] in self.rows for each in rows)
        self.rows |= {each["epoch"]: each["power_dbm"] for each in rows}
        counts = {"accepted": len(rows) - known, "duplicates": known, "late": len(rows), "refused": []}
        return httpx.Response(200, json=counts)


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Service:
    """The service that the command is connected with."""
    made = Service()

    @contextmanager
    def connected(*_: object, **__: object) -> Iterator[ServiceClient]:
        with ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(made.handle)) as client:
            yield client

    monkeypatch.setattr(module, "connected", connected)
    monkeypatch.setattr("service.cli.own_data.angles._POLL_S", 0.0)
    return made


def run(path: Path, *options: str, answers: str | None = None) -> Result:
    """Run the command; with answers, as on a terminal."""
    app = typer.Typer()
    app.command()(module.send)
    given = [str(path), "--spacecraft", "sc", "--source", "old", "--patience", "30", *options]
    if answers is None:
        return CliRunner().invoke(app, given)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_is_terminal", lambda: True)
        return CliRunner().invoke(app, given, input=answers)


def written(folder: Path, writing: Writing, known: Truth, name: str = "levels.csv") -> Path:
    """Return a foreign file."""
    return write_table(folder / name, table(known, writing), writing)


def wanted(known: Truth) -> dict[str, list[float]]:
    """Return the truth by epoch as the service has it."""
    return {
        format_epoch(round(epoch.timestamp() * 1e6)): list(levels)
        for epoch, levels in zip(known.epochs, known.levels_dbm, strict=True)
    }


def test_without_a_terminal_the_command_ends_with_the_options_that_answer_it(service: Service, tmp_path: Path) -> None:
    known = truth(CARRIERS, 100, datetime(2026, 3, 3, tzinfo=UTC))
    german = Writing(separator=";", decimal=",", pattern="%d.%m.%Y %H:%M:%S", zone="Europe/Berlin", offset_db=30.0)
    path = written(tmp_path, german, known)
    first = run(path, "--json")
    assert first.exit_code == 2
    assert "--time-format: day and month may be exchanged: '03.03.2026 01:00:00'" in first.output
    second = run(path, "--time-format", "%d.%m.%Y %H:%M:%S", "--json")
    assert second.exit_code == 2
    command = shlex.split(second.output.splitlines()[-1])
    assert command[:2] == ["soo", "send"]
    assert command[-4:] == ["--tz", "TZ", "--unit", "dBm|dBW"]
    assert service.rows == {}
    stated = [*command[7:], "--json"]
    stated[stated.index("TZ")], stated[stated.index("dBm|dBW")] = "Europe/Berlin", "dBW"
    done = run(path, *stated)
    assert done.exit_code == 0, done.output
    assert service.rows == wanted(known)


def test_a_person_answers_on_the_terminal_and_gets_the_command(service: Service, tmp_path: Path) -> None:
    known = truth(CARRIERS, 100, datetime(2026, 3, 3, tzinfo=UTC))
    names = {"c00": "Ch 1", "c01": "Ch 2", "c02": "Ch 3"}
    path = written(tmp_path, Writing(pattern="%d/%m/%Y %H:%M", names=names), known)
    # day first, a zone that is none and one that is, carriers (the third left out), a unit that is none and one that is
    done = run(path, answers="1\nMoon\nUTC\nc00\nc02\n\ndB\ndBm\ny\n")
    assert done.exit_code == 0, done.output
    assert "'Moon' is no time zone" in done.output
    assert "'dB' is no unit" in done.output
    assert list(service.rows.values()) == [[a, None, b] for a, b, _ in known.levels_dbm]
    again = next(line for line in done.output.splitlines() if line.startswith("without questions: "))
    service.rows.clear()
    options = shlex.split(again.removeprefix("without questions: "))[7:]
    assert run(path, *options, "--state", str(tmp_path / "other")).exit_code == 0
    assert len(service.rows) == 100


def test_a_person_who_does_not_agree_sends_nothing(service: Service, tmp_path: Path) -> None:
    path = written(tmp_path, Writing(), truth(CARRIERS, 10))
    assert run(path, *UTC_DBM, answers="n\n").exit_code == 2
    assert service.rows == {}


def test_the_report_says_how_old_the_rows_are_and_waits_for_angles(service: Service, tmp_path: Path) -> None:
    done = run(written(tmp_path, Writing(), truth(CARRIERS, 10)), *UTC_DBM)
    assert done.exit_code == 0, done.output
    assert "of them historical" in done.output
    assert "angles exist up to 2026-03-01T00:00:00.000000Z" in done.output
    assert service.pending == [0]


def test_a_dry_run_reports_gaps_duplicates_spans_and_grouped_faults(service: Service, tmp_path: Path) -> None:
    header, *rows = table(truth(CARRIERS, 300), Writing())
    for k in range(40, 60):
        rows[k][0] = "soon"
    rows[5][1] = ""
    path = write_table(tmp_path / "levels.csv", [header, *rows[:150], *rows[149:151], *rows[200:]], Writing())
    done = run(path, *UTC_DBM, "--dry-run", "--json")
    assert done.exit_code == 3, done.output
    report = json.loads(done.output)
    assert (report["rows"], report["unreadable"], report["duplicate_epochs"], report["gaps"]) == (232, 20, 1, 2)
    assert [(each["rows"], each["kind"]) for each in report["faults"]] == [(20, "epoch is not iso")]
    assert report["levels"]["c00"]["empty"] == 1
    assert report["layout"]["tz"] == "UTC"
    assert service.rows == {}
    assert "20 rows: epoch is not iso" in run(path, *UTC_DBM, "--dry-run").output


def test_a_newest_epoch_in_the_future_is_refused_unless_the_spacecraft_is_simulated(
    service: Service, tmp_path: Path
) -> None:
    # a zone nine hours wrong puts rows of the last hour into the future
    known = truth(CARRIERS, 60, datetime.now(UTC).replace(second=0, microsecond=0) - timedelta(hours=1))
    path = written(tmp_path, Writing(zone="Asia/Tokyo"), known)
    done = run(path, *UTC_DBM)
    assert done.exit_code == 2
    assert "after now" in done.output
    assert "is --tz right?" in done.output
    assert run(path, *UTC_DBM, "--dry-run", "--json").exit_code == 2
    assert service.rows == {}
    assert run(path, "--tz", "Asia/Tokyo", "--unit", "dBm").exit_code == 0
    service.simulated = True
    assert run(path, *UTC_DBM, "--state", str(tmp_path / "other")).exit_code == 0


def test_levels_that_no_analyzer_shows_are_refused(service: Service, tmp_path: Path) -> None:
    # C/N0 in dBHz that somebody calls dBm
    path = written(tmp_path, Writing(offset_db=-140.0), truth(CARRIERS, 30))
    done = run(path, *UTC_DBM)
    assert done.exit_code == 2
    assert "which no analyzer shows for a carrier" in done.output
    assert service.rows == {}


def test_mixed_separators_anywhere_refuse_the_file(service: Service, tmp_path: Path) -> None:
    known = truth(CARRIERS, 6000, step_s=10.0)
    path = written(tmp_path, Writing(), known)
    with path.open("a") as file:
        file.write("2026-03-03 00:00:00;-60.5;-61.5;-62.5\n")
    done = run(path, *UTC_DBM)
    assert done.exit_code == 2
    assert "mixed separators: 1 rows" in done.output
    assert service.rows == {}


def test_the_same_file_with_another_zone_is_another_sending(service: Service, tmp_path: Path) -> None:
    known = truth(CARRIERS, 10)
    path = written(tmp_path, Writing(), known)
    assert run(path, "--tz", "+03:00", "--unit", "dBm").exit_code == 0
    assert run(path, *UTC_DBM).exit_code == 0
    assert len(service.rows) == 20
    assert wanted(known).items() <= service.rows.items()
    # and the same once more sends nothing
    service.rows.clear()
    assert run(path, *UTC_DBM).exit_code == 0
    assert service.rows == {}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--map", "c00"), "write NAME=CARRIER"),
        (("--map", "a=c00", "--map", "a=c01"), "one thing twice"),
        (("--map", "Nobody=c00", *UTC_DBM), "no column 'Nobody'"),
        (("--unit", "dBHz"), "dBHz"),
    ],
)
def test_options_that_mean_nothing_end_with_2(
    service: Service, tmp_path: Path, options: tuple[str, ...], message: str
) -> None:
    done = run(written(tmp_path, Writing(), truth(CARRIERS, 10)), *options)
    assert done.exit_code == 2
    assert message in done.output


def test_files_of_our_own_are_sent_without_a_question(service: Service, tmp_path: Path) -> None:
    known = truth(CARRIERS, 10)
    names = {each: f"{each}_dbm" for each in CARRIERS}
    own = Writing(pattern="%Y-%m-%dT%H:%M:%SZ", time_name="epoch", names=names)
    done = run(written(tmp_path, own, known), "--json", answers="")
    assert done.exit_code == 0, done.output
    assert service.rows == wanted(known)
    without = Writing(pattern="%Y-%m-%d %H:%M:%S", time_name="epoch", names=names)
    path = written(tmp_path, without, known, "again.csv")
    refused = run(path, "--dry-run", "--json")
    assert refused.exit_code == 3
    fault = json.loads(refused.output)["faults"][0]
    assert (fault["rows"], fault["kind"]) == (10, "epoch without offset; state --tz")
    assert run(path, "--tz", "UTC", "--dry-run", "--json").exit_code == 0
