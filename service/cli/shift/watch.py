"""``soo watch``: a spacecraft on one screen."""

import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from service.cli.command_group import end
from service.cli.operation import connection
from service.cli.shift import tables
from service.client.documents import Json
from service.records.epoch import DAY_US, US_PER_S, format_epoch, parse_epoch

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

    from service.client.service_client import ServiceClient


_BLOCKS, _ASCII = "▁▂▃▄▅▆▇█", "_.-:=+*#"
#: lines below the state: titles of alarms and links, and the last line; lines that the carriers may take
_FRAME_LINES, _CARRIER_LINES = 3, 3
#: columns of the strip: with the words beside it 80 columns, and the least
_STRIP_COLUMNS, _LEAST_COLUMNS = 44, 12


@dataclass(frozen=True, slots=True)
class LiveState:
    """Documents of the service at one moment; ``samples`` are protection levels of the day before it."""

    spacecraft: Json
    status: Json
    row: Json
    other: Json
    control: Json
    torque: Json | None
    alarms: list[Json]
    samples: Json | None


def render(state: LiveState, console: "Console", cut: str = "") -> "RenderableType":
    """Return the screen; ``cut`` says since when nothing comes, and why."""
    # rich costs as much as the rest of a start
    from rich.console import Group

    blocks = _BLOCKS if console.encoding.startswith("utf") else _ASCII
    above = list(_above(state, cut, blocks, console.width))
    room = max(0, console.height - _FRAME_LINES - _height(console, above))
    alarms, links = (
        list(map(tables.alarm_line, tables.worst_first(state.alarms))),
        list(map(tables.link_line, state.status["links"])),
    )
    # a list that needs less than its half leaves the rest to the other one
    needs = [_height(console, _entries(each, "")) for each in (alarms, links)]
    for_links = min(needs[1], max(room // 2, room - needs[0]))
    return Group(
        *above,
        *_list(tables.words("views.shift.alarms"), alarms, "yellow", console, room - for_links),
        *_list(tables.words("views.now.links"), links, "", console, for_links),
        _line("q ends", "dim"),
    )


def _above(state: LiveState, cut: str, blocks: str, width: int) -> "Iterator[RenderableType]":
    """Yield the lines above the lists."""
    status, row, conditions = state.status, state.row, state.control["conditions"]
    verdict = status["control"]
    if cut:
        yield _line(cut, "bold reverse", is_cut=False)
        yield _line("below is what was last read; what holds now is not known", "bold")
    style = "bold" if cut else tables.SEVERITY_STYLES[verdict["situation"]["severity"]]
    yield _line(tables.sentence(status, row, state.control), style, is_cut=False)
    simulated = f" {tables.words('app.simulated')}" if state.spacecraft["simulated"] else ""
    title = f"{tables.clean(state.spacecraft['id'])}{simulated}, {tables.utc(status['now'])} UTC"
    yield _line(title, is_cut=False)
    yield _line(f"{tables.words('views.control.title')}: {tables.meaning('states', verdict['state'])}", is_cut=False)
    yield tables.axes_table(row, state.other, state.control)
    yield _line(_strip(state, tables.limit_of(conditions, "protection_level"), blocks, width))
    yield _line(f"{tables.words('views.now.torque')}: {_torque(state.torque)}", is_cut=False)
    used = tables.words("views.now.used", used=row["carriers_used"], all=row["carriers_used"] + len(row["excluded"]))
    carriers = f"{tables.words('views.now.carriers')}: {used}; left out: {tables.excluded_line(row)}"
    # lines break between words, each before its end
    most = _CARRIER_LINES * width * 4 // 5
    yield _line(carriers if len(carriers) <= most else f"{carriers[:most]}…", is_cut=False)


def _line(text: str, style: str = "", *, is_cut: bool = True) -> "Text":
    """Return a line that ends at the edge of the terminal, or goes on below."""
    from rich.text import Text

    return Text(text, style, no_wrap=is_cut, overflow="ellipsis" if is_cut else None)


def _entries(lines: list[str], style: str, *, is_cut: bool = False) -> "list[RenderableType]":
    """Return the lines of a list, each going on below or cut at the edge of the terminal."""
    from rich.padding import Padding

    return [Padding(_line(each, style, is_cut=is_cut), (0, 0, 0, 2)) for each in lines]


def _height(console: "Console", parts: "Iterable[RenderableType]") -> int:
    """Return how many lines of the terminal something takes."""
    return sum(len(console.render_lines(part, pad=False)) for part in parts)


def _list(title: str, lines: list[str], style: str, console: "Console", room: int) -> "Iterator[RenderableType]":
    """Yield a list under its title: a line each, the first ones whole while there is room, and the rest counted."""
    yield _line(f"{title}: {len(lines) or tables.words('views.now.none')}", "bold")
    # the first entry says more than the number of the others, which the title says
    shown = lines if len(lines) <= room else lines[: min(room, max(1, room - 1))]
    spare = room - len(lines)
    for each in shown:
        (whole,) = _entries([each], style)
        more = _height(console, [whole]) - 1
        yield from [whole] if more <= spare else _entries([each], style, is_cut=True)
        spare -= more if more <= spare else 0
    if 1 < room < len(lines):
        yield _line(f"  {tables.words('views.now.more', count=len(lines) - len(shown))}", style)


def _torque(torque: Json | None) -> str:
    """Return the impulse of the newest computed command about each axis."""
    impulses = torque and torque.get("impulse_n_m_s")
    if not impulses:
        return tables.words("views.now.none")
    return (
        ", ".join(f"{axis} {tables.number(impulses[axis], 4, '+')}" for axis in tables.AXES)
        + f" {tables.words('app.unit.n_m_s')}"
    )


def _strip(state: LiveState, alert_deg: float | None, blocks: str, width: int) -> str:
    """Return the greater protection level of roll and pitch over a day; ``!`` is beyond the alert limit."""
    title = f"{tables.words('views.now.protection')}, 24 h"
    present = state.status["now"]
    if state.samples is None or present is None:
        return f"{title}: {tables.words('views.now.none')}"
    limit = f"{tables.words('views.now.ofAlert', alert=tables.number(alert_deg, 2))} deg"
    columns = max(_LEAST_COLUMNS, min(_STRIP_COLUMNS, width - len(title) - len(limit) - 2))
    start_us = parse_epoch(present) - DAY_US
    greatest: dict[int, float] = {}
    for series in state.samples["series"]:
        for epoch, value in zip(state.samples["epochs"], series["max"], strict=True):
            column = (parse_epoch(epoch) - start_us) * columns // DAY_US
            if value is not None:
                greatest[column] = max(value, greatest.get(column, 0.0))
    full = alert_deg or max(greatest.values(), default=1.0) or 1.0
    levels = (_level(greatest.get(column), full, blocks) for column in range(columns))
    return f"{title} {''.join(levels)} {limit}"


def _level(value: float | None, full: float, blocks: str) -> str:
    """Return the mark of a value, blank for none."""
    if value is None:
        return " "
    return "!" if value > full else blocks[min(int(value / full * len(blocks)), len(blocks) - 1)]


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
            since = tables.words("app.link.cut", at=tables.utc(format_epoch(system_now_us())))
            self.cut = f"{since}: {tables.clean(error)}"


def watch(
    spacecraft: connection.SpacecraftOption,
    once: Annotated[bool, typer.Option("--once", help="Print one screen and end, as without a terminal.")] = False,
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
) -> None:
    """Follow a spacecraft on one screen; q or Ctrl-C ends it."""
    console = tables.screen()
    with (
        connection.connected(service, key_env, retries=0, timeout_s=_TIMEOUT_S) as client,
        connection.connected(service, key_env) as streaming,
    ):
        try:
            reader = LiveReader(client, streaming, spacecraft)
            first = render(reader.state, console)
        except KeyError as error:
            end(f"the answer of the service has no {error}: {connection.OLDER}", 1, error)
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
