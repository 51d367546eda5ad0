"""The console in a real browser, against a real service over a real socket: ``make console-check``.

Fixtures: ``service`` (one a module, on an archive with the spacecraft of its ``CRAFTS``, by default one that is
aligned and armed), ``ground`` (sends rows and orders to the first of them), ``page`` (a signed-in page that fails its
test over console errors and foreign requests), ``open_view``, ``screenshot``, ``axe_violations``. Wait by locators and
``expect``: the policy of the pages refuses functions that are evaluated in them.
"""

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright
from release_ground import ReleaseGround, record, seed_archive
from service_process import KEY, ServiceProcess, serving_on

CHROMIUM = shutil.which("chromium")
SCREENSHOTS = Path(__file__).parents[2] / "build" / "console"
#: a page that waits for anything longer is broken; the machine may be busy with other tests
TIMEOUT_MS = 15_000
FLAGS = (
    "--no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking "
    "--disable-component-update --disable-sync"
)
THEMES, LANGUAGES = ("dark", "light"), ("en", "ru")
GOOD_ROWS = 15


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Start the chromium of the system once; without one skip and say so, in continuous integration fail."""
    if CHROMIUM is None:
        message = "no chromium: apt-get install chromium"
        (pytest.fail if os.environ.get("CI") else pytest.skip)(message)
    expect.set_options(timeout=TIMEOUT_MS)
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=FLAGS.split())
        yield started
        started.close()


@pytest.fixture(scope="module")
def service(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Give one service to the tests of a module."""
    database = tmp_path_factory.mktemp("console") / "soo.db"
    seed_archive(f"sqlite:///{database}", *getattr(request.module, "CRAFTS", (record("yamal-202"),)))
    with serving_on(database, os.environ) as started:
        yield started


@pytest.fixture(scope="module")
def ground(service: ServiceProcess, request: pytest.FixtureRequest) -> Iterator[ReleaseGround]:
    """Give a station whose spacecraft is aligned, has had good rows, and is armed."""
    crafts = getattr(request.module, "CRAFTS", (record("yamal-202"),))
    with service.client() as client:
        station = ReleaseGround(client, crafts[0].id)
        station.align()
        station.rows(GOOD_ROWS, (0.0, 0.03, 0.0))
        station.post("/control:arm")
        yield station


@pytest.fixture
def new_context(browser: Browser, service: ServiceProcess) -> Iterator[Callable[..., BrowserContext]]:
    """Give a maker of contexts, each with cookies of its own; ``key=None``: nobody is signed in."""
    made: list[BrowserContext] = []

    def make(key: str | None = KEY, theme: str = "dark", language: str = "en", **options: Any) -> BrowserContext:
        options = {"viewport": {"width": 1280, "height": 800}, "base_url": service.url, **options}
        context = browser.new_context(color_scheme=theme, locale=language, **options)  # type: ignore[arg-type]
        context.set_default_timeout(TIMEOUT_MS)
        made.append(context)
        if key is not None:
            answer = context.request.post("/api/v1/session", data={"key": key})
            assert answer.ok, answer.text()
        return context

    yield make
    for context in made:
        # a request that is altered just now finds no page when its answer comes
        for page in context.pages:
            page.unroute_all(behavior="ignoreErrors")
        context.close()


@pytest.fixture
def new_page(new_context: Callable[..., BrowserContext], service: ServiceProcess) -> Iterator[Callable[..., Page]]:
    """Give a maker of pages; one that had errors or asked another server for something fails its test at the end.

    Tests that provoke refusals name their statuses, or the fault: ``new_page(allowed=(401, "ERR_FAILED"))``.
    """
    wrong: list[str] = []

    def make(context: BrowserContext | None = None, allowed: tuple[int | str, ...] = (), **options: Any) -> Page:
        page = (context or new_context(**options)).new_page()
        known = tuple(each if isinstance(each, str) else f"status of {each} " for each in allowed)
        page.on(
            "console",
            lambda said: (
                wrong.append(said.text)
                if said.type in {"error", "warning"} and not any(status in said.text for status in known)
                else None
            ),
        )
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("request", lambda sent: None if sent.url.startswith(service.url) else wrong.append(sent.url))
        return page

    yield make
    assert wrong == []


@pytest.fixture
def page(new_page: Callable[..., Page], ground: ReleaseGround) -> Page:
    """Give a page that is signed in as the administrator, in English and dark."""
    return new_page()


@pytest.fixture
def open_view() -> Callable[..., Page]:
    """Give a function that opens a view and waits until the stream is live."""

    def open_(page: Page, name: str, query: str = "") -> Page:
        page.goto(f"/console/#/{name}{query}")
        expect(page.locator(".link .symbol.normal")).to_be_visible()
        expect(page.locator("main > *").first).to_be_visible()
        return page

    return open_


@pytest.fixture
def fits() -> Callable[[Page], bool]:
    """Give a function that returns whether nothing of a page has to be scrolled."""
    asked = "document.documentElement.scrollHeight <= innerHeight && document.body.scrollWidth <= innerWidth"
    return lambda page: bool(page.evaluate(asked))


@pytest.fixture
def screenshot() -> Callable[[Page, str], None]:
    """Give a function that keeps a picture of a page in build/console."""
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    return lambda page, name: page.screenshot(path=SCREENSHOTS / f"{name}.png") and None


@pytest.fixture
def axe_violations() -> Callable[[Page], list[str]]:
    """Give a function that returns what axe finds on a page, one line a violation."""

    def run(page: Page) -> list[str]:
        found = Axe().run(page).response["violations"]
        return [f"{each['id']}: {node['html'][:200]}" for each in found for node in each["nodes"]]

    return run
