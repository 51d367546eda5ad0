"""What every view has in common when something is wrong: refusals, sizes, colours, keys; and a chart that is not."""

import csv
import io
import os
import re
from hashlib import sha256

import pytest
from playwright.sync_api import expect
from release_ground import record, seed_archive
from service_process import KEY, serving_on

CRAFTS = (record("yamal-202"), record("yamal-two", name="second"))
VIEWS = [
    "now",
    "alarms",
    "history",
    "carriers",
    "links",
    "control",
    "calibration",
    "shift",
    "archive",
    "audit",
    "keys",
    "about",
]
#: the session and the list of spacecraft are read once, the stream has tests of its own
REFUSED = re.compile(r"/api/v1/(?!session$|spacecraft$|spacecraft/[^/]+/stream)")
REFUSALS = [
    (503, "service.not_ready", "Several parts of the service are not ready. Ask who runs the service."),
    (429, "rate.limited", "Too many requests"),
]
#: what stands in a view once it is loaded
SHOWN = dict.fromkeys(VIEWS, "main h1") | {
    "history": ".history .reading",
    "calibration": ".calibration .windows[aria-busy=false]",
    "archive": "main code",
    "links": ".links-view table",
}
NO_SIDEWAYS = "document.documentElement.scrollWidth <= innerWidth"


@pytest.mark.parametrize(("status", "code", "said"), REFUSALS)
def test_every_view_says_why_it_is_refused_and_comes_back(new_page, ground, open_view, status, code, said):
    page = new_page(allowed=(status,))
    problem = {"status": status, "code": code, "title": "no", "detail": ""}
    refuse = lambda route: route.fulfill(status=status, json=problem, headers={"Retry-After": "1"})  # noqa: E731
    open_view(page, "keys")
    page.route(REFUSED, refuse)
    for view in VIEWS:
        # what stood there is not taken for what comes
        page.evaluate("document.querySelector('main').replaceChildren()")
        page.goto(f"/console/#/{view}")
        if view == "now":
            # what is newest is read with the page
            page.reload()
        alert = page.locator("main [role=alert]").first
        expect(alert, view).to_contain_text(said)
        expect(alert, view).to_contain_text("Try again in 1 s.")
    page.unroute(REFUSED, refuse)
    page.get_by_role("button", name="Read again").click()
    expect(page.get_by_role("row", name="starlette")).to_be_visible()
    open_view(page, "now")
    expect(page.locator(".gauge.is-stale")).to_have_count(0)
    expect(page.locator("main [role=alert]")).to_have_count(0)


def test_now_does_not_call_a_refused_row_one_that_never_came(new_page, ground, open_view, fits):
    page = new_page(allowed=(503,))
    problem = {"status": 503, "code": "service.not_ready"}
    page.route(re.compile(r"/attitude\?"), lambda route: route.fulfill(status=503, json=problem))
    open_view(page, "now")
    expect(page.locator("main [role=alert]")).to_contain_text("Several parts of the service are not ready")
    expect(page.get_by_role("heading", level=1)).not_to_contain_text("no row has come yet")
    expect(page.locator(".gauge.is-stale")).to_have_count(3)
    assert fits(page)
    page.unroute_all()
    # it is asked for again by itself
    expect(page.locator("main [role=alert]")).to_have_count(0)
    expect(page.locator(".gauge.is-stale")).to_have_count(0)


@pytest.mark.parametrize("options", [{"forced_colors": "active"}, {"reduced_motion": "reduce"}])
def test_every_view_at_twice_the_size_with_the_settings_of_the_system(
    new_page, ground, open_view, axe_violations, screenshot, options
):
    page = new_page(viewport={"width": 640, "height": 400}, **options)
    for view, shown in SHOWN.items():
        page.evaluate("document.querySelector('main')?.replaceChildren()")
        open_view(page, view)
        expect(page.locator(shown).first).to_have_text(re.compile(r"\S"))
        assert page.evaluate(NO_SIDEWAYS), f"{view}: 200 % of 1280 needs no sideways scroll"
        assert axe_violations(page) == [], view
        running = "document.getAnimations().filter((each) => each.playState === 'running').length"
        assert page.evaluate(running) == 0, view
        screenshot(page, f"{view}-narrow-{next(iter(options))}")


@pytest.mark.parametrize(
    ("view", "wanted"),
    [("history", "Zoom in"), ("calibration", "Recommend"), ("archive", "Show")],
)
def test_wide_views_are_operated_by_keyboard_alone(page, ground, open_view, view, wanted):
    open_view(page, view)
    expect(page.locator(SHOWN[view]).first).to_be_visible()
    button = page.locator("main").get_by_role("button", name=wanted, exact=True).last
    expect(button).to_be_enabled()
    page.locator("main").focus()
    passed = []
    for _ in range(200):
        page.keyboard.press("Tab")
        if button.evaluate("node => node === document.activeElement"):
            break
        passed.append(page.evaluate("document.activeElement.outerHTML.slice(0, 60)"))
    else:
        raise AssertionError(passed[-20:])
    expect(button).to_be_focused()
    outline = "node => getComputedStyle(node).outlineStyle !== 'none' || getComputedStyle(node).boxShadow !== 'none'"
    assert button.evaluate(outline), "the focus is seen"
    with page.expect_request(re.compile("/api/v1/")):
        page.keyboard.press("Enter")


def test_a_changed_uplot_is_not_served_and_the_page_shows_tables(new_page, browser, tmp_path):
    """A wheel of the same name whose files are others stands before the installed one."""
    wheel, held = tmp_path / "wheel", ("uplot.iife.min.js", "uplot.min.css")
    (wheel / "youplot").mkdir(parents=True)
    (wheel / "youplot-1.0.0.dist-info").mkdir()
    (wheel / "youplot-1.0.0.dist-info/METADATA").write_text("Metadata-Version: 2.1\nName: youplot\nVersion: 1.0.0\n")
    listed = io.StringIO()
    for name in held:
        content = b"document.title = 'not uPlot';"
        (wheel / "youplot" / name).write_bytes(content)
        csv.writer(listed).writerow([f"youplot/{name}", f"sha256={sha256(content).hexdigest()}", len(content)])
    (wheel / "youplot-1.0.0.dist-info/RECORD").write_text(listed.getvalue())
    database = tmp_path / "soo.db"
    seed_archive(f"sqlite:///{database}", record("yamal-202"))
    paths = os.pathsep.join(filter(None, (str(wheel), os.environ.get("PYTHONPATH", ""))))
    with serving_on(database, {**os.environ, "PYTHONPATH": paths}) as service:
        context = browser.new_context(base_url=service.url, locale="en")
        assert "is not that of uPlot 1.6.31" in service.written()
        assert context.request.post("/api/v1/session", data={"key": KEY}).ok
        page = context.new_page()
        page.goto("/console/#/history?span=3600")
        expect(page.get_by_role("table", name="Angles of both methods")).to_be_visible()
        expect(page.locator(".history-status")).to_contain_text("soo[console]")
        assert "not uPlot" not in page.title()
        context.close()


def test_a_new_plan_while_somebody_looks_is_shown_on_now_with_its_first_row(page, ground, open_view, fits):
    """One carrier, then 128: the strip is that of the plan of the newest row, and nothing has to be scrolled."""
    path = "/api/v1/spacecraft/yamal-two"
    first = ground.get("/carriers")["carriers"][1]

    def put(count):
        carriers = [first | {"id": f"x{k:03d}"} for k in range(count)]
        made = ground.client.put(f"{path}/carriers", json={"carriers": carriers})
        assert made.is_success, made.text
        return made.json()["plan_id"]

    def send(plan_id, count, ahead_s):
        row = {"epoch": ground.epoch(ahead_s), "power_dbm": [-50.0] * count}
        body = {"plan_id": plan_id, "source": "sa-2", "measurements": [row]}
        assert ground.client.post(f"{path}/measurements:batch", json=body).json()["accepted"] == 1

    send(put(1), 1, 60)
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option("yamal-two")
    chips = page.locator(".strip li:not(.count)")
    expect(chips).to_have_count(1)
    assert fits(page)
    plan_id = put(128)
    send(plan_id, 128, 120)
    expect(chips).to_have_count(128)
    assert fits(page)
    edges = "({ x, y, right, bottom }) => [x, y, right, bottom]"
    boxes = f"nodes => nodes.map((node) => node.getBoundingClientRect()).map({edges})"
    drawn = chips.evaluate_all(boxes)
    inside = [box for box in drawn if box[3] <= 800.5 and box[2] <= 1280.5]
    assert len(inside) == 128, "each carrier is on the screen"
    overlaps = [
        (one, other)
        for k, one in enumerate(drawn)
        for other in drawn[k + 1 :]
        if one[0] < other[2] - 0.5 and other[0] < one[2] - 0.5 and one[1] < other[3] - 0.5 and other[1] < one[3] - 0.5
    ]
    assert overlaps == []


def test_archive_without_calibration_alignment_and_ephemeris_says_so(ground, new_page, open_view):
    document = ground.client.get(ground.base).json() | {"id": "bare", "name": "bare"}
    document.pop("warnings", None)
    assert ground.client.post("/api/v1/spacecraft", json=document).is_success
    page = new_page(allowed=(404, 409, 422))
    page.add_init_script('localStorage.setItem("soo.spacecraft", "bare")')
    open_view(page, "control")
    expect(page.locator("[data-code=not_aligned][data-met=false]")).to_be_visible()
    page.get_by_label("Reason", exact=True).fill("none")
    page.get_by_role("button", name="Look first").click()
    refused = page.locator(".prepare").get_by_role("alert")
    expect(refused).to_be_visible()
    assert not re.search(r"\b[a-z]+[._][a-z_.]+\b \(", refused.inner_text()), "a code without words"
    open_view(page, "calibration")
    view = page.locator(".calibration")
    expect(view).to_contain_text("There is no calibration yet.")
    expect(view).to_contain_text("There is no alignment yet.")
    open_view(page, "now")
    expect(page.get_by_role("heading", level=1)).to_contain_text("no row has come yet; no torque")
