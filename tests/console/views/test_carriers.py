"""Carriers: table, curves, map, one carrier; who is down, in words; plans of any size, names that mean harm."""

import json

import pytest
from playwright.sync_api import expect
from release_ground import MINUTE

from service.records.epoch import format_epoch

HOSTILE = "<img src=x onerror=alert(1)>\u202egnp.\u2066" + "w" * 150
EXPECTED = {"en": "All 12 carriers are as expected.", "ru": "Все 12 несущих в норме."}


def send(ground, craft, plan_id, powers, now_us):
    """Send one row of powers, None = absent."""
    row = {"epoch": format_epoch(now_us), "power_dbm": powers}
    path = f"/api/v1/spacecraft/{craft}/measurements:batch"
    answer = ground.client.post(path, json={"plan_id": plan_id, "source": "sa-1", "measurements": [row]})
    assert answer.json()["accepted"] == 1, answer.text


def new_craft(ground, name):
    """Add a spacecraft with nothing but its entry, in the pattern of the first."""
    document = ground.client.get(ground.base).json() | {"id": name, "name": HOSTILE}
    document.pop("warnings", None)
    assert ground.client.post("/api/v1/spacecraft", json=document).is_success


def put_plan(ground, craft, count, name=""):
    """Put a plan of some carriers; return its number."""
    first = ground.get("/carriers")["carriers"][1]
    carriers = [
        first
        | {"id": f"x{k:03d}", "name": name, "transponder": f"t{k // 4}"}
        | {"station": {"name": name or f"site {k}", "latitude_deg": 55.0 - k % 40, "longitude_deg": 20.0 + k / 2}}
        for k in range(count)
    ]
    answer = ground.client.put(f"/api/v1/spacecraft/{craft}/carriers", json={"carriers": carriers})
    assert answer.is_success, answer.text
    return answer.json()["plan_id"]


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_every_form_in_each_theme_and_language(
    new_page, ground, open_view, screenshot, axe_violations, theme, language
):
    page = open_view(new_page(theme=theme, language=language), "carriers")
    expect(page.locator(".verdict")).to_contain_text(EXPECTED[language])
    expect(page.locator("tbody tr")).to_have_count(12)
    expect(page.locator(".map .arrow")).to_have_count(12)
    assert axe_violations(page) == []
    screenshot(page, f"carriers-{theme}-{language}")
    open_view(page, "carriers", "?form=multiples")
    expect(page.locator(".multiples .trace")).to_have_count(24)
    assert axe_violations(page) == []
    screenshot(page, f"carriers-curves-{theme}-{language}")
    open_view(page, "carriers", "?carrier=c03&hours=1")
    expect(page.locator(".traces .line.model").first).to_be_visible()
    expect(page.locator(".map .chosen")).to_be_visible()
    assert axe_violations(page) == []
    screenshot(page, f"carrier-{theme}-{language}")


def test_one_user_down_is_said_sorted_and_found_by_keyboard(page, ground, open_view, screenshot):
    open_view(page, "carriers")
    expect(page.locator(".verdict")).to_contain_text(EXPECTED["en"])
    newest = {each["carrier"]: each["power_dbm"] for each in ground.get("/measurements")}
    for _ in range(3):
        ground.now_us += MINUTE
        powers = [None if name == "c05" else level for name, level in newest.items()]
        send(ground, ground.spacecraft_id, 1, powers, ground.now_us)
    ground.settle()
    expect(page.locator(".verdict")).to_contain_text("One of 12 is down: c05. The others are as expected.")
    first = page.locator("tbody tr").first
    expect(first).to_contain_text("c05")
    expect(first).to_contain_text("absent")
    expect(first.locator("td.figure").first).to_have_text("–")
    screenshot(page, "carriers-one-down")
    heading = page.get_by_role("button", name="Carrier", exact=True)
    heading.focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    expect(page.locator("th[aria-sort=descending]")).to_have_text("Carrier")
    expect(first).to_contain_text("c11")
    page.get_by_role("link", name="c05").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="c05")).to_be_visible()
    expect(page.get_by_text("yaw", exact=False).first).to_be_visible()
    page.get_by_role("link", name="All carriers").click()
    expect(page.locator("tbody tr")).to_have_count(12)


def test_an_empty_archive_one_and_128_carriers_and_a_new_plan_while_somebody_looks(
    page, ground, open_view, screenshot, axe_violations
):
    """Without calibration, alignment and ephemeris; names are text, whatever they say."""
    new_craft(ground, "zz-bare")
    put_plan(ground, "zz-bare", 1)
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option("zz-bare")
    open_view(page, "carriers")
    expect(page.locator(".verdict")).to_contain_text("Waiting for the first row")
    expect(page.get_by_text("No row has come yet.")).to_be_visible()
    expect(page.locator("tbody tr")).to_have_count(1)
    screenshot(page, "carriers-empty")
    send(ground, "zz-bare", 1, [-50.0], ground.now_us)
    expect(page.locator("tbody tr")).to_contain_text("-50.00")
    expect(page.get_by_text("No calibration is in force", exact=False)).to_be_visible()
    plan_id = put_plan(ground, "zz-bare", 128, HOSTILE)
    send(ground, "zz-bare", plan_id, [None if k % 3 == 0 else -50.0 - k for k in range(128)], ground.now_us + MINUTE)
    expect(page.locator("tbody tr")).to_have_count(128)
    expect(page.locator("main").get_by_text("<img src=x", exact=False).first).to_be_visible()
    assert page.locator("main img").count() == 0
    assert axe_violations(page) == []
    screenshot(page, "carriers-128")
    open_view(page, "carriers", "?form=multiples")
    expect(page.locator(".multiples li")).to_have_count(128)
    open_view(page, "carriers", "?carrier=x%20%3Cb%3E")
    expect(page.get_by_role("heading", name="x <b>")).to_be_visible()
    gone = f"Plan {plan_id}, which is in force now, has no such carrier."
    expect(page.get_by_text(gone, exact=False)).to_be_visible()


def test_refusals_are_said_and_the_view_goes_on(new_page, ground, open_view):
    page = new_page(allowed=(429, 503))
    refusal = {"code": "rate_limit.exceeded", "detail": "too many requests"}
    page.route(
        "**/measurements",
        lambda route: route.fulfill(
            status=429, content_type="application/problem+json", headers={"Retry-After": "2"}, body=json.dumps(refusal)
        ),
    )
    open_view(page, "carriers")
    expect(page.locator("main").get_by_role("alert")).to_contain_text("Try again in 2 s.")
    page.unroute("**/measurements")
    ground.rows(1)
    expect(page.locator("tbody tr")).to_have_count(12)
    expect(page.locator("main").get_by_role("alert")).to_have_count(0)


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_about(new_page, ground, open_view, screenshot, axe_violations, theme, language):
    page = open_view(new_page(theme=theme, language=language), "about")
    expect(page.locator("tr.changed", has_text="SOO_CLOCK")).to_contain_text("data")
    expect(page.get_by_role("row", name="starlette")).to_be_visible()
    assert "(set)" in page.get_by_role("row", name="SOO_BOOTSTRAP_KEY").inner_text()
    assert axe_violations(page) == []
    screenshot(page, f"about-{theme}-{language}")
    if (theme, language) == ("dark", "en"):
        page.locator("summary").focus()
        page.keyboard.press("Enter")
        expect(page.get_by_role("row", name="SOO_INTERLOCK__VALIDITY_LIMIT_DEG")).to_contain_text("deg")
        # at twice the size nothing is lost sidewards
        page.set_viewport_size({"width": 640, "height": 400})
        assert page.evaluate("document.documentElement.scrollWidth") <= 640


#: carriers down, state of those, newest row: the sentence
WHOM = [
    ([], "used", {}, "All 6 carriers are as expected."),
    (["a0", "a1", "a2", "b0", "b1", "b2"], "uncalibrated", {}, "All 6 carriers are on the air; without a calibration"),
    (["a0"], "absent", {}, "One of 6 is down: a0. The others are as expected."),
    (["a0", "b1"], "excluded", {}, "2 of 6 are down: a0, b1."),
    (["a0", "a1", "a2"], "excluded", {}, "Transponder A is down: all its 3 carriers, and no other."),
    (["a0", "b0"], "absent", {}, "Station s0 is down: all its 2 carriers, and no other."),
    (["a0", "a1", "a2", "b0", "b1", "b2"], "absent", {}, "All 6 carriers are down: look at this site's"),
    (["a0", "a1", "a2", "b0", "b1"], "absent", {}, "5 of 6 are down: a0, a1, a2, b0, b1."),
    ([], "used", {"common_db": -4.12, "inhibitions": ["common_change"]}, "All carriers are 4.1 dB low: rain over"),
    (["a0"], "absent", {"downlink_fade": True, "downlink_fade_db": 2.5}, "All carriers are 2.5 dB low"),
    (["a0"], "absent", {"common_db": -4.12, "downlink_fade_db": None, "inhibitions": None}, "One of 6 is down: a0."),
]


def test_whom_a_loss_concerns_is_said_in_words(page, ground, open_view):
    """All, one transponder, one station, single users; rain over the site before all of them."""
    open_view(page, "carriers")
    carriers = [
        {"id": f"{letter}{k}", "transponder": letter.upper(), "station": {"name": f"s{k}"}}
        for letter in "ab"
        for k in range(3)
    ]
    said = """async ([carriers, states, attitude]) => {
        const { affected } = await import("/console/views/carriers/affected.js");
        const { affectedWords } = await import("/console/views/carriers.js");
        return affectedWords(affected(carriers, new Map(states), attitude));
    }"""
    for down, state, row, expected in WHOM:
        states = [[each["id"], {"state": state if each["id"] in down else "used"}] for each in carriers]
        assert page.evaluate(said, [carriers, states, row]).startswith(expected)
    assert page.evaluate(said, [carriers, [], None]) == "Waiting for the first row"
