"""Access keys over the interface: made, used, expired, revoked; kept as digests and never told twice."""

import asyncio
import logging
from http import HTTPStatus

import pytest

from db.storage import SqlStorage
from service.api.access import key_cache as stored_keys
from service.errors import StorageError
from service.records.epoch import format_epoch
from service.records.operations.access_key import AccessKey, Role, StoredKey, digest_of, new_key

pytestmark = pytest.mark.anyio
KEYS = "/api/v1/keys"
SC = "/api/v1/spacecraft"
S = 1_000_000


async def make(soo, role="viewer", name="anna", **fields):
    answer = await soo.client.post(KEYS, json={"name": name, "role": role, **fields})
    assert answer.status_code == 201, answer.text
    assert answer.headers["cache-control"] == "no-store"
    return answer.json()


def bearer(key):
    return {"Authorization": f"Bearer {key}"}


async def status(soo, key, path=SC):
    return (await soo.client.get(path, headers=bearer(key))).status_code


async def test_a_key_opens_what_its_role_may(soo, spacecraft):
    made = await make(soo, "operator")
    assert made["key"].startswith(f"soo_{made['id']}_")
    # 256 random bits in base64
    assert len(made["key"].split("_", 2)[2]) == 43
    assert await status(soo, made["key"]) == 200
    created = await soo.client.post(SC, json=spacecraft, headers=bearer(made["key"]))
    assert created.status_code == 201
    refused = await soo.client.post(KEYS, json={"name": "x", "role": "admin"}, headers=bearer(made["key"]))
    assert (refused.status_code, refused.json()["code"]) == (403, "key.forbidden")


async def test_the_key_stands_in_one_answer_and_its_digest_in_the_archive(soo, tmp_path, caplog):
    with caplog.at_level(logging.DEBUG):
        made = await make(soo)
        await status(soo, made["key"])
        await status(soo, made["key"] + "x")
        listed = await soo.client.get(KEYS)
    secret = made["key"].split("_", 2)[2]
    assert secret not in listed.text
    soo.storage.close()
    for file in tmp_path.iterdir():
        assert secret.encode() not in file.read_bytes(), file
    assert secret not in caplog.text


async def test_keys_are_listed_with_their_life(soo):
    later = format_epoch(soo.clock.system + 100 * S)
    first = await make(soo, name="first", expires_at=later)
    second = await make(soo, "admin", name="second")
    assert await status(soo, first["key"]) == 200
    rows = (await soo.client.get(KEYS)).json()["rows"]
    # made at one instant, so their order is that of their ids
    assert {(row["name"], row["role"], row["state"]) for row in rows} == {
        ("first", "viewer", "valid"),
        ("second", "admin", "valid"),
    }
    reported = {row["name"]: row for row in rows}
    now = format_epoch(soo.clock.system)
    assert (reported["first"]["expires_at"], reported["first"]["last_used_at"]) == (later, now)
    assert (reported["second"]["expires_at"], reported["second"]["last_used_at"]) == (None, None)
    assert {row["created_by"] for row in rows} == {"bootstrap"}
    assert (await soo.client.delete(f"{KEYS}/{second['id']}")).status_code == 204
    assert [row["name"] for row in (await soo.client.get(KEYS)).json()["rows"]] == ["first"]
    rows = (await soo.client.get(KEYS, params={"revoked": True})).json()["rows"]
    assert {row["name"]: row["state"] for row in rows} == {"first": "valid", "second": "revoked"}
    soo.clock.system += 100 * S
    assert (await soo.client.get(KEYS)).json()["rows"][0]["state"] == "expired"


async def test_a_revoked_key_is_worthless_at_once(soo):
    made = await make(soo)
    assert await status(soo, made["key"]) == 200
    assert (await soo.client.delete(f"{KEYS}/{made['id']}")).status_code == 204
    assert await status(soo, made["key"]) == 401
    again = await soo.client.delete(f"{KEYS}/{made['id']}")
    assert (again.status_code, again.json()["code"]) == (404, "key.unknown")


async def test_a_key_revoked_by_another_process_is_worthless_within_seconds(soo, monkeypatch):
    made = await make(soo)
    monkeypatch.setattr(stored_keys, "REFRESH_S", 600.0)
    assert await status(soo, made["key"]) == 200
    soo.storage.keys.revoke(made["id"], soo.clock.system)
    assert await status(soo, made["key"]) == 200
    monkeypatch.setattr(stored_keys, "REFRESH_S", 0.0)
    assert await status(soo, made["key"]) == 401


async def test_a_key_made_by_another_process_is_known_soon(soo, tmp_path, monkeypatch):
    assert await status(soo, "soo_unknown_x") == 401
    other = SqlStorage(f"sqlite:///{tmp_path / 'soo.db'}")
    key_id, text = new_key()
    key = AccessKey(id=key_id, name="elsewhere", role=Role.VIEWER, created_at_us=1, created_by="other")
    other.keys.add(StoredKey(key, digest_of(text.encode())))
    other.close()
    monkeypatch.setattr(stored_keys, "RECHECK_S", 0.0)
    assert await status(soo, text) == 200


async def test_an_expired_key_is_worthless(soo):
    made = await make(soo, expires_at=format_epoch(soo.clock.system + S))
    assert await status(soo, made["key"]) == 200
    soo.clock.system += S
    assert await status(soo, made["key"]) == 401


async def test_requests_cost_no_query(soo, monkeypatch):
    made = await make(soo)
    asked = []
    real = soo.storage.keys.all
    monkeypatch.setattr(soo.storage.keys, "all", lambda: asked.append(1) or real())
    # keys are read again when these times have passed, however many requests came meanwhile
    monkeypatch.setattr(stored_keys, "REFRESH_S", 600.0)
    monkeypatch.setattr(stored_keys, "RECHECK_S", 600.0)
    for _ in range(50):
        await status(soo, made["key"], "/api/v1/jobs/x")
        await status(soo, "soo_invented_secret", "/api/v1/jobs/x")
    assert len(asked) <= 1


async def test_times_of_use_are_stored_beside_requests_not_by_them(soo, monkeypatch):
    made = await make(soo)
    written = []
    real = soo.storage.keys.note_used
    monkeypatch.setattr(soo.storage.keys, "note_used", lambda used: written.append(used) or real(used))
    for _ in range(20):
        await status(soo, made["key"])
    assert written == []
    keys = soo.app.state.stored_keys
    await asyncio.to_thread(keys.write_down_used)
    await asyncio.to_thread(keys.write_down_used)
    assert written == [{made["id"]: soo.clock.system}]
    assert soo.storage.keys.all()[0].key.last_used_us == soo.clock.system


async def test_while_the_archive_is_gone_known_keys_hold_for_a_while(soo, monkeypatch):
    made = await make(soo)
    assert await status(soo, made["key"]) == 200

    def fail():
        raise StorageError("storage.unavailable", "the disk is gone")

    monkeypatch.setattr(soo.storage.keys, "all", fail)
    monkeypatch.setattr(stored_keys, "REFRESH_S", 0.0)
    monkeypatch.setattr(stored_keys, "HOLDS_S", 600.0)
    assert await status(soo, made["key"]) == 200
    monkeypatch.setattr(stored_keys, "HOLDS_S", -1.0)
    assert await status(soo, made["key"]) == HTTPStatus.SERVICE_UNAVAILABLE
    # the bootstrap key needs no archive
    assert (await soo.client.get("/api/v1/spacecraft")).status_code == 200


@pytest.mark.parametrize(
    ("body", "code"),
    [
        ({"name": "x"}, "field.missing"),
        ({"name": "", "role": "viewer"}, "value.length"),
        ({"name": "x", "role": "king"}, "value.choice"),
        ({"name": "a\nb", "role": "viewer"}, "value.pattern"),
        ({"name": "x", "role": "viewer", "expires_at": "2026-11-21T02:59:59Z"}, "key.expires_past"),
        ({"name": "x", "role": "viewer", "expires_at": "soon"}, "epoch.malformed"),
        ({"name": "x", "role": "viewer", "key": "mine"}, "field.unknown"),
    ],
)
async def test_what_is_no_key_is_refused(soo, body, code):
    answer = await soo.client.post(KEYS, json=body)
    assert (answer.status_code, answer.json()["code"]) == (422, code)
    assert soo.storage.keys.all() == ()


async def test_a_key_that_stands_in_a_path_by_mistake_is_told_nowhere(soo, caplog):
    made = await make(soo)
    with caplog.at_level(logging.DEBUG, "service"):
        for headers in (None, bearer("wrong")):
            answer = await soo.client.delete(f"{KEYS}/{made['key']}", headers=headers)
            assert answer.status_code in {404, 401}
            assert made["key"] not in answer.text
        await soo.client.get(f"/api/v1/{made['key']}", headers=bearer("wrong"))
    assert made["key"].split("_", 2)[2] not in caplog.text
    assert all(made["key"] not in entry.audit_event.target for entry in soo.storage.audit.chain())


@pytest.mark.parametrize("name", ["Bootstrap", "anonymous ", "ol\u200bga", "\u202eolga", "   "])
async def test_names_that_mislead_are_refused(soo, name):
    answer = await soo.client.post(KEYS, json={"name": name, "role": "viewer"})
    assert (answer.status_code, answer.json()["code"]) == (422, "key.name")
    assert [each["pointer"] for each in answer.json()["errors"]] == ["/name"]


async def test_a_name_is_kept_in_one_form_and_belongs_to_one_key(soo):
    assert (await make(soo, name=" Olga\u00a0 B. "))["name"] == "Olga B."
    answer = await soo.client.post(KEYS, json={"name": "OLGA b.", "role": "admin"})
    assert (answer.status_code, answer.json()["code"]) == (409, "key.exists")


async def test_a_key_in_a_path_is_left_out_of_the_answer(soo):
    made = await make(soo)
    for path in (f"{SC}/{made['key']}", f"/api/v1/jobs/{made['key']}"):
        answer = await soo.client.get(path)
        assert answer.status_code == 404
        assert made["key"].split("_", 2)[2] not in answer.text
