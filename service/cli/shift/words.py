"""Words of the console for the terminal: its English table, numbers, instants, and text of others made harmless."""

import json
import math
import re
import unicodedata
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from service.client.documents import Json

AXES = ("yaw", "roll", "pitch")
MISSING = "–"
#: control, format and surrogate characters: a terminal executes some of them
_OBEYED = frozenset({"Cc", "Cf", "Cs"})
#: commands that a person has to act on, in this order
_OWED = ("open_commands", "unreported_commands")
#: word of the unit and digits of a condition's value
_UNITS = {"deg": ("deg", 2), "dB": ("db", 1), "%": ("percent", 0)}


@cache
def _table() -> Json:
    """Return the English table of the console."""
    path = files("service.console").joinpath("static/words/en.json")
    return Json(json.loads(path.read_text(encoding="utf-8")))


def words(key: str, **values: object) -> str:
    """Return the words of a key, levels divided by dots, or its last level; ``count`` also chooses the plural."""
    found: Any = _table()
    *_, last = levels = key.split(".")
    for name in levels:
        found = found.get(name, {})
    return _composed(found, values) if found else clean(last)


def meaning(group: str, code: str, part: str = "name", default: str | None = None) -> str:
    """Return the name of a code of the service, or its next step; an unknown code stands for itself."""
    found = _table()[group].get(code, {}).get(part)
    unknown = default if default is not None else code if part == "name" else ""
    return clean(unknown) if found is None else _composed(found, {})


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
    """Return what is known, whether torques may go, the reason to act on and its next step, as the console says it."""
    verdict, conditions, known = status["control"], control["conditions"], _known(row)
    owed = next((name for name in _OWED if control[name]), None)
    if verdict["allowed"] and owed:
        return words(f"views.now.sentence.{owed}", known=known, number=", ".join(map(str, control[owed])))
    # before the first row nothing else can be mended
    is_empty = status["newest_measurement"] is None
    reasons = sorted(verdict["reasons"], key=lambda each: is_empty and each["code"] != "no_attitude")
    reason = next_step = ""
    if reasons:
        more = words("views.now.more", count=len(reasons) - 1) if len(reasons) > 1 else ""
        reason = f"{_reason(reasons[0], row, conditions)} {more}".rstrip()
        next_step = meaning("reasons", reasons[0]["code"], "next", reasons[0]["next_step"])
    key = "forbidden" if not verdict["allowed"] else "allowedBut" if reasons else "allowed"
    return words(f"views.now.sentence.{key}", known=known, reason=reason, next=next_step)


def _known(row: Json) -> str:
    """Return what is known of roll and pitch; sigma is rounded up: never better than it is."""
    sigmas = [row["sigma_deg"][axis] for axis in ("roll", "pitch")]
    if row["status"] == "INVALID":
        return words("views.now.unknown")
    if row["status"] != "ACQUIRED" or None in sigmas:
        return meaning("statuses", row["status"])
    return words("views.now.known", sigma=number(math.ceil(200 * max(sigmas)) / 100, 2))


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
    """Return a sentence with its values."""
    text: str = found if isinstance(found, str) else found["one" if values.get("count") == 1 else "other"]
    return re.sub(r"\{(\w+)\}", lambda found: str(values.get(found[1], MISSING)), text)
