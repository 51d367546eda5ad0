"""View Now: the sentence, the axes, what is old, what is excluded, and what is hostile, on one screen."""

import re

import pytest
from playwright.sync_api import expect
from release_ground import record

HOSTILE = "<img src=x onerror=alert(1)>\u202e" + "long " * 40
CRAFTS = (record("yamal-202"), record("zeta", name=HOSTILE[:100]))

#: a path with points
CURVE = re.compile(r"^M[\d.-]+ [\d.-]+L")


@pytest.mark.parametrize(("theme", "language"), [("dark", "en"), ("light", "ru")])
def test_the_sentence_and_the_axes_are_those_of_the_service(
    new_page, ground, open_view, screenshot, axe_violations, theme, language, fits
):
    page = open_view(new_page(theme=theme, language=language), "now")
    expect(page.get_by_role("heading", level=1)).to_contain_text(
        {
            "en": "torques may go, but the sign of yaw is not proven",
            "ru": "моменты разрешены, но знак рыскания не доказан",
        }[language]
    )
    row = ground.get("/attitude")
    for axis, name in (("roll", {"en": "Roll", "ru": "Крен"}), ("yaw", {"en": "Yaw", "ru": "Рыскание"})):
        shown = page.get_by_role("region", name=name[language], exact=True)
        text = f"{row[f'{axis}_deg']:.3f}".replace(".", "," if language == "ru" else ".")
        expect(shown.locator(".value")).to_have_text(text)
        expect(shown.locator(".hour .curve")).to_have_attribute("d", CURVE)
    assert fits(page)
    assert axe_violations(page) == []
    screenshot(page, f"now-{theme}-{language}")


def test_a_new_row_is_shown_and_the_limits_are_those_in_force(page, ground, open_view):
    open_view(page, "now")
    ground.rows(1, (0.0, 0.03, 0.0))
    row = ground.get("/attitude")
    roll = page.get_by_role("region", name="Roll", exact=True)
    expect(roll.locator(".value")).to_have_text(f"{row['roll_deg']:.3f}")
    expect(roll.get_by_role("img", name="limit 0.40 deg")).to_be_visible()
    expect(roll).to_contain_text(f"{row['protection_deg']['roll']:.3f} of 0.22")
    expect(page.locator(".strip .count")).to_have_text("12 of 12 used")


def test_an_operation_that_inhibits_is_the_reason_and_its_comment_is_text(page, ground, open_view, screenshot, fits):
    open_view(page, "now")
    body = {"kind": "station_keeping", "start": ground.epoch(30.0), "stop": ground.epoch(600.0)}
    made = ground.post("/operations", {**body, "inhibit_control": True, "comment": HOSTILE}, status=201)
    ground.rows(1, (0.0, 0.03, 0.0))
    expect(page.get_by_role("heading", level=1)).to_contain_text("no torque: a declared operation forbids torques")
    page.reload()
    expect(page.get_by_role("region", name="Operation", exact=True)).to_contain_text("station keeping")
    expect(page.get_by_text("<img src=x onerror=alert(1)>", exact=False).first).to_be_attached()
    expect(page.locator("main img")).to_have_count(0)
    assert fits(page)
    screenshot(page, "now-operation")
    # every reason, each with its next step, stands behind the sentence
    page.get_by_role("heading", level=1).get_by_role("link").click()
    expect(page.locator(".conditions [data-met=false]").first).to_contain_text("declared operation")
    ended = ground.client.patch(f"{ground.base}/operations/{made['id']}", json={"stop": ground.epoch(60.0)})
    assert ended.is_success, ended.text


def test_an_empty_archive_says_so_and_its_hostile_name_is_text(page, open_view, screenshot, axe_violations, fits):
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option("zeta")
    expect(page.get_by_role("heading", level=1)).to_contain_text("no row has come yet; no torque")
    expect(page.locator(".gauge.is-stale")).to_have_count(3)
    expect(page.get_by_role("region", name="Roll", exact=True)).to_contain_text("no row")
    expect(page.locator("header img")).to_have_count(0)
    assert fits(page)
    assert axe_violations(page) == []
    screenshot(page, "now-empty")


def test_a_hundred_and_twenty_eight_carriers_stay_on_the_screen(page, ground, open_view, screenshot, fits):
    plan = ground.client.get("/api/v1/spacecraft/zeta/carriers").json()
    carriers = [each for each in plan["carriers"] if each["band"] == "Ku"]
    many = [{**carriers[k % len(carriers)], "id": f"carrier-{k:03d}"} for k in range(128)]
    made = ground.client.put("/api/v1/spacecraft/zeta/carriers", json={"carriers": many})
    assert made.is_success, made.text
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option("zeta")
    expect(page.locator(".strip .count")).to_have_text("0 of 128 used")
    assert fits(page)
    screenshot(page, "now-128")


def test_a_wall_is_one_screen_without_controls(new_page, ground, open_view, screenshot, fits):
    page = open_view(new_page(viewport={"width": 1920, "height": 1080}), "now", "?wall=1")
    expect(page.get_by_role("heading", level=1)).to_be_visible()
    expect(page.get_by_role("button")).to_have_count(0)
    assert fits(page)
    size = page.locator(".gauge .value").first.evaluate("node => parseFloat(getComputedStyle(node).fontSize)")
    assert size >= 60, "numbers are read from five metres"
    screenshot(page, "now-wall")


@pytest.mark.parametrize("options", [{"reduced_motion": "reduce"}, {"forced_colors": "active"}])
def test_motion_and_colours_of_the_system_are_kept(new_page, ground, open_view, axe_violations, options):
    page = open_view(new_page(**options), "now")
    expect(page.get_by_role("heading", level=1)).to_be_visible()
    assert axe_violations(page) == []


def test_at_twice_the_size_everything_can_be_reached_by_keyboard(new_page, ground, open_view):
    page = open_view(new_page(viewport={"width": 640, "height": 400}), "now")
    assert page.evaluate("document.body.scrollWidth <= innerWidth"), "200 % of 1280 needs no sideways scroll"
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="To the view")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
