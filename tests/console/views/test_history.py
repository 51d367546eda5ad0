"""History: curves, lanes, tables and export of any span, live or past."""

import os
import re
import signal
import urllib.parse

import pytest
from playwright.sync_api import expect
from release_ground import ReleaseGround, record, seed_archive
from service_process import KEY, PLAIN, ServiceProcess, serving_on

#: keeps the frames that the page asks for in `window.held` where that is a list
HOLD_FRAMES = """
const frame = requestAnimationFrame.bind(window);
window.requestAnimationFrame = (draw) => (window.held ? window.held.push(draw) : frame(draw));
"""
HOSTILE = "<img src=x onerror=alert(1)>\u202e" + "x" * 1000


def ready(page):
    """Wait until the span is loaded and drawn, and return the view."""
    expect(page.locator(".history[aria-busy=false]")).to_be_visible()
    expect(page.locator(".history canvas, .history-tables table").first).to_be_visible()
    return page.locator(".history")


def parameters(page):
    """Return what the address says of the span."""
    return dict(urllib.parse.parse_qsl(page.url.partition("?")[2]))


def asked_for(page, act):
    """Do something that asks for another span, and return the span of the request, s."""
    with page.expect_request(re.compile("/timeline")) as sent:
        act()
    query = dict(urllib.parse.parse_qsl(urllib.parse.urlsplit(sent.value.url).query))
    ready(page)
    return [page.evaluate("(text) => Date.parse(text) / 1000", query[end]) for end in ("start", "stop")]


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_live_span_in_each_theme_and_language(new_page, ground, open_view, screenshot, axe_violations, theme, language):
    page = open_view(new_page(theme=theme, language=language), "history", "?span=3600")
    view = ready(page)
    expect(view.locator("canvas")).to_have_count(3)
    expect(view.locator(".lane")).to_have_count(9)
    expect(view.locator(".reading")).to_contain_text("10:15:00")
    expect(view.locator(".legend > span")).to_have_count(6)
    assert axe_violations(page) == []
    screenshot(page, f"history-{theme}-{language}")


def test_wheel_drag_and_keys_choose_the_span_and_the_address_keeps_it(page, open_view):
    view = ready(open_view(page, "history", "?start=2027-01-15T09:00:00Z&stop=2027-01-15T11:00:00Z"))
    over = view.locator(".u-over").first
    box = over.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, middle)
    start, stop = asked_for(page, lambda: page.mouse.wheel(0, -100))
    assert stop - start == pytest.approx(7200 / 1.25, abs=2)

    def drag():
        page.mouse.move(box["x"] + 0.25 * box["width"], middle)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.75 * box["width"], middle, steps=4)
        page.mouse.up()

    dragged = asked_for(page, drag)
    assert dragged[1] - dragged[0] == pytest.approx((stop - start) / 2, rel=0.02)
    view.locator(".plots").focus()
    moved = asked_for(page, lambda: page.keyboard.press("ArrowRight"))
    assert moved[0] - dragged[0] == pytest.approx((dragged[1] - dragged[0]) / 4, rel=0.02)
    wider = asked_for(page, lambda: page.keyboard.press("-"))
    assert wider[1] - wider[0] == pytest.approx(1.5 * (moved[1] - moved[0]), rel=0.02)
    kept = parameters(page)
    page.reload()
    ready(page)
    assert parameters(page) == kept
    asked_for(page, lambda: page.get_by_role("button", name="Back to live").click())
    assert set(parameters(page)) == {"span"}
    expect(view.locator(".history-status")).to_contain_text("Live.")


def test_past_span_shows_what_happened_as_text(page, ground, open_view, screenshot):
    ground.post("/operations", {"kind": "eclipse", "start": ground.epoch(-600), "comment": HOSTILE}, status=201)
    note = {"text": HOSTILE, "spacecraft_id": ground.spacecraft_id, "epoch": ground.epoch(-300)}
    assert ground.client.post("/api/v1/notes", json=note).status_code == 201
    span = urllib.parse.urlencode({"start": ground.epoch(-3600), "stop": ground.epoch(60), "as": "table"})
    view = ready(open_view(page, "history", f"?{span}"))
    events = view.get_by_role("table", name="What happened")
    expect(events.get_by_text("<img src=x")).to_have_count(2)
    expect(view.locator("img")).to_have_count(0)
    expect(events.get_by_role("row").filter(has_text="Alignment 1")).to_have_count(1)
    angles = view.get_by_role("table", name="Angles of both methods")
    expect(angles.get_by_role("row").last).to_contain_text(ground.get("/attitude?method=robust")["epoch"][11:19])
    screenshot(page, "history-table")
    page.get_by_role("button", name="Table").click()
    expect(view.locator("canvas").first).to_be_visible()
    assert "as" not in parameters(page)


def test_exports_of_the_span_are_offered_in_every_format(page, ground, open_view):
    span = {"start": ground.epoch(-600), "stop": ground.epoch(1)}
    view = ready(open_view(page, "history", f"?{urllib.parse.urlencode(span)}"))
    links = view.get_by_role("link")
    expect(links).to_have_count(12)
    rows = len(ground.get(f"/attitude/history?{urllib.parse.urlencode(span)}")["rows"])
    for link in links.all():
        href = link.get_attribute("href")
        if "method=robust_smoothed&" in href:
            # this span has no smoothed rows; their files stand in the test of the smoothed curve
            continue
        with page.expect_download() as download:
            link.click()
        content = download.value.path().read_bytes()
        assert content
        if "method=robust&" in href and "format=csv" in href:
            assert len(content.splitlines()) - 1 == rows


def test_a_view_that_is_left_draws_no_more(new_page, ground, open_view):
    page = new_page()
    page.add_init_script(HOLD_FRAMES)
    ready(open_view(page, "history", "?span=3600"))
    open_view(page, "now")
    page.evaluate("window.held = []")
    page.evaluate("location.hash = '#/history?span=3600'")
    expect(page.locator(".history[aria-busy=false]")).to_be_attached()
    loading = []
    page.route("**/views/links.js", lambda route: loading.append(route))
    with page.expect_request("**/views/links.js"):
        page.evaluate("location.hash = '#/links'")
    # the view that was left still stands on the page, and a frame of it is due
    assert page.evaluate("window.held.splice(0).map((draw) => draw(performance.now())).length") > 0
    assert page.locator(".history .uplot").count() == 0
    page.evaluate("window.held = null")
    loading.pop().continue_()
    expect(page.get_by_role("heading", name="Links", level=1)).to_be_visible()


def test_without_uplot_there_are_tables_and_a_reason(new_page, ground, open_view):
    page = new_page(allowed=(404,))
    page.route("**/uplot.js", lambda route: route.fulfill(status=404))
    view = ready(open_view(page, "history", "?span=3600"))
    expect(view.get_by_role("table", name="Angles of both methods")).to_be_visible()
    expect(view.locator(".history-status")).to_contain_text("soo[console]")


@pytest.mark.parametrize(("status", "code"), [(503, "storage.unavailable"), (429, "rate.limited")])
def test_a_refusal_is_told_and_asked_again(new_page, ground, open_view, status, code):
    page = new_page(allowed=(status,))
    problem = {"status": status, "code": code, "title": "no", "detail": "not now"}
    refuse = lambda route: route.fulfill(status=status, json=problem, headers={"Retry-After": "7"})  # noqa: E731
    page.route("**/timeline?*", refuse)
    open_view(page, "history", "?span=3600")
    expect(page.locator(".history [role=alert]")).to_contain_text("7 s")
    page.unroute("**/timeline?*", refuse)
    page.get_by_role("button", name="Try again").click()
    ready(page)
    expect(page.locator(".history [role=alert]")).to_have_count(0)


def test_a_span_that_cannot_be_and_one_without_rows_are_told(page, open_view):
    ready(open_view(page, "history", "?start=yesterday&stop=now"))
    expect(page.locator(".history [role=alert]")).to_contain_text("no span")
    page.goto("/console/#/history?start=2020-01-01T00:00:00Z&stop=2021-01-01T00:00:00Z")
    expect(page.locator(".history-status")).to_contain_text("no rows in this span")


def test_after_kill_9_no_row_is_missing_or_doubled(new_page, tmp_path, browser):
    """The service dies while rows come and is started again on the same port; the plot has each row once."""
    database = tmp_path / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    with serving_on(database, os.environ) as first:
        port = urllib.parse.urlsplit(first.url).port
        context = browser.new_context(base_url=first.url, viewport={"width": 1280, "height": 800}, locale="en")
        page = context.new_page()
        with first.client() as client:
            station = ReleaseGround(client, "yamal-202")
            assert context.request.post("/api/v1/session", data={"key": KEY}).ok
            station.align()
            station.rows(5)
            page.goto("/console/#/history?span=3600")
            view = ready(page)
            station.rows(3)
            expect(view.locator(".reading")).to_contain_text(station.epoch()[11:19])
        first.end(signal.SIGKILL)
        expect(page.locator(".link .symbol.critical")).to_be_visible()
        again = ServiceProcess(tmp_path, database, ["--port", str(port), "--clock", "data"], dict(os.environ) | PLAIN)
        try:
            with again.client() as client:
                station.client = client
                station.rows(4)
                expect(view.locator(".reading")).to_contain_text(station.epoch()[11:19])
                rows = client.get(f"{station.base}/attitude/history?method=robust&limit=1000").json()["rows"]
                epochs = [row["epoch"][11:19] for row in rows if row["yaw_deg"] is not None]
                assert len(epochs) >= 12
                expect(view).to_have_attribute("data-rows", str(len(epochs)))
                page.get_by_role("button", name="Table").click()
                shown = view.get_by_role("table", name="Angles of both methods").get_by_role("rowheader")
                expect(shown).to_have_count(len(epochs))
                assert [text[11:] for text in shown.all_inner_texts()] == epochs
        finally:
            again.process.kill()
            again.process.wait()
            context.close()
