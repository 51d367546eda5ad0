"""A shift at a real terminal: the live screen and the commands."""

import contextlib
import json
import os
import pty
import select
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

import httpx
import pytest
from release_ground import ReleaseGround, record, seed_archive
from service_process import KEY

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.timeout(600)]


class WatchingTerminal:
    """A terminal in which ``soo watch`` runs."""

    def __init__(self, url: str, folder: Path) -> None:
        environment = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
        environment |= {"SOO_URL": url, "SOO_KEY": KEY, "XDG_CONFIG_HOME": str(folder)}
        environment |= {"TERM": "xterm", "NO_COLOR": "1", "COLUMNS": "80", "LINES": "24"}
        self.keyboard, end = pty.openpty()
        command = [sys.executable, "-m", "service", "watch"]
        self.process = subprocess.Popen(command, env=environment, stdin=end, stdout=end, stderr=end)
        os.close(end)
        self.shown = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self.keyboard)

    def await_text(self, text: str, timeout_s: float = 120.0) -> None:
        """Wait until a text is drawn that was not there before."""
        self.shown, deadline = "", time.monotonic() + timeout_s
        while text not in self.shown:
            assert time.monotonic() < deadline, f"{text!r} is not shown:\n{self.shown[-4000:]}"
            if select.select([self.keyboard], [], [], 1.0)[0]:
                self.shown += os.read(self.keyboard, 65536).decode(errors="replace")

    def press(self, key: bytes) -> int:
        """Press a key and return the exit code."""
        os.write(self.keyboard, key)
        # what it writes last is read, so that it can end
        with contextlib.suppress(OSError):
            while self.process.poll() is None:
                if select.select([self.keyboard], [], [], 0.2)[0]:
                    os.read(self.keyboard, 65536)
        return self.process.wait(120)


def test_the_screen_follows_the_stream_and_says_when_it_is_cut(serving: Any, tmp_path: Path) -> None:
    database = tmp_path / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    with serving(database) as service, WatchingTerminal(service.url, tmp_path) as terminal:
        terminal.await_text("yamal-202 SIMULATED")
        with service.client() as client:
            ground = ReleaseGround(client, "yamal-202")
            ground.align()
            ground.rows(2)
            terminal.await_text(ground.epoch()[:19].replace("T", " "))
        service.end()
        terminal.await_text("cut since 20")
        terminal.await_text("what holds now is not known")
        assert terminal.press(b"q") == 0


SHIFT_KEY = "a-key-for-tests-only"
CRAFTS = (record("yamal-202"), record("express-80"))
#: a person writes into the log what a terminal or a browser would execute; C1 controls pass the interface
HOSTILE = "<script>alert(1)</script> \u009b31mred\u202e [x](javascript:y)"


class Terminal:
    """Commands of a person at a terminal, with the key of that person."""

    def __init__(self, url: str, folder: Path) -> None:
        own = {name: value for name, value in os.environ.items() if not name.startswith("SOO_")}
        self.folder = folder
        self.environment = own | {"SOO_URL": url, "SOO_SPACECRAFT": "yamal-202", "XDG_CONFIG_HOME": str(folder)}

    def run(self, *command: str, key: str = SHIFT_KEY, **changes: str) -> Any:
        """Run one command and return its exit code and output; none prints what a terminal executes."""
        done = subprocess.run(
            [sys.executable, "-m", "service", *command],
            env=self.environment | {"SOO_KEY": key} | changes,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=300,
        )
        assert "Traceback" not in done.stderr, done.stderr
        assert not {"\x1b", "\u009b", "\u202e"} & set(done.stdout + done.stderr), done.stdout
        return done

    def document(self, *command: str, code: int = 0, key: str = SHIFT_KEY) -> Any:
        """Return the document that a command prints for programs."""
        done = self.run(*command, "--json", key=key)
        assert done.returncode == code, done.stderr
        return json.loads(done.stdout)


@pytest.fixture
def terminal(service: Any, tmp_path: Path) -> Terminal:
    return Terminal(service.url, tmp_path)


def test_the_seven_questions_of_a_shift_are_one_command_each(terminal: Terminal, client: httpx.Client) -> None:
    empty = terminal.run("status")
    assert (empty.returncode, "no row has come yet" in empty.stdout) == (3, True)
    assert terminal.run("attitude").returncode == 3
    assert terminal.run("watch").returncode == 0
    ground = ReleaseGround(client, "yamal-202")
    ground.align()
    ground.rows(15, (0.0, 0.03, 0.0))
    # where
    where = terminal.run("attitude")
    assert where.returncode == 0
    assert "Roll   +0.0" in where.stdout
    assert terminal.document("attitude") == ground.get("/attitude")
    # may it be trusted
    trust = terminal.run("status")
    assert (
        trust.returncode,
        "no torque: control is not armed (and 1 more)" in " ".join(trust.stdout.split()),
    ) == (3, True)
    assert terminal.document("status", code=3)["control"] == ground.get("/control")["control"]
    # which carriers
    assert "12 of 12 used" in terminal.run("carriers").stdout
    _release(terminal, ground)
    # acknowledge
    ground.rows(15, (0.0, 0.34, 0.0))
    alarm = terminal.document("alarms", code=3)["rows"][0]
    listed = " ".join(terminal.run("alarms").stdout.split())
    assert "angle beyond" in listed
    assert terminal.document("ack", str(alarm["id"]), "--comment", "known")["acknowledged"]["comment"] == "known"
    assert terminal.run("shelve", str(alarm["id"]), "--hours", "2").returncode == 0
    assert alarm["id"] not in [each["id"] for each in terminal.document("alarms", code=3)["rows"]]
    # why did it stop
    assert terminal.run("control", "stop", "--comment", "unexpected motion").returncode == 0
    stopped = terminal.run("status")
    assert (stopped.returncode, "an operator stopped control" in " ".join(stopped.stdout.split())) == (4, True)
    _hand_over(terminal)


def _release(terminal: Terminal, ground: ReleaseGround) -> None:
    """Release a command: one command for each person and step."""
    anna, boris = ground.key("Anna", "operator"), ground.key("Boris", "approver")
    assert terminal.run("control", "arm", key=anna).returncode == 0
    assert terminal.run("status").returncode == 0
    assert terminal.run("torque", "prepare", "roll is off", "--dry-run", key=anna).returncode == 0
    prepared = terminal.document("torque", "prepare", "roll is off", key=anna)
    number, digest = str(prepared["id"]), prepared["digest"]
    second = {"SOO_SECOND_KEY": boris}
    unread = terminal.run("torque", "confirm", number, key=anna, **second)
    assert (unread.returncode, "state --digest" in unread.stderr) == (2, True)
    other = terminal.run("torque", "confirm", number, "--digest", "0" * 64, key=anna, **second)
    assert (other.returncode, "nothing was sent" in other.stderr) == (2, True)
    alone = terminal.run("torque", "confirm", number, "--digest", digest, key=anna)
    assert (alone.returncode, "SOO_SECOND_KEY is empty" in alone.stderr) == (2, True)
    assert terminal.run("torque", "confirm", number, "--digest", digest, key=anna, SOO_SECOND_KEY=anna).returncode == 1
    done = terminal.run("torque", "confirm", number, "--digest", digest[:8], key=anna, **second)
    assert (done.returncode, f"command {number}: RELEASED" in done.stdout) == (0, True), done.stderr
    assert digest in done.stdout
    assert terminal.run("torque", "report", number, "sent", key=anna).returncode == 0
    assert terminal.document("torque", "report", number, "executed", key=anna)["state"] == "EXECUTED"


def _hand_over(terminal: Terminal) -> None:
    """Write a hostile note, then every page and screen that shows it."""
    assert terminal.run("note", HOSTILE).returncode == 0
    page = terminal.run("handover").stdout
    assert "\\<script\\>alert(1)\\</script\\> �31mred� \\[x\\](javascript:y)" in page
    path = terminal.folder / "shift.html"
    assert terminal.run("handover", "--format", "html", "--output", str(path)).returncode == 0
    assert "&lt;script&gt;alert(1)" in path.read_text()
    assert "<script" not in path.read_text()
    assert terminal.run("report", "day", "--output", str(path)).returncode == 0
    assert "data:image/png;base64," in path.read_text()
    assert "Command 1, executed: roll is off; Anna" in path.read_text()
    screen = terminal.run("watch", COLUMNS="80", LINES="24").stdout
    assert "no torque: an operator stopped control" in " ".join("".join(screen.splitlines()[:2]).split())
    assert "yamal-202 SIMULATED" in screen
    assert len(screen.splitlines()) <= 24
    assert max(map(len, screen.splitlines())) <= 80


def test_what_is_wrong_is_said_with_the_exit_code(terminal: Terminal, client: httpx.Client, tmp_path: Path) -> None:
    several = terminal.run("status", SOO_SPACECRAFT="")
    assert (several.returncode, "express-80, yamal-202" in several.stderr) == (2, True)
    wrong = terminal.run("status", key="wrong")
    assert (wrong.returncode, "key.invalid" in wrong.stderr) == (1, True)
    absent = terminal.run("control", "stop", SOO_URL="http://127.0.0.1:9")
    assert absent.returncode == 1
    assert "has not confirmed the stop of yamal-202. Control may go on" in absent.stderr
    with socket.create_server(("127.0.0.1", 0)) as silent:
        # it accepts the request and never answers
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        unanswered = terminal.run("control", "stop", SOO_URL=address)
    assert (unanswered.returncode, "Control may go on" in unanswered.stderr) == (1, True)
    viewer = ReleaseGround(client, "yamal-202").key("Vera", "viewer")
    forbidden = terminal.run("control", "stop", key=viewer)
    assert (forbidden.returncode, "key.forbidden" in forbidden.stderr) == (1, True)
    assert terminal.run("watch", SOO_URL="http://127.0.0.1:9").returncode == 1
    assert terminal.run("ack", "999").returncode == 1
    assert terminal.run("handover", "--output", str(tmp_path / "none" / "page.md")).returncode == 2
    assert terminal.run("handover", SOO_SPACECRAFT="express-80").returncode == 0
    report = terminal.run("report", "shift", "--format", "md", SOO_SPACECRAFT="express-80")
    assert (report.returncode, "There are no rows in this span." in report.stdout) == (0, True)
