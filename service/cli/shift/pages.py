"""Pages of a shift as Markdown or as one file of HTML: sections of lines, in which no text of others is markup."""

import base64
import html
import re
from typing import Literal, NamedTuple

from service.cli.shift.tables import alarm_line, alarm_lines, clean, meaning, number, sentence, utc, words
from service.client.documents import Json

PageFormat = Literal["md", "html"]
_MARKUP = re.compile(r"([\\`*_{}\[\]<>#|~!&])")
_PICTURE = "Angles with two sigma, and protection levels"
_STYLE = "body{font:15px/1.5 sans-serif;max-width:60em;margin:2em auto}img{max-width:100%}"


class Section(NamedTuple):
    """Title and lines of a part of a page."""

    title: str
    lines: list[str]


def page(title: str, sections: list[Section], wanted: PageFormat, picture: bytes | None = None) -> str:
    """Return a page; the picture, PNG, is a part of it."""
    source = None if picture is None else f"data:image/png;base64,{base64.b64encode(picture).decode()}"
    return (_html if wanted == "html" else _markdown)(title, sections, source)


def _html(title: str, sections: list[Section], source: str | None) -> str:
    image = f'<img alt="{_PICTURE}" src="{source}">\n' if source else ""
    lines = [f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{html.escape(title)}</title>']
    lines += [f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>", image]
    for each in sections:
        lines += [f"<h2>{html.escape(each.title)}</h2>", "<ul>"]
        lines += [*(f"<li>{html.escape(line)}</li>" for line in each.lines), "</ul>"]
    return "\n".join([*lines, "</html>\n"])


def _markdown(title: str, sections: list[Section], source: str | None) -> str:
    lines = [f"# {_escaped(title)}", "", *([f"![{_PICTURE}]({source})", ""] if source else [])]
    for each in sections:
        lines += [f"## {_escaped(each.title)}", "", *(f"* {_escaped(line)}" for line in each.lines), ""]
    return "\n".join(lines)


def handover_sections(handover: Json, row: Json, control: Json) -> list[Section]:
    """Return what the next shift must know: alarms, control, operations, links, what ends, notes."""
    verdict = handover["control"]
    said = [sentence(handover["status"], row, control), meaning("states", verdict["state"])]
    covered = [*handover["shelved"], *handover["suppressed"]]
    links = [f"{clean(each['id'])}: {words('views.links.state.' + each['state'])}" for each in handover["links"]]
    sources = [
        f"{clean(each['source'])}: {utc(each['newest_epoch'])}, "
        f"{words('views.now.missing', count=each['rows_missing'] or 0)}"
        for each in handover["sources"]
    ]
    notes = [f"{utc(each['epoch'])} {clean(each['author'])}: {clean(each['text'])}" for each in handover["notes"]]
    listed = {
        "views.control.title": [*said, *map(reason_line, verdict["reasons"])],
        "views.shift.alarms": [line for each in handover["alarms"] for line in alarm_lines(each)],
        "views.shift.covered": list(map(alarm_line, covered)),
        "views.shift.operations": list(map(operation_line, handover["operations"])),
        "views.shift.links": links,
        "views.shift.sources": sources,
        "views.shift.ending": _ending(handover),
        "views.shift.log": notes,
    }
    none = words("views.shift.none")
    return [Section(words(key), lines or [none]) for key, lines in listed.items()]


def reason_line(reason: Json) -> str:
    """Return a reason of the verdict with its next step."""
    next_step = meaning("reasons", reason["code"], "next", reason["next_step"])
    return f"{meaning('reasons', reason['code'], default=reason['text'])}: {next_step}"


def operation_line(operation: Json) -> str:
    """Return a declared operation with its span and comment."""
    stop = utc(operation["stop"]) if operation["stop"] else words("views.shift.open")
    span = f"{utc(operation['start'])} – {stop}"
    return f"{meaning('operations', operation['kind'])}, {span}: {clean(operation['comment'])}"


def _ending(handover: Json) -> list[str]:
    """Return what ends: keys and the ephemeris, and the age of the alignment."""
    lines = [f"{clean(each['name'])} {utc(each['expires_at'])}" for each in handover["keys"]]
    if handover["ephemeris"]:
        lines.append(f"{words('views.shift.ephemeris')} {utc(handover['ephemeris']['valid_stop'])}")
    if handover["alignment"]:
        lines.append(words("views.shift.aligned", hours=number(handover["alignment"]["age_hours"], 0)))
    return lines


def _escaped(text: str) -> str:
    """Return a text of which Markdown makes no markup."""
    return _MARKUP.sub(r"\\\1", text)
