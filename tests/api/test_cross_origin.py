"""Reading by pages of other origins: listed ones read every answer with a key, nobody changes anything."""

from collections.abc import Callable

import httpx
import pytest

from service.api.access.cross_origin import CrossOriginReading
from service.api.limits.rate_limits import RateLimitConfig, RateLimits

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
ORIGIN = "https://openmct.example"
GRANT = "access-control-allow-origin"


@pytest.fixture
def page(soo) -> Callable[..., httpx.AsyncClient]:
    """Give a maker of pages: clients that state their origin, with the administrator's key or another one."""
    soo.app.add_middleware(CrossOriginReading, origins=(ORIGIN, "http://localhost:8080"))

    def make(origin: str = ORIGIN, key: str | None = None) -> httpx.AsyncClient:
        soo.client.headers["Origin"] = origin
        if key is not None:
            soo.client.headers["Authorization"] = f"Bearer {key}"
        return soo.client

    return make


def grants(answer) -> list[str]:
    """Return the names of the headers that let a page read."""
    return [name for name in answer.headers if name.startswith("access-control-")]


async def ask(page, method, path=SC, headers="authorization"):
    """Return the answer to a browser's question before its request."""
    asked = {"Access-Control-Request-Method": method, "Access-Control-Request-Headers": headers}
    return await page.options(path, headers=asked)


async def test_without_a_list_nothing_is_granted(soo):
    soo.client.headers["Origin"] = ORIGIN
    for answer in (await soo.client.get(SC), await ask(soo.client, "GET")):
        assert grants(answer) == []


@pytest.mark.parametrize("method", ["GET", "HEAD"])
async def test_a_listed_origin_may_ask_and_read(page, method):
    asked = await ask(page(), method, headers="authorization, last-event-id")
    assert (asked.status_code, asked.headers[GRANT]) == (200, ORIGIN)
    assert asked.headers["access-control-allow-methods"] == "GET, HEAD"
    assert "authorization" in asked.headers["access-control-allow-headers"]
    read = await page().request(method, SC)
    assert read.headers[GRANT] == ORIGIN
    assert "RateLimit-Remaining" in read.headers["access-control-expose-headers"]
    assert "origin" in read.headers["vary"].lower()


async def test_refusals_are_readable_so_that_the_page_can_say_why(page, soo):
    wrong = await page(key="wrong").get(SC)
    assert (wrong.status_code, wrong.headers[GRANT]) == (401, ORIGIN)
    soo.app.state.rate_limits = RateLimits(RateLimitConfig(anonymous_burst=1), lambda: 0.0)
    floods = [await page().get(SC) for _ in range(2)]
    assert [(each.status_code, each.headers[GRANT]) for each in floods] == [(401, ORIGIN), (429, ORIGIN)]
    assert "retry-after" in floods[1].headers["access-control-expose-headers"].lower()


@pytest.mark.parametrize(
    "origin",
    [
        "https://other.example",
        "http://openmct.example",
        "https://openmct.example:8443",
        "https://openmct.example.evil.example",
        "https://sub.openmct.example",
        "HTTPS://OPENMCT.EXAMPLE",
        "null",
        "*",
        "",
    ],
)
async def test_another_origin_gets_no_header(page, origin):
    for answer in (await page(origin).get(SC), await ask(page(origin), "GET")):
        assert grants(answer) == []


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE"])
async def test_what_changes_something_is_never_granted(page, spacecraft, method):
    asked = await ask(page(), method)
    assert (asked.status_code, asked.json()["code"]) == (405, "method.not_allowed")
    assert grants(asked) == []
    assert grants(await page().request(method, SC, json=spacecraft)) == []


async def test_cookies_are_never_admitted(page, soo):
    opened = await soo.client.post("/api/v1/session", json={"key": soo.client.headers["Authorization"].split()[1]})
    for answer in (opened, await ask(page(), "GET"), await page().get(SC)):
        assert "access-control-allow-credentials" not in answer.headers
