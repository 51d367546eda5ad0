"""History: smoothed angles of the live series beside the filtered ones, with the numbers of the interface."""

import os
from collections.abc import Iterator
from urllib.parse import urlencode

import numpy as np
import pytest
from playwright.sync_api import Page, expect
from release_ground import ReleaseGround, record, seed_archive, until
from service_process import ServiceProcess, serving_on

ROWS = 45
#: pixels of the curves whose colour is nearer to that of the smoothed ones than a tenth
COUNT = """
() => {
  const hex = getComputedStyle(document.documentElement).getPropertyValue("--smoothed").trim();
  const wanted = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16));
  return [...document.querySelectorAll(".history canvas")].map((canvas) => {
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let at = 0; at < data.length; at += 4) {
      count += data[at + 3] > 200 && wanted.every((value, part) => Math.abs(data[at + part] - value) < 25) ? 1 : 0;
    }
    return count;
  });
}
"""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    """Give a service whose smoothed rows come five minutes behind."""
    database = tmp_path_factory.mktemp("smoothed") / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    with serving_on(database, {**os.environ, "SOO_SMOOTHING__LAG_S": "300"}) as started:
        yield started


@pytest.fixture(scope="module")
def ground(ground: ReleaseGround) -> ReleaseGround:
    """Give the station after rows of a slow motion, once their smoothed rows are made."""
    ground.rows(ROWS, np.linspace((0.0, 0.0, 0.0), (0.1, 0.06, -0.04), ROWS))
    until(lambda: len(ground.get("/attitude/smoothed")["rows"]) >= ROWS // 5, "rows are smoothed", patience_s=300.0)
    return ground


def opened(page: Page, ground: ReleaseGround, **parameters: str) -> Page:
    """Open the rows of the motion."""
    span = {"start": ground.epoch(-60.0 * ROWS), "stop": ground.epoch(1)}
    page.goto(f"/console/#/history?{urlencode(span | parameters)}")
    expect(page.locator(".history[aria-busy=false]")).to_be_visible()
    expect(page.locator(".history canvas, .history-tables table").first).to_be_visible()
    return page


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_a_curve_is_drawn_named_and_switched_off(new_page, ground, screenshot, axe_violations, theme, language):
    page = opened(new_page(theme=theme, language=language), ground)
    switch = page.get_by_role("button", name={"en": "Smoothed", "ru": "Сглаженные"}[language], exact=True)
    expect(switch).to_have_attribute("aria-pressed", "true")
    expect(page.locator(".legend > span", has_text={"en": "smoothed", "ru": "сглаженный"}[language])).to_be_visible()
    until(lambda: min(page.evaluate(COUNT)) > 100, "three curves are drawn")
    assert axe_violations(page) == []
    screenshot(page, f"history-smoothed-{theme}-{language}")
    switch.click()
    until(lambda: max(page.evaluate(COUNT)) == 0, "no smoothed curve is drawn")
    expect(page.locator(".legend .smoothed")).to_have_count(0)
    assert "smoothed=0" in page.url


def test_its_numbers_are_those_of_the_interface(new_page, ground):
    page = opened(new_page(), ground, **{"as": "table"})
    figures = page.get_by_role("table", name="Angles of both methods")
    span = urlencode({"start": ground.epoch(-60.0 * ROWS), "stop": ground.epoch(1)})
    rows = ground.get(f"/attitude/smoothed?{span}")["rows"]
    assert len(rows) >= ROWS // 5 - 1
    heads = figures.get_by_role("columnheader").all_inner_texts()
    places = [heads.index(f"{axis}, deg (smoothed)") - 1 for axis in ("Yaw", "Roll", "Pitch")]
    for row in rows:
        cells = figures.get_by_role("row").filter(has_text=row["epoch"][11:19]).get_by_role("cell").all_inner_texts()
        expected = [f"{round(row[f'{axis}_deg'], 3) + 0.0:.3f}" for axis in ("yaw", "roll", "pitch")]
        assert [cells[place] for place in places] == expected
    with page.expect_download() as download:
        page.get_by_role("link", name="smoothed, csv").click()
    assert len(download.value.path().read_bytes().splitlines()) == len(rows) + 1


def test_a_smoothed_row_of_a_live_span_is_shown_when_it_is_made(new_page, ground):
    page = new_page()
    page.goto("/console/#/history?span=3000&as=table")
    figures = page.get_by_role("table", name="Angles of both methods")
    expect(figures).to_be_visible()
    known = len(ground.get("/attitude/smoothed")["rows"])
    ground.rows(6, (0.1, 0.06, -0.04))
    until(lambda: len(ground.get("/attitude/smoothed")["rows"]) > known, "another one is made", patience_s=300.0)
    newest = ground.get("/attitude/smoothed?order=desc&limit=1")["rows"][0]
    cells = figures.get_by_role("row").filter(has_text=newest["epoch"][11:19]).get_by_role("cell")
    expect(cells.last).to_have_text(f"{round(newest['pitch_deg'], 3) + 0.0:.3f}")
