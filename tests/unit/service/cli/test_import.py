"""``soo import`` and its manifests: what is proposed of a folder, sent, left as it is and refused."""

import json
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from foreign_station import write_carriers, write_orbit, write_station
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from service.api.schemas.catalogue import (
    CarrierPlanDocument,
    EphemerisDocument,
    EphemerisReceiptAnswer,
    SpacecraftDocument,
)
from service.cli.importing import import_command as command
from service.cli.importing.manifest import (
    NAME,
    Guess,
    read_manifest,
    read_stated,
    write_manifest,
)
from service.cli.operation import connection
from service.client.service_client import ServiceClient
from service.formats.foreign.columns import PowersStatement as PowersSection
from service.formats.foreign.table import ForeignTableError

MINUTES = 40
STATED = (
    "pegel.csv.tz=Asia/Yekaterinburg",
    "pegel.csv.unit=dBW",
    "star-tracker.csv.tz=UTC",
    "star-tracker.csv.last_day=2026-10-05",
)
DAY_FIRST = "pegel.csv.time_format=%d.%m.%Y %H:%M:%S"
LAST_DAY = "pegel.csv.last_day=2026-10-05"
WINDOW = {"start": "2026-10-05T00:00:00.000000Z", "stop": "2026-10-05T00:30:00.000000Z"}


class Service:
    """A service that keeps what it is sent."""

    def __init__(self) -> None:
        self.kept: dict[str, Any] = {}
        self.rows: dict[str, dict[str, Any]] = {"measurements": {}, "references": {}}
        self.calibrations: list[dict[str, Any]] = []
        self.alignments: list[dict[str, Any]] = []
        self.warnings = ["w"]
        self.orders: list[str] = []
        self.job: dict[str, Any] = {"state": "done"}
        #: code of the answer to every request, and how many requests are answered before the service is away
        self.refusal: tuple[int, str] | None = None
        self.answers_left = 10_000

    def handle(self, request: httpx.Request) -> httpx.Response:
        """Answer one request."""
        self.answers_left -= 1
        if self.answers_left < 0:
            raise httpx.ConnectError("refused")
        if self.refusal is not None:
            return httpx.Response(self.refusal[0], json={"code": self.refusal[1], "detail": "no"})
        path = request.url.path.removeprefix("/api/v1/spacecraft").removeprefix("/yamal-202").strip("/")
        if request.method == "GET":
            return self._read(path)
        if request.method == "DELETE":
            self.calibrations[:] = [one for one in self.calibrations if path != f"calibrations/{one['id']}"]
            return httpx.Response(204)
        self.orders.append(f"{request.method} {path}")
        return httpx.Response(200, json=self._change(path, json.loads(request.content or b"{}")))

    def _read(self, path: str) -> httpx.Response:
        lists = {"calibrations": self.calibrations, "alignments": self.alignments}
        if path in lists:
            return httpx.Response(200, json={"rows": lists[path]})
        if path.startswith("calibrations/"):
            return httpx.Response(200, json=self.calibrations[0])
        if path.startswith("api/v1/jobs"):
            return httpx.Response(200, json=self.job)
        if path == "status":
            ids = {"calibration_id": 1, "alignment_id": 1, "newest_attitude": WINDOW["stop"]}
            return httpx.Response(200, json={"aligned": True, "pending": 0, **ids})
        if path == "attitude":
            angles = {f"{axis}_deg": 0.1 for axis in ("yaw", "roll", "pitch")}
            return httpx.Response(200, json={"epoch": WINDOW["stop"], **angles})
        codes = {"": "spacecraft.unknown", "carriers": "plan.unknown", "ephemeris": "ephemeris.none"}
        if path not in self.kept:
            return httpx.Response(404, json={"code": codes.get(path, "path.unknown"), "detail": "none"})
        return httpx.Response(200, json=self.kept[path])

    def _change(self, path: str, body: dict[str, Any]) -> dict[str, Any]:
        if path == "" and "id" in body:
            self.kept[""] = SpacecraftDocument.model_validate_json(json.dumps(body)).model_dump(mode="json")
        elif path == "carriers":
            plan = CarrierPlanDocument.model_validate_json(json.dumps(body)).model_dump(mode="json")
            self.kept["carriers"] = {"plan_id": 1, **plan}
        elif path == "ephemeris":
            record = EphemerisDocument.model_validate_json(json.dumps(body)).to_record()
            self.kept["ephemeris"] = json.loads(EphemerisReceiptAnswer.of(record).model_dump_json())
        elif path.endswith(":batch"):
            return self._rows(body)
        elif path == "calibrations":
            return self._calibrate(body)
        elif path.endswith(":activate"):
            (made,) = (one for one in self.calibrations if path.startswith(f"calibrations/{one['id']}:"))
            made |= {"state": "active", "override_reason": body.get("override_reason")}
            return made
        elif path == "alignments":
            window = {name: body[name] for name in ("start", "stop")}
            self.alignments.append({"id": 1, "calibration_id": 1, "window": window, "epoch": body["stop"]})
            return self.alignments[-1]
        return {}

    def _calibrate(self, body: dict[str, Any]) -> dict[str, Any]:
        number = 1 + max((one["id"] for one in self.calibrations), default=0)
        figures = {"quality": {"warnings": list(self.warnings)}, "observability": {}, "carriers": []}
        sources = dict.fromkeys(("yaw", "roll", "pitch"), body["source"])
        made = {"id": number, "state": "draft", "plan_id": 1, "ephemeris_id": 1, "sources": sources, **figures, **body}
        self.calibrations.insert(0, made)
        return {"id": number, "job": "j"}

    def _rows(self, body: dict[str, Any]) -> dict[str, Any]:
        kind = "measurements" if "measurements" in body else "references"
        sent = {each["epoch"]: each for each in body[kind]}
        known = len(sent.keys() & self.rows[kind].keys())
        self.rows[kind] |= sent
        return {"accepted": len(sent) - known, "duplicates": known, "late": 0, "refused": []}


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Service:
    """The service that the command is connected with."""
    made = Service()
    monkeypatch.setenv("SOO_KEY", "key")
    client = httpx.MockTransport(made.handle)

    def connected_client(service: str, key: str, **_: object) -> ServiceClient:
        return ServiceClient("http://service", key, retries=0, http=client)

    real = connection.connected

    @contextmanager
    def connected(*given: Any, **options: Any) -> Iterator[Any]:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("service.client.service_client.ServiceClient", connected_client)
            with real(*given, **options) as found:
                yield found

    monkeypatch.setattr(connection, "connected", connected)
    return made


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of a foreign station, with files that are none of ours."""
    write_station(tmp_path, minutes=MINUTES)
    (tmp_path / "notes.txt").write_text("call Ivan\n")
    (tmp_path / "weather.csv").write_text("Time,temperature\n2026-10-05 00:00:00,4\n2026-10-05 01:00:00,5\n")
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
    (tmp_path / "plans.json").write_text('{"a": 1}')
    (tmp_path / "old").mkdir()
    return tmp_path


def run(folder: Path, *options: str) -> Result:
    """Run the command."""
    return CliRunner().invoke(command.import_app, [str(folder), *options])


def propose(folder: Path, *stated: str) -> dict[str, Any]:
    """Write the manifest and return the report."""
    done = run(folder, "--propose", "--json", *(word for each in stated for word in ("--state", each)))
    assert done.exit_code == 0, done.output
    return dict(json.loads(done.stdout))


def with_windows(folder: Path) -> None:
    """Write windows into the manifest, as a person does."""
    windows = {"windows": {name: dict(WINDOW) for name in ("quiet", "turns", "align")}}
    with (folder / "soo.yaml").open("a") as file:
        file.write(yaml.safe_dump(windows))


@pytest.mark.slow
def test_a_proposal_marks_what_no_content_proves_and_sends_nothing(service: Service, folder: Path) -> None:
    report = propose(folder)
    assert set(report["guesses"]) == {
        "powers pegel.csv.time_format",
        "powers pegel.csv.tz",
        "powers pegel.csv.unit",
        "references star-tracker.csv.tz",
        "references star-tracker.csv.last_day",
    }
    assert set(report["left_out"]) == {"notes.txt", "weather.csv", "picture.png", "plans.json", "old"}
    assert report["left_out"]["weather.csv"] == "no column is a carrier or an angle"
    assert report["shortcomings"] == ["less than a day of readings: three quiet days and turns are wanted"]
    assert any("5 Oct 2026 00:39 UTC" in note for note in report["notes"]["star-tracker.csv"])
    refused = run(folder)
    assert refused.exit_code == 2
    assert "powers pegel.csv.unit: dBm" in refused.output
    assert service.orders == []
    (folder / NAME).unlink()
    asked = run(folder)
    assert (asked.exit_code, "this must be stated" in asked.output, service.orders) == (2, True, []), asked.output
    shown = run(folder, "--propose").output
    command_line = shlex.split(shown.splitlines()[-1].partition("or state it: ")[2])
    assert "pegel.csv.unit=dBm" in command_line
    assert command_line.count("--state") == len(report["guesses"])


@pytest.mark.slow
def test_a_second_proposal_keeps_what_was_stated(service: Service, folder: Path) -> None:
    propose(folder, *STATED)
    assert set(propose(folder)["guesses"]) == {"powers pegel.csv.time_format"}
    assert set(propose(folder, DAY_FIRST)["guesses"]) == {"powers pegel.csv.last_day"}
    assert propose(folder, LAST_DAY)["guesses"] == {}
    (powers,) = yaml.safe_load((folder / "soo.yaml").read_text())["powers"]
    assert (powers["tz"], powers["unit"], powers["decimal"]) == ("Asia/Yekaterinburg", "dBW", "comma")
    assert powers["carriers"]["Ch03"] == "c02"
    for stated, said in (
        ("nothing.txt.tz=UTC", "no file nothing.txt"),
        ("tz=UTC", "write FILE.FIELD=VALUE"),
        ("pegel.csv.unit=V", "write dBm, dBW"),
        ("pegel.csv.tz=Moon", "no time zone"),
        ("pegel.csv.colour=red", "colour"),
        ("pegel.csv.last_day=2025-10-05", "the newest row is of 2026-10-05"),
    ):
        wrong = run(folder, "--propose", "--state", stated)
        assert (wrong.exit_code, said in wrong.output) == (2, True), wrong.output


@pytest.mark.slow
def test_a_folder_is_sent_once_and_nothing_that_exists_is_changed(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    dry = run(folder, "--dry-run")
    assert (dry.exit_code, service.orders) == (0, []), dry.output
    assert "spacecraft, carriers, ephemeris" in dry.output
    first = run(folder)
    assert first.exit_code == 0, first.output
    assert "pegel.csv: 40 accepted, 0 duplicates" in first.output
    first_row = service.rows["measurements"]["2026-10-05T00:00:00.000000Z"]
    assert -60.0 < first_row["power_dbm"][0] < -40.0
    service.orders.clear()
    again = run(folder)
    assert again.exit_code == 0, again.output
    assert set(service.orders) <= {"POST attitude-references:batch", "POST measurements:batch"}
    assert "created nothing, all was there" in again.output
    assert not any("control" in order for order in service.orders)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda kept: kept[""].update(torque_limit_n_m=0.1), "spacecraft.torque_limit_n_m: the folder has 0.05"),
        (lambda kept: kept["carriers"]["carriers"][3].update(band="C"), "carriers.c03.band: the folder has Ku"),
        (lambda kept: kept["carriers"]["carriers"].pop(), "carriers: the folder has c00"),
        (lambda kept: kept["ephemeris"].update(nodal_period_s=86000.0), "ephemeris.nodal_period_s"),
    ],
)
def test_what_the_service_has_otherwise_is_listed_and_nothing_is_sent(
    service: Service, folder: Path, change: Any, said: str
) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    assert run(folder).exit_code == 0
    change(service.kept)
    service.orders.clear()
    done = run(folder)
    assert (done.exit_code, said in done.output, service.orders) == (3, True, []), done.output


@pytest.mark.slow
def test_calibration_and_alignment_are_made_once_and_only_when_asked(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    missing = run(folder, "--calibrate")
    assert (missing.exit_code, "states no window quiet or turns" in missing.output) == (2, True)
    assert run(folder, "--align").exit_code == 2
    with_windows(folder)
    assert run(folder).exit_code == 0
    assert (service.calibrations, service.alignments) == ([], [])
    service.warnings = []
    for _ in range(2):
        done = run(folder, "--calibrate", "--align")
        assert done.exit_code == 0, done.output
        assert "calibration 1 is active" in done.output
        assert f"angles at {WINDOW['stop']}: yaw +0.100" in done.output
    assert [each["state"] for each in service.calibrations] == ["active"]
    assert service.calibrations[0]["source"] == "star_tracker"
    assert [each["window"] for each in service.alignments] == [WINDOW]


def test_a_calibration_with_a_warning_stays_a_draft_until_it_is_accepted(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    with_windows(folder)
    stopped = run(folder, "--calibrate", "--align")
    assert stopped.exit_code == 3, stopped.output
    for said in ("warning: w", "calibration 1 is draft, its warnings stand", "--accept"):
        assert said in stopped.output
    assert ([each["state"] for each in service.calibrations], service.alignments) == (["draft"], [])
    accepted = run(folder, "--calibrate", "--align", "--accept", "the yaw sign is known")
    assert accepted.exit_code == 0, accepted.output
    (made,) = service.calibrations
    assert (made["state"], made["override_reason"]) == ("active", "the yaw sign is known")
    assert len(service.alignments) == 1


@pytest.mark.slow
def test_a_second_calibration_with_the_same_figures_leaves_one_draft(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    with_windows(folder)
    for _ in range(2):
        assert "calibration 1 is draft" in run(folder, "--calibrate").output
        assert [each["id"] for each in service.calibrations] == [1]
    service.warnings = ["another"]
    assert "calibration 2 is draft" in run(folder, "--calibrate").output
    assert [each["id"] for each in service.calibrations] == [2, 1]
    accepted = run(folder, "--calibrate", "--accept", "the yaw sign is known")
    assert "calibration 2 is active" in accepted.output


@pytest.mark.slow
def test_a_calibration_that_fails_ends_the_import_with_its_reason(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    with_windows(folder)
    reason = "only 3 carriers can be used, 4 are needed for three angles and the common level"
    service.job = {"state": "failed", "error": reason}
    done = run(folder, "--calibrate", "--align")
    assert (done.exit_code, reason in done.output) == (1, True), done.output
    assert (service.calibrations[-1]["state"], service.alignments) == ("draft", []), "nothing is activated or aligned"


@pytest.mark.slow
def test_an_interrupted_import_goes_on(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    for answers in range(1, 9):
        service.answers_left = answers
        stopped = run(folder, "--patience", "0")
        assert stopped.exit_code in (0, 1), stopped.output
        assert stopped.exit_code == 0 or "no answer from" in stopped.output
    service.answers_left = 1000
    assert run(folder).exit_code == 0
    assert len(service.rows["measurements"]) == len(service.rows["references"]) == MINUTES


@pytest.mark.slow
@pytest.mark.parametrize(
    ("refusal", "said"),
    [((401, "auth.invalid"), "auth.invalid"), ((404, "path.unknown"), "older than this command")],
)
def test_a_wrong_key_and_an_older_service_are_said(
    service: Service, folder: Path, refusal: tuple[int, str], said: str
) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    service.refusal = refusal
    done = run(folder)
    assert (done.exit_code, said in done.output) == (1, True), done.output


@pytest.mark.slow
def test_options_that_contradict_each_other_and_missing_files_are_refused(service: Service, folder: Path) -> None:
    assert run(folder, "--propose", "--align").exit_code == 2
    assert run(folder, "--state", "a.b=c").exit_code == 2
    assert run(folder, "--state", "b=c").exit_code == 2
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    (folder / "yamal.tle").unlink()
    done = run(folder)
    assert (done.exit_code, "has no yamal.tle, which the manifest names" in done.output) == (2, True)


@pytest.mark.slow
def test_the_orbit_of_another_satellite_is_left_out_or_refused(service: Service, folder: Path) -> None:
    write_orbit(folder / "neighbour.tle", 49.0)
    assert "orbit of another satellite" in propose(folder, *STATED, DAY_FIRST, LAST_DAY)["left_out"]["neighbour.tle"]
    write_orbit(folder / "yamal.tle", 49.0)
    done = run(folder)
    assert (done.exit_code, "the orbit of another satellite" in done.output) == (2, True)
    assert service.orders == []


@pytest.mark.slow
def test_exchanged_coordinates_are_refused_before_anything_is_sent(service: Service, folder: Path) -> None:
    propose(folder, *STATED, DAY_FIRST, LAST_DAY)
    write_carriers(folder / "carriers.csv", is_exchanged=True)
    done = run(folder)
    assert (done.exit_code, "latitude and longitude look exchanged" in done.output) == (2, True), done.output
    (folder / NAME).unlink()
    again = run(folder, *(word for each in (*STATED, DAY_FIRST, LAST_DAY) for word in ("--state", each)))
    assert (again.exit_code, "a file that the others need is left out" in again.output) == (2, True), again.output
    assert service.orders == []


@pytest.mark.slow
def test_several_files_of_one_role_and_channels_without_names_are_guesses(service: Service, folder: Path) -> None:
    (folder / "satellite-2.csv").write_bytes((folder / "satellite.csv").read_bytes())
    text = (folder / "pegel.csv").read_text("utf-8-sig")
    (folder / "pegel.csv").write_text(text.replace("Ch", "Kanal "))
    (folder / "star-tracker.csv").rename(folder / "angles.csv")
    guesses = propose(folder)["guesses"]
    assert guesses["spacecraft.file"] == "one of satellite-2.csv, satellite.csv"
    assert "no column has the name of a carrier" in guesses["powers pegel.csv.carriers"]
    assert "names no sensor" in guesses["references angles.csv.source"]
    assert "Kanal 03: c02" in (folder / "soo.yaml").read_text()


TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=("C",)), min_size=1, max_size=20).filter(str.strip)
TABLE = """\
powers:
- {file: levels.csv, source: sa-1, tz: +10:00, unit: dBW, carriers: {On: c00, 0123: c01, 2026-01-01: c02}}
windows:
  turns: {start: 2026-10-08T00:00:00+03:00, stop: '2026-10-08T08:00:00Z'}
"""


def written(folder: Path, text: str) -> Path:
    """Return a folder with a manifest."""
    (folder / NAME).write_text(text)
    return folder


def test_texts_that_yaml_would_take_for_something_else_stay_texts(tmp_path: Path) -> None:
    manifest = read_manifest(written(tmp_path, TABLE))
    (powers,) = manifest.powers
    assert (powers.tz, dict(powers.carriers)) == ("+10:00", {"On": "c00", "0123": "c01", "2026-01-01": "c02"})
    assert manifest.windows.turns is not None
    assert manifest.windows.model_dump(mode="json")["turns"]["start"] == "2026-10-07T21:00:00.000000Z"


@given(st.dictionaries(TEXTS, TEXTS, max_size=4), TEXTS, st.sampled_from(["UTC", "+10:00", "-03:30", "no", "1e3"]))
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, carriers: dict[str, str], file: str, tz: str
) -> None:
    folder = tmp_path_factory.mktemp("folder")
    entry = {"file": file, "source": "sa-1", "tz": tz, "carriers": carriers}
    write_manifest(folder, {"carriers": file, "powers": [entry]})
    manifest = read_manifest(folder)
    assert manifest.carriers == file
    assert manifest.powers == (PowersSection.model_validate(entry),)


def test_guesses_are_refused_by_line_and_left_out_of_what_is_stated(tmp_path: Path) -> None:
    entry = {"file": "levels.csv", "source": "sa-1", "tz": Guess("UTC", "no offset"), "unit": "dBm"}
    write_manifest(tmp_path, {"powers": [entry], "windows": {"turns": Guess({"start": "a", "stop": "b"}, "unsure")}})
    text = (tmp_path / NAME).read_text()
    assert "# levels.csv.tz: no offset" in text
    with pytest.raises(ForeignTableError) as ended:
        read_manifest(tmp_path)
    said = str(ended.value)
    line = text.splitlines().index("  tz: !guess 'UTC'") + 1
    assert f"line {line}: powers levels.csv.tz: UTC" in said
    assert "windows.turns" in said
    stated = read_stated(tmp_path)
    assert (stated.powers[0].unit, stated.powers[0].tz, stated.windows.turns) == ("dBm", None, None)
    written(
        tmp_path, text.replace("!guess ", "").replace("!guess", "").replace("start: a", "start: 2026-01-01T00:00:00Z")
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("powers: [", "is no YAML"),
        ("- a\n", "is no manifest"),
        ("", "is no manifest"),
        ("carriers: a.csv\ncarriers: b.csv\n", "'carriers' occurs twice"),
        ("powers: &a []\nreferences: *a\n", "has no aliases"),
        ("carriers: !!python/name:os.system\n", "is no YAML"),
        ("colour: red\n", "/colour: unknown field"),
        ("powers: [{file: a, source: b, decimal: dot}]\n", "/powers/0/decimal"),
        ("powers: [{source: b}]\n", "/powers/0/file: this field is required"),
        ("windows: {quiet: {start: yesterday, stop: today}}\n", "/windows/quiet/start: 'yesterday' is not"),
    ],
)
def test_what_is_no_manifest_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ForeignTableError) as ended:
        read_manifest(written(tmp_path, text))
    assert said in str(ended.value)


@pytest.mark.parametrize("encoding", ["ascii", "cp1251"])
def test_names_that_a_terminal_cannot_show_do_not_end_a_proposal(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "pegel-Δ.csv").write_text("Time,Уровень\n2026-10-05 00:00:00,дождь\n")
    done = soo("import", str(tmp_path), "--propose", PYTHONIOENCODING=encoding)
    assert done.returncode == 0, done.stderr
    shown = "left out: pegel-\\u0394.csv: no column is a carrier or an angle"
    assert shown in done.stdout.decode(encoding)


@pytest.mark.parametrize(
    ("words", "completed"), [("soo pu", "put"), ("soo put pow", "powers"), ("soo put --refuse", "--refuse-unknown")]
)
def test_a_shell_completes_commands_kinds_and_options(words: str, completed: str) -> None:
    done = soo(_SOO_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=str(words.count(" ")))
    assert done.stdout.decode().split() == [completed]


def soo(*words: str, **environment: str) -> subprocess.CompletedProcess[bytes]:
    """Run the installed command in a process of its own."""
    program = Path(sys.executable).with_name("soo")
    return subprocess.run([program, *words], env=os.environ | environment, capture_output=True, check=False)


def test_a_folder_without_a_manifest_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ForeignTableError, match="--propose"):
        read_manifest(tmp_path)
    assert read_stated(tmp_path).powers == ()
