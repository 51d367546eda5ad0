"""Pages of a shift: texts of persons are no markup in them."""

from html.parser import HTMLParser
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.cli.shift.pages import Section, handover_sections, page
from service.cli.shift.tables import link_line, sentence

NOW = "2027-01-15T10:30:00.000000Z"
HOSTILE = '<img src=x onerror=alert(1)> & "quoted" [x](javascript:y) *bold* \x1b[2J'


class Tags(HTMLParser):
    """Tags and texts of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.texts: list[str] = []

    def handle_starttag(self, tag: str, _: Any) -> None:
        self.tags.add(tag)

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


ROW: dict[str, Any] = {"downlink_fade_db": 0.0}
CONTROL: dict[str, Any] = {"conditions": [], "open_commands": [], "unreported_commands": []}
SOON = {"code": "towards_limit", "axis": "roll", "angle_deg": -0.3, "limit_deg": 0.4, "hours_to_limit": 0.5}


def handover(**changes: Any) -> dict[str, Any]:
    reason = {"code": "stop", "text": "", "next_step": "", "since": NOW}
    empty = {
        name: [] for name in ("alarms", "shelved", "suppressed", "operations", "links", "sources", "keys", "notes")
    }
    situation = SOON | dict.fromkeys(("rate_deg_h", "known_deg", "yaw_known_deg"))
    control = {"allowed": False, "state": "TRIPPED", "reasons": [reason], "situation": situation}
    status = {"control": control, "newest_measurement": NOW}
    return {**empty, "control": control, "status": status, "ephemeris": None, "alignment": None, **changes}


def test_an_empty_handover_says_none_everywhere_but_in_control_where_it_says_what_every_view_says() -> None:
    control, *others = handover_sections(handover(), ROW, CONTROL)
    assert control.lines == [
        sentence(handover()["status"], ROW, CONTROL),
        "tripped: no torque until a person resets",
        "an operator stopped control: find the cause, then reset control",
    ]
    assert control.lines[0].startswith("roll -0.30 deg meets its limit of 0.40 deg in 0.50 h; no torque: an operator")
    assert [each.lines for each in others] == [["none"]] * 7


def test_every_list_is_written() -> None:
    alarm = {"id": 3, "condition": "data_stale", "thing": "sa-1", "severity": "severe", "state": "shelved"}
    alarm |= {"present_value": None, "unit": "s", "raised_at": NOW, "next_step": "", "children": []}
    source = {"source": "sa-1", "newest_epoch": NOW, "rows_missing": 1}
    found = handover(
        shelved=[alarm],
        operations=[{"kind": "eclipse", "start": NOW, "stop": None, "comment": "long"}],
        links=[{"id": "sa-1", "state": "SILENT"}],
        sources=[source],
        keys=[{"name": "Anna", "expires_at": NOW}],
        notes=[{"epoch": NOW, "author": "Anna", "text": "first\nsecond"}],
        ephemeris={"valid_stop": NOW},
        alignment={"age_hours": 7.6},
    )
    at = "2027-01-15 10:30:00"
    lines = [line for each in handover_sections(found, ROW, CONTROL)[2:] for line in each.lines]
    assert lines[0].startswith(f"3 severe: no new measurements sa-1, shelved, raised {at}; look at the links")
    assert lines[1:] == [
        f"eclipse, {at} – open end: long",
        "sa-1: silent: no report",
        f"sa-1: {at}, 1 row missing",
        f"Anna {at}",
        f"ephemeris until {at}",
        "aligned 8 h ago",
        f"{at} Anna: first second",
    ]


def test_a_link_line_is_one_sentence() -> None:
    link = {"id": "sa-1", "state": "STOPPED", "warnings": [{"code": "analyzer.fault"}], "rows_missing": 0}
    said = "sa-1: stopped; The last cycle of the analyzer failed; it tries again; 2027-01-15 10:30:00"
    assert link_line({**link, "newest_epoch": NOW}) == said


@pytest.mark.parametrize("picture", [None, b"png"])
def test_a_hostile_note_is_text_in_html(picture: bytes | None) -> None:
    note = {"epoch": NOW, "author": HOSTILE, "text": HOSTILE}
    parser = Tags()
    parser.feed(page("a <b> title", handover_sections(handover(notes=[note]), ROW, CONTROL), "html", picture))
    known = {"html", "meta", "title", "style", "h1", "h2", "ul", "li"}
    assert parser.tags == known | ({"img"} if picture else set())
    assert HOSTILE.replace("\x1b", "�") in "".join(parser.texts)


@given(text=st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1))
def test_any_text_comes_back_from_html(text: str) -> None:
    parser = Tags()
    parser.feed(page("title", [Section("section", [text])], "html"))
    assert text in parser.texts


def test_a_hostile_note_is_no_markup_in_markdown() -> None:
    written = page("title", [Section("section", [HOSTILE])], "md")
    assert r"\<img src=x onerror=alert(1)\> \& " in written
    assert r"\[x\](javascript:y) \*bold\*" in written
