"""Rules of every path: keys, problems, sizes, packing, request ids, origins, the OpenAPI document, about."""

import gzip
import json
import logging
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.api.access.auth import CrossOriginReading
from service.api.app import render_openapi
from service.api.limits.rate_limits import RateLimitConfig, RateLimits
from service.composition.bootstrap import build_app, build_storage
from service.composition.settings import Settings
from service.errors import StorageError
from service.records.epoch import format_epoch

pytestmark = pytest.mark.anyio


SC = "/api/v1/spacecraft"
OPENAPI = Path(__file__).parents[2] / "docs" / "reference" / "openapi.json"
LIMIT = 200_000


def assert_problem(answer: httpx.Response, status: int, code: str) -> dict[str, Any]:
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (status, code), problem
    assert answer.headers["content-type"] == "application/problem+json"
    assert problem["status"] == status
    assert problem["type"] == f"urn:soo:problem:{code}"
    assert problem["request_id"] == answer.headers["x-request-id"]
    return problem


async def test_health_needs_no_key(soo):
    for path, status in (("/healthz", "ok"), ("/readyz", "ready")):
        answer = await soo.client.get(path, headers={"Authorization": ""})
        assert (answer.status_code, answer.json()["status"]) == (200, status)


async def test_readiness_fails_with_the_archive(soo, monkeypatch):
    def fail() -> None:
        raise StorageError("storage.unavailable", "the disk is full; free some space")

    monkeypatch.setattr(soo.storage, "state", fail)
    answer = await soo.client.get("/readyz")
    assert_problem(answer, 503, "storage.unavailable")
    assert answer.headers["retry-after"] == "5"
    assert (await soo.client.get("/healthz")).status_code == 200


@pytest.mark.parametrize(
    "header", ["", "Bearer", "Bearer ", "Bearer wrong", "Basic dGVzdA==", "Bearer t\u00e9st", "bearer"]
)
async def test_without_a_valid_key_nothing_is_answered(soo, header, caplog):
    with caplog.at_level(logging.DEBUG):
        answer = await soo.client.get(SC, headers={"Authorization": header.encode("utf-8")})
    assert_problem(answer, 401, "key.invalid")
    assert answer.headers["www-authenticate"] == "Bearer"
    assert "wrong" not in caplog.text, "a key was logged"


async def test_the_key_is_checked_before_the_body_is_read(soo):
    answer = await soo.client.post(SC, content=b"{", headers={"Authorization": "Bearer no"})
    assert_problem(answer, 401, "key.invalid")


@pytest.mark.parametrize(
    ("method", "path", "body"),
    [
        ("POST", SC, b'{"id": "a", "name": "b", "id": "c"}'),
        ("POST", SC, b'{"\\u0069d": "c"}'),
        ("POST", f"{SC}/a/measurements:batch", b'{"plan_id": 1, "measurements": [], "plan_id": 2}'),
        ("PATCH", f"{SC}/a", b'{"wheels": {"axes": null, "axes": []}}'),
    ],
)
async def test_a_key_that_stands_twice_is_refused(soo, spacecraft, method, path, body):
    """One parser believes the first, another the last: what was signed or looked at is not what is stored."""
    if path == SC:
        body = json.dumps(spacecraft)[:-1].encode() + b", " + body[1:]
    problem = assert_problem(await soo.client.request(method, path, content=body), 400, "json.duplicate_key")
    assert "twice" in problem["detail"]


@pytest.mark.parametrize(
    ("method", "path", "status", "code"),
    [
        ("GET", "/", 404, "path.unknown"),
        ("GET", "/api/v1/nothing", 404, "path.unknown"),
        ("GET", "/api/v1/spacecraft/", 404, "path.unknown"),
        ("GET", "/redoc", 404, "path.unknown"),
        ("DELETE", SC, 405, "method.not_allowed"),
        ("PUT", f"{SC}/yamal-202/measurements:batch", 405, "method.not_allowed"),
    ],
)
async def test_unknown_paths_and_methods_are_problems(soo, method, path, status, code):
    answer = await soo.client.request(method, path)
    assert_problem(answer, status, code)
    assert ("allow" in answer.headers) == (status == 405)


@pytest.mark.parametrize(
    ("body", "headers"),
    [
        (b" " * (LIMIT + 1), {}),
        (b" ", {"Content-Length": str(10**30)}),
        (gzip.compress(b"\0" * 100_000_000), {"Content-Encoding": "gzip"}),
    ],
    ids=["plain", "said to be large", "bomb"],
)
async def test_bodies_above_the_limit_are_refused_and_the_limit_is_told(soo, body, headers):
    answer = await soo.client.post(SC, content=body, headers=headers)
    problem = assert_problem(answer, 413, "body.too_large")
    assert str(LIMIT) in problem["detail"]
    assert soo.storage.catalogue.all_spacecraft() == ()


@pytest.mark.parametrize(
    "body",
    [
        b"{}",
        b"",
        gzip.compress(b"{}", mtime=0)[:-1],
        gzip.compress(b"{}", mtime=0) + b"rest",
        b"\x1f\x8b",
        b"\x1f\x8b" + b"\xff" * 60,
    ],
)
async def test_what_is_not_gzip_is_refused(soo, body):
    answer = await soo.client.post(SC, content=body, headers={"Content-Encoding": "gzip"})
    assert_problem(answer, 400, "json.malformed" if body == b"" else "body.gzip")


async def test_packed_bodies_are_read_whole_or_in_pieces(soo, spacecraft):
    packed = gzip.compress(json.dumps(spacecraft).encode())
    answer = await soo.client.post(SC, content=packed, headers={"Content-Encoding": "gzip"})
    assert answer.status_code == 201, answer.text

    async def parts():
        half = len(packed) // 2
        for part in (packed[:1], packed[1:half], b"", packed[half:]):
            yield part

    answer = await soo.client.post(SC, content=parts(), headers={"Content-Encoding": "GZIP"})
    assert_problem(answer, 409, "spacecraft.exists")
    members = gzip.compress(b'{"name":') + gzip.compress(b'"N"}')
    answer = await soo.client.patch(f"{SC}/yamal-202", content=members, headers={"Content-Encoding": "gzip"})
    assert (answer.status_code, answer.json()["name"]) == (200, "N")


@pytest.mark.parametrize("encoding", ["br", "deflate", "gzip, gzip", "zstd"])
async def test_other_encodings_are_refused(soo, encoding):
    answer = await soo.client.post(SC, content=b"{}", headers={"Content-Encoding": encoding})
    assert_problem(answer, 415, "encoding.unsupported")
    assert answer.headers["accept-encoding"] == "gzip"


@pytest.mark.parametrize("media", ["text/plain", "application/x-www-form-urlencoded", "application/xml", "json"])
async def test_other_media_are_refused(soo, media):
    answer = await soo.client.post(SC, content=b"{}", headers={"Content-Type": media})
    assert_problem(answer, 415, "media_type.unsupported")


async def test_long_answers_are_packed_for_those_who_take_it(soo, spacecraft):
    for k in range(10):
        await soo.client.post(SC, json=spacecraft | {"id": f"s{k}"})
    packed = await soo.client.get(SC, headers={"Accept-Encoding": "gzip"})
    plain = await soo.client.get(SC, headers={"Accept-Encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip"
    assert "content-encoding" not in plain.headers
    assert packed.json() == plain.json()


@pytest.mark.parametrize(
    ("offered", "is_kept"),
    [("abc-123_.:X", True), ("a" * 65, False), ("a b", False), ("a\tb", False), ("\u00e9", False)],
)
async def test_request_ids_are_kept_when_harmless(soo, offered, is_kept):
    answer = await soo.client.get("/healthz", headers={"X-Request-ID": offered.encode("utf-8")})
    assert (answer.headers["x-request-id"] == offered) == is_kept
    assert answer.headers["x-request-id"]


async def test_what_nobody_expected_is_a_500_that_tells_nothing(soo, monkeypatch, caplog):
    def fail() -> None:
        raise RuntimeError("the password is swordfish")

    monkeypatch.setattr(soo.storage, "state", fail)
    answer = await soo.client.get("/readyz", headers={"X-Request-ID": "r-1"})
    problem = assert_problem(answer, 500, "service.failed")
    assert "swordfish" not in answer.text
    assert "r-1" in problem["detail"]
    assert "r-1" in caplog.text
    assert "RuntimeError" in caplog.text


async def test_the_openapi_document_is_served_without_a_key_and_is_the_committed_one(soo):
    served = await soo.client.get("/openapi.json", headers={"Authorization": ""})
    assert served.json() == json.loads(render_openapi())
    message = "the interface changed: write docs/reference/openapi.json again with `python -m service openapi`"
    assert OPENAPI.read_text(encoding="utf-8") == render_openapi(), message


def test_every_list_in_pages_is_given_in_both_orders():
    paths = json.loads(render_openapi())["paths"]
    in_pages = {
        path: {parameter["name"] for parameter in known["get"].get("parameters", ())}
        for path, known in paths.items()
        if "get" in known
    }
    lacking = {path for path, names in in_pages.items() if "cursor" in names and "order" not in names}
    # a manifest is made while it is read, day by day
    assert {path.rsplit("/", 1)[-1] for path in lacking} == {"{series}:manifest"}


def test_every_reference_of_the_openapi_document_leads_somewhere():
    text = render_openapi()
    document = json.loads(text)
    names = {part.split('"')[0] for part in text.split("#/components/schemas/")[1:]}
    assert names <= set(document["components"]["schemas"])
    assert "$defs" not in text
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            assert operation["summary"], (method, path)
            assert "default" in operation["responses"], (method, path)
            if path.startswith("/api/"):
                assert operation["security"] == [{"HTTPBearer": []}], (method, path)


async def test_the_reference_page_needs_no_key(soo):
    answer = await soo.client.get("/docs")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/html")
    assert "/api/v1/spacecraft/{spacecraft_id}/attitude" in answer.text


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
    ["http://openmct.example", "https://openmct.example.evil.example", "https://sub.openmct.example", "null", "*"],
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


async def test_version_clock_and_licences(soo):
    answer = (await soo.client.get("/api/v1/about")).json()
    assert answer["version"] == version("soo")
    assert answer["clock"] == {"now": format_epoch(soo.clock.system_us()), "kind": "system"}
    licences = {each["name"]: each["licence"] for each in answer["shipped"]}
    assert next(iter(licences)) == "soo"
    assert licences["soo"] == "Apache-2.0"
    assert {"numpy", "fastapi", "starlette"} <= licences.keys()
    assert "pytest" not in licences


async def test_settings_are_shown_without_secrets(tmp_path, monkeypatch):
    """Each with value, default, unit and source; of what is secret only that it is set."""
    folder = tmp_path / "secrets"
    folder.mkdir()
    (folder / "soo_alarm_webhook_secret").write_text("hidden-1")
    monkeypatch.setenv("SOO_SECRETS_DIR", str(folder))
    monkeypatch.setenv("SOO_BOOTSTRAP_KEY", "hidden-2")
    monkeypatch.setenv("SOO_ALARM_WEBHOOK_URL", "https://user:hidden-3@hooks.test/T0/hidden-4")
    monkeypatch.setenv("SOO_ALARM_MAIL_PASSWORD", "hidden-5")
    monkeypatch.setenv("SOO_INTERLOCK__VALIDITY_LIMIT_DEG", "0.35")
    settings = Settings(database_url=f"sqlite:///{tmp_path}/soo.db", clock="data")
    app = build_app(settings, build_storage(settings))
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app=app), base_url="http://soo.test") as client:
        answer = await client.get("/api/v1/about", headers={"Authorization": "Bearer hidden-2"})
        await app.state.context.on_shutdown()
    assert answer.status_code == 200
    assert "hidden" not in answer.text
    shown = {each.pop("name"): each for each in answer.json()["settings"]}
    assert (
        shown["SOO_INTERLOCK__VALIDITY_LIMIT_DEG"].items()
        >= {"value": "0.35", "default": "0.4", "unit": "deg", "source": "environment"}.items()
    )
    sources = {name: (each["value"], each["source"]) for name, each in shown.items()}
    assert sources["SOO_BOOTSTRAP_KEY"] == sources["SOO_ALARM_WEBHOOK_URL"] == ("(set)", "environment")
    assert sources["SOO_ALARM_WEBHOOK_SECRET"] == ("(set)", "file")
    assert sources["SOO_CLOCK"] == ("data", "option")
    assert sources["SOO_PORT"] == ("8000", "default")
    assert answer.json()["clock"]["kind"] == "data"
    assert len(json.dumps(shown)) < 100_000


@pytest.mark.parametrize(
    ("url", "expected"),
    [
        ("sqlite:////srv/soo.db", "sqlite:////srv/soo.db"),
        ("postgresql+psycopg://u:p@db.test:5432/soo", "postgresql+psycopg://***@db.test:5432/soo"),
        ("postgresql://u:p#a/b?c@d@db.test/soo?password=p", "postgresql://***@db.test/soo?***"),
        ("postgresql://db.test/soo?user=u&password=p@q", "postgresql://***@q"),
    ],
)
async def test_a_url_is_shown_without_what_it_hides(url, expected):
    from service.composition.settings import setting_entries

    entries = setting_entries(Settings(database_url=url))
    assert next(entries).value == expected
