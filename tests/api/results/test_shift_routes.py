"""Shift work over the interface: the log, and what the next shift is handed over."""

import numpy as np
import pytest

from service.pipeline.estimation.row_evidence import RowEvidence
from service.records.catalogue import Carrier, CarrierPlan, Method
from service.records.inputs import Operation
from service.records.levels.measurement import Measurement
from service.records.operations.access_key import AccessKey, Role, StoredKey
from service.records.operations.link import LinkReport

pytestmark = pytest.mark.anyio
S = 1_000_000
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
