"""The view Calibration: windows dragged and written, a fit from its job to its activation, alignment, carriers."""

import re
import urllib.parse

import numpy as np
import pytest
from geometry_flight import HOUR, MINUTE, START_US
from playwright.sync_api import expect
from release_ground import NOISE_DB, PAYLOAD, ReleaseGround, record

from service.records.epoch import format_epoch
from service.records.operations.access import Role

CRAFTS = (record("yamal-202"), record("yamal-empty"))
HOSTILE = "<img src=x onerror=alert(1)>\u202e" + "x" * 900
QUIET_HOURS, TURN_HOURS = 26, 6
QUIET_US = START_US
TURNS_US = QUIET_US + QUIET_HOURS * HOUR
TURNS_END_US = TURNS_US + TURN_HOURS * HOUR
SIGMA_DEG = {"yaw": 0.01, "roll": 0.005, "pitch": 0.005}


def flown():
    """Return epochs of quiet hours and of turns of each axis to both sides, and the attitude at each."""
    quiet_us = QUIET_US + 6 * MINUTE * np.arange(QUIET_HOURS * 10)
    turns_us = TURNS_US + 2 * MINUTE * np.arange(TURN_HOURS * 30)
    turned = np.zeros((len(turns_us), 3))
    for k, part in enumerate(np.array_split(np.arange(len(turns_us)), 6)):
        turned[part, k % 3] = (0.5 if k < 3 else -0.5) * np.sin(np.linspace(0, np.pi, len(part)))
    return np.concatenate([quiet_us, turns_us]), np.vstack([np.zeros((len(quiet_us), 3)), turned])


@pytest.fixture(scope="module")
def ground(service):
    """Give a station that has flown quiet hours and turns with a star tracker, and is aligned and armed."""
    epochs_us, angles_deg = flown()
    with service.client() as client:
        station = ReleaseGround(client, "yamal-202")
        power = PAYLOAD.power_dbm(epochs_us, angles_deg)
        station.send(epochs_us, power + NOISE_DB * np.random.default_rng(16).normal(size=power.shape))
        readings = [
            {
                "epoch": format_epoch(int(at)),
                "yaw_deg": yaw,
                "roll_deg": roll,
                "pitch_deg": pitch,
                "sigma_deg": SIGMA_DEG,
            }
            for at, (yaw, roll, pitch) in zip(epochs_us, angles_deg.tolist(), strict=True)
        ]
        station.post("/attitude-references:batch", {"source": "star_tracker", "references": readings})
        ends = {"start": format_epoch(TURNS_US), "stop": format_epoch(TURNS_END_US)}
        station.post("/operations", {"kind": "calibration_turn", "comment": HOSTILE, **ends}, status=201)
        station.now_us = TURNS_END_US + HOUR
        station.align()
        station.rows(15)
        station.post("/control:arm")
        yield station


def ready(page):
    """Wait until the readings are drawn and the calibrations are listed, and return the view."""
    expect(page.locator(".windows[aria-busy=false]")).to_be_visible()
    expect(page.locator(".calibration .report")).to_be_visible()
    return page.locator(".calibration")


def written(instant_us):
    return format_epoch(instant_us)[:16].replace("T", " ")


def write_windows(view, quiet_us=QUIET_US):
    view.get_by_label("Quiet days: start").fill(written(quiet_us))
    view.get_by_label("Quiet days: stop").fill(written(TURNS_US))
    view.get_by_label("Turns: start").fill(written(TURNS_US))
    view.get_by_label("Turns: stop").fill(written(TURNS_END_US))


def span_of(page, view, name):
    """Return the ends of a window as the plot shows them, share of the plot."""
    mark, over = (view.locator(each).first.bounding_box() for each in (f".mark.{name}", ".u-over"))
    return [(mark["x"] + side - over["x"]) / over["width"] for side in (0.0, mark["width"])]


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_the_view_in_each_theme_and_language(new_page, ground, open_view, screenshot, axe_violations, theme, language):
    page = open_view(new_page(theme=theme, language=language), "calibration")
    view = ready(page)
    expect(view.locator("canvas")).to_have_count(3)
    expect(view.locator(".report tbody tr")).to_have_count(12)
    assert axe_violations(page) == []
    page.set_viewport_size({"width": 1280, "height": 2400})
    screenshot(page, f"calibration-{theme}-{language}")


def test_windows_are_dragged_or_written_and_plot_and_fields_stay_equal(page, open_view):
    view = ready(open_view(page, "calibration"))
    box = view.locator(".u-over").first.bounding_box()
    middle = box["y"] + box["height"] / 2
    view.get_by_role("button", name="Turns", exact=True).click()
    page.mouse.move(box["x"] + 0.5 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.75 * box["width"], middle, steps=4)
    page.mouse.up()
    expect(view.locator(".mark.turns")).to_be_visible()
    assert span_of(page, view, "turns") == pytest.approx([0.5, 0.75], abs=0.01)
    start, stop = (view.get_by_label(f"Turns: {end}").input_value() for end in ("start", "stop"))
    assert "2027-01-15 08" < start < stop < "2027-01-17"
    expect(view.locator(".mark.quiet")).to_have_count(0)
    view.get_by_role("button", name="As declared").click()
    expect(view.get_by_label("Turns: start")).to_have_value(re.compile(written(TURNS_US)))
    declared = span_of(page, view, "turns")
    write_windows(view)
    assert span_of(page, view, "turns") == pytest.approx(declared, abs=0.002)
    quiet = span_of(page, view, "quiet")
    assert quiet[1] == pytest.approx(declared[0], abs=0.002)
    expect(view.locator("form").first).to_contain_text("shorter than 2 days 21 hr")
    view.get_by_role("button", name="Span shown").click()
    view.get_by_role("button", name="Zoom out").click()
    ready(page)
    wide = span_of(page, view, "quiet")
    assert wide[1] - wide[0] == pytest.approx((quiet[1] - quiet[0]) / 2, abs=0.01)


def test_a_fit_goes_from_its_windows_to_its_activation_in_the_browser(page, ground, open_view, screenshot):
    view = ready(open_view(page, "calibration"))
    write_windows(view)
    view.get_by_label("Method", exact=True).select_option("paper")
    view.get_by_role("button", name="Start the calibration").click()
    expect(view.get_by_text("is complete")).to_be_visible()
    made = ground.get("/calibrations")["rows"][0]
    assert (made["state"], made["method"], made["sources"]["yaw"]) == ("draft", "paper", "star_tracker")
    report = view.get_by_role("region", name="Report")
    expect(report).to_contain_text(f"Report of calibration {made['id']}")
    rows = report.locator("tbody tr")
    expect(rows).to_have_count(len(made["carriers"]))
    for k, carrier in enumerate(made["carriers"]):
        figures = [carrier["sensitivity_db_per_deg"][axis] for axis in ("yaw", "roll", "pitch")]
        for column, value in enumerate(figures):
            expect(rows.nth(k).locator("td").nth(1 + column)).to_have_text(f"{round(value, 3) + 0.0:.3f}")
        expect(rows.nth(k).locator("td").last).to_contain_text("selected" if carrier["selected"] else "left out")
    for warning in made["quality"]["warnings"]:
        expect(report.locator(".warnings")).to_contain_text(warning)
    page.set_viewport_size({"width": 1280, "height": 2400})
    screenshot(page, "calibration-report")
    row = view.locator("tr", has_text=f"No. {made['id']}").first
    row.get_by_role("button", name="Activate").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("No calibration of its method is active now.")
    expect(dialog).to_contain_text("Methods that compute with it: published.")
    expect(dialog).not_to_contain_text("it trips")
    screenshot(page, "calibration-activate")
    dialog.get_by_role("button", name="Activate").click()
    expect(row).to_contain_text("active")
    assert ground.get(f"/calibrations/{made['id']}")["state"] == "active"


def test_the_report_stands_beside_the_active_one_and_activation_says_that_control_trips(new_page, ground, open_view):
    """The list is another: a draft by geometry that differs from the active one, with nulls wherever they may be."""
    page = new_page()
    [active] = [each for each in ground.get("/calibrations")["rows"] if each["method"] == "geometry"]
    first, second, *rest = active["carriers"]
    nothing = {"yaw": None, "roll": None, "pitch": None}
    other = {**first, "selected": False, "criteria_met": ["linear"], "rejected_because": [HOSTILE], "residual_db": None}
    bare = {**second, "id": HOSTILE, "sensitivity_db_per_deg": nothing, "axis": "mixed"}
    quality = {"warnings": [HOSTILE], "yaw_sign": "unproven", "common_sign": None, "turns": "contradicted"}
    draft = {**active, "id": 99, "state": "draft", "carriers": [other, bare, *rest], "quality": quality}
    draft["observability"] = {"condition": None, "dop": nothing, "crlb_deg": nothing}
    page.route(re.compile("/calibrations$"), lambda route: route.fulfill(json={"rows": [draft, active]}))
    orders = []
    page.route(
        re.compile("/calibrations/99:activate$"),
        lambda route: (orders.append(route.request.post_data_json), route.fulfill(json=draft)),
    )
    view = ready(open_view(page, "calibration"))
    report = view.get_by_role("region", name="Report")
    expect(report).to_contain_text(f"beside active calibration {active['id']}")
    row = report.locator("tbody tr").first
    expect(row).to_contain_text("left out; the active one selects it; not stable, no dominant axis")
    expect(row).to_contain_text(f"active: {first['residual_db']:.3f}")
    expect(report.locator("tbody tr", has_text=second["id"])).to_contain_text("not in this calibration")
    expect(report.locator(".warnings")).to_contain_text("<img src=x")
    assert page.locator("main img").count() == 0
    view.get_by_role("button", name="Activate").first.click()
    dialog = page.get_by_role("dialog")
    for said in (
        "takes the place of calibration",
        "No longer selected: c00",
        "the method paper will not control it",
        "1 warning",
    ):
        expect(dialog).to_contain_text(said)
    expect(dialog).to_contain_text("Control is armed: it trips")
    assert page.locator("dialog img").count() == 0
    expect(report).to_contain_text("Turns against the powers")
    dialog.get_by_role("button", name="Activate").click()
    assert orders == []
    dialog.get_by_label("Reason to activate it").fill("the clock is right, the rows were late")
    dialog.get_by_role("button", name="Activate").click()
    expect(dialog).to_have_count(0)
    assert orders == [{"override_reason": "the clock is right, the rows were late"}]


def test_windows_that_the_service_refuses_are_told_in_words(new_page, ground, open_view):
    view = ready(open_view(new_page(allowed=(422,)), "calibration"))
    write_windows(view, TURNS_US + HOUR)
    start = view.get_by_role("button", name="Start the calibration")
    start.click()
    expect(view.locator(".said").first).to_contain_text("start must lie before stop")
    write_windows(view, QUIET_US - 150 * 24 * HOUR)
    start.click()
    expect(view.locator(".said").first).to_contain_text("at most 100 days")


def test_an_alignment_says_what_it_will_do_and_what_it_did(page, ground, open_view, screenshot):
    view = ready(open_view(page, "calibration"))
    form = view.get_by_role("form", name="Align")
    form.get_by_label("Alignment: start").fill(written(TURNS_US - HOUR))
    form.get_by_label("Alignment: stop").fill(written(TURNS_US))
    form.get_by_label("Reason to override").fill(HOSTILE)
    form.get_by_role("button", name="Look, then align").click()
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("rows that an earlier alignment computed stay")
    expect(dialog).to_contain_text("has a later epoch")
    dialog.get_by_role("button", name="Align", exact=True).click()
    expect(form.locator(".said")).to_contain_text("holds from")
    made = ground.get("/alignments")["rows"][0]
    assert made["override_reason"] == HOSTILE
    expect(form.locator(".said")).to_contain_text(f"Alignment {made['id']}")
    expect(form.locator(".said")).to_contain_text("keep those of an earlier alignment")
    angles = ", ".join(f"{axis} {made[f'{axis.lower()}_deg'] + 0.0:.3f}" for axis in ("Yaw", "Roll", "Pitch"))
    expect(form.locator(".said")).to_contain_text(angles)
    listed = view.locator("tr", has_text="Overridden:")
    expect(listed).to_contain_text("star tracker")
    expect(listed).to_contain_text(angles)
    assert page.locator("main img").count() == 0
    form.get_by_role("button", name="Angles by hand").click()
    form.get_by_label("Epoch").fill(written(ground.now_us))
    for label in ("Yaw", "Roll", "Pitch"):
        form.get_by_label(f"{label}, deg").fill("0")
        form.get_by_label(f"{label}: sigma").fill("0.01")
    form.get_by_role("button", name="Look, then align").click()
    page.get_by_role("dialog").get_by_role("button", name="Align", exact=True).click()
    expect(form.locator(".said")).to_contain_text(f"Alignment {made['id'] + 1}")
    assert ground.get("/alignments")["rows"][0]["source"] == "manual"


def test_a_sensor_without_readings_is_refused_in_words(new_page, ground, open_view):
    page = new_page(allowed=(422,))
    view = ready(open_view(page, "calibration"))
    view.get_by_label("Roll by").select_option("earth_sensor")
    form = view.get_by_role("form", name="Align")
    form.get_by_label("Alignment: start").fill(written(TURNS_US - HOUR))
    form.get_by_label("Alignment: stop").fill(written(TURNS_US))
    form.get_by_role("button", name="Look, then align").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_role("button", name="Align", exact=True).click()
    expect(dialog.get_by_role("alert")).to_contain_text("The window holds no reading of the sensor.")
    expect(dialog.get_by_role("alert")).to_contain_text("earth_sensor")


def test_carriers_and_turns_are_recommended(new_page, ground, open_view, axe_violations):
    page = new_page(allowed=(422,))
    view = ready(open_view(page, "calibration"))
    form = view.get_by_role("form", name="Carriers and turns")
    form.get_by_label("Carriers wanted").fill("8")
    form.get_by_label("Turns", exact=True).select_option("standard")
    form.get_by_label("Turns start at").fill("2027-02-01T06:00")
    form.get_by_role("button", name="Recommend").click()
    answer = ground.get("/carrier-selection?" + urllib.parse.urlencode({"rule": "optimal", "count": 8}))
    expect(view.get_by_text(", ".join(answer["selected"]), exact=True)).to_be_visible()
    turns = view.get_by_role("group", name="Turns", exact=True).last
    expect(turns.locator("tbody tr").first).to_contain_text("2027-02-01 06:00:00")
    expect(view.get_by_role("group", name="Sets of carriers")).to_contain_text("Bound after averaging")
    assert axe_violations(page) == []
    form.get_by_label("Carriers wanted").fill("500")
    form.get_by_role("button", name="Recommend").click()
    expect(view.get_by_role("alert")).to_contain_text("More carriers than the calibration has.")


def test_who_may_not_operate_looks(new_page, ground, open_view):
    view = ready(open_view(new_page(key=ground.key("Vera", Role.VIEWER)), "calibration"))
    for name in ("Start the calibration", "Look, then align", "Activate", "As declared"):
        expect(view.get_by_role("button", name=name)).to_have_count(0)
    expect(view.get_by_role("button", name="Recommend")).to_be_visible()
    operator = ready(open_view(new_page(key=ground.key("Olga", Role.OPERATOR)), "calibration"))
    expect(operator.get_by_role("button", name="Look, then align")).to_be_visible()
    expect(operator.get_by_role("button", name="Angles by hand")).to_have_count(0)


@pytest.mark.parametrize(("status", "code"), [(503, "storage.unavailable"), (429, "rate.limited")])
def test_a_refusal_is_told_and_asked_again(new_page, ground, open_view, status, code):
    page = new_page(allowed=(status,))
    problem = {"status": status, "code": code, "title": "no", "detail": "not now"}
    refused = re.compile("/(attitude-references|calibrations|alignments)")
    page.route(refused, lambda route: route.fulfill(status=status, json=problem, headers={"Retry-After": "7"}))
    view = open_view(page, "calibration").locator(".calibration")
    expect(view.get_by_role("alert")).to_have_count(3)
    expect(view.get_by_role("alert").first).to_contain_text("7 s")
    page.unroute_all()
    for left in (2, 1, 0):
        view.get_by_role("button", name="Read again").first.click()
        expect(view.get_by_role("alert")).to_have_count(left)
    ready(page)


def test_a_job_that_has_no_answer_for_a_while_is_asked_again_and_a_fit_that_fails_says_why(new_page, ground, open_view):
    page = new_page(allowed=("ERR_FAILED",))
    view = ready(open_view(page, "calibration"))
    write_windows(view)
    view.get_by_label("Turns: stop").fill(written(TURNS_US + 2 * MINUTE))
    view.get_by_label("Method", exact=True).select_option("paper")
    page.route("**/jobs/*", lambda route: route.abort())
    view.get_by_role("button", name="Start the calibration").click()
    expect(view.locator(".said").first.get_by_role("alert")).to_be_visible()
    page.unroute_all()
    expect(view.locator(".said").first).to_contain_text("failed")
    expect(view.locator(".said").first.get_by_role("alert")).to_have_count(0)
    expect(view.get_by_role("region", name="Report")).to_contain_text(ground.get("/calibrations")["rows"][0]["error"])


def test_a_running_job_is_found_again_after_the_view_was_left(page, ground, open_view):
    """The service answers for a fit that takes as long as the test wants."""
    progress = {"state": "running", "progress": 0.25}

    def calibrations(route):
        found = route.fetch()
        rows = found.json()["rows"]
        if progress["state"] == "running":
            first = {"state": "draft", "observability": None, "carriers": [], "job": "calibration-0"}
            rows = [{**rows[0], "id": 99, **first}, *rows]
        route.fulfill(response=found, json={"rows": rows})

    page.route("**/calibrations", calibrations)
    page.route("**/jobs/calibration-0", lambda route: route.fulfill(json={**progress, "error": None}))
    view = ready(open_view(page, "calibration"))
    bar = view.get_by_role("progressbar")
    expect(bar).to_have_attribute("value", "0.25")
    page.get_by_role("link", name="Now").click()
    expect(view).to_have_count(0)
    progress["progress"] = 0.5
    page.get_by_role("link", name="Calibration").click()
    expect(bar).to_have_attribute("value", "0.5")
    progress.update(state="done", progress=1.0)
    expect(view.locator(".said").first).to_contain_text("is complete")
    expect(bar).to_have_count(0)
    page.unroute_all()


def test_an_empty_archive_says_what_is_missing(new_page, ground, open_view):
    page = new_page()
    page.add_init_script('localStorage.setItem("soo.spacecraft", "yamal-empty")')
    for name in ("calibrations", "alignments"):
        page.route(f"**/{name}", lambda route: route.fulfill(json={"rows": []}))
    page.goto("/console/#/calibration")
    view = page.locator(".calibration")
    expect(view.locator(".windows[aria-busy=false]")).to_be_visible()
    expect(view.locator(".windows")).to_contain_text("No sensor has sent readings in this span")
    expect(view).to_contain_text("There is no calibration yet.")
    expect(view).to_contain_text("There is no alignment yet.")
    expect(view.get_by_role("button", name="As declared")).to_be_disabled()
