"""Sessions of browsers: what the cookie carries, who may open one from where, and when it ends."""

from typing import Any

import httpx
import pytest

from service.api.access.session_cookie import COOKIE, LIFE_S
from service.api.limits.rate_limits import RateLimitConfig, RateLimits
from service.records.epoch import US_PER_S, format_epoch

pytestmark = pytest.mark.anyio
SESSION = "/api/v1/session"


@pytest.fixture
async def browser(soo):
    """A browser on this machine that has no key yet."""
    transport = httpx.ASGITransport(app=soo.app, client=("127.0.0.1", 50_000))
    async with httpx.AsyncClient(transport=transport, base_url="https://soo.test") as client:
        yield client


async def new_key(soo, role, expires_us=None) -> dict[str, Any]:
    """Return a fresh key."""
    expires = {} if expires_us is None else {"expires_at": format_epoch(expires_us)}
    made = await soo.client.post("/api/v1/keys", json={"name": f"some {role}", "role": role, **expires})
    assert made.status_code == 201, made.text
    return dict(made.json())


async def test_a_key_becomes_a_cookie_that_no_script_reads(soo, browser):
    made = await new_key(soo, "operator")
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
    made = await new_key(soo, "viewer", expires_us)
    opened = await browser.post(SESSION, json={"key": made["key"]})
    assert opened.json()["session_ends_at"] == opened.json()["key_expires_at"] == format_epoch(expires_us)
    soo.clock.system = expires_us
    assert (await browser.get(SESSION)).status_code == 401


async def test_a_session_ends_after_its_life_though_the_browser_kept_the_cookie(soo, browser):
    made = await new_key(soo, "viewer")
    await browser.post(SESSION, json={"key": made["key"]})
    browser.cookies.jar.clear_expired_cookies()
    soo.clock.system = soo.clock.system_us() + LIFE_S * US_PER_S
    assert (await browser.get(SESSION)).json()["code"] == "key.invalid"


async def test_a_revoked_key_ends_its_session(soo, browser):
    made = await new_key(soo, "viewer")
    await browser.post(SESSION, json={"key": made["key"]})
    assert (await soo.client.delete(f"/api/v1/keys/{made['id']}")).status_code < 300
    assert (await browser.get("/api/v1/spacecraft")).status_code == 401


async def test_closing_takes_the_cookie_away_and_leaves_the_key(soo, browser):
    made = await new_key(soo, "viewer")
    await browser.post(SESSION, json={"key": made["key"]})
    closed = await browser.delete(SESSION, headers={"Origin": "https://soo.test"})
    assert closed.status_code == 204
    assert COOKIE not in browser.cookies
    assert (await browser.get(SESSION)).status_code == 401
    answer = await browser.get(SESSION, headers={"Authorization": f"Bearer {made['key']}"})
    assert answer.json()["session_ends_at"] is None


@pytest.mark.parametrize(
    "headers",
    [{}, {"Origin": "https://elsewhere.test"}, {"Origin": "http://soo.test"}, {"Origin": "null"}],
    ids=["none", "other site", "without TLS", "null"],
)
async def test_a_change_by_cookie_needs_the_services_own_page(soo, browser, headers):
    made = await new_key(soo, "operator")
    await browser.post(SESSION, json={"key": made["key"]})
    note = {"text": "by a page of another site"}
    refused = await browser.post("/api/v1/notes", json=note, headers=headers)
    assert (refused.status_code, refused.json()["code"]) == (403, "session.origin")
    own = await browser.post("/api/v1/notes", json=note, headers={"Origin": "https://soo.test"})
    assert own.json().get("code") != "session.origin"
    bearer = await browser.post("/api/v1/notes", json=note, headers={"Authorization": f"Bearer {made['key']}"})
    assert bearer.json().get("code") != "session.origin"


async def test_a_second_persons_key_goes_before_the_cookie(soo, browser):
    first, second = await new_key(soo, "viewer"), await new_key(soo, "approver")
    await browser.post(SESSION, json={"key": first["key"]})
    with_both = await browser.get(SESSION, headers={"Authorization": f"Bearer {second['key']}"})
    assert with_both.json()["role"] == "approver"
    wrong = await browser.get(SESSION, headers={"Authorization": "Bearer soo_wrong_key"})
    assert wrong.status_code == 401
    assert (await browser.get(SESSION)).json()["role"] == "viewer"


@pytest.mark.parametrize("value", ["", "x", "1.", ".key", "99999999999999999.x", "-1.key", "1e9.key"])
async def test_a_cookie_that_is_none_is_no_key(soo, value):
    answer = await soo.client.get(SESSION, headers={"Authorization": "", "Cookie": f"{COOKIE}={value}"})
    assert answer.status_code == 401


async def test_wrong_keys_are_refused_and_counted(soo, browser):
    soo.app.state.rate_limits = RateLimits(RateLimitConfig(anonymous_per_s=0.001, anonymous_burst=2))
    statuses = [(await browser.post(SESSION, json={"key": f"wrong{n}"})).status_code for n in range(3)]
    assert statuses == [401, 401, 429]


@pytest.mark.parametrize(
    ("scheme", "client", "status"), [("http", "192.0.2.1", 403), ("http", "::1", 200), ("https", "192.0.2.1", 200)]
)
async def test_no_key_crosses_a_network_without_tls(soo, scheme, client, status):
    made = await new_key(soo, "viewer")
    transport = httpx.ASGITransport(app=soo.app, client=(client, 50_000))
    async with httpx.AsyncClient(transport=transport, base_url=f"{scheme}://soo.test") as browser:
        answer = await browser.post(SESSION, json={"key": made["key"]})
    assert answer.status_code == status
    if status == 403:
        assert answer.json()["code"] == "session.plain_http"
        assert "set-cookie" not in answer.headers
    else:
        assert ("Secure" in answer.headers["set-cookie"]) == (scheme == "https")
