"""Every role at every route, against docs/reference/roles.md; rates of requests, and a flood shuts nobody out."""

import asyncio
import re
import threading
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api.access.auth import BASE_PATH
from service.api.context import MonitoringSettings
from service.api.limits.rate_limits import RateLimitConfig, RateLimits, class_of
from service.api.monitoring.metrics import SharedReadiness
from service.api.routes import PUBLIC_ROUTERS, ROUTERS
from service.records.operations.access import Role

pytestmark = pytest.mark.anyio


PAGE = (Path(__file__).parents[2] / "docs/reference/roles.md").read_text(encoding="utf-8")
#: status of a refusal; whatever else is answered, the key was let in
REFUSED = {401, 403}


def permissions() -> dict[str, set[str]]:
    """Return the roles of each permission, as the page has them."""
    header = re.search(r"^\| permission \|(.*)\|$", PAGE, re.MULTILINE)
    assert header is not None
    roles = [name.strip() for name in header[1].split("|")]
    rows = re.findall(r"^\| `(\w+)` \|((?: (?:yes|-) \|)+)$", PAGE, re.MULTILINE)
    return {
        name: {role for role, mark in zip(roles, marks.split("|"), strict=False) if mark.strip() == "yes"}
        for name, marks in rows
    }


def table() -> dict[tuple[str, str], tuple[str, str]]:
    """Return permission and class of rate of each route, as the page has them."""
    rows = re.findall(r"^\| ([A-Z]+) \| `(\S+)` \| (\w+|-) \| (\w+) \|$", PAGE, re.MULTILINE)
    found = {(method, path): (permission, rate) for method, path, permission, rate in rows}
    assert len(found) == len(rows), "a route stands twice"
    return found


def routes(app: Any) -> set[tuple[str, str]]:
    """Return method and path of everything that the application serves."""
    assert len(app.routes) == len(ROUTERS) + len(PUBLIC_ROUTERS) + 1, "something is served beside the routers"
    given = [(BASE_PATH, router) for router in ROUTERS] + [("", router) for router in PUBLIC_ROUTERS]
    found = {
        (method, f"{base}{route.path}") for base, router in given for route in router.routes for method in route.methods
    }
    return found | {("GET", app.openapi_url)}


async def test_every_route_is_on_the_page_and_no_other(soo):
    served, page = routes(soo.app), set(table())
    assert len(served) > 60, "the search for routes finds too few"
    assert served - page == set(), "served, but not in docs/reference/roles.md"
    assert page - served == set(), "in docs/reference/roles.md, but not served"


@pytest.mark.parametrize("role", ["", *Role])
async def test_each_role_may_what_the_page_says(soo, role):
    may, known = permissions(), table()
    headers = {"Authorization": ""}
    if role:
        made = await soo.client.post("/api/v1/keys", json={"name": role, "role": role})
        headers = {"Authorization": f"Bearer {made.json()['key']}"}
    wrong = []
    for (method, path), (permission, _) in known.items():
        asked = re.sub(r"\{\w+\}", "x", path)
        answer = await soo.client.request(method, asked, content=b"{", headers=headers)
        is_let_in = answer.status_code not in REFUSED
        is_right = permission == "-" or role in may[permission]
        if is_let_in != is_right:
            wrong.append((method, path, permission, answer.status_code))
        if not is_let_in:
            assert answer.status_code == (403 if role else 401)
    assert wrong == []


def test_rates_are_those_of_the_page():
    for (method, path), (permission, rate) in table().items():
        without_key = "none" if path == "/healthz" else "anonymous"
        assert rate == (without_key if permission == "-" else class_of(method, path)), path
        assert permission == "-" or method != "GET" or class_of("HEAD", path) == rate


SC = "/api/v1/spacecraft"
WRONG = {"Authorization": "Bearer wrong"}


@pytest.fixture
def limited(soo):
    """The service with small bursts that do not refill during a test."""
    config = RateLimitConfig(read_per_s=0.01, read_burst=3, control_per_s=0.01, control_burst=1, anonymous_burst=4)
    soo.app.state.rate_limits = RateLimits(config, lambda: 0.0)
    return soo


async def test_answers_say_what_is_left_and_the_last_one_when_to_come_back(limited):
    answers = [await limited.client.get(SC) for _ in range(4)]
    assert [answer.status_code for answer in answers] == [200, 200, 200, 429]
    assert [answer.headers["ratelimit-remaining"] for answer in answers] == ["2", "1", "0", "0"]
    assert {answer.headers["ratelimit-limit"] for answer in answers} == {"3"}
    assert (answers[0].headers["ratelimit-reset"], answers[3].headers["ratelimit-reset"]) == ("100", "100")
    problem = answers[3].json()
    assert (problem["code"], answers[3].headers["retry-after"]) == ("rate.limited", "100")
    assert answers[3].headers["content-type"] == "application/problem+json"


async def test_classes_have_rates_of_their_own(limited, spacecraft):
    for _ in range(4):
        last = await limited.client.get(SC)
    assert last.status_code == 429
    assert (await limited.client.post(SC, json=spacecraft)).status_code == 201
    assert (await limited.client.post(SC, json=spacecraft | {"id": "other"})).status_code == 429
    assert len(limited.storage.catalogue.all_spacecraft()) == 1


async def test_a_flood_without_a_key_is_stopped_and_shuts_nobody_out(limited):
    statuses = [(await limited.client.get(SC, headers=WRONG)).status_code for _ in range(6)]
    assert statuses == [401] * 4 + [429] * 2
    assert (await limited.client.get(SC)).status_code == 200
    transport = httpx.ASGITransport(app=limited.app, client=("192.0.2.1", 1))
    async with httpx.AsyncClient(transport=transport, base_url="http://soo.test") as elsewhere:
        assert (await elsewhere.get(SC)).status_code == 401


async def test_public_paths_are_counted_by_address_but_not_the_sign_of_life(limited):
    anonymous = {"Authorization": ""}
    statuses = [(await limited.client.get("/openapi.json", headers=anonymous)).status_code for _ in range(5)]
    assert statuses == [200] * 4 + [429]
    for path in ("/healthz", "/readyz"):
        assert (await limited.client.get(path, headers=anonymous)).status_code == 200


async def test_files_of_the_console_have_a_rate_of_their_own(limited):
    # nothing is served there without the console, but it is counted all the same
    limited.app.state.rate_limits = RateLimits(RateLimitConfig(static_burst=3, anonymous_burst=1), lambda: 0.0)
    anonymous = {"Authorization": ""}
    paths = ("/", "/console/app.js", "/console/", "/console/store.js")
    statuses = [(await limited.client.get(path, headers=anonymous)).status_code for path in paths]
    assert statuses == [404, 404, 404, 429]
    statuses = [(await limited.client.get("/openapi.json", headers=anonymous)).status_code for _ in range(2)]
    assert statuses == [200, 429]


@pytest.mark.parametrize("is_key_needed", [False, True])
async def test_wrong_keys_of_others_keep_health_checks_and_holders_of_a_key_in(limited, is_key_needed):
    context = limited.app.state.context
    object.__setattr__(context, "monitoring", MonitoringSettings(metrics_need_key=is_key_needed))
    statuses = [(await limited.client.get("/metrics", headers=WRONG)).status_code for _ in range(6)]
    assert statuses == [401 if is_key_needed else 200] * 4 + [429] * 2
    assert (await limited.client.get(SC, headers=WRONG)).status_code == 429
    for _ in range(8):
        assert (await limited.client.get("/readyz", headers=WRONG)).status_code == 200
    assert (await limited.client.get("/metrics")).status_code == 200


async def test_health_checks_that_come_together_share_one_look(limited, monkeypatch):
    looks, asked, state, parts = [], [], limited.storage.state, SharedReadiness.parts
    have_come = threading.Event()

    def slow_state():
        looks.append(1)
        have_come.wait(120)
        return state()

    async def counted_parts(shared):
        asked.append(1)
        if len(asked) == 50:
            have_come.set()
        return await parts(shared)

    monkeypatch.setattr(limited.storage, "state", slow_state)
    monkeypatch.setattr(SharedReadiness, "parts", counted_parts)
    answers = await asyncio.gather(*[limited.client.get("/readyz") for _ in range(50)])
    assert {answer.status_code for answer in answers} == {200}
    # the last one may come when the look is just over
    assert len(looks) <= 2


async def test_thousands_of_query_parameters_are_refused(soo):
    answer = await soo.client.get(f"{SC}?" + "&".join(f"a{k}=1" for k in range(2000)))
    assert (answer.status_code, answer.json()["code"]) == (400, "query.too_many")
    answer = await soo.client.get(f"{SC}?" + "&".join(f"a{k}=1" for k in range(100)))
    assert (answer.status_code, answer.json()["code"]) == (422, "request.invalid")
    assert {each["code"] for each in answer.json()["errors"]} == {"query.unknown"}


async def test_every_route_refuses_a_parameter_that_it_does_not_take(soo):
    """Before, `?START=` and `?sourcee=` were passed over, and the whole archive was the answer."""
    wrong = []
    for method, path in sorted(routes(soo.app) - {("GET", soo.app.openapi_url)}):
        asked = re.sub(r"\{\w+\}", "x", path)
        answer = await soo.client.request(method, f"{asked}?sourcee=1", content=b"{")
        faults = [(each["pointer"], each["code"]) for each in answer.json().get("errors", ())]
        if (answer.status_code, faults) != (422, [("/query/sourcee", "query.unknown")]):
            wrong.append((method, path, answer.status_code))
    assert wrong == []


@pytest.mark.parametrize(
    ("path", "query", "detail"),
    [
        ("measurements/history", "START=2026-11-22T00:00:00Z", "the nearest that it takes is start"),
        ("measurements/history", "sourcee=x", "the nearest that it takes is source"),
        ("attitude-references", "source=star_tracker", "it takes cursor, limit, order, start, stop"),
        ("operations/1", "zzz=1", "it takes none"),
    ],
)
async def test_an_unknown_parameter_is_answered_with_the_nearest_name(soo, path, query, detail):
    answer = await soo.client.get(f"{SC}/x/{path}?{query}")
    assert (answer.status_code, answer.json()["code"]) == (422, "query.unknown")
    assert answer.json()["detail"].endswith(detail)
