"""Every role at every route, against docs/reference/roles.md: what is served and not on that page fails."""

import re
from pathlib import Path
from typing import Any

import pytest

from service.api.access.audit_context import BASE_PATH
from service.api.limits.rate_limits import class_of
from service.api.routes import PUBLIC_ROUTERS, ROUTERS
from service.records.operations.access_key import Role

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
