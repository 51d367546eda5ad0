"""Screen of ``soo watch``: verdict first, then angles with limits, protection of a day, carriers, alarms, links."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from service.cli.shift.tables import alarm_line, axes_table, excluded_line, limit_of, link_line
from service.cli.shift.words import AXES, clean, meaning, number, sentence, utc, words
from service.client.documents import Json
from service.records.epoch import DAY_US, parse_epoch

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.text import Text

_BLOCKS, _ASCII = "▁▂▃▄▅▆▇█", "_.-:=+*#"
#: lines that stand beside alarms and links, and the least of each list that is shown
_OTHER_LINES, _LEAST_LINES = 18, 3
#: columns of the strip, with the words beside it in 80 columns
_STRIP_COLUMNS = 44


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

    lists = max(2 * _LEAST_LINES, console.height - _OTHER_LINES) // 2
    blocks = _BLOCKS if console.encoding.startswith("utf") else _ASCII
    return Group(*_parts(state, cut, lists, blocks))


def _parts(state: LiveState, cut: str, lists: int, blocks: str) -> "Iterator[RenderableType]":
    """Yield the lines of the screen."""
    status, row, conditions = state.status, state.row, state.control["conditions"]
    verdict = status["control"]
    if cut:
        yield _line(cut, "bold reverse")
        yield _line("below is what was last read; what holds now is not known", "bold")
    style = "bold" if cut else "bold green" if verdict["allowed"] else "bold red"
    yield _line(sentence(status, row, state.control), style, is_cut=False)
    simulated = f" {words('app.simulated')}" if state.spacecraft["simulated"] else ""
    title = f"{clean(state.spacecraft['id'])}{simulated}, {utc(status['now'])} UTC"
    yield _line(f"{title}; {words('views.control.title')}: {meaning('states', verdict['state'])}")
    yield axes_table(row, state.other, conditions)
    yield _line(_strip(state, limit_of(conditions, "protection_level"), blocks))
    yield _line(f"{words('views.now.torque')}: {_torque(state.torque)}")
    used = words("views.now.used", used=row["carriers_used"], all=row["carriers_used"] + len(row["excluded"]))
    yield _line(f"{words('views.now.carriers')}: {used}; left out: {excluded_line(row)}")
    yield from _list(words("views.shift.alarms"), list(map(alarm_line, state.alarms)), lists, "yellow")
    yield from _list(words("views.now.links"), list(map(link_line, status["links"])), lists, "")
    yield _line("q ends", "dim")


def _line(text: str, style: str = "", *, is_cut: bool = True) -> "Text":
    """Return a line that ends at the edge of the terminal, or goes on below."""
    from rich.text import Text

    return Text(text, style, no_wrap=is_cut, overflow="ellipsis" if is_cut else None)


def _list(title: str, lines: list[str], most: int, style: str) -> "Iterator[Text]":
    """Yield a list under its title; entries that have no room are counted."""
    yield _line(f"{title}: {len(lines) or words('views.now.none')}", "bold")
    shown = lines if len(lines) <= most else lines[: most - 1]
    yield from (_line(f"  {each}", style) for each in shown)
    if len(shown) < len(lines):
        yield _line(f"  {words('views.now.more', count=len(lines) - len(shown))}", style)


def _torque(torque: Json | None) -> str:
    """Return the impulse of the newest computed command about each axis."""
    impulses = torque and torque.get("impulse_n_m_s")
    if not impulses:
        return words("views.now.none")
    return ", ".join(f"{axis} {number(impulses[axis], 4, '+')}" for axis in AXES) + f" {words('app.unit.n_m_s')}"


def _strip(state: LiveState, alert_deg: float | None, blocks: str) -> str:
    """Return the greater protection level of roll and pitch over a day; ``!`` is beyond the alert limit."""
    title = f"{words('views.now.protection')}, 24 h"
    present = state.status["now"]
    if state.samples is None or present is None:
        return f"{title}: {words('views.now.none')}"
    start_us = parse_epoch(present) - DAY_US
    greatest: dict[int, float] = {}
    for series in state.samples["series"]:
        for epoch, value in zip(state.samples["epochs"], series["max"], strict=True):
            column = (parse_epoch(epoch) - start_us) * _STRIP_COLUMNS // DAY_US
            if value is not None:
                greatest[column] = max(value, greatest.get(column, 0.0))
    full = alert_deg or max(greatest.values(), default=1.0) or 1.0
    levels = (_level(greatest.get(column), full, blocks) for column in range(_STRIP_COLUMNS))
    return f"{title} {''.join(levels)} {words('views.now.ofAlert', alert=number(alert_deg, 2))} deg"


def _level(value: float | None, full: float, blocks: str) -> str:
    """Return the mark of a value, blank for none."""
    if value is None:
        return " "
    return "!" if value > full else blocks[min(int(value / full * len(blocks)), len(blocks) - 1)]
