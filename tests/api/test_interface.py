"""What holds for every path: keys, problems, sizes, packing, request ids, health, the OpenAPI document."""

import gzip
import json
import logging
from pathlib import Path
from typing import Any

import httpx
import pytest
from role_keys import RoleKeys

from service.api.app import render_openapi
from service.errors import StorageError

pytestmark = pytest.mark.anyio
SC = "/api/v1/spacecraft"
OPENAPI = Path(__file__).parents[2] / "docs" / "reference" / "openapi.json"
LIMIT = 200_000
#: every path of the document with something in place of its parameters
PROTECTED = sorted(path for path in json.loads(render_openapi())["paths"] if path.startswith("/api/"))


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


@pytest.mark.parametrize("path", PROTECTED)
async def test_every_path_under_the_base_wants_a_key(soo, path):
    for method in ("get", "post", "put", "patch", "delete"):
        answer = await soo.client.request(
            method, path.replace("{", "").replace("}", ""), headers={"Authorization": "x"}
        )
        # a session is opened by a key in the body
        is_opening = (method, path) == ("post", "/api/v1/session")
        assert answer.status_code in ({400} if is_opening else {401, 405}), (method, path, answer.status_code)


async def test_the_key_is_checked_before_the_body_is_read(soo):
    answer = await soo.client.post(SC, content=b"{", headers={"Authorization": "Bearer no"})
    assert_problem(answer, 401, "key.invalid")


async def test_roles_decide_who_may_write(soo, spacecraft):
    soo.app.state.key_ring = RoleKeys()

    async def post(role: str, path: str) -> int:
        return (await soo.client.post(path, json={}, headers={"Authorization": f"Bearer {role}"})).status_code

    assert await post("viewer", SC) == 403
    assert await post("station", SC) == 403
    assert await post("operator", SC) == 422
    assert await post("viewer", f"{SC}/y/measurements:batch") == 403
    assert await post("station", f"{SC}/y/measurements:batch") == 422
    answer = await soo.client.post(SC, json=spacecraft, headers={"Authorization": "Bearer viewer"})
    assert_problem(answer, 403, "key.forbidden")
    listed = await soo.client.get(SC, headers={"Authorization": "Bearer viewer"})
    assert (listed.status_code, listed.json()["rows"]) == (200, [])


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


async def chunks(size: int, part: bytes = b" " * 4096):
    """A body without a length."""
    for _ in range(size // len(part)):
        yield part


@pytest.mark.parametrize(
    ("body", "headers"),
    [
        (b" " * (LIMIT + 1), {}),
        (chunks(2 * LIMIT), {}),
        (b" ", {"Content-Length": str(10**30)}),
        (gzip.compress(b" " * (LIMIT + 1)), {"Content-Encoding": "gzip"}),
        (gzip.compress(b"\0" * 100_000_000), {"Content-Encoding": "gzip"}),
        (gzip.compress(b" " * LIMIT) + gzip.compress(b" "), {"Content-Encoding": "gzip"}),
    ],
    ids=["plain", "chunked", "said to be large", "packed", "bomb", "two members"],
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
