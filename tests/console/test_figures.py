"""Figures of the console, held at twice what they are to reach; all go to build/console/figures.json.

Wall time on a busy machine judges the machine: a figure is kept where the wall time or, for what the page itself
computes, the time of its main thread (Chromium's ``threadTicks``) is.
"""

import json
import os
import re
import statistics
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import release_ground
from geometry_flight import FlightPayload
from playwright.sync_api import CDPSession, Locator, Page, expect
from release_ground import ReleaseGround, record, seed_archive
from service_process import ServiceProcess, serving_on
from waiting import wait_until

from service.records.epoch import format_epoch

FIGURES = Path(__file__).parents[2] / "build/console/figures.json"
RUNS = 5
#: twice what is to be reached
FACTOR = 2.0
FIRST_PAINT_S, FIRST_VALUES_S = 0.5, 1.0
#: rows of a burst, in requests of so many; six hours hold them all and those before them
BURST_ROWS, REQUEST_ROWS = 200, 10
SPAN_S = 6 * 3600
CLICK_S = 1.0
#: divides by rounds and views
NIGHTLY_ROWS = 45 * 12 * 19
#: of views of a kind that were left, whatever the engine likes to keep: V8 has the closure of a getter of the last plot
#: in the hidden class of its literal (uPlot, FeedbackVector, AllocationSite, AccessorPair); a leak leaves one a round
KEPT_OF_A_KIND = 2
#: nodes a round
NODES = 150
HEAP_BYTES = 1_000_000
#: bounds hangs, s: what is waited for comes when the service has answered, however busy the machine is
HANG_S = 240.0
ATTACHED_NODES = """(() => {
  const walker = document.createTreeWalker(document, NodeFilter.SHOW_ALL);
  let count = 1;
  while (walker.nextNode()) count += 1;
  return count;
})()"""
#: remembers when the first angle stands on the page, and when each row does
WATCH = """
window.shownRows = {};
new MutationObserver(() => {
  const value = document.querySelector(".gauge .value");
  if (value && /\\d/.test(value.textContent)) window.firstValue ??= performance.now();
  const row = document.querySelector("time.row");
  if (row) window.shownRows[row.textContent] ??= Date.now();
}).observe(document, { subtree: true, childList: true, characterData: true });
"""


@pytest.fixture(scope="module", params=[32])
def carriers(request: pytest.FixtureRequest) -> Iterator[int]:
    """Give the spacecraft as many carriers as a figure asks for."""
    former, release_ground.PAYLOAD = release_ground.PAYLOAD, FlightPayload.make(request.param)
    yield request.param
    release_ground.PAYLOAD = former


@pytest.fixture(scope="module")
def service(carriers: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Give a service to the tests of one number of carriers."""
    database = tmp_path_factory.mktemp("figures") / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    with serving_on(database, os.environ) as started:
        yield started


@pytest.fixture(scope="module")
def figures() -> Any:
    """Keep what was measured."""
    found: dict[str, Any] = {}
    yield found
    FIGURES.parent.mkdir(parents=True, exist_ok=True)
    FIGURES.write_text(json.dumps(found, indent=1) + "\n")


def thread_s(session: CDPSession) -> float:
    """Return the time of the main thread so far, s."""
    metrics = {each["name"]: each["value"] for each in session.send("Performance.getMetrics")["metrics"]}
    return float(metrics["TaskDuration"])


def measured(page: Page) -> CDPSession:
    """Return a session that measures processor time."""
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable", {"timeDomain": "threadTicks"})
    return session


def test_first_paint_and_first_values_of_a_cold_browser(new_context, ground, figures):
    paints, values, threads = [], [], []
    for _ in range(RUNS):
        page = new_context().new_page()
        page.add_init_script(WATCH)
        session = measured(page)
        page.goto("/console/")
        expect(page.locator(".gauge .value").first).to_have_text(re.compile(r"\d"))
        paints.append(page.evaluate("performance.getEntriesByName('first-paint')[0].startTime") / 1000)
        values.append(page.evaluate("window.firstValue") / 1000)
        threads.append(thread_s(session))
        page.context.close()
    paint_s, value_s, thread = map(statistics.median, (paints, values, threads))
    figures["first paint, values, main thread, s"] = [paint_s, value_s, thread]
    assert min(paint_s, thread) <= FACTOR * FIRST_PAINT_S
    assert min(value_s, thread) <= FACTOR * FIRST_VALUES_S


@pytest.mark.parametrize(
    ("carriers", "per_s", "rows", "p50_s", "p99_s"),
    [(32, 1.0, 10, 0.1, 0.3), (16, 10.0, 60, 0.15, 0.5)],
    indirect=["carriers"],
)
def test_a_row_is_on_the_screen_soon_after_it_was_accepted(
    new_page, ground, open_view, figures, carriers, per_s, rows, p50_s, p99_s
):
    page = new_page()
    page.add_init_script(WATCH)
    open_view(page, "now")
    session = measured(page)
    began, accepted = thread_s(session), {}
    for _ in range(rows):
        due = time.monotonic() + 1 / per_s
        ground.rows(1, (0.0, 0.03, 0.0), settle=False)
        accepted[format_epoch(ground.now_us)[11:19]] = time.time() * 1000
        page.wait_for_timeout(max(0.0, due - time.monotonic()) * 1000)
    newest = format_epoch(ground.now_us)[11:19]
    expect(page.locator("time.row")).to_have_text(newest)
    shown = page.evaluate("window.shownRows")
    waits_s = [max(0.0, shown[name] - at) / 1000 for name, at in accepted.items() if name in shown]
    a_row_s = (thread_s(session) - began) / rows
    found = [float(np.percentile(waits_s, share)) for share in (50, 99)]
    figures[f"2xx to screen, {carriers} carriers, {per_s:g} rows/s: p50, p99, main thread a row, s"] = [*found, a_row_s]
    assert len(waits_s) >= 0.5 * rows, "frames are dropped, not most of the rows"
    assert min(found[0], a_row_s) <= FACTOR * p50_s
    assert min(found[1], a_row_s) <= FACTOR * p99_s


def drawn_rows(view: Locator) -> int:
    """Return how many rows History draws, each of them alone."""
    return int(view.get_attribute("data-rows") or 0)


@pytest.mark.parametrize("carriers", [128], indirect=True)
def test_a_burst_drops_frames_and_no_rows(new_context, new_page, ground, open_view, figures, carriers):
    context = new_context()
    now, history = new_page(context), new_page(context)
    now.add_init_script(WATCH)
    open_view(now, "now")
    view = open_view(history, "history", f"?span={SPAN_S}").locator(".history[aria-busy=false]")
    expect(view).to_have_attribute("data-rows", re.compile("[1-9]"))
    before = drawn_rows(view)
    session = measured(now)
    began, began_s = thread_s(session), time.monotonic()
    for _ in range(BURST_ROWS // REQUEST_ROWS):
        ground.rows(REQUEST_ROWS, (0.0, 0.03, 0.0), settle=False)
    sent_s = time.monotonic() - began_s
    # a click in the middle of it
    at = thread_s(session)
    now.get_by_role("link", name="Carriers").click()
    expect(now.locator("nav a[aria-current]")).to_have_attribute("href", "#/carriers")
    expect(now.locator(".carriers")).to_be_visible()
    click_s = thread_s(session) - at
    now.get_by_role("link", name="Now").click()
    ground.settle()
    expect(now.locator("time.row")).to_have_text(format_epoch(ground.now_us)[11:19])
    a_row_s = (thread_s(session) - began) / BURST_ROWS
    shown = len(now.evaluate("window.shownRows"))
    expect(view).to_have_attribute("data-rows", str(before + BURST_ROWS))
    figures[f"burst, {carriers} carriers: rows/s sent"] = BURST_ROWS / sent_s
    figures["burst, main thread a row and of a click, s"] = [a_row_s, click_s]
    figures["burst, rows, frames that showed one"] = [BURST_ROWS, shown]
    assert click_s <= CLICK_S


class _Rounds:
    """Walks of a page through all views, and what they leave behind."""

    def __init__(self, page: Page, ground: ReleaseGround) -> None:
        self._page = page
        self._ground = ground
        self._session = page.context.new_cdp_session(page)
        self.names = [str(each.get_attribute("href")) for each in page.locator("nav a").all()]

    def run(self, rounds: int, rows: int) -> None:
        """Open every view in each round while so many rows come in; end in view Now."""
        for _ in range(rounds):
            for name in self.names:
                if rows:
                    self._ground.rows(rows // len(self.names), (0.0, 0.03, 0.0), settle=False)
                self._page.goto(f"/console/{name}")
                current, view = self._page.locator("nav a[aria-current]"), self._page.locator("main > *").first
                expect(current).to_have_attribute("href", name, timeout=1000 * HANG_S)
                expect(view).to_be_visible(timeout=1000 * HANG_S)
            self._ground.settle()
        self._page.goto("/console/#/now")
        expect(self._page.locator(".gauge .value").first).to_have_text(re.compile(r"\d"), timeout=1000 * HANG_S)

    def heap_bytes(self) -> int:
        """Return what is in use after a collection."""
        self._collect()
        return int(self._session.send("Runtime.getHeapUsage")["usedSize"])

    def unattached_nodes(self) -> int:
        """Return how many nodes there are after a collection besides those of the page, whatever it shows just now."""
        self._collect()
        return int(self._session.send("Memory.getDOMCounters")["nodes"]) - int(self._page.evaluate(ATTACHED_NODES))

    def detached(self) -> Counter[str]:
        """Return what a script holds that hangs on no page: how many trees by tag and class of the root."""
        self._collect()
        # a session holds what it has found: this one ends
        session = self._page.context.new_cdp_session(self._page)
        trees = session.send("DOM.getDetachedDomNodes")["detachedNodes"]
        session.detach()
        # attributes stand alone in the list
        roots = [each["treeNode"] for each in trees if "attributes" in each["treeNode"]]
        return Counter(f"{root['nodeName']} {root['attributes'][:2]}" for root in roots)

    def are_views_let_go(self) -> bool:
        """Return whether no more is held than the engine may keep; what a request holds goes when it is answered."""
        return max(self.detached().values(), default=0) <= KEPT_OF_A_KIND

    def _collect(self) -> None:
        for _ in range(3):
            self._session.send("HeapProfiler.collectGarbage")


@pytest.mark.parametrize(
    ("first", "last", "rows"),
    [(5, 15, 0), pytest.param(5, 50, NIGHTLY_ROWS, marks=[pytest.mark.nightly, pytest.mark.timeout(3600)])],
)
def test_rounds_of_all_views_leave_nothing_behind(new_page, ground, open_view, figures, first, last, rows):
    page = new_page()
    open_view(page, "now")
    rounds = _Rounds(page, ground)
    rounds.run(first, 0)
    wait_until(rounds.are_views_let_go, rounds.detached, HANG_S)
    heap, nodes = rounds.heap_bytes(), rounds.unattached_nodes()
    rounds.run(last - first, rows // (last - first))

    def gained() -> tuple[int, int, Counter[str]]:
        return rounds.heap_bytes() - heap, rounds.unattached_nodes() - nodes, rounds.detached()

    def is_let_go() -> bool:
        gained_bytes, gained_nodes, _ = gained()
        is_small = gained_bytes <= FACTOR * HEAP_BYTES and gained_nodes < NODES * (last - first)
        return is_small and rounds.are_views_let_go()

    wait_until(is_let_go, gained, HANG_S)
    gained_bytes, gained_nodes, detached = gained()
    figures[f"heap from round {first} to {last} of {len(rounds.names)} views, {rows} rows, bytes"] = gained_bytes
    figures[f"nodes gained, detached trees, to round {last}"] = [gained_nodes, detached.total()]
