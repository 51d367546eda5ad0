"""Keys, audit log and sessions of browsers: made, used, expired, revoked, and committed with their entries."""

import asyncio
import logging
from hashlib import sha256
from typing import Any

import httpx
import pytest

from db.operations.access import SESSIONS_PER_KEY
from db.storage import SqlStorage
from service.api.access import housekeeping as refusals
from service.api.access import housekeeping as stored_keys
from service.api.access.housekeeping import LIFE_OF_SESSION_S as LIFE_S
from service.api.access.housekeeping import StoredKeys
from service.api.limits.rate_limits import RateLimitConfig, RateLimits
from service.errors import StorageError
from service.records.epoch import US_PER_S, format_epoch
from service.records.operations.access import AccessKey, Role, StoredKey, digest_of, findings, new_key

pytestmark = pytest.mark.anyio


KEY = "test-key-of-the-administrator"
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


AUDIT = "/api/v1/audit"


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

    monkeypatch.setattr("db.database.append_entry", fail)
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


SESSION = "/api/v1/session"


@pytest.fixture
async def browser(soo):
    """A browser on this machine that has no key yet."""
    transport = httpx.ASGITransport(app=soo.app, client=("127.0.0.1", 50_000))
    async with httpx.AsyncClient(transport=transport, base_url="https://soo.test") as client:
        yield client


async def session_new_key(soo, role, expires_us=None) -> dict[str, Any]:
    """Return a fresh key."""
    expires = {} if expires_us is None else {"expires_at": format_epoch(expires_us)}
    made = await soo.client.post("/api/v1/keys", json={"name": f"some {role}", "role": role, **expires})
    assert made.status_code == 201, made.text
    return dict(made.json())


async def test_a_key_becomes_a_cookie_that_no_script_reads(soo, browser):
    made = await session_new_key(soo, "operator")
    opened = await browser.post(SESSION, json={"key": made["key"]})
    assert opened.status_code == 200
    ends_us = soo.clock.system_us() + LIFE_S * US_PER_S
    assert opened.json() == {
        "name": "some operator",
        "role": "operator",
        "permissions": ["operate", "read", "send"],
        "key_expires_at": None,
        "session_ends_at": format_epoch(ends_us),
    }
    cookie = opened.headers["set-cookie"]
    for word in ("HttpOnly", "SameSite=strict", "Secure", "Path=/", f"Max-Age={LIFE_S}"):
        assert word in cookie
    assert made["key"] not in opened.text
    assert opened.headers["cache-control"] == "no-store"
    asked = await browser.get(SESSION)
    assert asked.json() == opened.json()
    assert (await browser.get("/api/v1/spacecraft")).status_code == 200


async def test_a_session_ends_with_its_key(soo, browser):
    expires_us = soo.clock.system_us() + 3600 * US_PER_S
    made = await session_new_key(soo, "viewer", expires_us)
    opened = await browser.post(SESSION, json={"key": made["key"]})
    assert opened.json()["session_ends_at"] == opened.json()["key_expires_at"] == format_epoch(expires_us)
    soo.clock.system = expires_us
    assert (await browser.get(SESSION)).status_code == 401


async def test_a_session_ends_after_its_life_though_the_browser_kept_the_cookie(soo, browser):
    made = await session_new_key(soo, "viewer")
    await browser.post(SESSION, json={"key": made["key"]})
    browser.cookies.jar.clear_expired_cookies()
    soo.clock.system = soo.clock.system_us() + LIFE_S * US_PER_S
    assert (await browser.get(SESSION)).json()["code"] == "key.invalid"


async def test_a_revoked_key_ends_its_session(soo, browser):
    made = await session_new_key(soo, "viewer")
    await browser.post(SESSION, json={"key": made["key"]})
    assert (await soo.client.delete(f"/api/v1/keys/{made['id']}")).status_code < 300
    assert (await browser.get("/api/v1/spacecraft")).status_code == 401


async def test_closing_takes_the_cookie_away_and_leaves_the_key(soo, browser):
    made = await session_new_key(soo, "viewer")
    await browser.post(SESSION, json={"key": made["key"]})
    closed = await browser.delete(SESSION, headers={"Origin": "https://soo.test"})
    assert closed.status_code == 204
    assert not browser.cookies
    assert (await browser.get(SESSION)).status_code == 401
    answer = await browser.get(SESSION, headers={"Authorization": f"Bearer {made['key']}"})
    assert answer.json()["session_ends_at"] is None


@pytest.mark.parametrize(
    "headers",
    [{}, {"Origin": "https://elsewhere.test"}, {"Origin": "http://soo.test"}, {"Origin": "null"}],
    ids=["none", "other site", "without TLS", "null"],
)
async def test_a_change_by_cookie_needs_the_services_own_page(soo, browser, headers):
    made = await session_new_key(soo, "operator")
    await browser.post(SESSION, json={"key": made["key"]})
    note = {"text": "by a page of another site"}
    refused = await browser.post("/api/v1/notes", json=note, headers=headers)
    assert (refused.status_code, refused.json()["code"]) == (403, "session.origin")
    own = await browser.post("/api/v1/notes", json=note, headers={"Origin": "https://soo.test"})
    assert own.json().get("code") != "session.origin"
    bearer = await browser.post("/api/v1/notes", json=note, headers={"Authorization": f"Bearer {made['key']}"})
    assert bearer.json().get("code") != "session.origin"


async def test_a_second_persons_key_goes_before_the_cookie(soo, browser):
    first, second = await session_new_key(soo, "viewer"), await session_new_key(soo, "approver")
    await browser.post(SESSION, json={"key": first["key"]})
    with_both = await browser.get(SESSION, headers={"Authorization": f"Bearer {second['key']}"})
    assert with_both.json()["role"] == "approver"
    wrong = await browser.get(SESSION, headers={"Authorization": "Bearer soo_wrong_key"})
    assert wrong.status_code == 401
    assert (await browser.get(SESSION)).json()["role"] == "viewer"


@pytest.mark.parametrize(
    "value", ["", "x", "bootstrap", "bootstrap.", ".key", "bootstrap.x", f"99999999999999999.{KEY}"]
)
async def test_a_cookie_that_is_none_is_no_key(soo, browser, value):
    answer = await browser.get(SESSION, headers={"Cookie": f"{cookie_name(soo)}={value}"})
    assert answer.status_code == 401


def cookie_name(soo, prefix="__Host-"):
    return f"{prefix}soo-{soo.storage.keys.service_id()}"


async def signed_in(soo, browser, key):
    """Sign in; return the token that the browser now has."""
    opened = await browser.post(SESSION, json={"key": key})
    assert opened.status_code == 200, opened.text
    return browser.cookies[cookie_name(soo)]


async def test_the_cookie_is_a_random_token_of_which_the_archive_has_a_digest(soo, browser, tmp_path):
    made = await session_new_key(soo, "viewer")
    token = await signed_in(soo, browser, made["key"])
    assert made["key"].split("_", 2)[2] not in token
    assert await signed_in(soo, browser, made["key"]) != token
    soo.storage.close()
    for file in tmp_path.iterdir():
        assert token.partition(".")[2].encode() not in file.read_bytes(), file


async def test_a_session_that_was_ended_is_not_opened_by_its_old_cookie(soo, browser):
    token = await signed_in(soo, browser, KEY)
    assert (await browser.delete(SESSION, headers={"Origin": "https://soo.test"})).status_code == 204
    kept = {"Cookie": f"{cookie_name(soo)}={token}"}
    assert (await browser.get(SESSION, headers=kept)).json()["code"] == "key.invalid"


async def test_a_session_holds_for_its_key_and_its_service_only(soo, browser):
    first, second = await session_new_key(soo, "viewer"), await session_new_key(soo, "admin")
    token = await signed_in(soo, browser, first["key"])
    other = f"{second['id']}.{token.partition('.')[2]}"
    assert (await browser.get(SESSION, headers={"Cookie": f"{cookie_name(soo)}={other}"})).status_code == 401
    soo.app.state.key_ring = StoredKeys(soo.storage.keys, KEY, soo.clock.system_us, "another service")
    assert (await browser.get(SESSION, headers={"Cookie": f"{cookie_name(soo)}={token}"})).status_code == 401


async def test_a_session_of_the_bootstrap_key_ends_when_the_settings_give_another(soo, browser):
    await signed_in(soo, browser, KEY)
    service_id = soo.storage.keys.service_id()
    for key, status in ((KEY, 200), ("another bootstrap key", 401), (None, 401)):
        soo.app.state.key_ring = StoredKeys(soo.storage.keys, key, soo.clock.system_us, service_id)
        assert (await browser.get(SESSION)).status_code == status, key


async def test_a_session_of_another_process_opens_at_once(soo, browser, monkeypatch):
    token = await signed_in(soo, browser, KEY)
    monkeypatch.setattr(stored_keys, "REFRESH_S", 600.0)
    monkeypatch.setattr(stored_keys, "RECHECK_S", 600.0)
    other = StoredKeys(soo.storage.keys, KEY, soo.clock.system_us, soo.storage.keys.service_id())
    assert (await other.session_holder(token)).name == "bootstrap"
    there, _ = await asyncio.to_thread(other.open_session, await other.principal(KEY))
    answer = await browser.get(SESSION, headers={"Cookie": f"{cookie_name(soo)}={there}"})
    assert answer.status_code == 200


@pytest.mark.parametrize(("scheme", "prefix"), [("https", "__Host-"), ("http", "")])
async def test_services_of_one_host_have_cookies_of_their_own(soo, scheme, prefix):
    transport = httpx.ASGITransport(app=soo.app, client=("127.0.0.1", 50_000))
    async with httpx.AsyncClient(transport=transport, base_url=f"{scheme}://soo.test") as browser:
        await browser.post(SESSION, json={"key": KEY})
        name = cookie_name(soo, prefix)
        assert list(browser.cookies) == [name]
        # the other service on another port of this host
        soo.app.state.service_id = "fedcba9876543210"
        assert (await browser.get(SESSION)).status_code == 401
        await browser.post(SESSION, json={"key": KEY})
        assert list(browser.cookies) == [name, f"{prefix}soo-fedcba9876543210"]
        assert (await browser.get(SESSION)).status_code == 200


@pytest.mark.parametrize(
    ("headers", "status", "code"),
    [
        ({"Content-Type": ""}, 415, "media_type.unsupported"),
        ({"Content-Type": "text/plain"}, 415, "media_type.unsupported"),
        ({"Content-Type": "application/json", "Origin": "https://elsewhere.test"}, 403, "session.origin"),
        ({"Content-Type": "application/json", "Origin": "https://soo.test:8443"}, 403, "session.origin"),
        ({"Content-Type": "application/json", "Origin": "null"}, 403, "session.origin"),
        ({"Content-Type": "application/json", "Origin": "https://soo.test"}, 200, None),
    ],
    ids=["no type", "text", "other site", "other port", "null", "own page"],
)
async def test_signing_in_by_a_page_of_another_site_is_refused(soo, browser, headers, status, code):
    answer = await browser.post(SESSION, content=f'{{"key": "{KEY}"}}', headers=headers)
    assert (answer.status_code, answer.json().get("code")) == (status, code)
    assert ("set-cookie" in answer.headers) == (status == 200)


async def test_a_page_that_asks_who_is_signed_in_is_no_audit_entry(soo, browser):
    assert (await browser.get(SESSION)).status_code == 401
    assert chain(soo) == []
    assert (await browser.get(SESSION, headers=bearer("wrong"))).status_code == 401
    assert [entry.audit_event.action for entry in chain(soo)] == ["get_session"]


async def test_a_key_has_so_many_sessions_at_once(soo, browser):
    tokens = []
    for _ in range(SESSIONS_PER_KEY + 1):
        soo.clock.system += S
        token, _ = await asyncio.to_thread(
            soo.app.state.stored_keys.open_session, await soo.app.state.key_ring.principal(KEY)
        )
        tokens.append(token)
    statuses = []
    for token in (*tokens[:2], tokens[-1]):
        answer = await browser.get(SESSION, headers={"Cookie": f"{cookie_name(soo)}={token}"})
        statuses.append(answer.status_code)
    assert statuses == [401, 200, 200]
    soo.clock.system += LIFE_S * S
    await signed_in(soo, browser, KEY)
    assert len(soo.storage.keys.sessions()) == 1


async def test_wrong_keys_are_refused_and_counted(soo, browser):
    soo.app.state.rate_limits = RateLimits(RateLimitConfig(anonymous_per_s=0.001, anonymous_burst=2))
    statuses = [(await browser.post(SESSION, json={"key": f"wrong{n}"})).status_code for n in range(3)]
    assert statuses == [401, 401, 429]


@pytest.mark.parametrize(
    ("scheme", "client", "status"), [("http", "192.0.2.1", 403), ("http", "::1", 200), ("https", "192.0.2.1", 200)]
)
async def test_no_key_crosses_a_network_without_tls(soo, scheme, client, status):
    made = await session_new_key(soo, "viewer")
    transport = httpx.ASGITransport(app=soo.app, client=(client, 50_000))
    async with httpx.AsyncClient(transport=transport, base_url=f"{scheme}://soo.test") as browser:
        answer = await browser.post(SESSION, json={"key": made["key"]})
    assert answer.status_code == status
    if status == 403:
        assert answer.json()["code"] == "session.plain_http"
        assert "set-cookie" not in answer.headers
    else:
        assert ("Secure" in answer.headers["set-cookie"]) == (scheme == "https")
