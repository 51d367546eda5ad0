"""Tables of the shift on the screen, in the words of the console."""

import io
import json
import re
import sys
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import typer

from service.cli.command_group import end
from service.cli.operation.connection import OLDER
from service.client.documents import Json
from service.records.operations.alarms import Severity

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table


AXES = ("yaw", "roll", "pitch")
#: style of each severity of a situation
SEVERITY_STYLES = {"critical": "bold red", "serious": "bold red", "caution": "bold yellow", "normal": "bold green"}
MISSING = "–"
#: control, format and surrogate characters: a terminal executes some of them
_OBEYED = frozenset({"Cc", "Cf", "Cs"})
#: commands that a person has to act on, in this order
_OWED = ("open_commands", "unreported_commands")
#: of a situation
_FIGURES = ("angle_deg", "limit_deg", "rate_deg_h", "hours_to_limit", "known_deg", "yaw_known_deg")
#: word of the unit and digits of a condition's value
_UNITS = {"deg": ("deg", 2), "dB": ("db", 1), "%": ("percent", 0)}


@cache
def _table() -> Json:
    path = files("service.console").joinpath("static/words/en.json")
    return Json(json.loads(path.read_text(encoding="utf-8")))


def words(key: str, **values: object) -> str:
    """Return the words of a key, levels divided by dots, or its last level; ``count`` also chooses the plural."""
    found: Any = _table()
    *_, last = levels = key.split(".")
    for name in levels:
        found = found.get(name, {})
    return _composed(found, values) if found else clean(last)


def meaning(
    group: str, code: str, part: str = "name", default: str | None = None, values: Mapping[str, object] | None = None
) -> str:
    """Return the name of a code of the service, or its next step; an unknown code stands for itself."""
    found = _table()[group].get(code, {}).get(part)
    unknown = default if default is not None else code if part == "name" else ""
    return clean(unknown) if found is None else _composed(found, values or {})


def clean(text: object) -> str:
    r"""Return a text as one line without characters that a terminal executes.

    Examples
    --------
    >>> clean("red \x1b[31m alert\nsecond line")
    'red �[31m alert second line'
    """
    line = " ".join(str(text).split())
    return "".join("\N{REPLACEMENT CHARACTER}" if unicodedata.category(each) in _OBEYED else each for each in line)


def number(value: float | None, digits: int = 3, sign: str = "") -> str:
    """Return a number with some decimals, a dash for none."""
    return MISSING if value is None else f"{value:{sign}.{digits}f}"


def utc(epoch: str | None) -> str:
    """Return an RFC 3339 instant as date and time to the second."""
    return MISSING if epoch is None else clean(epoch)[:19].replace("T", " ")


def axes(values: Mapping[str, float | None], digits: int, unit: str) -> str:
    """Return one value an axis with its name, and the unit."""
    return ", ".join(f"{words(f'app.axis.{axis}')} {number(values[axis], digits)}" for axis in AXES) + f" {unit}"


def sentence(status: Json, row: Json, control: Json) -> str:
    """Return the situation, whether torques may go, the reason to act on and its next step, as the console says it."""
    verdict, conditions = status["control"], control["conditions"]
    situation = verdict["situation"]
    known = _situation(situation)
    owed = next((name for name in _OWED if control[name]), None)
    if verdict["allowed"] and owed:
        return words(f"views.now.sentence.{owed}", known=known, number=", ".join(map(str, control[owed])))
    torque = words(f"views.now.sentence.{'balance' if verdict['state'] == 'BALANCE' else 'noTorque'}")
    if not verdict["allowed"] and (step := meaning("situations", situation["code"], "next")):
        return words("views.now.sentence.plain", known=known, torque=torque, next=step)
    # before the first row nothing else can be mended
    is_empty = status["newest_measurement"] is None
    reasons = sorted(verdict["reasons"], key=lambda each: is_empty and each["code"] != "no_attitude")
    reason = next_step = ""
    if reasons:
        more = words("views.now.more", count=len(reasons) - 1) if len(reasons) > 1 else ""
        reason = f"{_reason(reasons[0], row, conditions)} {more}".rstrip()
        next_step = meaning("reasons", reasons[0]["code"], "next", reasons[0]["next_step"])
    key = "forbidden" if not verdict["allowed"] else "allowedBut" if reasons else "allowed"
    return words(f"views.now.sentence.{key}", known=known, torque=torque, reason=reason, next=next_step)


def _situation(situation: Json) -> str:
    """Return the words of the worst that is true now, as the service found it."""
    values = {name: number(situation[name], 2) for name in _FIGURES}
    axis = "" if situation["axis"] is None else words(f"app.axis.{situation['axis']}").lower()
    return meaning("situations", situation["code"], values={**values, "axis": axis})


def _reason(reason: Json, row: Json, conditions: list[Json]) -> str:
    """Return a reason with the value of its condition and its begin."""
    code = reason["code"]
    condition = next((each for each in conditions if each["code"] == code), {})
    value, limit, unit = (condition.get(name) for name in ("value", "limit", "unit"))
    if code in {"fade", "downlink_fade"}:
        value, limit, unit = row["downlink_fade_db"], None, "dB"
    name = meaning("reasons", code, default=reason["text"])
    parts = [name]
    if value is not None and unit in _UNITS:
        unit_name, digits = _UNITS[unit]
        of_limit = [] if limit is None else [words("views.now.ofAlert", alert=number(limit, digits))]
        parts = [f"{name}," if of_limit else name, number(value, digits), *of_limit, words(f"app.unit.{unit_name}")]
    since = reason["since"] or condition.get("since")
    return " ".join([*parts, *([words("views.now.since", at=utc(since)[11:16])] if since else [])])


def _composed(found: Any, values: Mapping[str, object]) -> str:
    text: str = found if isinstance(found, str) else found["one" if values.get("count") == 1 else "other"]
    return re.sub(r"\{(\w+)\}", lambda found: str(values.get(found[1], MISSING)), text)


def screen(*, is_error: bool = False) -> "Console":
    """Return a console that prints texts as they are; a character that the output cannot hold becomes a mark."""
    output = sys.stderr if is_error else sys.stdout
    if isinstance(output, io.TextIOWrapper):
        output.reconfigure(errors="replace")
    # rich costs as much as the rest of a start
    from rich.console import Console

    return Console(markup=False, highlight=False, emoji=False, stderr=is_error)


def show(document: object, parts: "Callable[[], Iterable[RenderableType]]", *, as_json: bool) -> None:
    """Print the document of the service for programs, or what is made of it for people."""
    if as_json:
        typer.echo(json.dumps(document))
        return
    console = screen()
    try:
        for part in parts():
            console.print(part)
    except KeyError as error:
        end(f"the answer of the service has no {error}: {OLDER}", 1, error)


def columns(*titles: str, show_header: bool = True) -> "Table":
    """Return a table without lines; what is wider than its column goes on below, and is not cut off."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold", show_header=show_header)
    for title in titles:
        table.add_column(title, overflow="fold")
    return table


def limit_of(conditions: Iterable[Json], code: str) -> float | None:
    """Return the limit of a condition, None where there is none."""
    return next((each["limit"] for each in conditions if each["code"] == code), None)


def axes_table(row: Json, other: Json, control: Json) -> "Table":
    """Return angle and limit, time to it, uncertainty and the other method's angle of each axis."""
    names = ("axis", "angle", "toLimit", "sigma", "protection", "otherMethod")
    table = columns(*(words(f"views.now.{name}") for name in names))
    alert, limit = limit_of(control["conditions"], "protection_level"), number(control["angle_limit_deg"], 2)
    motions = {each["axis"]: each for each in control["control"]["situation"]["axes"]}
    for axis in AXES:
        angle, sigma = row[f"{axis}_deg"], row["sigma_deg"][axis]
        protection = number(row["protection_deg"][axis])
        if axis != "yaw" and alert is not None:
            protection += f" {words('views.now.ofAlert', alert=number(alert, 2))}"
        table.add_row(
            words(f"app.axis.{axis}"),
            f"{number(angle, sign='+')} {words('views.now.ofAlert', alert=limit)}",
            _way(motions.get(axis)),
            number(None if sigma is None else 2 * sigma),
            protection,
            number(other[f"{axis}_deg"], sign="+"),
        )
    return table


def _way(motion: Json | None) -> str:
    """Return the time to the limit as the console says it."""
    if motion is None or motion["beyond"]:
        return number(None) if motion is None else words("views.now.beyond")
    if motion["hours_to_limit"] is None:
        return number(None) if motion["rate_deg_h"] is None else words("views.now.never")
    return f"{number(motion['hours_to_limit'], 2)} h"


def reasons_table(reasons: list[Json]) -> "Table":
    """Return every reason with its begin and the next step, the one to act on first."""
    table = columns("why no torque, or no yaw torque", "since, UTC", "next step")
    for each in reasons:
        next_step = meaning("reasons", each["code"], "next", each["next_step"])
        table.add_row(meaning("reasons", each["code"], default=each["text"]), utc(each["since"]), next_step)
    return table


def worst_first(alarms: Iterable[Json]) -> list[Json]:
    """Return alarms in the order of the console: the worst first, of one severity the newest."""
    ranks = {each.word: each.value for each in Severity}
    return sorted(alarms, key=lambda each: (ranks.get(each["severity"], 0), each["raised_at"]), reverse=True)


def alarm_line(alarm: Json) -> str:
    """Return an alarm with its id, value, the epoch of that, state, how many follow from it, and its next step last."""
    thing = _value_of(alarm)
    name = f"{alarm['id']} {meaning('severities', alarm['severity'])}: {meaning('alarms', alarm['condition'])}"
    state = f"{words('views.alarms.state.' + alarm['state'])}, raised {utc(alarm['raised_at'])}"
    next_step = meaning("alarms", alarm["condition"], "next", alarm["next_step"])
    children = len(alarm["children"])
    following = f" ({words('views.alarms.children', count=children)})" if children else ""
    return f"{name} {thing}, {state}{following}; {next_step}"


def alarm_lines(alarm: Json) -> list[str]:
    """Return the line of an alarm and those of what follows from it."""
    children = (f"  {meaning('alarms', each['condition'])} {_value_of(each)}" for each in alarm["children"])
    return [alarm_line(alarm), *children]


def _value_of(alarm: Json) -> str:
    """Return what an alarm is about, with the newest value and its epoch where one is known."""
    present = alarm["present_value"]
    value = () if present is None else (number(present, 2), clean(alarm["unit"]), f"({utc(alarm['present_at'])})")
    return " ".join(filter(None, (clean(alarm["thing"]), *value)))


def link_line(link: Json) -> str:
    """Return a source or link with its state, warnings and missing rows."""
    state = link["state"]
    said = words(f"views.links.state.{state}") if state else words("views.now.source")
    parts = [said, *(meaning("problems", each["code"]).rstrip(".") for each in link["warnings"])]
    if link["rows_missing"]:
        parts.append(words("views.now.missing", count=link["rows_missing"]))
    return f"{clean(link['id'] or link['source'])}: {'; '.join(parts)}; {utc(link['newest_epoch'])}"


def excluded_line(row: Json) -> str:
    """Return the carriers that are left out, with their reasons."""
    said = (f"{clean(each['carrier'])} ({meaning('exclusions', each['reason'])})" for each in row["excluded"])
    return ", ".join(said) or words("views.now.none")


def command_facts(command: Json) -> "tuple[RenderableType, ...]":
    """Return what a person must see of a command: purpose, pulses, predicted angles, checks and digest."""
    predicted = command["predicted"]
    facts: Mapping[str, Any] = {
        "reason": clean(command["reason"]),
        "purpose": words(f"views.control.purpose.{command['purpose']}"),
        "preparedBy": f"{clean(command['prepared_by'])}, {utc(command['prepared_at'])}",
        "span": f"{utc(command['start'])} – {utc(command['stop'])} UTC",
        "expires": utc(command["expires_at"]),
        "impulse": axes(command["gross_impulse_n_m_s"], 4, words("app.unit.n_m_s")),
        "change": axes(predicted["angle_change_deg"], 4, words("app.unit.deg")),
        "peak": axes(predicted["peak_angle_deg"], 4, words("app.unit.deg")),
    }
    table = columns("fact", "value", show_header=False)
    state = words("views.control.dryRun") if command["dry_run"] else meaning("commands", command["state"])
    simulated = f" {words('app.simulated')}" if command["simulated"] else ""
    table.add_row("command", f"{command['id']}: {state}{simulated}")
    for name, text in facts.items():
        table.add_row(words(f"views.control.fact.{name}"), text)
    for pulse in command["schedule"]:
        moved = [axis for axis in AXES if pulse[f"{axis}_n_m"]]
        torque = ", ".join(f"{words(f'app.axis.{axis}')} {pulse[f'{axis}_n_m']:+.2e}" for axis in moved)
        table.add_row("pulse", f"{utc(pulse['start'])}, {pulse['duration_s']:g} s, {torque} N m")
    for check in command["checks"]:
        said = words("views.control.ok" if check["ok"] else "views.control.notOk")
        table.add_row("check", f"{clean(check['name'])}: {said} {clean(check['detail'])}".rstrip())
    # of one piece at 80 columns: a person copies it
    return table, f"{words('views.control.fact.digest')} {clean(command['digest'])}"
