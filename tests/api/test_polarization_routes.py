"""Polarisation records: who may say what of which polarimeter, and the polarimeters of the catalogue."""

import pytest

from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
BASE = f"{SC}/yamal-202"
STATED = {"source": "pol-1", "feed_offset_deg": 10.0, "frequency_hz": 11.2e9}
NOTHING = dict.fromkeys(
    ("ratio_db", "co_power_dbm", "feed_offset_deg", "noise_db", "angle_deg", "sigma_deg", "tec_tecu")
)


@pytest.fixture
async def now(soo, spacecraft):
    """The present as text, of a spacecraft that has a polarimeter."""
    answer = await soo.client.post(SC, json=spacecraft | {"polarimeters": [STATED]})
    assert answer.status_code == 201, answer.text
    soo.accepted.clear()
    return format_epoch(soo.clock.system_us())


async def sent(soo, *records, source="pol-1"):
    answer = await soo.client.post(f"{BASE}/polarization:batch", json={"source": source, "records": list(records)})
    assert answer.status_code == 200, answer.text
    return answer.json()


async def test_records_read_back_as_sent_and_count_once(soo, now):
    row = {"epoch": now, "ratio_db": -15.0, "co_power_dbm": -55.0, "noise_db": 0.06, "tec_tecu": 12.0}
    assert (await sent(soo, row))["accepted"] == 1
    assert soo.accepted == ["yamal-202"]
    assert (await sent(soo, row))["duplicates"] == 1
    assert [r["code"] for r in (await sent(soo, row | {"ratio_db": -14.0}))["refused"]] == ["input.conflict"]
    listed = (await soo.client.get(f"{BASE}/polarization")).json()["rows"]
    assert listed == [{"source": "pol-1"} | NOTHING | row]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"ratio_db": None}, "value.absent"),
        ({"angle_deg": 0.1}, "value.absent"),
        ({"ratio_db": 61.0}, "value.out_of_range"),
        ({"feed_offset_deg": 0.0}, "value.out_of_range"),
        ({"feed_offset_deg": 81.0}, "value.out_of_range"),
        ({"noise_db": 0.0}, "value.out_of_range"),
        ({"tec_tecu": -1.0}, "value.out_of_range"),
        ({"epoch": "2099-01-01T00:00:00Z"}, "time.future"),
        ({"epoch": "1999-01-01T00:00:00Z"}, "time.too_old"),
    ],
)
async def test_records_that_cannot_be_are_left_out(soo, now, changes, code):
    answer = await sent(soo, {"epoch": now, "ratio_db": -15.0} | changes)
    assert [(r["index"], r["code"]) for r in answer["refused"]] == [(0, code)]
    assert (await soo.client.get(f"{BASE}/polarization")).json()["rows"] == []
    assert soo.accepted == []


async def test_an_unknown_polarimeter_is_answered_with_the_known_ones(soo, now):
    (refused,) = (await sent(soo, {"epoch": now, "ratio_db": -15.0}, source="pol-2"))["refused"]
    assert refused["code"] == "polarimeter.unknown"
    assert refused["detail"].endswith("it states: pol-1")


@pytest.mark.parametrize(
    ("polarimeters", "code"),
    [
        ([STATED | {"feed_offset_deg": 0.2}], "polarimeter.feed_offset"),
        ([STATED, STATED], "polarimeter.duplicate"),
        ([{"source": "pol-1"}], "request.invalid"),
    ],
)
async def test_polarimeters_that_measure_nothing_are_refused(soo, spacecraft, polarimeters, code):
    answer = await soo.client.post(SC, json=spacecraft | {"polarimeters": polarimeters})
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text


async def test_a_polarimeter_reads_back_with_its_defaults(soo, now):
    (stated,) = (await soo.client.get(BASE)).json()["polarimeters"]
    assert {name: stated[name] for name in STATED} == STATED
    assert (stated["site"], stated["used"], stated["field_t"]) == (None, True, 0.0)


async def test_a_viewer_may_read_and_not_send(soo, now):
    key = (await soo.client.post("/api/v1/keys", json={"name": "v", "role": "viewer"})).json()["key"]
    headers = {"Authorization": f"Bearer {key}"}
    body = {"source": "pol-1", "records": [{"epoch": now, "ratio_db": -15.0}]}
    assert (await soo.client.post(f"{BASE}/polarization:batch", json=body, headers=headers)).status_code == 403
    assert (await soo.client.get(f"{BASE}/polarization", headers=headers)).status_code == 200
