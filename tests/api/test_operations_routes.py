"""Operations: declared, changed, listed."""

import pytest

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
URL = f"{SC}/yamal-202/operations"
START = "2026-11-25T00:00:00.000000Z"
STOP = "2026-11-25T01:00:00.000000Z"
FULL = {
    "kind": "carrier_work",
    "start": START,
    "stop": STOP,
    "carriers": ["c00", "c03"],
    "transponders": ["Ku1"],
    "inhibit_control": True,
    "attitude_uncertainty_deg": {"yaw": 0.1, "roll": None, "pitch": 0.0},
    "comment": "first line\nsecond line",
}


async def test_an_operation_reads_back_as_declared(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    created = await soo.client.post(URL, json=FULL)
    assert created.status_code == 201, created.text
    assert created.json() == FULL | {"id": 1, "revision": 1}
    assert created.headers["location"] == f"{URL}/1"
    assert (await soo.client.get(created.headers["location"])).json() == created.json()
    assert (await soo.client.get(URL)).json()["rows"] == [created.json()]
    assert soo.accepted == ["yamal-202"]


@pytest.mark.parametrize(
    ("kind", "does_inhibit"),
    [("station_keeping", True), ("momentum_unloading", True), ("carrier_work", False), ("eclipse", False)],
)
async def test_kinds_that_turn_the_craft_inhibit_control_unless_it_is_said_otherwise(
    soo, spacecraft, kind, does_inhibit
):
    await soo.client.post(SC, json=spacecraft)
    plain = (await soo.client.post(URL, json={"kind": kind, "start": START})).json()
    assert (plain["inhibit_control"], plain["stop"]) == (does_inhibit, None)
    said = (await soo.client.post(URL, json={"kind": kind, "start": START, "inhibit_control": not does_inhibit})).json()
    assert said["inhibit_control"] is not does_inhibit


async def test_a_change_is_a_new_revision_and_only_the_newest_is_listed(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    await soo.client.post(URL, json=FULL)
    soo.accepted.clear()
    patch = {"stop": "2026-11-25T02:00:00.000000Z", "attitude_uncertainty_deg": {"yaw": None}, "carriers": None}
    changed = await soo.client.patch(f"{URL}/1", json=patch)
    assert changed.status_code == 200, changed.text
    assert changed.json() == FULL | {
        "id": 1,
        "revision": 2,
        "stop": "2026-11-25T02:00:00.000000Z",
        "carriers": None,
        "attitude_uncertainty_deg": {"yaw": None, "roll": None, "pitch": 0.0},
    }
    assert (await soo.client.get(URL)).json()["rows"] == [changed.json()]
    assert soo.accepted == ["yamal-202"]


BAD = [
    ("", 400, "json.malformed"),
    ("[]", 422, "value.type"),
    ("{}", 422, "request.invalid"),
    ({"kind": "holiday", "start": START}, 422, "value.choice"),
    ({"kind": "other"}, 422, "field.missing"),
    ({"kind": "other", "start": "soon"}, 422, "epoch.malformed"),
    ({"kind": "other", "start": "1990-01-01T00:00:00Z"}, 422, "epoch.range"),
    ({"kind": "other", "start": STOP, "stop": START}, 422, "range.invalid"),
    ({"kind": "other", "start": START, "stop": START}, 422, "range.invalid"),
    ({"kind": "other", "start": START, "carriers": "c00"}, 422, "value.type"),
    ({"kind": "other", "start": START, "carriers": ["c 0"]}, 422, "value.pattern"),
    ({"kind": "other", "start": START, "carriers": []}, 422, "value.length"),
    ({"kind": "other", "start": START, "attitude_uncertainty_deg": {"yaw": -1}}, 422, "value.range"),
    ({"kind": "other", "start": START, "attitude_uncertainty_deg": [1, 2, 3]}, 422, "value.type"),
    ({"kind": "other", "start": START, "comment": "x" * 4001}, 422, "value.length"),
    ({"kind": "other", "start": START, "comment": "\u0000"}, 422, "value.pattern"),
    ({"kind": "other", "start": START, "inhibit_control": "yes"}, 422, "value.type"),
    ({"kind": "other", "start": START, "id": 5}, 422, "field.unknown"),
]


@pytest.mark.parametrize(("body", "status", "code"), BAD)
async def test_bad_operations_are_refused(soo, spacecraft, body, status, code):
    await soo.client.post(SC, json=spacecraft)
    soo.accepted.clear()
    sent = {"content": body} if isinstance(body, str) else {"json": body}
    answer = await soo.client.post(URL, **sent)
    assert (answer.status_code, answer.json()["code"]) == (status, code), answer.text
    assert (await soo.client.get(URL)).json()["rows"] == []
    assert soo.accepted == []


async def test_a_bad_change_changes_nothing(soo, spacecraft):
    await soo.client.post(SC, json=spacecraft)
    before = (await soo.client.post(URL, json=FULL)).json()
    for patch, code in (
        ({"stop": "2026-11-24T00:00:00Z"}, "range.invalid"),
        ({"revision": 9}, "field.unknown"),
        ({"kind": None}, "field.missing"),
    ):
        answer = await soo.client.patch(f"{URL}/1", json=patch)
        assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert (await soo.client.get(f"{URL}/1")).json() == before


async def test_unknown_operations_and_spacecraft_are_a_404(soo, spacecraft):
    assert (await soo.client.post(URL, json=FULL)).json()["code"] == "spacecraft.unknown"
    await soo.client.post(SC, json=spacecraft)
    for answer in (await soo.client.get(f"{URL}/7"), await soo.client.patch(f"{URL}/7", json={})):
        assert (answer.status_code, answer.json()["code"]) == (404, "operation.unknown")
    for text in ("0", "x", "99999999999"):
        assert (await soo.client.get(f"{URL}/{text}")).status_code == 422
