"""``soo watch`` on a terminal of 80x24: it follows the stream, says when it is cut and since when, and ends on q."""

import contextlib
import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

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
