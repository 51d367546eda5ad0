"""Child processes of a demonstration, and the port by which the ground's knowledge comes."""

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Self


class SimulatorLine:
    """Line of JSON messages to a port of the simulator.

    Parameters
    ----------
    host, port : str, int
        Address of the port.
    timeout_s : float
        Longest wait for a line.
    """

    def __init__(self, host: str, port: int, timeout_s: float = 120.0) -> None:
        self._socket = socket.create_connection((host, port), timeout=timeout_s)
        self._lines = self._socket.makefile("rb")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the line."""
        self._lines.close()
        self._socket.close()


class GroundLink(SimulatorLine):
    """Client of the ground port."""

    def messages(self) -> Iterator[dict[str, Any]]:
        """Yield the messages until the story ends or the simulator leaves."""
        for line in self._lines:
            message: dict[str, Any] = json.loads(line)
            yield message
            if message["kind"] == "end":
                return

    def proceed(self) -> None:
        """Confirm that all before the last hold was forwarded: the rows up to it may be swept."""
        self._socket.sendall(b'{"kind":"proceed"}\n')


_READY_TIMEOUT_S = 60.0
_STOP_TIMEOUT_S = 15.0


class ProcessFailedError(Exception):
    """A process of the demonstration did not start or ended early; the text names its log."""


class ChildProcess:
    """One process with its log.

    Parameters
    ----------
    name : str
        What it is, for messages.
    arguments : sequence of str
        Module and arguments after ``python -m``.
    log_path : Path
        File that takes what it writes to standard error.
    environment : mapping
        Whole environment of the process.
    announces : bool
        Whether its first line of output is a JSON object that says where it listens.
    """

    def __init__(
        self,
        name: str,
        arguments: Sequence[str],
        log_path: Path,
        environment: Mapping[str, str],
        *,
        announces: bool = True,
    ) -> None:
        self.name = name
        self.log_path = log_path
        self._log = log_path.open("wb")
        self._process = subprocess.Popen(
            [sys.executable, "-m", *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE if announces else self._log,
            stderr=self._log,
            env=dict(environment),
            # Ctrl-C at the terminal is for the demonstration, which ends its processes in their order
            start_new_session=True,
        )
        self.announcement: dict[str, Any] = self._await_announcement() if announces else {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def require_alive(self) -> None:
        """Raise ProcessFailedError when the process has ended."""
        code = self._process.poll()
        if code is not None:
            message = f"{self.name} ended with code {code}; its log is {self.log_path}:\n{self._last_lines()}"
            raise ProcessFailedError(message)

    def stop(self) -> int:
        """Ask the process to end, wait, and return its exit code."""
        if self._process.poll() is None:
            self._process.send_signal(signal.SIGTERM)
            try:
                self._process.wait(_STOP_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
        code = self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()
        self._log.close()
        return code

    def _await_announcement(self) -> dict[str, Any]:
        """Return the first line of output as JSON."""
        output = self._process.stdout
        if output is None:
            return {}
        watchdog = threading.Timer(_READY_TIMEOUT_S, self._process.kill)
        watchdog.start()
        line = output.readline()
        watchdog.cancel()
        if not line:
            self._process.wait(_STOP_TIMEOUT_S)
            output.close()
            self._log.close()
            message = f"{self.name} did not start; its log is {self.log_path}:\n{self._last_lines()}"
            raise ProcessFailedError(message)
        try:
            announcement: dict[str, Any] = json.loads(line)
        except ValueError:
            self._process.kill()
            self.stop()
            message = f"{self.name} said {line.decode(errors='replace').strip()!r} in place of where it listens"
            raise ProcessFailedError(message) from None
        # whatever it prints later must not fill the pipe
        threading.Thread(target=output.read, daemon=True).start()
        return announcement

    def _last_lines(self) -> str:
        return "\n".join(self.log_path.read_text(errors="replace").splitlines()[-12:])


class FrontEnd:
    """The front end that measures now; at most one runs.

    Parameters
    ----------
    directory : Path
        Takes its tasks and its logs.
    resource : str
        VISA name of the analyzer, a TCP socket.
    arguments : sequence of str
        Arguments that never change.
    environment : mapping
        Whole environment of the process.
    """

    def __init__(
        self, directory: Path, resource: str, arguments: Sequence[str], environment: Mapping[str, str]
    ) -> None:
        self._directory = directory
        self._resource = resource
        self._arguments = tuple(arguments)
        self._environment = environment
        self._process: ChildProcess | None = None
        self._started = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        # the analyzer may have gone before
        self._end()

    @property
    def is_running(self) -> bool:
        """Return whether one was started and not stopped."""
        return self._process is not None

    def start(self, task: Mapping[str, Any], source: str) -> None:
        """Measure this task under the name of this source."""
        self._started += 1
        suffix = f"-{self._started}" if self._started > 1 else ""
        task_path = self._directory / f"task{suffix}.json"
        task_path.write_text(json.dumps(task))
        chosen = ("--task", str(task_path), "--source", source, "--resource", self._resource)
        arguments = ["service", "acquire", *chosen, *self._arguments]
        log_path = self._directory / f"acquire{suffix}.log"
        self._process = ChildProcess("front end", arguments, log_path, self._environment, announces=False)

    def require_alive(self) -> None:
        """Raise ProcessFailedError when it has ended by itself."""
        if self._process is not None:
            self._process.require_alive()

    def stop(self) -> None:
        """Let it deliver what it has and end it; the analyzer forgets the sweep that it waited for."""
        self._end()
        abort_sweep(self._resource)

    def _end(self) -> None:
        if self._process is not None:
            self._process.stop()
            self._process = None


def abort_sweep(resource: str) -> None:
    """Let an analyzer forget the sweep that an ended front end had started.

    A simulated analyzer holds a sweep until its row is allowed; the row would go to nobody.
    """
    _, host, port, _ = resource.split("::")
    with socket.create_connection((host, int(port)), timeout=_STOP_TIMEOUT_S) as line:
        line.sendall(b":ABOR;*OPC?\n")
        line.recv(64)
