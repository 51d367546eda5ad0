"""Stations own their sources: what the key of another station is refused, what a new key of the same may do."""

import asyncio
from typing import Any

import pytest

from service.ports.archive import ListPart
from service.records.calibration import Window
from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio

KEYS, SC = "/api/v1/keys", "/api/v1/spacecraft/yamal-202"
NOW_US = 1_795_230_000_000_000
POWERS = [-42.1, None, -43.25, -60.0]
ALL = Window(0, 4 * 10**15)


async def key(soo, name: str, role: str = "station", **bound: Any) -> tuple[str, dict[str, str]]:
    """Make a key; return its id and the headers that carry it."""
    made = await soo.client.post(KEYS, json={"name": name, "role": role, **bound})
    assert made.status_code == 201, made.text
    return made.json()["id"], {"Authorization": f"Bearer {made.json()['key']}"}


def batch(plan_id: int, offset_s: int, source: str = "sa-1", **more: Any) -> dict[str, Any]:
    epoch = format_epoch(NOW_US + offset_s * 1_000_000)
    return {"plan_id": plan_id, "source": source, "measurements": [{"epoch": epoch, "power_dbm": POWERS}], **more}


async def send(soo, headers: dict[str, str] | None, *arguments: Any, **more: Any) -> Any:
    return await soo.client.post(f"{SC}/measurements:batch", json=batch(*arguments, **more), headers=headers)


async def rows(soo) -> list[tuple[str, str | None]]:
    """Return key and station of each stored row."""
    found = (await soo.client.get(f"{SC}/measurements/history", params={"limit": 1000})).json()["rows"]
    return [(row["key_id"], row["station"]) for row in found]


async def test_the_key_of_another_station_sends_nothing_for_a_source(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    _, own = await key(soo, "north")
    _, other = await key(soo, "south")
    assert (await send(soo, own, plan_id, -5)).status_code == 200
    # a forged row of an epoch that has none, one that is there already, and an evidence trace
    for offset_s in (-4, -5):
        refused = await send(soo, other, plan_id, offset_s)
        assert (refused.status_code, refused.json()["code"]) == (403, "source.not_yours")
        assert "'sa-1' belongs to station 'north', the key to station 'south'" in refused.json()["detail"]
    trace = {"epoch": format_epoch(NOW_US - 1_000_000), "sweep": "wide", "start_hz": 1e9, "step_hz": 1e3}
    trace |= {"rbw_hz": 1e3, "enbw_hz": 1e3, "sweep_time_s": 2.0, "power_dbm": [-60.0, -60.1]}
    refused = await soo.client.post(f"{SC}/traces", json={"source": "sa-1", "traces": [trace]}, headers=other)
    assert (refused.status_code, refused.json()["code"]) == (403, "source.not_yours")
    assert (await send(soo, other, plan_id, -4, "sa-2")).status_code == 200
    assert len(soo.storage.archive.measurements("yamal-202", ListPart(ALL, 9))) == 2


async def test_a_row_that_a_person_sent_says_so_and_a_station_takes_the_source(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    desk_id, desk = await key(soo, "olga", "operator")
    north_id, north = await key(soo, "north key", station="north")
    _, south = await key(soo, "south")
    for offset_s, headers in ((-9, desk), (-8, north), (-7, north), (-6, desk), (-5, north)):
        assert (await send(soo, headers, plan_id, offset_s)).json()["accepted"] == 1
    assert (await send(soo, None, plan_id, -4)).json()["accepted"] == 1
    assert (await send(soo, south, plan_id, -3)).status_code == 403
    of_north, of_desk = (north_id, "north"), (desk_id, None)
    assert await rows(soo) == [of_desk, of_north, of_north, of_desk, of_north, ("bootstrap", None)]
    (source,) = (await soo.client.get(f"{SC}/sources")).json()["rows"]
    assert (source["station"], source["key_id"]) == ("north", "bootstrap")


async def test_a_station_is_bound_to_spacecraft_and_kinds(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    _, weather = await key(soo, "gauge", kinds=["weather"])
    _, elsewhere = await key(soo, "far", spacecraft=["other-1"])
    _, bound = await key(soo, "near", spacecraft=["yamal-202", "other-1"], kinds=["powers", "telemetry"])
    for headers, words in ((weather, "bound to weather, not to powers"), (elsewhere, "other-1, not to yamal-202")):
        refused = await send(soo, headers, plan_id, -5)
        assert (refused.status_code, refused.json()["code"]) == (403, "station.not_bound")
        assert words in refused.json()["detail"]
    assert (await send(soo, bound, plan_id, -5)).status_code == 200
    kinds = {"telemetry": 200, "corrections": 403, "attitude-references": 403, "weather": 403, "polarization": 403}
    body = {"records": [{"epoch": format_epoch(NOW_US), "onboard_mode": "earth"}]}
    for kind, status in kinds.items():
        assert (await soo.client.post(f"{SC}/{kind}:batch", json=body, headers=bound)).status_code == status, kind


async def test_a_key_is_replaced_under_load_and_no_row_is_lost(soo, spacecraft, carriers):
    """Front ends send all the while; the new key takes over, the old one is revoked, what it brought is sent again."""
    plan_id = await soo.with_plan(spacecraft, carriers)
    # without a station stated it is that of the key's name
    old_id, old = await key(soo, "Станция Дубна", kinds=["powers"])
    held = {"headers": old}
    answers: list[int] = []

    async def front_end(number: int) -> None:
        for k in range(60):
            # as the spool does: the same row again, with the key that is there, until it is accepted
            while True:
                answer = await send(soo, held["headers"], plan_id, -600 + k, f"sa-{number}", first_seq=k)
                answers.append(answer.status_code)
                if answer.status_code == 200:
                    break
                await asyncio.sleep(0.01)

    sending = [asyncio.create_task(front_end(number)) for number in range(3)]
    while len(answers) < 30:
        await asyncio.sleep(0.01)
    new_id, new = await key(soo, "north 2", station="Станция Дубна")
    await soo.client.delete(f"{KEYS}/{old_id}")
    while 401 not in answers:
        await asyncio.sleep(0.01)
    held["headers"] = new
    await asyncio.gather(*sending)
    assert set(answers) == {200, 401}
    found = await rows(soo)
    assert len(found) == 180
    assert set(found) == {(old_id, "Станция Дубна"), (new_id, "Станция Дубна")}
    # the new key has the binding of the old one
    refused = await soo.client.post(f"{SC}/weather:batch", json={}, headers=new)
    assert (refused.status_code, refused.json()["code"]) == (403, "station.not_bound")
    sources = (await soo.client.get(f"{SC}/sources")).json()["rows"]
    assert {(each["station"], each["key_id"], each["rows"]) for each in sources} == {("Станция Дубна", new_id, 60)}


async def test_what_a_key_may_not_state_about_a_station(soo):
    assert (await key(soo, "north 1", station="north", kinds=["powers"]))[0]
    for body, status, code in (
        ({"role": "station", "station": "north", "kinds": ["weather"]}, 409, "key.station_bound"),
        ({"role": "station", "station": "north", "spacecraft": ["a-1"]}, 409, "key.station_bound"),
        ({"role": "viewer", "station": "north"}, 422, "key.not_station"),
        ({"role": "station", "kinds": ["money"]}, 422, "value.choice"),
    ):
        refused = await soo.client.post(KEYS, json={"name": "another", **body})
        assert (refused.status_code, refused.json()["code"]) == (status, code)
    made = await soo.client.post(KEYS, json={"name": "b", "role": "station", "station": "north", "kinds": ["powers"]})
    assert made.status_code == 201
    listed = {each["name"]: each for each in (await soo.client.get(KEYS)).json()["rows"]}
    assert [listed["b"][name] for name in ("station", "spacecraft", "kinds")] == ["north", [], ["powers"]]
