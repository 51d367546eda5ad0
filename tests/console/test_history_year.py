"""Figures of a year of rows a minute, both methods: request, drawing and zoom; processor time judges."""

import os
import statistics
import urllib.parse
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import expect
from release_ground import OPERATION_US, PAYLOAD, record, seed_archive, until
from service_process import serving_on

from db.encoding.column_blob import pack_columns
from db.encoding.segments import DAY_US, PLAIN_COLUMNS, measured_arrays
from db.results.result_samples import STATES, stretch_blob
from db.sealing import bins_of
from db.storage import SqlStorage
from db.tables import segment, summary
from service.core.rows import RowState, StateRun, Stretch
from service.ports.archive import ATTITUDE_FIGURES, LIVE
from service.records.catalogue import LIVE_METHODS
from service.records.epoch import format_epoch
from service.records.levels.measurement import MeasurementBatch

DAYS = 365
MINUTE_US = 60_000_000
FIRST_US = OPERATION_US // DAY_US * DAY_US - DAYS * DAY_US
#: s; some three times the figures that are reached on an idle machine: they find a request of rows in place of bins
REQUEST_S, DRAWN_S, ZOOM_S = 1.5, 3.0, 1.5
REPEATS = 5
#: opens a view
OPEN = "(hash) => { window.began = performance.now(); location.hash = hash; }"
#: ms from the wish for each span until it is drawn, and its requests from the first until the last answer
WATCH = """
window.spans = [];
new MutationObserver((changes) => {
  for (const { target } of changes) {
    if (target.getAttribute("aria-busy") === "true") window.began ??= performance.now();
    else if (window.began !== undefined) {
      const isOfSpan = ({ name, startTime }) => startTime >= window.began && /[/](samples|timeline)[?]/.test(name);
      const asked = performance.getEntriesByType("resource").filter(isOfSpan);
      const [start, stop] = [asked.map((each) => each.startTime), asked.map((each) => each.responseEnd)];
      const requested = Math.max(...stop) - Math.min(...start);
      // the frame that draws, and what follows its painting
      requestAnimationFrame(() => setTimeout(() => {
        window.spans.push([performance.now() - window.began, requested]);
        window.began = undefined;
        performance.clearResourceTimings();
      }));
    }
  }
}).observe(document, { subtree: true, attributeFilter: ["aria-busy"] });
"""


def seed_year(url: str) -> None:
    """Lay a row and the summaries of a year into an archive: charts of sealed days are read from these alone."""
    storage = SqlStorage(url)
    # a row before all, and one from which the clock of the data goes on
    rows_us = np.array([FIRST_US - MINUTE_US, OPERATION_US - 60 * MINUTE_US], dtype=np.int64)
    powers = np.asarray(PAYLOAD.power_dbm(rows_us, (0.0, 0.0, 0.0)), dtype=np.float32)
    index, is_stale = np.arange(2), np.zeros(2, dtype=np.bool_)
    batch = MeasurementBatch("yamal-202", "sa-1", 1, OPERATION_US, index, rows_us, powers, (None, None), is_stale)
    storage.archive.append_measurements(batch).result()
    random = np.random.default_rng(1)
    key = storage._database.key("yamal-202")
    with storage._database.engines.write.begin() as connection:
        for start_us in range(FIRST_US, FIRST_US + DAYS * DAY_US, DAY_US):
            epochs_us = start_us + MINUTE_US * np.arange(DAY_US // MINUTE_US)
            lay_segment(connection, key, epochs_us, {}, None, measured(epochs_us, powers.shape[1]))
            for method in LIVE_METHODS:
                values = random.normal(0.02, 0.01, (len(epochs_us), len(ATTITUDE_FIGURES)))
                states = stretch_blob(states_of(epochs_us, random))
                lay_segment(
                    connection, key, epochs_us, bins_of("attitude", epochs_us, values) | {(STATES, 0): states}, method
                )
    storage.close()


def measured(epochs_us: np.ndarray, carriers: int) -> bytes:
    """Return measurements of one level."""
    count = len(epochs_us)
    yes, no, zero = np.ones(count, np.bool_), np.zeros(count, np.bool_), np.zeros(count, np.int64)
    powers, flags = np.full((count, carriers), -50, np.float32), np.zeros((count, carriers), np.int32)
    details = np.full((count, 4, carriers), np.nan, np.float32)
    plain = dict(zip(PLAIN_COLUMNS, (epochs_us, zero, epochs_us, yes, no, no, zero - 1), strict=True))
    return pack_columns(measured_arrays(plain, powers, flags, details))


def lay_segment(connection, key, epochs_us, bins, method=None, content=b""):
    """Lay a segment of measurements or of a method's attitude, and its summaries; what is not read has no content."""
    first, last = int(epochs_us[0]), int(epochs_us[-1])
    series = {"series": "measurement", "version": "", "method": "", "source_key": 1, "plan_id": 1}
    if method is not None:
        series = {"series": "attitude", "version": LIVE, "method": method.value, "source_key": 0, "plan_id": 0}
    counts = {"row_count": len(epochs_us), "feeding_count": len(epochs_us) if method is None else 0}
    places = {"first_epoch_us": first, "last_epoch_us": last, "first_number": 0, "last_number": 0}
    values = {"spacecraft_key": key, **series, "day": first // DAY_US, **counts, **places, "content": content}
    name = connection.execute(segment.insert().values(values)).inserted_primary_key[0]
    rows = [{"segment_id": name, "quantity": each[0], "bin_s": each[1], "content": bins[each]} for each in bins]
    if rows:
        connection.execute(summary.insert(), rows)


def states_of(epochs_us: np.ndarray, random: np.random.Generator) -> Stretch:
    """Return a day with twenty stretches of fade and one status."""
    starts = np.sort(random.choice(len(epochs_us) // 20, 20, replace=False)) * 20
    fades = [StateRun(RowState("fade", "downlink"), *map(int, epochs_us[[k, k + 9]]), 10) for k in starts]
    whole = StateRun(RowState("status", "ACQUIRED"), int(epochs_us[0]), int(epochs_us[-1]), len(epochs_us))
    return Stretch(whole.start_us, whole.stop_us, MINUTE_US, [whole, *fades], [])


def processor_s(process_id: int) -> float:
    """Return the processor time of a process so far."""
    fields = Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    """Give a service with a year of summaries."""
    database = tmp_path_factory.mktemp("year") / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    seed_year(f"sqlite:///{database}")
    with serving_on(database, os.environ) as started:
        yield started


def test_a_year_of_both_methods(new_page, ground, service, screenshot, record_property):
    page = new_page()
    page.add_init_script(WATCH)
    ticks = page.context.new_cdp_session(page)
    ticks.send("Performance.setTimeDomain", {"timeDomain": "threadTicks"})
    ticks.send("Performance.enable")

    def page_s():
        metrics = ticks.send("Performance.getMetrics")["metrics"]
        return next(each["value"] for each in metrics if each["name"] == "TaskDuration")

    def taken(act):
        """Return time until a span is drawn, of its requests, and processor time of the page and of the service."""
        page.evaluate("window.spans = []; performance.clearResourceTimings()")
        before = page_s(), processor_s(service.process.pid)
        act()
        until(lambda: page.evaluate("window.spans.length") == 1, "the span is drawn")
        after = page_s(), processor_s(service.process.pid)
        walls_s = [each / 1000 for each in page.evaluate("window.spans[0]")]
        return [*walls_s, *(late - early for early, late in zip(before, after, strict=True))]

    span = {"start": format_epoch(FIRST_US), "stop": format_epoch(FIRST_US + DAYS * DAY_US)}
    year = f"#/history?{urllib.parse.urlencode(span)}"
    page.goto(f"/console/{year}")
    expect(page.locator(".history[aria-busy=false] canvas")).to_have_count(3)
    expect(page.locator(".history")).to_have_attribute("data-rows", str(DAYS))
    screenshot(page, "history-year")
    loads = []
    for _ in range(REPEATS):
        page.get_by_role("link", name="Now").click()
        expect(page.locator(".history")).to_have_count(0)
        loads.append(taken(lambda: page.evaluate(OPEN, year)))
    page.locator(".plots").focus()
    zooms = [taken(lambda key=key: page.keyboard.press(key)) for key in ("+", "-", "+", "-", "+")]
    figures = {
        name: [round(statistics.median(column), 3) for column in zip(*found, strict=True)]
        for name, found in (("load", loads), ("zoom", zooms))
    }
    print("drawn, requests, page, service, s:", figures)
    record_property("figures", figures)
    for kind, drawn_s in (("load", DRAWN_S), ("zoom", ZOOM_S)):
        wall_s, requests_s, page_used_s, service_used_s = figures[kind]
        assert min(wall_s, page_used_s) <= drawn_s
        assert min(requests_s, service_used_s) <= REQUEST_S


def test_spans_whose_states_are_left_out_are_named(page, open_view):
    def answer(route):
        found = route.fetch()
        left_out = [{"start": "2027-01-15T09:00:00Z", "stop": "2027-01-15T09:30:00Z"}]
        route.fulfill(response=found, json={**found.json(), "states_left_out": left_out})

    page.route("**/timeline?*", answer)
    open_view(page, "history", "?start=2027-01-15T09:00:00Z&stop=2027-01-15T11:00:00Z")
    status = page.locator(".history-status")
    expect(status).to_contain_text("States and gaps of 2027-01-15 09:00:00 – 2027-01-15 09:30:00 are not shown")
