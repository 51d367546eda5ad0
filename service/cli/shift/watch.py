"""``soo watch``: the state of a spacecraft on one screen, read again whenever the stream reports something.

Exit codes: 0 ended by a person, 1 the service refused or did not answer at the start, 2 a wrong option.
"""

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from service.cli.command_group import end
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    OLDER,
    KeyEnvironment,
    ServiceUrl,
    SpacecraftOption,
    connected,
)
from service.cli.shift.live_screen import LiveState, render
from service.cli.shift.tables import screen
from service.cli.shift.words import clean, utc, words
from service.client.documents import Json
from service.records.epoch import DAY_US, US_PER_S, format_epoch, parse_epoch

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient

#: the screen is drawn so often; documents are read again at most so often, s
_DRAW_S, _READ_S = 0.5, 1.0
#: samples of the day are read again when the spacecraft's clock, fast where it is simulated, has moved so far
_SAMPLES_US = 300 * US_PER_S
#: an answer that takes longer counts as none; a stream that was cut is opened again after this, s
_TIMEOUT_S, _AGAIN_S = 3.0, 2.0
_STRIP_SAMPLES = 96


class LiveReader:
    """Reads the documents of a spacecraft, and follows its stream in a thread.

    Parameters
    ----------
    client : ServiceClient
        Of requests.
    streaming : ServiceClient
        Of the stream alone.
    spacecraft : str
        Id of the spacecraft.
    """

    def __init__(self, client: "ServiceClient", streaming: "ServiceClient", spacecraft: str) -> None:
        self._client, self._streaming, self._spacecraft = client, streaming, spacecraft
        self._is_changed, self._ended = threading.Event(), threading.Event()
        self._read_at_s = float("-inf")
        self._samples: Json | None = None
        self._samples_us = 0
        #: since when nothing comes, and why; empty while the stream is open
        self.cut = ""
        self.state = self._read()

    def start(self) -> None:
        """Follow the stream until `end`."""
        threading.Thread(target=self._follow, daemon=True).start()

    def end(self) -> None:
        """Let the thread end with its next event."""
        self._ended.set()

    def update(self) -> None:
        """Read the documents again when the stream reported something since the last time."""
        from service.client.problem import ClientError

        if not self._is_changed.is_set() or time.monotonic() - self._read_at_s < _READ_S:
            return
        self._is_changed.clear()
        try:
            self.state = self._read()
        except ClientError as error:
            self._is_changed.set()
            self._read_at_s = time.monotonic()
            self._on_cut(error)

    def _read(self) -> LiveState:
        """Return the documents as they are now."""
        from service.client.problem import ProblemError

        client, name = self._client, self._spacecraft
        status, row = Json(client.status(name)), Json(client.attitude(name))
        torque = None
        # there is none before the first row
        with suppress(ProblemError):
            torque = client.torques(name)
        if status["now"] is not None and parse_epoch(status["now"]) >= self._samples_us + _SAMPLES_US:
            self._samples, self._samples_us = self._read_samples(status), parse_epoch(status["now"])
        state = LiveState(
            spacecraft=client.spacecraft(name),
            status=status,
            row=row,
            other=Json(client.attitude(name, "paper" if row["method"] == "robust" else "robust")),
            control=Json(client.control(name)),
            torque=torque,
            alarms=list(client.pages(f"/spacecraft/{name}/alarms")),
            samples=self._samples,
        )
        self._read_at_s = time.monotonic()
        return state

    def _read_samples(self, status: Json) -> Json:
        """Return the protection levels of roll and pitch over the last day."""
        stop_us = parse_epoch(status["now"]) + 1
        params = {
            "quantity": ["roll_protection_deg", "pitch_protection_deg"],
            "method": status["method"],
            "start": format_epoch(stop_us - DAY_US),
            "stop": format_epoch(stop_us),
            "count": _STRIP_SAMPLES,
        }
        return Json(self._client.request("GET", f"/spacecraft/{self._spacecraft}/samples", params=params))

    def _follow(self) -> None:
        """Report every event of the stream; open it again when it is cut."""
        from service.client.problem import ClientError

        while not self._ended.is_set():
            try:
                for _ in self._streaming.stream(self._spacecraft, patience_s=0.0):
                    if self._ended.is_set():
                        return
                    self.cut = ""
                    self._is_changed.set()
            except ClientError as error:
                self._on_cut(error)
                self._ended.wait(_AGAIN_S)

    def _on_cut(self, error: Exception) -> None:
        """Keep since when nothing comes, by the clock of this machine."""
        from service.runtime.clock import system_now_us

        if not self.cut:
            since = words("app.link.cut", at=utc(format_epoch(system_now_us())))
            self.cut = f"{since}: {clean(error)}"


def watch(
    spacecraft: SpacecraftOption,
    once: Annotated[bool, typer.Option("--once", help="Print one screen and end, as without a terminal.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
) -> None:
    """Follow a spacecraft on one screen; q or Ctrl-C ends it."""
    console = screen()
    with (
        connected(service, key_env, retries=0, timeout_s=_TIMEOUT_S) as client,
        connected(service, key_env) as streaming,
    ):
        try:
            reader = LiveReader(client, streaming, spacecraft)
            first = render(reader.state, console)
        except KeyError as error:
            end(f"the answer of the service has no {error}: {OLDER}", 1, error)
        if once or not console.is_terminal:
            console.print(first)
            return
        from rich.live import Live

        signal.signal(signal.SIGTERM, _stop)
        reader.start()
        with suppress(KeyboardInterrupt), _quit_key() as is_quit, Live(console=console, screen=True) as live:
            while not is_quit(_DRAW_S):
                reader.update()
                live.update(render(reader.state, console, reader.cut), refresh=True)
        reader.end()


@contextmanager
def _quit_key() -> Iterator[Callable[[float], bool]]:
    """Give a function that waits some seconds for the key q; where keys cannot be read it only waits."""
    try:
        import termios
        import tty
    except ImportError:
        yield _wait
        return
    if not sys.stdin.isatty():
        yield _wait
        return
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    tty.setcbreak(keyboard)
    try:
        yield lambda wait_s: bool(select.select([keyboard], [], [], wait_s)[0]) and os.read(keyboard, 1) in b"qQ"
    finally:
        termios.tcsetattr(keyboard, termios.TCSADRAIN, before)


def _wait(wait_s: float) -> bool:
    """Wait; no key was pressed."""
    time.sleep(wait_s)
    return False


def _stop(*_: object) -> NoReturn:
    """Let a signal end the command as Ctrl-C does, so that the terminal is restored."""
    raise KeyboardInterrupt
