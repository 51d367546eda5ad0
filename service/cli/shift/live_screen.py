"""Screen of ``soo watch``: verdict first, then angles with limits, protection of a day, carriers, alarms, links."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.cli.shift.tables import alarm_line, axes_table, excluded_line, limit_of, link_line, worst_first
from service.cli.shift.words import AXES, clean, meaning, number, sentence, utc, words
from service.client.documents import Json
from service.records.epoch import DAY_US, parse_epoch

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

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
    alarms, links = list(map(alarm_line, worst_first(state.alarms))), list(map(link_line, state.status["links"]))
    # a list that needs less than its half leaves the rest to the other one
    needs = [_height(console, _entries(each, "")) for each in (alarms, links)]
    for_links = min(needs[1], max(room // 2, room - needs[0]))
    return Group(
        *above,
        *_list(words("views.shift.alarms"), alarms, "yellow", console, room - for_links),
        *_list(words("views.now.links"), links, "", console, for_links),
        _line("q ends", "dim"),
    )


def _above(state: LiveState, cut: str, blocks: str, width: int) -> "Iterator[RenderableType]":
    """Yield the lines above the lists."""
    status, row, conditions = state.status, state.row, state.control["conditions"]
    verdict = status["control"]
    if cut:
        yield _line(cut, "bold reverse", is_cut=False)
        yield _line("below is what was last read; what holds now is not known", "bold")
    style = "bold" if cut else "bold green" if verdict["allowed"] else "bold red"
    yield _line(sentence(status, row, state.control), style, is_cut=False)
    simulated = f" {words('app.simulated')}" if state.spacecraft["simulated"] else ""
    title = f"{clean(state.spacecraft['id'])}{simulated}, {utc(status['now'])} UTC"
    yield _line(title, is_cut=False)
    yield _line(f"{words('views.control.title')}: {meaning('states', verdict['state'])}", is_cut=False)
    yield axes_table(row, state.other, conditions)
    yield _line(_strip(state, limit_of(conditions, "protection_level"), blocks, width))
    yield _line(f"{words('views.now.torque')}: {_torque(state.torque)}", is_cut=False)
    used = words("views.now.used", used=row["carriers_used"], all=row["carriers_used"] + len(row["excluded"]))
    carriers = f"{words('views.now.carriers')}: {used}; left out: {excluded_line(row)}"
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
    yield _line(f"{title}: {len(lines) or words('views.now.none')}", "bold")
    # the first entry says more than the number of the others, which the title says
    shown = lines if len(lines) <= room else lines[: min(room, max(1, room - 1))]
    spare = room - len(lines)
    for each in shown:
        (whole,) = _entries([each], style)
        more = _height(console, [whole]) - 1
        yield from [whole] if more <= spare else _entries([each], style, is_cut=True)
        spare -= more if more <= spare else 0
    if 1 < room < len(lines):
        yield _line(f"  {words('views.now.more', count=len(lines) - len(shown))}", style)


def _torque(torque: Json | None) -> str:
    """Return the impulse of the newest computed command about each axis."""
    impulses = torque and torque.get("impulse_n_m_s")
    if not impulses:
        return words("views.now.none")
    return ", ".join(f"{axis} {number(impulses[axis], 4, '+')}" for axis in AXES) + f" {words('app.unit.n_m_s')}"


def _strip(state: LiveState, alert_deg: float | None, blocks: str, width: int) -> str:
    """Return the greater protection level of roll and pitch over a day; ``!`` is beyond the alert limit."""
    title = f"{words('views.now.protection')}, 24 h"
    present = state.status["now"]
    if state.samples is None or present is None:
        return f"{title}: {words('views.now.none')}"
    limit = f"{words('views.now.ofAlert', alert=number(alert_deg, 2))} deg"
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
