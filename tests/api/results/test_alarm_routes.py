"""Alarms over the interface: lists, orders of operators, limits with their versions, and the stream."""

import json

import numpy as np
import pytest

from service.api.context.carrier_names import CarrierNameCache
from service.api.stream.backlog import ArchiveReader
from service.api.stream.event_cache import EventTexts
from service.pipeline.estimation.row_evidence import RowEvidence
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.levels.measurement import Measurement

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
    for names in (("c00",), ("c01",), ("c00", "c01")):
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


async def test_the_audit_log_tells_who_did_what(bench, absent):
    absent("c00")
    alarm_id = (await bench.client.get(ALARMS)).json()["rows"][0]["id"]
    await bench.client.post(f"/api/v1/alarms/{alarm_id}:acknowledge")
    await bench.client.put(LIMITS, json={})
    entries = [entry.audit_event for entry in bench.storage.audit.chain()]
    assert [(audit_event.who, audit_event.action, audit_event.target) for audit_event in entries] == [
        ("bootstrap", "acknowledge_alarm", f"/alarms/{alarm_id}:acknowledge"),
        ("bootstrap", "put_alarm_limits", "/spacecraft/yamal-202/alarm-limits"),
    ]
