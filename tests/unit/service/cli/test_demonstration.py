"""The demonstration's commands: the archive's offer, screens, keys of its persons, its file, and what is injected."""

import io
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import typer
from rich.console import Console
from typer.testing import CliRunner

from service.cli.app import app
from service.cli.demonstration import persons
from service.cli.demonstration.demo import RunningDemonstration, published, running_demonstration
from service.cli.demonstration.demo_screen import Presenter, operation_screen
from service.cli.demonstration.persons import Person, commands_to_try, offer_archive, program, two_persons, write_key
from service.records.epoch import parse_epoch
from service.study.demonstration.demonstration import Scene, Story
from service.study.demonstration.judgement import FlightAlone


@pytest.fixture
def directory(tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "soo.db").write_text("rows")
    key = folder / "operator.key"
    key.touch(0o600)
    return folder


@pytest.fixture
def answered(monkeypatch):
    """Give a function that plays a terminal where a person answers in turn."""
    former = signal.getsignal(signal.SIGINT)

    def play(*answers):
        left = list(answers)

        def prompt(*_arguments, **_options):
            answer = left.pop(0)
            if answer is None:
                raise typer.Abort
            return str(answer)

        monkeypatch.setattr(persons.typer, "prompt", prompt)
        monkeypatch.setattr(persons.sys.stdin, "isatty", lambda: True, raising=False)

    yield play
    signal.signal(signal.SIGINT, former)


def offered(directory, keep=None, *, is_asked=True, is_terminal=True) -> str:
    out = io.StringIO()
    offer_archive(Console(file=out, width=200, force_terminal=is_terminal), directory, keep, is_asked=is_asked)
    return out.getvalue()


def test_a_named_folder_gets_a_copy_with_the_modes_of_its_keys(directory, answered, tmp_path):
    folder = tmp_path / "kept"
    answered(folder)
    text = offered(directory)
    assert (folder / "soo.db").read_text() == "rows"
    assert (folder / "operator.key").stat().st_mode & 0o777 == 0o600
    key = f'SOO_BOOTSTRAP_KEY="$(cat {folder / "administrator.key"})"'
    assert f"{key} {program()} serve --clock data --database sqlite:///{folder / 'soo.db'}" in text
    assert "database and logs are in" in text


def test_a_folder_that_exists_is_not_written_to(directory, answered, tmp_path):
    taken = tmp_path / "taken"
    taken.mkdir()
    answered(taken, "")
    text = offered(directory)
    assert "not copied" in text
    assert "is removed" in text
    assert list(taken.iterdir()) == []


@pytest.mark.parametrize("answer", ["", None])
def test_nothing_is_kept_without_a_name(directory, answered, answer):
    answered(answer)
    assert "soo demo --keep FOLDER keeps it" in offered(directory)


@pytest.mark.parametrize("options", [{"is_terminal": False}, {"is_asked": False}])
def test_without_a_person_it_says_how_to_keep_it(directory, answered, options):
    answered()
    assert "soo demo --keep FOLDER keeps it" in offered(directory, **options)


def test_a_folder_that_was_to_be_kept_is_named(directory, answered):
    answered()
    (directory / "demonstration.png").touch()
    text = offered(directory, directory)
    assert str(directory / "soo.db") in text
    assert "database, logs and figure are in" in text


SCENE = SimpleNamespace(
    phase="start",
    until="",
    client=SimpleNamespace(service_url="http://127.0.0.1:1"),
    story=SimpleNamespace(spacecraft_id="sim", phases={}),
)


@pytest.mark.parametrize("width", [20, 80, 400])
@pytest.mark.parametrize("is_flown", [True, False])
def test_the_key_is_named_by_its_file_and_commands_are_not_broken(tmp_path, width, is_flown):
    SCENE.story.centre = object() if is_flown else None
    printed = io.StringIO()
    presenter = Presenter(Console(file=printed, width=width), 0.0, with_table=True)
    key_file = tmp_path / "administrator.key"
    key_file.write_text("soo_secret")
    presenter.announce("http://127.0.0.1:1", key_file)
    assert printed.getvalue() == "", "there is no spacecraft yet"
    presenter.show(SCENE)
    presenter._invite(SCENE)
    lines = printed.getvalue().splitlines()
    assert f"console http://127.0.0.1:1/console/, sign in with the key in {key_file}" in lines
    commands = [line for line in lines if line.startswith(("SOO_URL=", program()))]
    key = f"SOO_URL=http://127.0.0.1:1 SOO_KEY_FILE={key_file} {program()}"
    assert commands == [
        f"{key} watch",
        f"{program()} demo inject rain" if is_flown else f"{key} status",
        f"{key} control stop",
    ]
    assert "soo_secret" not in printed.getvalue()


def test_two_persons_get_their_commands_with_their_own_keys():
    persons = Person("Anna", "operator", Path("a key/o")), Person("Boris", "approver", Path("a key/b"))
    tries = dict(commands_to_try("http://127.0.0.1:1", Path("k"), persons, is_flown=True))
    anna = "SOO_URL=http://127.0.0.1:1 SOO_KEY_FILE='a key/o'"
    assert tries["Anna prepares a torque"] == f"{anna} {program()} torque prepare 'a first one'"
    confirm = f"{anna} SOO_SECOND_KEY_FILE='a key/b' {program()} torque confirm 1"
    assert tries["Boris confirms it by its digest"] == confirm


def test_the_program_is_named_by_a_path_that_another_terminal_can_run(monkeypatch, tmp_path):
    monkeypatch.setattr("sys.executable", str(tmp_path / "a venv" / "python"))
    assert program() == f"'{tmp_path}/a venv/python' -m service"
    (tmp_path / "a venv").mkdir()
    (tmp_path / "a venv" / "soo").touch()
    assert program() == f"'{tmp_path}/a venv/soo'"


def test_no_bar_stays_above_the_operation(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")  # a dumb terminal erases nothing
    printed = io.StringIO()
    presenter = Presenter(Console(file=printed, width=80, force_terminal=True), 0.0, with_table=True)
    presenter.open()
    presenter.close()
    # a transient bar is erased at its end
    assert printed.getvalue().rstrip().endswith("\x1b[2K")


START = "2026-11-05T10:00:00.000000Z"
EPOCH = "2026-11-05T11:00:00.000000Z"
REASON = {"code": "yaw_sign", "text": "the sign of yaw is not proven", "since": None, "next_step": "prove it"}
SITUATION = {
    "code": "known",
    "severity": "normal",
    "axis": None,
    "known_deg": 0.04,
    "yaw_known_deg": 0.41,
    **dict.fromkeys(("angle_deg", "limit_deg", "rate_deg_h", "hours_to_limit")),
}
ALLOWED = {"allowed": True, "state": "ENGAGED", "reasons": [], "situation": SITUATION}
ANGLES = {"yaw": 0.1, "roll": 0.02, "pitch": 0.02}


class Client:
    """A service that says one row."""

    service_url = "http://127.0.0.1:43210"

    def __init__(self, verdict):
        self.verdict = verdict

    def attitude(self, _spacecraft_id, method="robust"):
        estimate = {f"{axis}_deg": None if method == "paper" else 0.123 for axis in ANGLES}
        excluded = [{"carrier": "c07", "reason": "step"}]
        rest = {"control": ALLOWED, "excluded": excluded, "carriers_used": 15, "sigma_deg": ANGLES}
        return {"epoch": EPOCH, "status": "ACQUIRED", **estimate, **rest}

    def status(self, _spacecraft_id):
        return {"control": self.verdict, "newest_measurement": EPOCH}

    def control(self, _spacecraft_id):
        return {"conditions": [], "open_commands": [], "unreported_commands": []}

    def torques(self, _spacecraft_id):
        return {"yaw_n_m": None, "roll_n_m": 1e-5, "pitch_n_m": -2e-6}


def scene(*, is_flown=True, roll_deg=0.02, verdict=ALLOWED) -> Scene:
    truth = {parse_epoch(START): (0.1, 0.0, 0.0), parse_epoch(EPOCH): (0.1, roll_deg, 0.0)}
    centre = object() if is_flown else None
    story = Story("yamal-202", {"operation": (START, "2026-11-06T10:00:00Z")}, truth, centre=centre)
    return Scene("operation", EPOCH, story, Client(verdict))


def printed(moment: Scene, alone: FlightAlone | None = None, width: int = 80) -> list[str]:
    out = io.StringIO()
    folder = Path("soo-demo-abcdefgh")
    keys = {"key": folder / "administrator.key", "Anna": folder / "operator.key"}
    Console(file=out, width=width).print(operation_screen(moment, alone, keys))
    return out.getvalue().splitlines()


def alone(largest_deg: float) -> FlightAlone:
    hours = np.array([0.0, 1.0, 2.0])
    return FlightAlone(hours, np.outer([0.0, 0.5, 1.0], [largest_deg, 0.0, 0.0]))


def test_it_says_where_how_sure_since_when_the_torque_and_what_happens_without_control():
    lines = printed(scene(), alone(2.0))
    text = "\n".join(lines)
    assert len(lines) <= 24
    assert lines[0].startswith("roll, pitch known to 0.04 deg, yaw to 0.41 deg; ")
    assert "4 Operation, 1.0 h" in lines[1]
    assert "within its bounds since 2026-11-05T10:00Z, 1.0 h" in text
    assert "Without control it leaves them after 1.0 h" in text
    assert "http://127.0.0.1:43210/console/" in text
    assert "Anna    soo-demo-abcdefgh/operator.key" in lines
    assert "carriers used 15, excluded: c07 (step)" in text
    yaw, roll = (next(line.split() for line in lines if line.split()[:1] == [axis]) for axis in ("yaw", "roll"))
    assert yaw == ["yaw", "+0.123", "0.100", "+0.100", "-", "0.5", "+1.000", "-"]
    assert roll == ["roll", "+0.123", "0.020", "+0.020", "-", "0.3", "+0.000", "+1.0e-05"]


@pytest.mark.parametrize(
    ("flight", "words"),
    [
        (None, "Without control: being flown"),
        (alone(0.1), "Without control it stays for 2.0 h"),
        (
            alone(2.0)._replace(hours=np.array([0.0, 0.4, 0.8])),
            "Without control it leaves them after 0.4 h; it was flown for 0.8 h",
        ),
    ],
)
def test_the_flight_without_control_is_shown_as_far_as_it_is_known(flight, words):
    assert words in "\n".join(printed(scene(), flight))


def test_a_true_attitude_beyond_its_bounds_is_said():
    assert "The true attitude is out of its bounds" in "\n".join(printed(scene(roll_deg=0.3)))


def test_a_story_that_is_only_followed_has_neither_bounds_nor_another_flight():
    text = "\n".join(printed(scene(is_flown=False)))
    assert "Nobody keeps the spacecraft" in text
    assert "bound" not in text.partition("deg")[2]
    assert "left alone" not in text


@pytest.mark.parametrize(
    ("verdict", "words"),
    [
        ({**ALLOWED, "reasons": [REASON]}, "torques may go, but the sign of yaw is not proven: run the sign check"),
        (
            {**ALLOWED, "allowed": False, "state": "TRIPPED", "reasons": [REASON]},
            "no torque: the sign of yaw is not proven",
        ),
    ],
)
def test_the_verdict_comes_first_in_the_words_of_the_console(verdict, words):
    assert words in " ".join(printed(scene(verdict=verdict), width=200)[0].split())


class PersonClient:
    """A service that makes keys."""

    def request(self, method, path, body):
        assert (method, path) == ("POST", "/keys")
        return {"key": f"soo_{body['name']}_{body['role']}"}


def test_an_operator_and_an_approver_have_a_file_each(tmp_path):
    persons = two_persons(PersonClient(), tmp_path)
    assert [(person.name, person.role, person.key) for person in persons] == [
        ("Anna", "operator", "soo_Anna_operator"),
        ("Boris", "approver", "soo_Boris_approver"),
    ]
    assert [person.key_file.stat().st_mode & 0o777 for person in persons] == [0o600, 0o600]


def test_a_file_of_an_earlier_run_that_others_may_read_is_replaced(tmp_path):
    path = tmp_path / "administrator.key"
    path.write_text("old")
    path.chmod(0o644)
    write_key(path, "new")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("new\n", 0o600)


HERE = RunningDemonstration(os.getpid(), "http://127.0.0.1:1", "administrator.key", ("127.0.0.1", 2))


@pytest.fixture(autouse=True)
def path(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    return tmp_path / "soo" / "demonstration.json"


def refused(capsys) -> str:
    with pytest.raises(typer.Exit) as ended:
        running_demonstration()
    assert ended.value.exit_code == 1
    return capsys.readouterr().err


@pytest.mark.parametrize("changes", [("127.0.0.1", 2), None])
def test_it_is_found_while_it_runs(path, capsys, changes):
    demonstration = HERE._replace(changes=changes)
    with published(demonstration):
        assert running_demonstration() == demonstration
        assert path.stat().st_mode & 0o777 == 0o600
        assert path.parent.stat().st_mode & 0o777 == 0o700
    assert not path.exists()
    assert "soo demo" in refused(capsys)


def test_the_end_of_an_older_one_leaves_the_newer_one(path):
    with published(HERE):
        path.write_text(json.dumps(HERE._replace(process_id=os.getppid())._asdict()))
    assert path.exists()


def test_a_process_that_was_killed_is_not_running(path, capsys):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait(60)
    path.parent.mkdir()
    path.write_text(json.dumps(HERE._replace(process_id=ended.pid)._asdict()))
    assert "no demonstration" in refused(capsys)


@pytest.mark.parametrize("text", ["", "[]", "null", "{}", '{"process_id": "x"}', '{"process_id": 1, "changes": [1]}'])
def test_a_file_that_holds_something_else_is_none(path, capsys, text):
    path.parent.mkdir()
    path.write_text(text)
    assert "no demonstration" in refused(capsys)


ANSWER = {
    "type": "changed",
    "change": "rain",
    "carrier": None,
    "from": "2026-11-05T10:00:00Z",
    "until": "2026-11-05T11:00:00Z",
}


@pytest.fixture
def simulator():
    """Give a function that runs a port with one answer; it returns address and lines received."""
    servers = []

    def play(answer: bytes):
        server = socket.create_server(("127.0.0.1", 0))
        servers.append(server)
        received: list[bytes] = []

        def serve() -> None:
            connection, _ = server.accept()
            with connection, connection.makefile("rb") as lines:
                received.append(lines.readline())
                connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        return server.getsockname()[:2], received

    yield play
    for server in servers:
        server.close()


def run(changes, *arguments):
    with published(HERE._replace(key_file="absent.key", changes=changes)):
        return CliRunner().invoke(app, ["demo", "inject", *arguments])


def test_a_change_is_sent_and_what_is_to_be_seen_is_said(simulator):
    address, received = simulator(json.dumps(ANSWER).encode() + b"\n")
    ran = run(address, "rain", "--minutes", "60")
    assert (ran.exit_code, json.loads(received[0])) == (0, {"change": "rain", "duration_s": 3600.0})
    assert "until 2026-11-05T11:00:00Z" in ran.output
    assert "inhibited by a fade" in ran.output


def test_a_program_gets_the_answer(simulator):
    address, received = simulator(json.dumps(ANSWER).encode() + b"\n")
    ran = run(address, "step", "--carrier", "c03", "--json")
    assert json.loads(ran.output) == ANSWER
    assert json.loads(received[0])["carrier"] == "c03"


def test_a_refusal_of_the_simulator_is_a_wrong_option(simulator):
    address, _ = simulator(b'{"type":"error","detail":"there is no carrier c99"}\n')
    ran = run(address, "step", "--carrier", "c99")
    assert (ran.exit_code, ran.output) == (2, "nothing was changed: there is no carrier c99\n")


def test_a_simulator_that_leaves_is_away(simulator):
    address, _ = simulator(b"")
    assert run(address, "rain").exit_code == 1


def test_a_port_that_is_closed_is_away():
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = server.getsockname()[:2]
    ran = run(address, "rain")
    assert ran.exit_code == 1
    assert "does not answer" in ran.output


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("rain", "--carrier", "c00"), 2, "leave --carrier out"),
        (("rain",), 1, "without --open"),
        (("stop",), 1, "does not answer"),
        (("snow",), 2, "snow"),
    ],
)
def test_what_cannot_be_done_is_refused(arguments, code, words):
    ran = run(None, *arguments)
    assert ran.exit_code == code
    assert words in ran.output
