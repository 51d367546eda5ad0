"""Commands of an operation: profile, connection, ``calibrate``, ``compare`` and ``replays``."""

import json
import math
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import numpy as np
import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.operation import connection
from service.cli.operation.connection import connected
from service.cli.operation.profile import ProfileError, UserProfile, profile_path, read_profile, write_profile
from service.formats.series_tables import ATTITUDE
from service.formats.table_file import table_bytes
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import NO_ANGLES, Axes, row_without_attitude

URL = "http://127.0.0.1:9"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    for name in ("SOO_KEY", "SOO_KEY_FILE", "SOO_URL", "SOO_SPACECRAFT"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def key_file(folder: Path, mode: int = 0o600, text: str = "the-key\n") -> Path:
    path = folder / "operator.key"
    path.write_text(text)
    path.chmod(mode)
    return path


def written(text: str) -> Path:
    profile_path().parent.mkdir(parents=True, exist_ok=True)
    profile_path().write_text(text)
    return profile_path()


def test_what_is_written_is_read(home: Path) -> None:
    path = write_profile(URL, key_file(home), "yamal-202")
    assert path == home / "soo/profile.toml"
    assert read_profile() == UserProfile(URL, home / "operator.key", "yamal-202")
    assert read_profile().key() == "the-key"


CHARACTERS = st.characters(codec="utf-8", min_codepoint=1, exclude_characters="/\x7f")


@given(name=st.text(CHARACTERS, min_size=1, max_size=40))
def test_any_name_of_a_file_comes_back(tmp_path_factory: pytest.TempPathFactory, name: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        folder = tmp_path_factory.mktemp("config")
        patch.setenv("XDG_CONFIG_HOME", str(folder))
        stated = folder.resolve() / "keys" / f"k{name}"
        write_profile(URL, stated, None)
        assert read_profile() == UserProfile(URL, stated, None)


def test_without_a_file_nothing_is_stated() -> None:
    assert read_profile() == UserProfile()
    assert UserProfile().key() is None


def test_another_profile_is_not_overwritten(home: Path) -> None:
    path = write_profile(URL, key_file(home), None)
    before = path.read_bytes()
    assert write_profile(URL, key_file(home), None) == path
    with pytest.raises(ProfileError, match="states another service"):
        write_profile("http://elsewhere", key_file(home), None)
    assert path.read_bytes() == before


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o620])
def test_a_key_that_others_can_read_is_refused_with_the_command_that_mends_it(home: Path, mode: int) -> None:
    path = key_file(home, mode)
    with pytest.raises(ProfileError, match=f"run chmod 600 {path}"):
        UserProfile(URL, path).key()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("service = ", "cannot be read"),
        ('sevice = "x"', "sevice: a profile has key_file, service, spacecraft"),
        ("spacecraft = 7", "spacecraft: a profile has"),
        ('service = ""', "service: a profile has"),
    ],
)
def test_a_profile_that_is_none_names_file_and_fault(text: str, said: str) -> None:
    path = written(text)
    with pytest.raises(ProfileError, match=said) as caught:
        read_profile()
    assert str(path) in str(caught.value)


def test_an_empty_key_file_and_a_missing_one_are_named(home: Path) -> None:
    with pytest.raises(ProfileError, match="is empty"):
        UserProfile(URL, key_file(home, text="\n")).key()
    with pytest.raises(ProfileError, match="cannot be read"):
        UserProfile(URL, home / "none").key()


class Requests(list):
    """Requests of commands, answered by a service with some spacecraft."""

    spacecraft = ("yamal-202",)


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> Requests:
    from service.client.service_client import ServiceClient

    seen = Requests()

    def request(client: ServiceClient, _method: str, path: str, *_: object, **__: object) -> dict[str, object]:
        seen.append((client.service_url, client._http.headers["Authorization"], path))
        return {"rows": [{"id": name} for name in seen.spacecraft]}

    def replays(client: ServiceClient, spacecraft_id: str) -> list[dict[str, str]]:
        seen.append((client.service_url, client._http.headers["Authorization"], spacecraft_id))
        return [{"version": "replay-1"}]

    monkeypatch.setattr(ServiceClient, "request", request)
    monkeypatch.setattr(ServiceClient, "replays", replays)
    return seen


def run(*options: str, **environment: str):
    return CliRunner().invoke(app, ["replays", "--json", *options], env=environment)


def test_service_key_and_spacecraft_come_from_the_profile(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), "express-80")
    result = run()
    assert json.loads(result.stdout) == {"version": "replay-1"}
    assert requests == [(URL, "Bearer the-key", "express-80")]


def test_options_go_before_the_environment_and_it_before_the_profile(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), "a-1")
    run(SOO_URL="http://127.0.0.1:8", SOO_SPACECRAFT="b-2", SOO_KEY="other")
    run("--service", "http://127.0.0.1:7", "--spacecraft", "c-3", SOO_URL="http://127.0.0.1:8", SOO_KEY="other")
    assert requests == [
        ("http://127.0.0.1:8", "Bearer other", "b-2"),
        ("http://127.0.0.1:7", "Bearer other", "c-3"),
    ]


def test_a_key_of_the_profile_never_goes_to_another_service(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), "a-1")
    result = run("--service", "http://127.0.0.1:7")
    assert (result.exit_code, requests) == (2, [])
    assert "names none for this service" in result.output


def test_the_only_spacecraft_of_a_service_needs_no_name(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home), None)
    assert run().exit_code == 0
    assert [path for _, _, path in requests] == ["/spacecraft", "yamal-202"]


@pytest.mark.parametrize(
    ("held", "said"), [(("a-1", "b-2"), "has a-1, b-2: state one with --spacecraft"), ((), "has no spacecraft")]
)
def test_several_spacecraft_or_none_end_the_command(
    home: Path, requests: Requests, held: tuple[str, ...], said: str
) -> None:
    write_profile(URL, key_file(home), None)
    requests.spacecraft = held
    result = run()
    assert (result.exit_code, said in result.output) == (2, True)


def test_a_key_that_others_can_read_ends_the_command(home: Path, requests: Requests) -> None:
    write_profile(URL, key_file(home, 0o644), "a-1")
    result = run()
    assert (result.exit_code, requests) == (2, [])
    assert "chmod 600" in result.output


@pytest.mark.parametrize(
    ("status", "code", "is_older"),
    [(404, "path.unknown", True), (405, "method.not_allowed", True), (404, "spacecraft.unknown", False)],
)
def test_a_request_that_the_service_does_not_know_is_one_for_a_newer_service(
    status: int, code: str, is_older: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = said_of(status, {"code": code, "detail": "there is none", "next_step": "Look."}, monkeypatch, capsys)
    assert f"{status} {code}: there is none" in said
    assert ("update the service, or use the soo of its version" in said) == is_older
    assert ("\nNext: Look.\n" in said) != is_older


def test_faulty_fields_stand_below_the_detail_and_the_next_step_last(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    errors = [
        {"pointer": f"/carriers/{k}/id", "code": "carrier.duplicate", "detail": f"two have {k}"} for k in range(14)
    ]
    problem = {"code": "request.invalid", "detail": "14 fields are invalid", "next_step": "Correct them."}
    head = "422 request.invalid: 14 fields are invalid (request r-1)"
    listed = [f"  /carriers/{k}/id: two have {k}" for k in range(14)]
    whole = {**problem, "request_id": "r-1", "errors": errors[:12]}
    assert said_of(422, whole, monkeypatch, capsys).splitlines() == [head, *listed[:12], "Next: Correct them."]
    more = {**whole, "errors": errors}
    lines = said_of(422, more, monkeypatch, capsys).splitlines()
    assert lines == [head, *listed[:12], "  (and 2 more)", "Next: Correct them."]
    # a fault of the whole document, and an answer of an older service
    older = {"code": "json.malformed", "detail": "the body is wrong", "errors": [{"pointer": "", "detail": "is empty"}]}
    assert said_of(400, older, monkeypatch, capsys) == "400 json.malformed: the body is wrong\n  /: is empty\n"


def test_the_only_fault_is_not_said_twice_and_a_busy_service_says_its_next_step_too(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    named = {"code": "value.range", "detail": "/a: must be 1", "errors": [{"pointer": "/a", "detail": "must be 1"}]}
    assert said_of(422, named, monkeypatch, capsys) == "422 value.range: /a: must be 1\n"
    placed = {**named, "detail": "must be 1"}
    assert said_of(422, placed, monkeypatch, capsys) == "422 value.range: must be 1\n  /a\n"
    busy = {"code": "storage.closed", "detail": "The archive is closing.", "next_step": "Wait."}
    said = said_of(503, busy, monkeypatch, capsys, retries=0)
    assert said == "503 storage.closed: The archive is closing. Next: Wait.\n"


def said_of(
    status: int,
    problem: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    **options: Any,
) -> str:
    """Return what a command prints of a problem, ended with 1."""
    monkeypatch.setenv("SOO_KEY", "a-key")
    http = httpx.MockTransport(lambda _: httpx.Response(status, json=problem))
    with (
        pytest.raises(typer.Exit) as ended,
        connected("http://127.0.0.1:9", "SOO_KEY", http=http, **options) as client,
    ):
        client.status("yamal-202")
    assert ended.value.exit_code == 1
    return capsys.readouterr().err


def test_a_key_that_the_service_does_not_know_is_said_to_come_from_somewhere(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said = said_of(401, {"code": "key.invalid", "detail": "There is none.", "next_step": "Send."}, monkeypatch, capsys)
    start = "401 key.invalid: There is none.\nNext: correct the key of SOO_KEY, of the file of SOO_KEY_FILE, or of /"
    assert said.startswith(start)


@pytest.mark.parametrize("address", ["127.0.0.1:8000", "ftp://127.0.0.1", "service"])
def test_an_address_of_no_service_is_a_wrong_option(address: str) -> None:
    done = CliRunner().invoke(app, ["status"], env={"SOO_URL": address, "SOO_KEY": "a-key"})
    assert done.exit_code == 2
    assert f"{address!r} is no address of a service: state http://HOST:PORT" in done.stderr


QUIET = ("2026-11-01T00:00:00Z", "2026-11-04T00:00:00Z")
TURNS = ("2026-11-04T00:00:00Z", "2026-11-04T08:30:00Z")
RESULT: dict[str, Any] = {
    "id": 7,
    "carriers": [{"id": "c00", "selected": True}, {"id": "c01", "selected": False}],
    "quality": {"warnings": ["c01 was silent"]},
}


class Service:
    """A service that notes what it is asked and has its calibration done at once."""

    def __init__(self) -> None:
        self.bodies: list[dict[str, Any]] = []
        self.activated: list[tuple[int, str | None]] = []

    def start_calibration(self, spacecraft_id: str, body: dict[str, Any]) -> dict[str, Any]:
        assert spacecraft_id == "yamal-202"
        self.bodies.append(body)
        return {"id": RESULT["id"], "job": "job-7"}

    def wait_job(self, job_id: str, *, on_progress: Any) -> None:
        assert job_id == "job-7"
        on_progress(1.0)

    def activate_calibration(self, spacecraft_id: str, calibration_id: int, reason: str | None) -> None:
        self.activated.append((calibration_id, reason))

    def calibration(self, spacecraft_id: str, calibration_id: int) -> dict[str, Any]:
        assert calibration_id == RESULT["id"]
        return {**RESULT, "state": "active" if self.activated else "draft"}


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch) -> Service:
    made = Service()

    monkeypatch.setattr(connection, "connected", lambda _service, _key_env: nullcontext(made))
    return made


def calibrate(*options: str) -> Any:
    windows = ["--quiet", *QUIET, "--turns", *TURNS]
    return CliRunner().invoke(app, ["calibrate", "--spacecraft", "yamal-202", *windows, *options])


def test_a_calibration_is_by_geometry_unless_said_otherwise(service: Service) -> None:
    assert calibrate().exit_code == 0
    assert calibrate("--method", "paper", "--source", "earth_sensor").exit_code == 0
    window = {"quiet": dict(zip(("start", "stop"), QUIET, strict=True))}
    window |= {"turns": dict(zip(("start", "stop"), TURNS, strict=True))}
    assert service.bodies == [
        {**window, "method": "geometry", "source": "star_tracker"},
        {**window, "method": "paper", "source": "earth_sensor"},
    ]


def test_a_calibration_stays_a_draft_unless_it_is_to_be_activated(service: Service) -> None:
    result = calibrate()
    assert service.activated == []
    assert result.stdout == "calibration 7 is draft; selected: c00\nwarning: c01 was silent\n"
    assert calibrate("--activate").stdout.startswith("calibration 7 is active;")
    assert calibrate("--activate", "--override-reason", "the clock is right").exit_code == 0
    assert service.activated == [(7, None), (7, "the clock is right")]


def test_json_is_the_answer_of_the_service(service: Service) -> None:
    assert json.loads(calibrate("--json").stdout) == {**RESULT, "state": "draft"}


def test_an_alignment_says_which_rows_it_computes_and_names_the_replay_of_those_it_keeps(service: Service) -> None:
    made = {"id": 3, "epoch": "2026-11-04T09:29:00.000000Z", "created_at": "2026-11-04T11:00:00.000000Z"}
    made |= dict.fromkeys(("yaw_deg", "roll_deg", "pitch_deg"), 0.0)
    asked = ["align", "--spacecraft", "yamal-202", "--start", TURNS[1], "--stop", "2026-11-04T09:30:00Z"]
    service.align = lambda _spacecraft, _body: {**made, "rows_recomputed": 0, "rows_kept": 90}  # type: ignore[attr-defined]
    reported = CliRunner().invoke(app, asked).stdout
    assert "stored rows after it: 0 computed, 90 kept" in reported
    span = "--start 2026-11-04T09:29:00.000000Z --stop 2026-11-04T11:00:00.000000Z"
    assert f"soo replay --spacecraft yamal-202 {span} --alignment 3 --order epoch" in reported
    service.align = lambda _spacecraft, _body: {**made, "rows_recomputed": 4, "rows_kept": 0}  # type: ignore[attr-defined]
    assert "soo replay" not in CliRunner().invoke(app, asked).stdout


@pytest.mark.parametrize(("options", "commands"), [((), True), (("--no-commands",), False)])
def test_a_replay_leaves_torques_out_where_they_are_not_wanted(
    service: Service, options: tuple[str, ...], commands: bool
) -> None:
    asked = []

    def request(method: str, path: str, body: dict[str, Any]) -> dict[str, Any]:
        asked.append((method, path, body["commands"]))
        return {"id": 4, "version": "replay-4", "job": "job-7"}

    service.request = request  # type: ignore[attr-defined]
    span = ["--start", TURNS[0], "--stop", TURNS[1]]
    assert CliRunner().invoke(app, ["replay", "--spacecraft", "yamal-202", *span, *options]).exit_code == 0
    assert asked == [("POST", "/spacecraft/yamal-202/replays", commands)]


START_US = 1_800_000_000_000_000
SPANS = {1: (0, 100), 2: (10, 200)}


def row(minute, angles_deg, *, sigma_deg=0.02, inhibitions=()):
    """Return a row of the archive."""
    epoch_us = START_US + 60_000_000 * minute
    return replace(
        row_without_attitude(epoch_us, epoch_us, minute, Method.ROBUST, inhibitions),
        attitude_deg=Axes(*angles_deg),
        sigma_deg=Axes(*[sigma_deg] * 3),
        control_allowed=not inhibitions,
    )


@pytest.fixture
def held(monkeypatch):
    """Rows by version that the service holds, and what it was asked."""
    rows, asked = {}, []

    def download(path, params):
        start, stop = params["start"], params["stop"]
        asked.append((path, start, stop, params["method"], params["version"]))
        chosen = [each for each in rows[params["version"]] if start <= format_epoch(each.epoch_us) < stop]
        return table_bytes(ATTITUDE, params["format"], [chosen])

    def replay(_, number):
        start, stop = (format_epoch(START_US + 60_000_000 * minute) for minute in SPANS[number])
        return {"start": start, "stop": stop}

    client = SimpleNamespace(download=download, replay=replay)
    monkeypatch.setattr(connection, "connected", lambda *_: nullcontext(client))
    return SimpleNamespace(rows=rows, asked=asked)


def compare_run(*options):
    return CliRunner().invoke(app, ["compare", "--spacecraft", "sa-1", *options])


def test_figures_are_those_of_the_rows_that_both_have(held, tmp_path):
    # two rows of one epoch; one row without angles; one row in each alone
    held.rows["live"] = [
        row(9, (0.0, 0.0, 0.0)),
        row(20, (0.1, 0.2, 0.3), sigma_deg=0.03),
        row(20, (1.0, 1.0, 1.0), sigma_deg=0.04, inhibitions=("late",)),
        row(30, NO_ANGLES, sigma_deg=math.nan, inhibitions=("no_fix",)),
        row(40, (0.0, 0.0, 0.0)),
    ]
    held.rows["replay-2"] = [
        row(20, (0.4, 0.2, 0.3)),
        row(20, (0.6, 1.0, 1.0), inhibitions=("late", "settling")),
        row(30, (0.0, 0.0, 0.0)),
        row(50, (0.0, 0.0, 0.0)),
    ]
    figure = tmp_path / "difference.png"
    result = compare_run("live", "replay-2", "--json", "--figure", str(figure))
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert {asked[1:3] for asked in held.asked} == {(document["start"], document["stop"])}
    assert document["start"] == format_epoch(START_US + 600_000_000), "the span of the replay"
    assert document["rows"] == {"both": 3, "first_alone": 1, "second_alone": 1, "both_with_angles": 2}
    yaw = document["difference_deg"]["yaw"]
    np.testing.assert_allclose((yaw["rms"], yaw["greatest"]), (np.sqrt((0.3**2 + 0.4**2) / 2), -0.4), rtol=1e-9)
    assert yaw["greatest_at"] == format_epoch(START_US + 1_200_000_000)
    assert document["difference_deg"]["roll"]["rms"] == 0.0
    np.testing.assert_allclose(document["rms_sigma_deg"]["pitch"], [np.sqrt((0.03**2 + 0.04**2) / 2), 0.02])
    assert document["median_protection_deg"]["yaw"] == [None, None]
    np.testing.assert_allclose(document["control_allowed"], [1 / 3, 2 / 3])
    assert document["inhibitions"] == {"late": [1, 1], "no_fix": [1, 0], "settling": [0, 1]}
    assert figure.read_bytes().startswith(b"\x89PNG")
    lines = compare_run("live", "replay-2").stdout
    assert "yaw    rms 0.3536, greatest -0.4000 deg at" in lines
    assert "settling: 0 -> 1 rows" in lines


def test_two_replays_are_compared_where_both_reach(held):
    held.rows |= {"replay-1": [row(50, (0.0, 0.0, 0.0))], "replay-2": [row(50, (0.0, 0.0, 0.0))]}
    assert compare_run("replay-1", "replay-2", "--method", "paper").exit_code == 0
    span = tuple(format_epoch(START_US + 60_000_000 * minute) for minute in (10, 100))
    assert [asked[1:4] for asked in held.asked] == [(*span, "paper")] * 2


@pytest.mark.parametrize(
    ("options", "code", "said"),
    [
        (("live", "live"), 2, "name two versions"),
        (("live", "replay"), 2, "no version"),
        (("live", "replay-x"), 2, "no version"),
        (("live", "3"), 2, "no version"),
        (("live", "replay-2"), 1, "no row in both, live has 0 and replay-2 has 1"),
        (("live", "replay-2", "--figure", "nowhere/x.png", "--start", "2000-01-01T00:00:00Z"), 1, "no row in both"),
    ],
)
def test_what_cannot_be_compared_ends_with_words(held, options, code, said):
    held.rows |= {"live": [], "replay-2": [row(20, (0.0, 0.0, 0.0))]}
    result = compare_run(*options)
    assert result.exit_code == code
    assert said in result.stderr


def test_a_figure_that_cannot_be_written_is_said(held, tmp_path):
    held.rows |= {version: [row(20, (0.0, 0.0, 0.0))] for version in ("live", "replay-2")}
    result = compare_run("live", "replay-2", "--figure", str(tmp_path / "nowhere" / "x.png"))
    assert (result.exit_code, "the figure cannot be written" in result.stderr) == (2, True)


DONE = {
    "version": "replay-1",
    "start": "2026-11-05T00:00:00Z",
    "stop": "2026-11-06T00:00:00Z",
    "state": "done",
    "progress": 1.0,
    "attitude_rows": 2880,
    "torque_rows": 1440,
    "size_bytes": 1_843_200,
}


@pytest.fixture
def deleted(monkeypatch):
    """Numbers that the service was asked to delete."""
    numbers = []
    held = [DONE, DONE | {"version": "replay-2", "state": "running", "progress": 0.25}]
    client = SimpleNamespace(replays=lambda _: held, delete_replay=lambda _, number: numbers.append(number))
    monkeypatch.setattr(connection, "connected", lambda *_: nullcontext(client))
    return numbers


def test_versions_are_lines_with_state_and_size(deleted):
    lines = CliRunner().invoke(app, ["replays", "--spacecraft", "yamal-202"]).stdout.splitlines()
    span = "2026-11-05T00:00:00Z to 2026-11-06T00:00:00Z"
    assert lines[0] == f"replay-1  {span}  done  2880 rows, 1440 torques, 1.8 MB"
    assert lines[1].startswith(f"replay-2  {span}  running 25%  ")
    assert deleted == []


def test_one_is_deleted_and_the_list_is_json(deleted):
    result = CliRunner().invoke(app, ["replays", "--spacecraft", "yamal-202", "--delete", "3", "--json"])
    assert deleted == [3]
    assert json.loads(result.stdout.splitlines()[0]) == DONE
