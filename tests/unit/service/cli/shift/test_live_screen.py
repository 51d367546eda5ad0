"""The live screen fits its terminal, says what is cut, and shows a day of protection levels."""

from typing import Any

import pytest
from rich.console import Console

from service.cli.shift.watch import LiveReader, render
from service.client.problem import ServiceUnavailableError


def lines(reader: LiveReader, width: int = 80, height: int = 24, cut: str = "", encoding: str = "utf-8") -> list[str]:
    console = Console(width=width, height=height, markup=False, emoji=False, no_color=True)
    console.__class__ = type("Encoded", (Console,), {"encoding": encoding})
    with console.capture() as capture:
        console.print(render(reader.state, console, cut))
    return capture.get().splitlines()


@pytest.mark.parametrize("count", [0, 1, 40])
@pytest.mark.parametrize(("width", "height"), [(80, 24), (200, 60)])
def test_the_screen_fits_its_terminal(documents: Any, count: int, width: int, height: int) -> None:
    documents.alarms = [documents.alarms[0] | {"id": number} for number in range(count)]
    shown = lines(LiveReader(documents, documents, "yamal-202"), width, height, cut="cut since 10:30:00")
    assert len(shown) <= height
    assert max(map(len, shown)) <= width
    assert f"Alarms: {count or 'none'}" in [line.strip() for line in shown]
    assert shown[-1].strip() == "q ends"


def test_the_verdict_is_the_first_line_and_a_cut_stands_before_it(documents: Any) -> None:
    reader = LiveReader(documents, documents, "yamal-202")
    assert "no torque: control is not armed" in lines(reader)[0]
    shown = lines(reader, cut="cut since 2027-01-15 10:30:00: no answer")
    assert shown[0].strip() == "cut since 2027-01-15 10:30:00: no answer"
    assert "what holds now is not known" in shown[1]


def test_next_steps_and_states_are_whole_where_there_is_room(documents: Any) -> None:
    documents.alarms = [documents.alarms[0] | {"id": number} for number in range(2)]
    shown = lines(LiveReader(documents, documents, "yamal-202"), height=30)
    assert not [line for line in shown if "…" in line]
    text = " ".join(" ".join(shown).split())
    assert text.count("check with another sensor; look at control and the newest torque") == 2
    assert "Control: inhibited: no torque may go" in text


def test_the_worst_alarm_is_whole_before_others_are(documents: Any) -> None:
    documents.alarms = [documents.alarms[0] | {"id": number} for number in range(1, 8)]
    shown = lines(LiveReader(documents, documents, "yamal-202"))
    first = shown.index(next(line for line in shown if line.startswith("Alarms: 7"))) + 1
    whole = " ".join(" ".join(shown[first : first + 3]).split())
    assert whole.endswith("check with another sensor; look at control and the newest torque")
    assert shown[first + 3].rstrip().endswith("…")
    assert "more)" not in "".join(shown)


def test_a_small_terminal_shows_the_worst_alarm_and_the_newest_hours(documents: Any) -> None:
    documents.alarms = [documents.alarms[0] | {"id": number} for number in range(1, 8)]
    shown = lines(LiveReader(documents, documents, "yamal-202"), width=60, height=20)
    assert len(shown) <= 20
    text = " ".join(" ".join(shown).split())
    assert "Alarms: 7 1 warning: angle beyond its limit roll" in text
    assert "! of 0.22 deg" in text
    assert "pitch +0.0010 N m s" in text


def test_the_worst_and_newest_alarms_are_shown_where_not_all_have_room(documents: Any) -> None:
    mild = [documents.alarms[0] | {"id": number, "severity": "watch"} for number in range(40)]
    severe = documents.alarms[0] | {"id": 98, "severity": "severe"}
    newest = documents.alarms[0] | {"id": 99, "severity": "watch", "raised_at": "2027-01-15T10:31:00.000000Z"}
    documents.alarms = [*mild, severe, newest]
    shown = lines(LiveReader(documents, documents, "yamal-202"))
    first = shown.index(next(line for line in shown if line.startswith("Alarms: 42"))) + 1
    assert [line.split()[:2] for line in shown[first : first + 2]] == [["98", "severe:"], ["99", "watch:"]]


def test_many_carriers_that_are_left_out_leave_room_for_alarms_and_links(documents: Any) -> None:
    documents.rows["robust"]["excluded"] = [{"carrier": f"c{k:02d}", "reason": "absent"} for k in range(16)]
    shown = lines(LiveReader(documents, documents, "yamal-202"), cut="cut since 10:30:00: " + "no answer " * 12)
    assert len(shown) <= 24
    assert "Links: 1" in [line.strip() for line in shown]
    assert shown[-1].strip() == "q ends"


def test_the_strip_follows_the_clock_of_the_spacecraft(documents: Any) -> None:
    reader = LiveReader(documents, documents, "yamal-202")
    known, asked = documents.status(""), []
    answer = documents.request

    def request(method: str, path: str, body: Any = None, params: Any = None) -> Any:
        asked.append(params["stop"])
        return answer(method, path, body, params)

    documents.request = request
    for minute in (31, 36):
        documents.status = lambda _, now=f"2027-01-15T10:{minute}:00.000000Z": known | {"now": now}
        reader._read()
    assert asked == ["2027-01-15T10:36:00.000001Z"]


@pytest.mark.parametrize(("encoding", "mark"), [("utf-8", "▂"), ("ascii", ".")])
def test_the_strip_has_a_mark_for_each_half_hour_that_has_rows(documents: Any, encoding: str, mark: str) -> None:
    shown = lines(LiveReader(documents, documents, "yamal-202"), encoding=encoding)
    (strip,) = [line for line in shown if line.startswith("Protection level, 24 h")]
    assert strip.split() == ["Protection", "level,", "24", "h", mark, "!", "of", "0.22", "deg"]
    assert strip.index("!") == len("Protection level, 24 h ") + 43


def test_before_the_first_row_there_is_no_strip(documents: Any) -> None:
    known = documents.status("")
    documents.status = lambda _: known | {"now": None}
    shown = lines(LiveReader(documents, documents, "yamal-202"))
    assert "Protection level, 24 h: none" in [line.strip() for line in shown]


def test_a_reader_says_since_when_nothing_comes_and_reads_again_after_it(documents: Any) -> None:
    events = iter([True, False, True])

    def stream(_: str, *, patience_s: float) -> Any:
        assert patience_s == 0.0
        if next(events):
            yield None
        if reader.cut:
            reader.end()
        raise ServiceUnavailableError("no answer from \x1b[2J")

    reader = LiveReader(documents, type("Streaming", (), {"stream": staticmethod(stream)}), "yamal-202")
    assert reader.cut == ""
    reader._follow()
    assert reader.cut.startswith("cut since 20")
    assert reader.cut.endswith(": no answer from �[2J")


def test_documents_are_read_again_after_an_event_and_not_before(
    documents: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.cli.shift.watch._READ_S", 0.0)
    reader = LiveReader(documents, documents, "yamal-202")
    documents.alarms = []
    reader.update()
    assert len(reader.state.alarms) == 1
    reader._is_changed.set()
    reader.update()
    assert reader.state.alarms == []

    def status(_: str) -> Any:
        raise ServiceUnavailableError("no answer")

    documents.status = status
    reader._is_changed.set()
    reader.update()
    assert (reader.state.alarms, reader._is_changed.is_set()) == ([], True)
    assert reader.cut.endswith("no answer")
