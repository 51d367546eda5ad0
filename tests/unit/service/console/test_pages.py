"""Static files of the console: what is served, packed, remembered, and refused."""

import json
import posixpath
import re
from importlib import metadata
from pathlib import Path

import httpx
import pytest
from fastapi import FastAPI

from service.console import pages

pytestmark = pytest.mark.anyio
STATIC = Path(pages.__file__).with_name("static")


@pytest.fixture
async def client():
    async with httpx.AsyncClient(
        transport=httpx.ASGITransport(pages.with_console(FastAPI())), base_url="http://soo"
    ) as opened:
        yield opened


async def test_the_address_of_the_service_leads_to_the_console(client):
    for path in ("/", "/console"):
        answer = await client.get(path)
        assert (answer.status_code, answer.headers["location"]) == (307, "/console/")
    answer = await client.get("/console/")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "text/html; charset=utf-8")


async def test_all_that_the_page_names_is_served(client):
    page = (STATIC / "index.html").read_text()
    named = re.findall(r'(?:href|src)="([^"]+)"', page)
    assert len(named) > 15
    assert set(named) <= set(pages.console_files())


async def test_every_file_has_the_headers_that_keep_foreign_code_out(client):
    for name in pages.console_files():
        answer = await client.get(f"/console/{name}")
        policy = answer.headers["content-security-policy"]
        assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'")
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert answer.headers["referrer-policy"] == "no-referrer"


async def test_a_file_is_sent_packed_once_and_not_again_while_it_is_the_same(client):
    packed = await client.get("/console/app.js", headers={"accept-encoding": "gzip"})
    plain = await client.get("/console/app.js", headers={"accept-encoding": "identity"})
    assert packed.headers["content-encoding"] == "gzip"
    assert packed.content == plain.content == (STATIC / "app.js").read_bytes()
    assert "content-encoding" not in plain.headers
    again = await client.get("/console/app.js", headers={"if-none-match": f'"other", {packed.headers["etag"]}'})
    assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", packed.headers["etag"])
    changed = await client.get("/console/app.js", headers={"if-none-match": 'W/"other"'})
    assert changed.status_code == 200
    head = await client.head("/console/app.js")
    assert (head.status_code, head.content) == (200, b"")


@pytest.mark.parametrize("language", ["en", "ru"])
async def test_words_are_sent_whole_and_without_the_blanks_of_their_layout(client, language):
    answer = await client.get(f"/console/words/{language}.json")
    assert answer.json() == json.loads((STATIC / f"words/{language}.json").read_text())
    assert b"\n" not in answer.content


@pytest.mark.parametrize("name", ["nothing.js", "../pages.py", "..%2fpages.py", "%2e%2e/pages.py", "views", "views/"])
async def test_nothing_else_is_served(client, name):
    assert (await client.get(f"/console/{name}")).status_code in {404, 307}
    assert name not in pages.console_files()


def needed(files, name):
    """Return the names of the files that a module imports, itself included; types in comments are no imports."""
    found, waiting = set(), [name]
    while waiting:
        each = waiting.pop()
        if each not in found:
            found.add(each)
            imported = re.findall(r'^(?:import|export) [^"]*"(\.[^"]+)";', files[each].plain.decode(), re.MULTILINE)
            waiting += [posixpath.normpath(posixpath.join(posixpath.dirname(each), path)) for path in imported]
    return found


async def test_each_view_without_data_stays_small():
    files = pages.console_files()
    head = set(re.findall(r'(?:href|src)="([^"]+)"', files["index.html"].plain.decode())) & set(files)
    # whatever of uPlot is loaded, and the words of the longer language
    shell = head | needed(files, "app.js") | {"index.html", "uplot.js", "uplot.css", "words/ru.json"}
    views = [name for name in files if re.fullmatch(r"views/\w+\.js", name)]
    sizes = {name: sum(len(files[each].packed) for each in shell | needed(files, name)) for name in views}
    print(sizes)
    assert len(sizes) == 12
    assert max(sizes.values()) <= 150_000


async def test_uplot_is_served_as_npm_has_it():
    files = pages.console_files()
    assert {name: pages.sha256(files[name].plain).hexdigest() for name in ("uplot.js", "uplot.css")} == {
        "uplot.js": "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2",
        "uplot.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    }


async def test_another_uplot_is_not_served_and_the_console_is(monkeypatch, caplog):
    monkeypatch.setitem(pages._UPLOT, "uplot.js", ("uplot.iife.min.js", "0" * 64))
    files = pages.console_files()
    assert "index.html" in files
    assert not {"uplot.js", "uplot.css"} & set(files)
    assert "uplot.js of youplot is not that of uPlot 1.6.31" in caplog.text


@pytest.mark.parametrize("found", [None, []])
async def test_a_wheel_that_lists_no_files_brings_no_uplot(monkeypatch, caplog, found):
    monkeypatch.setattr(metadata, "files", lambda _: found)
    assert "uplot.js" not in pages.console_files()
    assert "pip install soo[console]" in caplog.text


async def test_without_the_wheel_the_console_is_served_and_the_log_says_what_to_install(monkeypatch, caplog):
    monkeypatch.setattr(pages, "_WHEEL", "no-such-wheel")
    files = pages.console_files()
    assert {"index.html", "app.js", "words/ru.json"} <= set(files)
    assert "uplot.js" not in files
    assert "pip install soo[console]" in caplog.text


def test_modules_and_styles_stay_few():
    lines = sum(len(path.read_text().splitlines()) for end in ("js", "css") for path in STATIC.rglob(f"*.{end}"))
    assert lines <= 6000
