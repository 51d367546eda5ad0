"""Shift work over the interface: alarms, the log, timelines, torques and what the next shift is handed over."""

import json
from dataclasses import replace

import numpy as np
import pytest
from stored_records import ALARM

from db.results import result_samples
from service.api.context import CarrierNameCache
from service.api.stream.events import ArchiveReader, EventTexts
from service.api.views import timeline
from service.pipeline.estimation.method import RowEvidence
from service.ports.archive import Outcome
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.epoch import format_epoch
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import Axes, Exclusion
from service.records.levels.measurement import Measurement
from service.records.operations.access import AccessKey, Role, StoredKey
from service.records.operations.alarms import AlarmChange, ChangeKind, Process
from service.records.operations.work import LinkReport

pytestmark = pytest.mark.anyio


S = 1_000_000
MINUTE = 60 * S
PLAN = CarrierPlan(9, "sha", tuple(Carrier(f"c0{k}", "Ku", "Ku1", 11e9, 1e6) for k in range(2)))
ALARMS = "/api/v1/spacecraft/yamal-202/alarms"
LIMITS = "/api/v1/spacecraft/yamal-202/alarm-limits"


@pytest.fixture
def absent(bench, make):
    """Let carriers be absent for some minutes and the desk look at it."""
    minutes = iter(range(1, 1000))

    def report(*names, rows=4):
        for minute in [next(minutes) for _ in range(rows)]:
            epoch_us = make.now_us - 1000 * MINUTE + minute * MINUTE
            powers = np.array([np.nan if name in names else -40.0 for name in PLAN.carrier_ids])
            measurement = Measurement(epoch_us, epoch_us, minute, "sa", 9, powers, None)
            bench.context.alarms.on_rows(make.sc, [RowEvidence(measurement, PLAN, (), Method.PAPER, None, {})])
        bench.context.alarms._check_rows()

    return report


async def test_an_alarm_is_listed_with_all_that_an_operator_needs(bench, absent):
    assert (await bench.client.get(ALARMS)).json()["rows"] == []
    absent("c00")
    (row,) = (await bench.client.get(ALARMS)).json()["rows"]
    assert (row["condition"], row["thing"], row["state"], row["severity"]) == (
        "carrier_absent",
        "c00",
        "unacknowledged",
        "warning",
    )
    assert (row["value"], row["limit"], row["unit"], row["present_value"]) == (120.0, 120.0, "s", 180.0)
    assert row["since"] < row["raised_at"]
    assert row["detail"] == "carrier c00 has been absent for 120 s, limit 120 s"
    assert "look at the trace" in row["next_step"]


async def test_an_alarm_goes_its_way_by_orders_and_keeps_who_gave_them(bench, absent):
    absent("c00")
    alarm_id = (await bench.client.get(ALARMS)).json()["rows"][0]["id"]
    at = f"/api/v1/alarms/{alarm_id}"
    seen = await bench.client.post(f"{at}:acknowledge", json={"comment": "on it"})
    assert seen.status_code == 200
    assert seen.json()["state"] == "acknowledged"
    assert seen.json()["acknowledged"] | {"at": ""} == {"by": "bootstrap", "at": "", "comment": "on it"}
    shelved = await bench.client.post(f"{at}:shelve", json={"until": "2026-11-21T04:00:00Z"})
    assert (shelved.json()["state"], shelved.json()["shelved_until"]) == ("shelved", "2026-11-21T04:00:00.000000Z")
    assert (await bench.client.get(ALARMS)).json()["rows"] == []
    assert len((await bench.client.get(ALARMS, params={"state": "shelved"})).json()["rows"]) == 1
    assert (await bench.client.post(f"{at}:unshelve")).json()["state"] == "acknowledged"
    cleared = await bench.client.post(f"{at}:clear", json={})
    assert (cleared.json()["state"], cleared.json()["cleared"]["by"]) == ("normal", "bootstrap")
    history = (await bench.client.get(at)).json()
    assert [change["change"] for change in history["changes"]] == [
        "raised",
        "acknowledged",
        "shelved",
        "unshelved",
        "cleared",
    ]
    assert history["alarm"]["state"] == history["changes"][-1]["alarm"]["state"] == "normal"


async def test_bad_orders_are_refused(bench, absent):
    absent("c00")
    alarm_id = (await bench.client.get(ALARMS)).json()["rows"][0]["id"]
    for order, sent, status, code in (
        ("shelve", {"json": {"until": "2026-11-21T03:00:00Z"}}, 422, "alarm.shelve_until"),
        ("shelve", {"json": {"until": "2026-11-22T03:00:00.000001Z"}}, 422, "alarm.shelve_until"),
        ("shelve", {"json": {}}, 422, "field.missing"),
        ("acknowledge", {"json": {"comment": 5}}, 422, "value.type"),
        ("acknowledge", {"content": b"{"}, 400, "json.malformed"),
        ("unshelve", {}, 409, "alarm.not_shelved"),
    ):
        answer = await bench.client.post(f"/api/v1/alarms/{alarm_id}:{order}", **sent)
        assert (answer.status_code, answer.json()["code"]) == (status, code), (order, sent)
    assert (await bench.client.get(ALARMS)).json()["rows"][0]["state"] == "unacknowledged"


async def test_unknown_and_closed_alarms_are_told_so(bench, absent):
    absent("c00")
    alarm_id = (await bench.client.get(ALARMS)).json()["rows"][0]["id"]
    await bench.client.post(f"/api/v1/alarms/{alarm_id}:clear")
    closed = await bench.client.post(f"/api/v1/alarms/{alarm_id}:acknowledge")
    assert (closed.status_code, closed.json()["code"]) == (409, "alarm.closed")
    for answer in (await bench.client.get("/api/v1/alarms/999"), await bench.client.post("/api/v1/alarms/999:clear")):
        assert (answer.status_code, answer.json()["code"]) == (404, "alarm.unknown")
    assert (await bench.client.get("/api/v1/spacecraft/nobody/alarms")).status_code == 404


async def test_lists_are_paged_and_chosen_by_state_and_time(bench, absent):
    for names in (("c00",), ("c01",), ("c00",), ("c01",)):
        absent(*names)
        absent()
    found = (await bench.client.get(ALARMS, params={"state": ["returned", "closed"]})).json()["rows"]
    assert [row["thing"] for row in found] == ["c00", "c01"]
    page = (await bench.client.get(ALARMS, params={"limit": 1})).json()
    rest = (await bench.client.get(ALARMS, params={"limit": 1, "cursor": page["next"]})).json()
    assert [row["id"] for row in page["rows"] + rest["rows"]] == [row["id"] for row in found]
    assert rest["next"] is None
    later = {"state": "returned", "start": found[1]["raised_at"]}
    assert [row["id"] for row in (await bench.client.get(ALARMS, params=later)).json()["rows"]] == [found[1]["id"]]
    assert (await bench.client.get(ALARMS, params={"state": "loud"})).status_code == 422


async def test_limits_are_versions_that_can_be_taken_elsewhere(bench):
    first = (await bench.client.get(LIMITS)).json()
    assert (first["version"], first["sets"], first["created_at"]) == (0, {}, None)
    stated = {"sets": {"normal": {"carrier_absent": {"warning": 30.0, "distress": None}}}, "comment": "tight"}
    put = await bench.client.put(LIMITS, json=stated)
    assert put.status_code == 200, put.text
    assert (put.json()["version"], put.json()["created_by"], put.json()["sets"]) == (1, "bootstrap", stated["sets"])
    exported = (await bench.client.get(LIMITS)).json()
    again = await bench.client.put(LIMITS, json=exported)
    assert (again.json()["version"], again.json()["sets"]) == (2, stated["sets"])
    assert (await bench.client.get(LIMITS, params={"version": 1})).json() == exported
    unknown = await bench.client.get(LIMITS, params={"version": 7})
    assert (unknown.status_code, unknown.json()["code"]) == (404, "alarm_limits.unknown")
    in_force = (await bench.client.get(f"{LIMITS}/in-force")).json()
    assert (in_force["version"], in_force["sets"]) == (2, ["normal"])
    absence = in_force["conditions"]["carrier_absent"]
    assert (absence["warning"], absence["distress"], absence["off_s"], absence["unit"]) == (30.0, None, 120.0, "s")


async def test_stated_limits_hold(bench, absent):
    await bench.client.put(LIMITS, json={"sets": {"normal": {"carrier_absent": {"enabled": False}}}})
    absent("c00", rows=30)
    assert (await bench.client.get(ALARMS)).json()["rows"] == []


async def test_limits_that_make_no_sense_are_refused(bench):
    for stated, code in (
        ({"sets": {"normal": {"nonsense": {}}}}, "alarm_limits.condition"),
        ({"sets": {"normal": {"carrier_level": {"warning": 9.0}}}}, "alarm_limits.order"),
        ({"sets": {"normal": {"carrier_level": {"warning": float("nan")}}}}, "value.not_finite"),
        ({"sets": {"stormy": {}}}, "value.choice"),
        ({"sets": {"normal": {"carrier_level": {"latching": None}}}}, "value.type"),
        ({"sets": {"normal": {"carrier_level": {"on_s": -1.0}}}}, "value.range"),
        ({"nominal_dbm": {"c00": 60.0}}, "value.range"),
    ):
        headers = {"Content-Type": "application/json"}
        answer = await bench.client.put(LIMITS, content=json.dumps(stated), headers=headers)
        assert (answer.status_code, answer.json()["code"]) == (422, code), stated
    assert (await bench.client.get(LIMITS)).json()["version"] == 0


async def test_a_stream_resumes_changes_of_alarms_without_loss(bench, absent, make):
    absent("c00")
    absent()
    raised, returned = bench.storage.alarms.changes_after(make.sc, 0, 10)
    names = CarrierNameCache(bench.storage.catalogue)
    reader = ArchiveReader(bench.storage, names, make.sc)
    present, _ = reader.present_and_end()
    assert present.alarm == returned.sequence
    assert reader.next_page(present).events == []
    page = reader.next_page(present._replace(alarm=raised.sequence))
    assert ([event.content for event in page.events], page.position.alarm) == ([returned], returned.sequence)
    reported = json.loads(EventTexts(names).of(make.sc, page.events[0]))
    assert (reported["change"], reported["sequence"], reported["alarm"]["thing"]) == (
        "returned",
        returned.sequence,
        "c00",
    )
    assert reported["alarm"]["next_step"]


HOUR = 3600 * S
NOTES = "/api/v1/notes"
HANDOVER = "/api/v1/spacecraft/yamal-202/handover"


async def test_a_note_keeps_author_instant_and_tags(bench, make):
    body = {"text": "first\nsecond: ünïcode", "spacecraft_id": make.sc, "tags": ["shift", "rain"]}
    written = await bench.client.post(NOTES, json=body)
    assert written.status_code == 201, written.text
    note = written.json()
    assert (note["author"], note["epoch"], note["text"]) == ("bootstrap", "2026-11-21T03:00:00.000000Z", body["text"])
    assert (note["tags"], note["corrects"]) == (["shift", "rain"], None)
    assert (await bench.client.get(written.headers["Location"])).json() == note


async def test_a_correction_is_a_new_note_that_names_the_old_one(bench):
    first = (await bench.client.post(NOTES, json={"text": "yaw is off"})).json()
    second = await bench.client.post(NOTES, json={"text": "roll is off", "corrects": first["id"]})
    assert second.json()["corrects"] == first["id"]
    rows = (await bench.client.get(NOTES)).json()["rows"]
    assert [row["text"] for row in rows] == ["yaw is off", "roll is off"]
    for method in ("PUT", "PATCH", "DELETE"):
        assert (await bench.client.request(method, f"{NOTES}/{first['id']}", json={})).status_code == 405


async def test_notes_are_listed_by_craft_and_time_in_pages(bench, make):
    for minute, spacecraft in enumerate((make.sc, None, make.sc)):
        epoch = f"2026-11-21T0{minute}:00:00Z"
        await bench.client.post(NOTES, json={"text": str(minute), "epoch": epoch, "spacecraft_id": spacecraft})
    page = (await bench.client.get(NOTES, params={"limit": 2, "spacecraft_id": make.sc})).json()
    rest = (await bench.client.get(NOTES, params={"cursor": page["next"], "spacecraft_id": make.sc})).json()
    assert [row["text"] for row in page["rows"] + rest["rows"]] == ["0", "1", "2"]
    window = {"start": "2026-11-21T01:00:00Z", "stop": "2026-11-21T02:00:00Z"}
    assert [row["text"] for row in (await bench.client.get(NOTES, params=window)).json()["rows"]] == ["1"]


async def test_bad_notes_are_refused(bench):
    for body, status, code in (
        ({"text": ""}, 422, "value.length"),
        ({"text": "x", "corrects": 99}, 404, "note.unknown"),
        ({"text": "x", "spacecraft_id": "nobody"}, 404, "spacecraft.unknown"),
        ({"text": "x", "epoch": "yesterday"}, 422, "epoch.malformed"),
        ({"text": "x", "author": "me"}, 422, "field.unknown"),
        ({"text": "\x00"}, 422, "value.pattern"),
    ):
        answer = await bench.client.post(NOTES, json=body)
        assert (answer.status_code, answer.json()["code"]) == (status, code), body
    assert (await bench.client.get(NOTES)).json()["rows"] == []


async def test_an_empty_hand_over_says_so(bench):
    reported = (await bench.client.get(HANDOVER)).json()
    for name in ("alarms", "shelved", "suppressed", "calibrations", "keys", "links", "sources", "operations", "notes"):
        assert reported[name] == [], name
    assert reported["alignment"] is None
    assert reported["ephemeris"]["hours_left"] == 0.0
    assert (reported["control"]["mode"], reported["control"]["state"]) == ("ground", "INHIBITED")
    assert reported["at"] == "2026-11-21T03:00:00.000000Z"
    assert (await bench.client.get("/api/v1/spacecraft/nobody/handover")).status_code == 404


def raise_alarms(bench, make):
    """Let two carriers be absent, one of them for so long that it is worse."""
    plan = CarrierPlan(9, "sha", tuple(Carrier(f"c0{k}", "Ku", "Ku1", 11e9, 1e6) for k in range(3)))
    for minute in range(90):
        epoch_us = make.now_us + (minute - 100) * 60 * S
        gone = (False, minute > 0, minute > 80)
        powers = np.where(gone, np.nan, -40.0)
        measurement = Measurement(epoch_us, epoch_us, minute, "sa", 9, powers, None)
        bench.context.alarms.on_rows(make.sc, [RowEvidence(measurement, plan, (), Method.PAPER, None, {})])
    bench.context.alarms._check_rows()


async def test_the_hand_over_tells_what_the_next_shift_must_know(bench, make):
    raise_alarms(bench, make)
    worst, other = bench.storage.alarms.open_alarms(make.sc)
    bench.context.alarms.shelve(other.id, "anna", "known", make.now_us + HOUR)
    link = LinkReport("sa-1", "analyzer", make.sc, "sa", "BACKOFF", {}, {}, None, period_s=10.0)
    bench.storage.links.report([link], make.now_us)
    in_force = Operation(0, "carrier_work", make.now_us - HOUR, None)
    far = Operation(0, "eclipse", make.now_us + 30 * HOUR, make.now_us + 31 * HOUR)
    for operation in (in_force, far):
        bench.storage.archive.add_operation(make.sc, operation)
    for name, days in (("soon", 3), ("late", 60)):
        key = AccessKey(
            id=name,
            name=name,
            role=Role.STATION,
            created_at_us=0,
            created_by="x",
            expires_at_us=make.now_us + days * 24 * HOUR,
        )
        bench.storage.keys.add(StoredKey(key, name.encode()))
    await bench.client.post(NOTES, json={"text": "rain over the site", "spacecraft_id": make.sc})
    reported = (await bench.client.get(HANDOVER)).json()
    assert [(row["id"], row["severity"]) for row in reported["alarms"]] == [(worst.id, "distress")]
    assert [(row["id"], row["shelved_until"]) for row in reported["shelved"]] == [
        (other.id, "2026-11-21T04:00:00.000000Z")
    ]
    assert [row["id"] for row in reported["links"]] == ["sa-1"]
    assert [row["kind"] for row in reported["operations"]] == ["carrier_work"]
    assert [(row["name"], row["days_left"]) for row in reported["keys"]] == [("soon", 3.0)]
    assert [row["text"] for row in reported["notes"]] == ["rain over the site"]


TIMELINE_MINUTE = 60_000_000
LISTS = ("states", "gaps", "operations", "corrections", "commands", "calibrations", "alignments", "alarms", "notes")


def epoch(make, minute):
    return format_epoch(make.now_us + minute * TIMELINE_MINUTE)


@pytest.fixture
def story(bench, make):
    """An hour of rows: fade in the second quarter, a gap in the third, one carrier left out at the end."""
    rows = bench.append([make.now_us + k * TIMELINE_MINUTE for k in range(60) if not 35 <= k < 40])
    changes = [
        {"downlink_fade": True, "inhibitions": ("downlink_fade",), "control_allowed": False} if 15 <= k < 30 else {}
        for k in (round((row.epoch_us - make.now_us) / TIMELINE_MINUTE) for row in rows)
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
    story.align(make.now_us + 20 * TIMELINE_MINUTE)
    archive = story.storage.archive
    archive.add_operation(make.sc, Operation(0, "eclipse", make.now_us + 5 * TIMELINE_MINUTE, None))
    archive.append_inputs(make.sc, [Correction(make.now_us, make.now_us + TIMELINE_MINUTE, Axes(0.0, 0.1, 0.0))])
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
        raised_us = make.now_us + raised * TIMELINE_MINUTE
        gone_us = None if gone is None else make.now_us + gone * TIMELINE_MINUTE
        about = {"thing": thing, "process": process, "changed_at_us": gone_us or raised_us, "returned_at_us": gone_us}
        alarm = replace(ALARM, spacecraft_id=make.sc, since_us=raised_us, raised_at_us=raised_us, **about)
        changes.append(AlarmChange(ChangeKind.RAISED, alarm, raised_us, is_told=False))
    service = replace(
        changes[5].alarm, spacecraft_id=None, thing="of the service", raised_at_us=make.now_us - TIMELINE_MINUTE
    )
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
    monkeypatch.setattr(result_samples, "MOST_ROWS", 25)
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
