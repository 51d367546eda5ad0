"""Weather reports: who may say what about which station."""

import pytest

from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
BASE = f"{SC}/yamal-202"


def report(make_epoch, **changes):
    return {"epoch": make_epoch, "station": "Station 1", "rain_rate_mm_h": 2.5} | changes


@pytest.fixture
async def now(soo, spacecraft, carriers):
    """The present as text, of a spacecraft that has a carrier plan."""
    await soo.client.post(SC, json=spacecraft)
    await soo.client.put(f"{BASE}/carriers", json={"carriers": carriers})
    soo.accepted.clear()
    return format_epoch(soo.clock.system_us())


async def sent(soo, *reports, source="radar"):
    answer = await soo.client.post(f"{BASE}/weather:batch", json={"source": source, "reports": list(reports)})
    assert answer.status_code == 200, answer.text
    return answer.json()


async def test_reports_read_back_as_sent_and_count_once(soo, now):
    rows = [report(now), report(now, station="Station 0", rain_rate_mm_h=None, attenuation_db=0.0)]
    assert (await sent(soo, *rows))["accepted"] == 2
    assert soo.accepted == ["yamal-202"]
    assert (await sent(soo, *rows))["duplicates"] == 2
    assert (await sent(soo, *rows, source="gauge"))["accepted"] == 2
    assert [r["code"] for r in (await sent(soo, report(now, rain_rate_mm_h=0.0)))["refused"]] == ["input.conflict"]
    listed = (await soo.client.get(f"{BASE}/weather")).json()["rows"]
    assert listed == [{"source": source, "attenuation_db": None} | row for source in ("radar", "gauge") for row in rows]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"station": "Station 7"}, "station.unknown"),
        ({"station": "station 1"}, "station.unknown"),
        ({"rain_rate_mm_h": None}, "value.absent"),
        ({"rain_rate_mm_h": -0.1}, "value.out_of_range"),
        ({"rain_rate_mm_h": 2001}, "value.out_of_range"),
        ({"attenuation_db": -3.0}, "value.out_of_range"),
        ({"attenuation_db": 101}, "value.out_of_range"),
        ({"epoch": "2099-01-01T00:00:00Z"}, "time.future"),
        ({"epoch": "1999-01-01T00:00:00Z"}, "time.too_old"),
    ],
)
async def test_reports_that_cannot_be_are_left_out(soo, now, changes, code):
    answer = await sent(soo, report(now, **changes))
    assert [(r["index"], r["code"]) for r in answer["refused"]] == [(0, code)]
    assert (await soo.client.get(f"{BASE}/weather")).json()["rows"] == []
    assert soo.accepted == []


async def test_an_unknown_station_is_answered_with_the_known_ones(soo, now):
    (refused,) = (await sent(soo, report(now, station="Statoin 1")))["refused"]
    assert refused["detail"].endswith("it has: Station 0, Station 1, Station 2")


async def test_without_a_carrier_plan_there_is_no_station(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    body = {"source": "radar", "reports": [report("2026-11-20T00:00:00Z")]}
    answer = await soo.client.post(f"{BASE}/weather:batch", json=body)
    assert (answer.status_code, answer.json()["code"]) == (404, "plan.none")


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"reports": []}, "field.missing"),
        ({"source": "", "reports": []}, "value.pattern"),
        ({"source": "radar", "reports": [{"epoch": "2026-11-20T00:00:00Z"}]}, "field.missing"),
        ({"source": "radar", "reports": [report("2026-11-20T00:00:00Z", rain_rate_mm_h="wet")]}, "value.type"),
        ({"source": "radar", "reports": [report("2026-11-20T00:00:00Z", rain=1)]}, "field.unknown"),
        ({"source": "radar", "reports": [report("yesterday")]}, "epoch.malformed"),
    ],
)
async def test_bad_batches_are_refused_whole(soo, now, body, code):
    answer = await soo.client.post(f"{BASE}/weather:batch", json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, code), answer.text
    assert soo.accepted == []


async def test_a_viewer_may_read_and_not_send(soo, now):
    key = (await soo.client.post("/api/v1/keys", json={"name": "v", "role": "viewer"})).json()["key"]
    headers = {"Authorization": f"Bearer {key}"}
    body = {"source": "radar", "reports": [report(now)]}
    assert (await soo.client.post(f"{BASE}/weather:batch", json=body, headers=headers)).status_code == 403
    assert (await soo.client.get(f"{BASE}/weather", headers=headers)).status_code == 200
