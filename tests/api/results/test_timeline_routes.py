"""Timeline: intervals and marks of a span in one answer."""

from dataclasses import replace

import pytest

from db.results import state_summaries
from service.api.views import timeline
from service.ports import Outcome
from service.records.epoch import format_epoch
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import Axes, Exclusion
from service.records.operations.alarm import Alarm, AlarmChange, ChangeKind, Cover, Process, Severity

pytestmark = pytest.mark.anyio
MINUTE = 60_000_000
LEVEL = Alarm(
    id=0,
    spacecraft_id=None,
    condition="carrier_level",
    thing="",
    process=Process.UNACKNOWLEDGED,
    cover=Cover.NONE,
    severity=Severity.WARNING,
    since_us=0,
    raised_at_us=0,
    changed_at_us=0,
    value=-4.0,
    limit=-3.0,
    unit="dB",
    detail="4 dB below its level",
)
LISTS = ("states", "gaps", "operations", "corrections", "commands", "calibrations", "alignments", "alarms", "notes")


def epoch(make, minute):
    return format_epoch(make.now_us + minute * MINUTE)


@pytest.fixture
def story(bench, make):
    """An hour of rows: fade in the second quarter, a gap in the third, one carrier left out at the end."""
    rows = bench.append([make.now_us + k * MINUTE for k in range(60) if not 35 <= k < 40])
    changes = [
        {"downlink_fade": True, "inhibitions": ("downlink_fade",), "control_allowed": False} if 15 <= k < 30 else {}
        for k in (round((row.epoch_us - make.now_us) / MINUTE) for row in rows)
    ]
    changes[-1] = {"excluded": (Exclusion("c02", "step"),)}
    made = [Outcome((replace(make.row(row), **each),), None) for row, each in zip(rows, changes, strict=True)]
    bench.consume(made)
    return bench


async def test_states_are_intervals_of_rows(story, make):
    found = await story.get("/timeline", start=epoch(make, 10), stop=epoch(make, 60), method="paper")
    assert found["joined_s"] == 0
    fades = [state for state in found["states"] if state["kind"] == "fade"]
    fade = {"start": epoch(make, 15), "stop": epoch(make, 29), "rows": 15}
    assert fades == [{"method": "paper", "kind": "fade", "name": "downlink", "carrier": None, **fade}]
    reason = next(state for state in found["states"] if state["name"] == "downlink_fade")
    assert (reason["kind"], {key: reason[key] for key in fade}) == ("inhibition", fade)
    (left_out,) = [state for state in found["states"] if (state["kind"], state["name"]) == ("exclusion", "step")]
    assert (left_out["carrier"], left_out["rows"]) == ("c02", 1)
    assert found["gaps"] == [{"start": epoch(make, 35), "stop": epoch(make, 40), "rows_missing": 5}]
    both = await story.get("/timeline", start=epoch(make, 10), stop=epoch(make, 60))
    assert {state["method"] for state in both["states"]} == {"paper", "robust"}


async def test_inputs_notes_and_alignments_stand_beside_the_states(story, make):
    calibration = story.calibrate([])
    story.align(make.now_us + 20 * MINUTE)
    archive = story.storage.archive
    archive.add_operation(make.sc, Operation(0, "eclipse", make.now_us + 5 * MINUTE, None))
    archive.append_inputs(make.sc, [Correction(make.now_us, make.now_us + MINUTE, Axes(0.0, 0.1, 0.0))])
    note = {"text": "<img onerror>", "spacecraft_id": make.sc, "epoch": epoch(make, 7)}
    await story.client.post("/api/v1/notes", json=note)
    found = await story.get("/timeline", start=epoch(make, 0), stop=epoch(make, 60))
    assert [each["kind"] for each in found["operations"]] == ["eclipse"]
    assert [each["roll_deg"] for each in found["corrections"]] == [0.1]
    assert [each["text"] for each in found["notes"]] == ["<img onerror>"]
    assert [each["epoch"] for each in found["alignments"]] == [epoch(make, 20)]
    assert [each["calibration_id"] for each in found["calibrations"]] == [calibration.id]
    later = await story.get("/timeline", start=epoch(make, 600), stop=epoch(make, 660))
    assert [len(later[name]) for name in LISTS] == [0, 0, 1, 0, 0, 0, 0, 0, 0]


async def test_alarms_are_those_that_were_active_within_the_span(bench, make):
    """Raised before the span, an alarm is in it as long as its condition stood, acknowledged or not."""
    bench.append([make.now_us])
    cases = {
        "gone before, not acknowledged": (-50, -40, Process.RETURNED),
        "gone before, closed": (-49, -39, Process.NORMAL),
        "cleared before": (-48, None, Process.NORMAL),
        "gone within, closed": (-30, 5, Process.NORMAL),
        "gone within, latched": (-29, 6, Process.LATCHED),
        "stands": (-20, None, Process.ACKNOWLEDGED),
        "raised within": (10, 12, Process.NORMAL),
        "raised behind": (70, None, Process.UNACKNOWLEDGED),
    }
    changes = []
    for thing, (raised, gone, process) in cases.items():
        raised_us = make.now_us + raised * MINUTE
        gone_us = None if gone is None else make.now_us + gone * MINUTE
        about = {"thing": thing, "process": process, "changed_at_us": gone_us or raised_us, "returned_at_us": gone_us}
        alarm = replace(LEVEL, spacecraft_id=make.sc, since_us=raised_us, raised_at_us=raised_us, **about)
        changes.append(AlarmChange(ChangeKind.RAISED, alarm, raised_us, is_told=False))
    service = replace(changes[5].alarm, spacecraft_id=None, thing="of the service", raised_at_us=make.now_us - MINUTE)
    bench.storage.alarms.save(changes)
    bench.storage.alarms.save([AlarmChange(ChangeKind.RAISED, service, service.raised_at_us, is_told=False)])
    found = await bench.get("/timeline", start=epoch(make, 0), stop=epoch(make, 60))
    expected = ["gone within, closed", "gone within, latched", "stands", "of the service", "raised within"]
    assert [each["thing"] for each in found["alarms"]] == expected


async def test_too_many_runs_are_joined_and_too_long_lists_cut(story, make, monkeypatch):
    monkeypatch.setattr(timeline, "MOST_RUNS", 5)
    monkeypatch.setattr(timeline, "MOST", 1)
    for minute in (1, 2):
        await story.client.post("/api/v1/notes", json={"text": "x", "epoch": epoch(make, minute)})
    found = await story.get("/timeline", start=epoch(make, 0), stop=epoch(make, 60), method="paper")
    names = [(state["kind"], state["name"], state["carrier"]) for state in found["states"]]
    assert len(names) == len(set(names)) > 5
    assert found["joined_s"] == 1024
    assert (len(found["notes"]), found["cut"]) == (1, ["notes"])


async def test_what_is_left_out_is_stated(story, make, monkeypatch):
    monkeypatch.setattr(state_summaries, "MOST_ROWS", 25)
    found = await story.get("/timeline", start=epoch(make, 0), stop=epoch(make, 60))
    (left_out,) = found["states_left_out"]
    # 25 rows stand from here on; the five of the gap are missing
    assert left_out["start"] == epoch(make, 0)
    assert epoch(make, 29) < left_out["stop"] < epoch(make, 30)
    assert min(state["start"] for state in found["states"]) == epoch(make, 30)
    alone = await story.get("/timeline", **left_out)
    assert [each["start"] for each in alone["states_left_out"]] == [epoch(make, 0)]


async def test_an_empty_archive_has_an_empty_timeline(bench):
    found = await bench.get("/timeline")
    assert all(found[name] == [] for name in LISTS)


async def test_bad_ends_are_refused(bench, make):
    span = {"start": epoch(make, 1), "stop": epoch(make, 0)}
    url = f"/spacecraft/{make.sc}/timeline"
    assert await bench.refused("GET", url, params=span) == (422, "range.invalid", ["/query/start"])
    assert (await bench.refused("GET", "/spacecraft/nobody/timeline"))[:2] == (404, "spacecraft.unknown")
