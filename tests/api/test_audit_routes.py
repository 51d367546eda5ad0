"""The audit log over the interface: changes are committed with their entries, refusals too, and no flood fills it."""

from hashlib import sha256

import httpx
import pytest

from service.api.access import refusal_audit as refusals
from service.errors import StorageError
from service.records.epoch import format_epoch
from service.records.operations.audit import findings

pytestmark = pytest.mark.anyio
AUDIT = "/api/v1/audit"
SC = "/api/v1/spacecraft"


def chain(soo):
    found = list(soo.storage.audit.chain())
    assert list(findings(found, soo.storage.audit.head())) == []
    return found


def reported(soo):
    return [(e.audit_event.who, e.audit_event.action, e.audit_event.target, e.audit_event.outcome) for e in chain(soo)]


async def key_of(soo, role, name):
    made = (await soo.client.post("/api/v1/keys", json={"name": name, "role": role})).json()
    return made["id"], {"Authorization": f"Bearer {made['key']}"}


async def test_every_change_is_written_down_with_what_it_made(soo, spacecraft, carriers):
    key_id, operator = await key_of(soo, "operator", "olga")
    request = soo.client.build_request("POST", SC, json=spacecraft, headers=operator | {"X-Request-ID": "r-7"})
    assert (await soo.client.send(request)).status_code == 201
    await soo.client.put(f"{SC}/yamal-202/carriers", json={"carriers": carriers}, headers=operator)
    await soo.client.patch(f"{SC}/yamal-202", json={"name": "N"}, headers=operator)
    assert reported(soo) == [
        ("bootstrap", "create_key", f"/keys/{key_id}", "done"),
        ("olga", "create_spacecraft", "/spacecraft", "done"),
        ("olga", "put_carriers", "/spacecraft/yamal-202/carriers/1", "done"),
        ("olga", "change_spacecraft", "/spacecraft/yamal-202", "done"),
    ]
    audit_event = chain(soo)[1].audit_event
    assert (audit_event.key_id, audit_event.role, audit_event.request_id, audit_event.at_us) == (
        key_id,
        "operator",
        "r-7",
        soo.clock.system,
    )
    assert audit_event.address == "127.0.0.1"
    assert audit_event.body_sha256 == sha256(request.content).hexdigest()


async def test_reading_sending_and_what_fails_leave_no_entry(soo, spacecraft, carriers):
    plan_id = await soo.with_plan(spacecraft, carriers)
    before = len(chain(soo))
    await soo.client.get(SC)
    row = {"epoch": format_epoch(soo.clock.system), "power_dbm": [None] * 4}
    sent = await soo.client.post(
        f"{SC}/yamal-202/measurements:batch", json={"plan_id": plan_id, "source": "a", "measurements": [row]}
    )
    assert sent.json()["accepted"] == 1
    assert (await soo.client.post(SC, json=spacecraft)).status_code == 409
    assert (await soo.client.post(SC, json={})).status_code == 422
    assert len(chain(soo)) == before


async def test_a_change_and_its_entry_are_one(soo, spacecraft, monkeypatch):
    """When the entry cannot be written the change does not take place."""

    def fail(*_):
        raise StorageError("storage.unavailable", "on purpose")

    monkeypatch.setattr("db.audit_chain.append_entry", fail)
    answer = await soo.client.post(SC, json=spacecraft)
    assert (answer.status_code, answer.headers["retry-after"]) == (503, "5")
    monkeypatch.undo()
    assert soo.storage.catalogue.all_spacecraft() == ()


async def test_a_change_without_a_write_is_written_down_before_its_answer(soo, spacecraft, monkeypatch):
    monkeypatch.setattr(soo.storage.catalogue, "replace_spacecraft", lambda _: None)
    await soo.client.post(SC, json=spacecraft)
    assert (await soo.client.patch(f"{SC}/yamal-202", json={"name": "N"})).status_code == 200
    assert reported(soo)[-1][1] == "change_spacecraft"

    def fail(_):
        raise StorageError("storage.unavailable", "on purpose")

    monkeypatch.setattr(soo.storage.audit, "append", fail)
    answer = await soo.client.patch(f"{SC}/yamal-202", json={"name": "M"})
    assert (answer.status_code, answer.json()["code"]) == (503, "storage.unavailable")


async def test_a_change_that_fails_after_its_first_write_says_both(soo, spacecraft, monkeypatch):
    await soo.client.post(SC, json=spacecraft)
    real = soo.storage.catalogue.replace_spacecraft

    def half(record):
        real(record)
        raise StorageError("storage.unavailable", "on purpose")

    monkeypatch.setattr(soo.storage.catalogue, "replace_spacecraft", half)
    assert (await soo.client.patch(f"{SC}/yamal-202", json={"name": "N"})).status_code == 503
    assert [entry[1:] for entry in reported(soo)[-2:]] == [
        ("change_spacecraft", "/spacecraft/yamal-202", "done"),
        ("change_spacecraft", "/spacecraft/yamal-202", "503"),
    ]


async def test_refusals_are_written_down_with_who_is_known(soo, spacecraft):
    _, viewer = await key_of(soo, "viewer", "vera")
    await soo.client.post(SC, json=spacecraft, headers=viewer)
    await soo.client.get(SC, headers={"Authorization": "Bearer nobody"})
    assert reported(soo)[1:] == [
        ("vera", "create_spacecraft", "/spacecraft", "403"),
        ("anonymous", "list_spacecraft", "/spacecraft", "401"),
    ]


async def test_a_flood_of_refusals_is_counted(soo, monkeypatch):
    now_s = [0.0]
    soo.app.state.refusals = counted = refusals.Refusals(lambda: now_s[0])
    for k in range(100):
        await soo.client.get(f"{SC}/s{k}", headers={"Authorization": "Bearer nobody"})
    assert len(chain(soo)) == 1
    assert counted.settled() == []
    now_s[0] = refusals.WINDOW_S
    (audit_event,) = counted.settled()
    assert (audit_event.times, audit_event.target, audit_event.outcome) == (99, "/spacecraft/s99", "401")
    await soo.client.get(SC, headers={"Authorization": "Bearer nobody"})
    assert len(chain(soo)) == 2


async def test_a_flood_from_everywhere_is_bounded(soo):
    for k in range(60):
        transport = httpx.ASGITransport(app=soo.app, client=(f"192.0.2.{k}", 1))
        async with httpx.AsyncClient(transport=transport, base_url="http://soo.test") as client:
            for _ in range(3):
                await client.get(SC)
    assert len(chain(soo)) == refusals.MAX_GROUPS + 1
    rest = soo.app.state.refusals.settled(is_last=True)
    assert sum(audit_event.times for audit_event in rest) == 60 * 3 - len(chain(soo))
    assert len(rest) == refusals.MAX_GROUPS + 1


async def test_who_keeps_the_log_while_the_archive_is_gone(soo, monkeypatch, caplog):
    def fail(_):
        raise StorageError("storage.unavailable", "on purpose")

    monkeypatch.setattr(soo.storage.audit, "append", fail)
    answer = await soo.client.get(SC, headers={"Authorization": "Bearer nobody"})
    assert answer.status_code == 401
    assert "could not be written to the audit log" in caplog.text


async def test_the_log_is_paged_filtered_and_names_its_head(soo, spacecraft):
    _, approver = await key_of(soo, "approver", "anton")
    for k in range(5):
        soo.clock.system += 1_000_000
        await soo.client.post(SC, json=spacecraft | {"id": f"s{k}"})
    page = (await soo.client.get(AUDIT, params={"limit": 4}, headers=approver)).json()
    assert [row["number"] for row in page["rows"]] == [1, 2, 3, 4]
    assert page["head"] == {"number": 6, "hash": chain(soo)[-1].hash}
    rest = (await soo.client.get(AUDIT, params={"limit": 4, "cursor": page["next"]}, headers=approver)).json()
    assert ([row["number"] for row in rest["rows"]], rest["next"]) == ([5, 6], None)
    for params, numbers in (
        ({"action": "create_key"}, [1]),
        ({"who": "bootstrap", "target": "/spacecraft"}, [2, 3, 4, 5, 6]),
        ({"start": format_epoch(soo.clock.system)}, [6]),
        ({"outcome": "401"}, []),
    ):
        rows = (await soo.client.get(AUDIT, params=params)).json()["rows"]
        assert [row["number"] for row in rows] == numbers, params


@pytest.mark.parametrize(("role", "status"), [("viewer", 403), ("station", 403), ("operator", 403), ("approver", 200)])
async def test_the_log_is_for_approvers_and_administrators(soo, role, status):
    _, key = await key_of(soo, role, role)
    assert (await soo.client.get(AUDIT, headers=key)).status_code == status
