"""``soo send`` with tables and messages of other programs: what is stated, read back, sent and refused."""

import json
import random
import shlex
import tracemalloc
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pyarrow as pa
import pytest
import typer
from foreign_files import Truth, Writing, table, truth, write_table
from hypothesis import given, settings
from hypothesis import strategies as st
from pyarrow import parquet
from typer.testing import CliRunner, Result

from service.cli.own_data.foreign_archive import ForeignArchive, sample_of
from service.cli.own_data.tdm_archive import open_any_archive
from service.cli.station import send as module
from service.client.service_client import ServiceClient
from service.formats.foreign.layout import StatedLayout, TableLayout
from service.formats.foreign.proposal import propose
from service.frontend.backfill.columns import ArchiveError
from service.frontend.backfill.reader import FileRow
from service.records.epoch import format_epoch

CARRIERS = ("c00", "c01", "c02")
PLAN = {each: each for each in CARRIERS}
STATED = StatedLayout(tz="UTC", unit="dBm")


def layout_of(path: Path, stated: StatedLayout) -> TableLayout:
    """Return the layout of a file that leaves no question."""
    proposal = propose(sample_of(path), stated, PLAN)
    assert proposal.questions == ()
    assert proposal.layout is not None
    return proposal.layout


def rows_of(path: Path, stated: StatedLayout = STATED) -> list[FileRow]:
    """Return the rows of a file, those that cannot be read too."""
    with closing(ForeignArchive(path, layout_of(path, stated))) as archive:
        return list(archive.rows())


def read(path: Path, stated: StatedLayout = STATED) -> dict[int, list[float | None]]:
    """Return levels by epoch, in the order of the carriers."""
    order = list(dict.fromkeys(layout_of(path, stated).carriers.values()))
    rows = rows_of(path, stated)
    assert [row.detail for row in rows if row.fault] == []
    return {row.cells[0]: [row.cells[1 + order.index(name)] for name in CARRIERS if name in order] for row in rows}


def wanted(known: Truth) -> dict[int, list[float]]:
    """Return the truth by epoch."""
    return {
        round(epoch.timestamp() * 1e6): list(levels)
        for epoch, levels in zip(known.epochs, known.levels_dbm, strict=True)
    }


@pytest.mark.parametrize(
    ("writing", "stated"),
    [
        (Writing(), STATED),
        (Writing(separator=";", decimal=",", pattern="%d.%m.%Y %H:%M:%S", end="\r\n", mark=b"\xef\xbb\xbf"), STATED),
        (Writing(separator="\t", pattern="%m/%d/%Y %I:%M:%S %p"), STATED),
        (Writing(decimal=",", pattern="%Y/%m/%d %H:%M"), STATED),
        (Writing(pattern="1"), STATED),
        (Writing(pattern="1000"), STATED),
        (Writing(pattern="%Y-%m-%dT%H:%M:%S%z", zone="Asia/Tokyo"), StatedLayout(unit="dBm")),
        (Writing(zone="Europe/Moscow"), StatedLayout(tz="Europe/Moscow", unit="dBm")),
        (Writing(zone="Asia/Kolkata"), StatedLayout(tz="+05:30", unit="dBm")),
        (Writing(offset_db=30.0), StatedLayout(tz="UTC", unit="dBW")),
        (Writing(offset_db=30.0, names={each: f"{each} (dBW)" for each in CARRIERS}), StatedLayout(tz="UTC")),
        (Writing(time_name="epoch UTC", names={each: f"{each}_dBm" for each in CARRIERS}), StatedLayout()),
        (Writing(is_long=True), STATED),
        (Writing(is_long=True, separator=";", decimal=","), STATED),
        (
            Writing(names={"c00": "Ch 1", "c01": "Ch 2", "c02": "Ch=3"}),
            StatedLayout(tz="UTC", unit="dBm", carriers={"Ch 1": "c00", "Ch 2": "c01", "Ch=3": "c02"}),
        ),
        (
            Writing(is_long=True, names={"c00": "A", "c01": "B", "c02": "C"}),
            StatedLayout(tz="UTC", unit="dBm", carrier_column="Channel", carriers={"A": "c00", "B": "c01", "C": "c02"}),
        ),
    ],
)
def test_tables_are_read_back_to_what_was_written(tmp_path: Path, writing: Writing, stated: StatedLayout) -> None:
    # a day above the twelfth proves the order of day and month
    known = truth(CARRIERS, 200, datetime(2026, 3, 21, 20, 0, tzinfo=UTC))
    path = write_table(tmp_path / "levels.csv", table(known, writing), writing)
    assert read(path, stated) == wanted(known)


def test_long_tables_may_come_carrier_by_carrier(tmp_path: Path) -> None:
    known = truth(CARRIERS, 50)
    header, *rows = table(known, Writing(is_long=True))
    rows.sort(key=lambda row: row[1])
    assert read(write_table(tmp_path / "levels.csv", [header, *rows], Writing())) == wanted(known)


def test_a_second_level_of_one_carrier_at_one_epoch_is_kept_back(tmp_path: Path) -> None:
    header, *rows = table(truth(CARRIERS, 3), Writing(is_long=True))
    path = write_table(tmp_path / "levels.csv", [header, *rows, [*rows[0][:2], "-1.5"]], Writing())
    kept_back = [row for row in rows_of(path) if row.fault]
    assert [(row.line, row.fault) for row in kept_back] == [(11, "second level of one carrier at one epoch")]


def test_date_and_time_in_two_columns(tmp_path: Path) -> None:
    known = truth(CARRIERS, 20, datetime(2026, 3, 21, tzinfo=UTC))
    rows = [[*row[0].split(" "), *row[1:]] for row in table(known, Writing(pattern="%d.%m.%Y %H:%M:%S"))[1:]]
    path = write_table(tmp_path / "levels.csv", [["Date", "Clock", *CARRIERS], *rows], Writing())
    assert layout_of(path, STATED).time_columns == ("Date", "Clock")
    assert read(path) == wanted(known)


@pytest.mark.parametrize("zone", [None, "UTC", "Asia/Tokyo"])
@pytest.mark.parametrize("unit", ["us", "ns", "ms"])
def test_parquet_is_read_with_and_without_a_zone(tmp_path: Path, zone: str | None, unit: str) -> None:
    known = truth(CARRIERS, 30)
    levels = {name: [row[k] for row in known.levels_dbm] for k, name in enumerate(CARRIERS)}
    instants = pa.array([each.replace(tzinfo=None) for each in known.epochs], pa.timestamp(unit))
    if zone is not None:
        instants = instants.cast(pa.timestamp(unit, tz=zone))
    path = tmp_path / "levels.parquet"
    parquet.write_table(pa.table({"when": instants, **levels}), path)
    stated = STATED if zone is None else StatedLayout(unit="dBm")
    if zone is None:
        questions = propose(sample_of(path), StatedLayout(unit="dBm"), PLAN).questions
        assert [each.option for each in questions] == ["--tz"]
    assert read(path, stated) == wanted(known)


def test_cells_without_a_level_are_absent_and_odd_ones_are_kept_back(tmp_path: Path) -> None:
    header, *rows = table(truth(CARRIERS, 60), Writing())
    rows[3][1], rows[4][2], rows[5][3], rows[6][1] = "", "NaN", "n/a", "---"
    rows[7][1], rows[8][2], rows[9][0] = "overload", "-60,5", "2026-02-30 00:00:00"
    path = write_table(tmp_path / "levels.csv", [header, *rows], Writing())
    found = rows_of(path)
    assert [found[k].cells[n] for k, n in ((3, 1), (4, 2), (5, 3), (6, 1))] == [None] * 4
    odd = {row.line: row for row in found if row.fault}
    assert {line: row.fault for line, row in odd.items()} == {
        9: "level is no number with decimal point",
        10: "level is no number with decimal point",
        11: "epoch is not iso",
    }
    # under our own header: what is understood in dBm, the rest as it stands
    assert odd[9].cells[1] == "overload"
    assert odd[11].cells == ["2026-02-30 00:00:00", *map(float, rows[9][1:])]


def test_a_file_that_was_cut_off_does_not_give_a_cut_number(tmp_path: Path) -> None:
    known = truth(CARRIERS, 20)
    path = write_table(tmp_path / "levels.csv", table(known, Writing()), Writing())
    whole = path.read_bytes()
    draw = random.Random(3)
    for _ in range(40):
        path.write_bytes(whole[: draw.randrange(len(whole) // 2, len(whole) - 1)])
        readable = {row.cells[0]: row.cells[1:] for row in rows_of(path) if not row.fault}
        assert readable.items() <= wanted(known).items()
        assert len(readable) >= 8


@pytest.mark.parametrize("zone", ["Europe/Berlin", "America/New_York"])
def test_hours_that_a_change_of_the_clocks_repeats_are_kept_back(tmp_path: Path, zone: str) -> None:
    known = truth(CARRIERS, 8, datetime(2025, 10, 26, tzinfo=UTC), step_s=900.0)
    if zone == "America/New_York":
        known = truth(CARRIERS, 8, datetime(2025, 11, 2, 5, tzinfo=UTC), step_s=900.0)
    path = write_table(tmp_path / "levels.csv", table(known, Writing(zone=zone)), Writing())
    faults = [row.fault for row in rows_of(path, StatedLayout(tz=zone, unit="dBm"))]
    assert faults == ["epoch in an hour that the change of the clocks repeats or leaves out"] * 8


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "no header with lines"),
        (b"\xff\xfet\x00", "UTF-16"),
        ("Время;c00\n2026;-1\n".encode("cp1251"), "not UTF-8"),
        (b"Time,c00;c01\n" + b"2026-03-01 00:00:00;-60.5;-61\n" * 5, "mixed separators"),
        (b"Time,c00,c01\n" + b"2026-03-01 00:00:00,-60,5,-61,25\n" * 5, "decimal comma"),
        (b"x" * (1 << 20) + b"\n", "this is no table"),
        (b'Time,c00\n"2026,-1\n' + b"2026,-1\n" * 40_000, "check the quotes|no header|separator"),
        (b"nothing of a table\nat all\n", "mixed separators"),
    ],
)
def test_what_is_no_table_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "levels.csv"
    path.write_bytes(content)
    with pytest.raises(ArchiveError, match=message):
        sample_of(path)


def test_a_parquet_file_that_was_cut_off_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "levels.parquet"
    parquet.write_table(pa.table({"Time": ["2026-03-01 00:00:00"] * 100, "c00": [-60.0] * 100}), path)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(ArchiveError, match="cut off"):
        sample_of(path)


@pytest.mark.parametrize("is_long", [False, True])
def test_memory_does_not_grow_with_the_file(tmp_path: Path, is_long: bool) -> None:
    writing = Writing(is_long=is_long)
    path = write_table(tmp_path / "levels.csv", table(truth(CARRIERS, 200), writing), writing)
    layout = layout_of(path, STATED)
    peaks = []
    for rows in (500, 5_000):
        write_table(path, table(truth(CARRIERS, rows), writing), writing)
        archive = ForeignArchive(path, layout)
        tracemalloc.start()
        assert sum(1 for _ in archive.rows()) == rows
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        archive.close()
    assert peaks[1] < 1.5 * peaks[0] + 100_000
    print(f"peak {peaks[1] / 1e6:.2f} MB")


@settings(deadline=None)
@given(st.binary(max_size=400))
def test_no_bytes_end_in_anything_but_a_refusal(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.mktemp("bytes") / "levels.csv"
    path.write_bytes(b"Time,c00\n" + content)
    try:
        sample = sample_of(path)
    except ArchiveError:
        return
    assert all(len(row) == len(sample.header) for row in sample.rows)


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

    def connected(*_: object, **__: object) -> ServiceClient:
        return ServiceClient("http://service", "key", retries=0, http=httpx.MockTransport(made.handle))

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


def file_wanted(known: Truth) -> dict[str, list[float]]:
    """Return the truth by epoch as the service has it."""
    return {format_epoch(epoch_us): levels for epoch_us, levels in wanted(known).items()}


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
    assert service.rows == file_wanted(known)


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
    assert file_wanted(known).items() <= service.rows.items()
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
    assert service.rows == file_wanted(known)
    without = Writing(pattern="%Y-%m-%d %H:%M:%S", time_name="epoch", names=names)
    path = written(tmp_path, without, known, "again.csv")
    refused = run(path, "--dry-run", "--json")
    assert refused.exit_code == 3
    fault = json.loads(refused.output)["faults"][0]
    assert (fault["rows"], fault["kind"]) == (10, "epoch without offset; state --tz")
    assert run(path, "--tz", "UTC", "--dry-run", "--json").exit_code == 0


MESSAGE = """CCSDS_TDM_VERS = 2.0
META_START
TRACK_ID = sa-1/c01
TIME_SYSTEM = UTC
META_STOP
DATA_START
CARRIER_POWER = 2026-11-21T00:01:00.000000 -72.25
CARRIER_POWER = 2026-11-21T00:00:00.000000 -72.1
DATA_STOP
META_START
TRACK_ID = sa-1/c00
TIME_SYSTEM = UTC
META_STOP
DATA_START
CARRIER_POWER = 2026-11-21T00:00:00.000000 -80
PC_N0 = 2026-11-21T00:00:00.000000 70
DATA_STOP
"""
LINES = '{"epoch":"2026-11-21T00:00:00Z","c00_dbm":-40.5}\n\n{"c00_dbm":null,"epoch":"2026-11-21T00:00:01Z"}\n'


def tdm_read(path: Path, text: str) -> tuple[list[str], list[list[Any]]]:
    """Return header and cells of a file with this text."""
    path.write_text(text)
    with closing(open_any_archive(path)) as archive:
        rows = [row.cells for row in archive.rows()]
        assert archive.done == archive.total
        return archive.header, rows


def test_segments_of_a_message_become_rows(tmp_path: Path) -> None:
    header, rows = tdm_read(tmp_path / "powers.tdm", MESSAGE)
    assert header == ["epoch", "source", "c01_dbm", "c00_dbm"]
    assert rows == [[1_795_219_200_000_000, "sa-1", -42.1, -50.0], [1_795_219_260_000_000, "sa-1", -42.25, None]]


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [("sa-1/c01", "track 7", "TRACK_ID"), ("-72.25", "loud", "line 7"), ("CCSDS_TDM", "CCSDS_XXX", "line 1")],
)
def test_other_messages_are_refused(tmp_path: Path, old: str, new: str, word: str) -> None:
    with pytest.raises(ArchiveError, match=word):
        tdm_read(tmp_path / "powers.tdm", MESSAGE.replace(old, new))


def test_objects_are_read_by_name(tmp_path: Path) -> None:
    header, rows = tdm_read(tmp_path / "levels.ndjson", LINES)
    assert header == ["epoch", "c00_dbm"]
    assert rows == [["2026-11-21T00:00:00Z", -40.5], ["2026-11-21T00:00:01Z", None]]


@pytest.mark.parametrize(
    ("line", "word"),
    [("{", "line 4 is no JSON"), ("[1]", "line 4 is no JSON object"), ('{"epoch":1}', "line 4 has other names")],
)
def test_lines_that_are_no_such_objects_are_refused(tmp_path: Path, line: str, word: str) -> None:
    with pytest.raises(ArchiveError, match=word):
        tdm_read(tmp_path / "levels.ndjson", LINES + line + "\n")


def test_a_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError):
        open_any_archive(tmp_path / "none.tdm")
