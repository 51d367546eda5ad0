"""One ``soo serve`` as a process of its own, spoken to over real sockets on 127.0.0.1."""

import json
import random
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx

KEY = "a-key-for-tests-only"
PLAIN = {"SOO_BOOTSTRAP_KEY": KEY, "SOO_ACCESS_LOG": "false"}
#: a start takes 2 s alone; the machine may be busy with other tests
START_TIMEOUT_S = 120.0


def free_ports(count: int = 1) -> int:
    """Return the first of some ports in a row that nobody listens on, below those that the system gives out.

    For programs whose port is written down before they start; any other binds port 0 and says where it listens.
    """
    first = random.randrange(20_000, 30_000)
    try:
        for port in range(first, first + count):
            with socket.create_server(("127.0.0.1", port)):
                pass
    except OSError:
        return free_ports(count)
    return first


class ServiceProcess:
    """One ``soo serve``; what it writes goes to files, so that no pipe fills."""

    def __init__(self, folder: Path, database: Path, arguments: list[str], environment: dict[str, str]) -> None:
        number = len(list(folder.glob("service-*.out")))
        self.output, self.log = folder / f"service-{number}.out", folder / f"service-{number}.err"
        command = [sys.executable, "-m", "service", "serve", "--database", f"sqlite:///{database}", *arguments]
        with self.output.open("wb") as output, self.log.open("wb") as log:
            self.process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=log, env=environment
            )

    def await_announcement(self) -> dict[str, Any]:
        """Return the line that tells where it listens."""
        deadline = time.monotonic() + START_TIMEOUT_S
        while time.monotonic() < deadline:
            text = self.output.read_text()
            if text.endswith("\n"):
                return dict(json.loads(text.splitlines()[0]))
            if self.process.poll() is not None:
                break
            time.sleep(0.02)
        raise AssertionError(f"no announcement, exit code {self.process.poll()}:\n{self.log.read_text()}")

    @property
    def url(self) -> str:
        """Address, known once it listens."""
        return str(self.await_announcement()["url"])

    def client(self) -> httpx.Client:
        """Return a client with the key of the tests."""
        return httpx.Client(
            base_url=self.url,
            headers={"Authorization": f"Bearer {KEY}"},
            timeout=120.0,
            trust_env=False,
            # well before the server closes an idle connection, after 5 s: a request on one that is being closed is lost
            limits=httpx.Limits(keepalive_expiry=1.0),
        )

    def end(self, number: signal.Signals = signal.SIGTERM, timeout_s: float = 120.0) -> tuple[int, float]:
        """Send a signal and return exit code and seconds until the end."""
        began = time.monotonic()
        self.process.send_signal(number)
        return self.process.wait(timeout_s), time.monotonic() - began

    def written(self) -> str:
        """Return all that it wrote so far."""
        return self.output.read_text() + self.log.read_text()


@contextmanager
def serving_on(database: Path, environment: Mapping[str, str]) -> Iterator[ServiceProcess]:
    """Run a service under the clock of the data on any free port; it fails where the service logs a traceback."""
    arguments = ["--port", "0", "--clock", "data"]
    service = ServiceProcess(database.parent, database, arguments, {**PLAIN, **environment})
    try:
        yield service
        said = service.written()
        assert "Traceback" not in said, said[said.index("Traceback") - 500 :][:5000]
    finally:
        service.process.kill()
        service.process.wait()
