"""The control view and Stop: a torque goes from dry run to report in the browser, and every refusal has words."""

import re

import pytest
from playwright.sync_api import expect
from release_ground import ReleaseGround, record, until

from service.records.epoch import parse_epoch
from service.records.operations.access import Role

CRAFTS = (record("yamal-202"), record("yamal-empty"), record("yamal-signs"))
HOSTILE = "<img src=x onerror=alert(1)> \u202egnorw " + "long " * 150


@pytest.fixture
def anna(ground, new_page, open_view):
    """Give the control view as the operator Anna sees it; control is armed, and nothing waits."""
    if ground.get("/control")["state"] == "TRIPPED":
        ground.post("/control:reset")
    for counter in ground.get("/control")["open_commands"]:
        ground.post(f"/torques/{counter}:cancel")
    if ground.get("/control")["state"] == "INHIBITED":
        ground.rows(12, (0.0, 0.03, 0.0))
        if not ground.get("/control")["armed"]:
            ground.post("/control:arm")
        until(lambda: bool(ground.get("/control")["state"] == "ARMED"), "control is armed")
    ground.rows(1, (0.0, 0.03, 0.0))
    page = new_page(key=ground.key("Anna", Role.OPERATOR), allowed=(403, 409, 410, "ERR_FAILED"))
    return open_view(page, "control")


def prepare(page, reason="roll is off"):
    page.get_by_label("Reason", exact=True).fill(reason)
    page.get_by_role("button", name="Prepare", exact=True).click()
    card = page.locator(".card.waiting")
    expect(card).to_be_visible()
    return card


def test_a_torque_goes_from_dry_run_to_report_in_the_browser(anna, ground, screenshot):
    boris = ground.key("Boris", Role.APPROVER)
    expect(anna.locator(".state.present")).to_have_text("ARMED")
    anna.get_by_label("Reason", exact=True).fill("roll is off")
    anna.get_by_role("button", name="Look first").click()
    expect(anna.get_by_text("Dry run: nothing is stored")).to_be_visible()
    expect(anna.locator(".prepare .pulses svg")).to_have_count(2)
    assert ground.get("/control")["open_commands"] == []
    card = prepare(anna)
    command = ground.get(f"/torques/{card.get_attribute('data-command')}")
    expect(card.locator(".digest")).to_have_text(command["digest"])
    expect(card.locator(".checks li")).to_have_count(len(command["checks"]))
    screenshot(anna, "control-prepared")
    card.get_by_label("Key of the second person").fill(boris)
    card.get_by_role("button", name="Confirm with this key").click()
    owed = anna.locator(".card.owed")
    expect(owed).to_contain_text("Boris")
    product = anna.context.request.get(owed.get_by_role("link").get_attribute("href")).json()
    assert (product["counter"], product["digest"]) == (command["id"], command["digest"])
    owed.get_by_role("button", name="Uplinked").click()
    expect(owed.get_by_role("button", name="Uplinked")).to_have_count(0)
    screenshot(anna, "control-sent")
    owed.get_by_role("button", name="Executed").click()
    expect(owed).to_have_count(0)
    history = anna.locator(f".control-history [data-command='{command['id']}']")
    expect(history).to_contain_text("Anna + Boris")
    history.locator("summary").click()
    expect(history.locator(".digest")).to_have_text(command["digest"])
    expect(history.locator(".pulses svg")).to_have_count(2)
    assert ground.get(f"/torques/{command['id']}")["state"] == "EXECUTED"


def test_predicted_angles_are_drawn_as_the_service_has_them(anna, ground):
    card = prepare(anna)
    angles = ground.get(f"/torques/{card.get_attribute('data-command')}")["predicted_angles"]
    plot = card.locator(".pulses svg").nth(1)
    values = {axis: [each["angle_change_deg"][axis] for each in angles] for axis in ("yaw", "roll", "pitch")}
    size = max(map(max, values.values())) - min(map(min, values.values()))
    heights = {}
    for axis, expected in values.items():
        points = [each.split(",") for each in plot.locator(f"polyline.line-{axis}").get_attribute("points").split()]
        assert len(points) == len(expected) == 61
        heights[axis] = [float(y) for _, y in points]
    # one scale for all axes, up is more; a place is rounded to a tenth of a pixel
    scale = (heights["roll"][0] - heights["roll"][-1]) / values["roll"][-1]
    assert scale > 0.0
    for axis, expected in values.items():
        drawn = [(heights[axis][0] - height) / scale for height in heights[axis]]
        assert drawn == pytest.approx(expected, abs=0.01 * size), axis
    assert f"{values['roll'][-1]:.3f}" in plot.locator("text").all_text_contents()


def test_without_predicted_angles_the_pulses_alone_are_drawn(anna, ground):
    def without(route):
        route.fulfill(json={**route.fetch().json(), "predicted_angles": None})

    anna.route(re.compile(r"/torques/\d+$"), without)
    card = prepare(anna)
    expect(card.locator(".pulses svg")).to_have_count(1)
    expect(card.locator(".pulses svg")).to_have_attribute("aria-label", re.compile("Torque"))


def test_what_confirms_nothing_is_refused_in_words(anna, ground):
    card = prepare(anna)
    counter = int(card.get_attribute("data-command"))

    def confirm(key):
        card.get_by_label("Key of the second person").fill(key)
        card.get_by_role("button", name="Confirm with this key").click()

    def refused(text):
        expect(card.get_by_role("alert")).to_contain_text(text)
        expect(card.get_by_label("Key of the second person")).to_have_value("")

    confirm(ground.key("Vera", Role.VIEWER))
    refused("role of this key does not allow it")
    card.get_by_role("button", name="Cancel the command").click()
    expect(anna.locator(".card.waiting")).to_have_count(0)
    assert ground.get(f"/torques/{counter}")["state"] == "CANCELLED"


def test_a_command_that_has_expired_is_refused_in_words_and_leaves_the_page(anna, ground):
    """The page still shows it, because its answers did not come; the clock of the data has gone on."""
    card = prepare(anna)
    counter = int(card.get_attribute("data-command"))
    expires_us = parse_epoch(ground.get(f"/torques/{counter}")["expires_at"])
    answers = re.compile(r"/(control|status|torques/commands.*|torques/\d+)$")
    anna.route(answers, lambda route: route.abort())
    ground.now_us = max(ground.now_us, expires_us)
    ground.rows(1, (0.0, 0.03, 0.0))
    card.get_by_label("Key of the second person").fill(ground.key("Boris", Role.APPROVER))
    card.get_by_role("button", name="Confirm with this key").click()
    expect(card.get_by_role("alert")).to_contain_text("not confirmed in time. Prepare the command again.")
    anna.unroute(answers)
    expect(anna.locator(".card.waiting")).to_have_count(0)
    expect(anna.locator(f".control-history [data-command='{counter}']")).to_contain_text("expired")


def test_engaging_without_proven_signs_is_refused_in_words_and_who_joins_asks_for_the_same_end(
    anna, ground, new_page, open_view
):
    page = new_page(key=ground.key("Boris", Role.APPROVER), allowed=(409,))
    until = ground.epoch(3600)
    asked = ground.get("/control") | {"requested_by": "Carla", "requested_until": until}
    page.route(re.compile(r"/control$"), lambda route: route.fulfill(json=asked))
    open_view(page, "control")
    said = page.locator(".control-state > .said")
    page.get_by_role("button", name="Engage", exact=True).click()
    expect(said.get_by_role("alert")).to_contain_text("not proven. Run the sign checks.")
    with page.expect_request(re.compile("control:engage$")) as sent:
        page.get_by_role("button", name="Engage with the first person").click()
    assert sent.value.post_data_json == {"until": until}
    expect(said.get_by_role("alert")).to_contain_text("not proven. Run the sign checks.")
    expect(anna.get_by_role("button", name="Engage with the first person")).to_have_count(0)


def test_the_first_person_is_no_second_one(ground, new_page, open_view):
    carla = ground.key("Carla", Role.APPROVER)
    page = open_view(new_page(key=carla, allowed=(403, 409)), "control")
    for counter in ground.get("/control")["open_commands"]:
        ground.post(f"/torques/{counter}:cancel")
    ground.rows(1, (0.0, 0.03, 0.0))
    card = prepare(page)
    expect(card.get_by_role("button", name="Confirm as")).to_have_count(0)
    card.get_by_label("Key of the second person").fill(carla)
    card.get_by_role("button", name="Confirm with this key").click()
    expect(card.get_by_role("alert")).to_contain_text("Who prepared the command cannot confirm it")


def test_another_digest_than_the_one_that_was_shown_is_refused(anna, ground):
    card = prepare(anna)
    anna.route(
        re.compile(r"/torques/\d+:confirm$"),
        lambda route: route.continue_(post_data='{"digest": "' + "0" * 64 + '"}'),
    )
    card.get_by_label("Key of the second person").fill(ground.key("Boris", Role.APPROVER))
    card.get_by_role("button", name="Confirm with this key").click()
    expect(card.get_by_role("alert")).to_contain_text("not the one that was shown")


def test_of_two_that_prepare_at_once_the_second_is_told(anna, ground):
    ground.post("/torques:prepare", {"reason": HOSTILE[:900]}, status=201)
    anna.get_by_label("Reason", exact=True).fill("mine")
    anna.get_by_role("button", name="Prepare", exact=True).click()
    expect(anna.locator(".prepare").get_by_role("alert")).to_contain_text("waits")
    card = anna.locator(".card.waiting")
    expect(card).to_contain_text("<img src=x onerror=alert(1)>")
    assert card.evaluate("node => node.scrollWidth <= node.clientWidth + 1")


@pytest.mark.parametrize(("role", "forms"), [(Role.VIEWER, 0), (Role.OPERATOR, 1), (Role.APPROVER, 1)])
def test_what_a_role_may_not_do_is_not_offered(ground, new_page, open_view, role, forms):
    page = open_view(new_page(key=ground.key("Somebody", role)), "control")
    expect(page.locator(".conditions").first).to_be_visible()
    expect(page.locator(".prepare")).to_have_count(forms)
    expect(page.locator(".orders")).to_have_count(forms)
    expect(page.get_by_role("button", name="Engage", exact=True)).to_have_count(int(role is Role.APPROVER))
    expect(page.locator("button.stop:visible")).to_have_count(forms)


def test_stop_is_alt_s_and_enter_also_while_the_stream_is_cut(anna, ground, screenshot):
    anna.goto("/console/#/now")
    anna.route(re.compile(r"/yamal-202/stream"), lambda route: route.abort())
    anna.reload()
    expect(anna.locator(".link")).to_contain_text("cut since")
    anna.keyboard.press("Alt+KeyS")
    expect(anna.get_by_role("alertdialog")).to_contain_text("yamal-202")
    anna.keyboard.press("Escape")
    expect(anna.get_by_role("alertdialog")).to_have_count(0)
    assert ground.get("/control")["state"] != "TRIPPED"
    anna.keyboard.press("Alt+KeyS")
    anna.keyboard.press("Enter")
    expect(anna.locator(".stop-panel").get_by_role("alert")).to_contain_text("yamal-202 is tripped")
    assert ground.get("/control")["trips"] == ["stop"]
    anna.goto("/console/#/control")
    expect(anna.locator(".state.present")).to_have_text("TRIPPED")
    screenshot(anna, "control-tripped")
    anna.get_by_role("button", name="Reset the trip").click()
    expect(anna.locator(".state.present")).to_have_text("INHIBITED")


@pytest.mark.parametrize("fault", [503, 429, "network"])
def test_a_stop_that_is_not_confirmed_says_so_and_is_sent_again(ground, new_page, open_view, fault):
    page = new_page(key=ground.key("Anna", Role.OPERATOR), allowed=(503, 429, "ERR_FAILED"))
    open_view(page, "now")
    answer = {"status": fault, "json": {"code": "service.unavailable"}}
    page.route(
        re.compile(r"control:stop$"), lambda route: route.fulfill(**answer) if fault != "network" else route.abort()
    )
    page.get_by_role("button", name="Stop (Alt+S)").click()
    page.get_by_role("link", name="Control", exact=True).click()
    expect(page.locator(".control-view")).to_be_visible()
    page.keyboard.press("Enter")
    expect(page.locator(".stop-panel")).to_contain_text("has not confirmed the stop of yamal-202")
    page.unroute_all()
    page.keyboard.press("Enter")
    expect(page.locator(".stop-panel")).to_contain_text("yamal-202 is tripped")
    ground.post("/control:reset")


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_each_theme_and_language(ground, new_page, open_view, screenshot, axe_violations, theme, language):
    if not ground.get("/control")["open_commands"] and ground.get("/control")["state"] == "ARMED":
        ground.post("/torques:prepare", {"reason": "roll is off"}, status=201)
    page = open_view(new_page(theme=theme, language=language), "control")
    expect(page.locator(".conditions").first).to_be_visible()
    expect(page.locator(".state.present")).to_be_visible()
    screenshot(page, f"control-{theme}-{language}")
    page.keyboard.press("Alt+KeyS")
    expect(page.get_by_role("alertdialog")).to_be_visible()
    assert axe_violations(page) == []
    screenshot(page, f"stop-{theme}-{language}")


def test_an_empty_archive_shows_what_is_missing(ground, new_page, open_view, screenshot):
    page = open_view(new_page(), "control")
    page.get_by_label("Spacecraft").select_option("yamal-empty")
    expect(page.locator("[data-code=no_attitude][data-met=false]")).to_be_visible()
    expect(page.locator("[data-code=not_aligned][data-met=false]")).to_be_visible()
    expect(page.get_by_text("No command yet.")).to_be_visible()
    screenshot(page, "control-empty")


@pytest.mark.parametrize("fault", [429, "network"])
def test_a_service_that_does_not_answer_is_told_and_looked_for_again(ground, new_page, open_view, fault):
    page = open_view(new_page(allowed=(503, 429, "ERR_FAILED")), "now")
    answer = {"status": fault, "json": {"code": "service.unavailable"}, "headers": {"Retry-After": "1"}}
    page.route(re.compile(r"/control$"), lambda route: route.fulfill(**answer) if fault != "network" else route.abort())
    page.get_by_role("link", name="Control", exact=True).click()
    expect(page.locator(".control-state .failure")).to_be_visible()
    expect(page.locator("button.stop")).to_be_enabled()
    page.unroute_all()
    expect(page.locator(".control-state .failure")).to_have_count(0)


def test_nulls_and_codes_of_another_version_are_shown(ground, new_page, open_view):
    def without_figures(route):
        control = route.fetch().json()
        nothing = {"value": None, "limit": None, "since": None}
        control["conditions"] = [{**each, **nothing} for each in control["conditions"]]
        control["conditions"][0].update(code="of_another_version", met=False, unit="", bound=None)
        control |= {"since": None, "sent_impulse_n_m_s": {"yaw": None, "roll": None, "pitch": None}}
        control["sign_check"] = {
            "axis": "roll",
            "state": "open",
            "detail": HOSTILE,
            "legs": 2,
            "legs_done": 0,
            "log_ratio": None,
            "started_at": ground.epoch(),
            "started_by": HOSTILE,
            "until": ground.epoch(60.0),
            "wheels": None,
        }
        route.fulfill(json=control)

    page = new_page()
    page.route(re.compile(r"/control$"), without_figures)
    open_view(page, "control")
    expect(page.locator("[data-code=of_another_version]")).to_contain_text("of_another_version")
    expect(page.locator(".control-state")).to_contain_text("<img src=x onerror=alert(1)>")
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")


def test_while_the_known_torque_is_balanced_the_title_says_so_and_what_leads_out(
    ground, new_page, open_view, screenshot
):
    def balanced(route):
        control = route.fetch().json()
        fade = {"code": "downlink_fade", "text": "", "since": None, "next_step": ""}
        control["control"] |= {"allowed": False, "state": "BALANCE", "reasons": [fade]}
        route.fulfill(json=control | {"state": "BALANCE"})

    page = new_page()
    page.route(re.compile(r"/control$"), balanced)
    open_view(page, "control")
    expect(page.get_by_role("heading", level=1)).to_contain_text("Only the known torque is balanced")
    expect(page.locator(".state.present")).to_have_text("BALANCE")
    expect(page.locator(".ways")).to_contain_text("the known torque may not be balanced any more \u2192 INHIBITED")
    screenshot(page, "control-balance")


def test_a_narrow_page_does_not_scroll_sideways(ground, new_page, open_view, screenshot):
    """Hold what 200 % zoom of 1280 makes of it."""
    page = open_view(new_page(viewport={"width": 640, "height": 400}), "control")
    expect(page.locator(".conditions").first).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth <= document.documentElement.clientWidth")
    screenshot(page, "control-narrow")


def test_a_sign_check_and_release_automatic_say_what_they_wait_for(ground, new_page, open_view):
    """A spacecraft of its own: a sign check waits for the end of what is flown."""
    flown = ReleaseGround(ground.client, "yamal-signs")
    flown.align()
    flown.rows(15, (0.0, 0.03, 0.0))
    flown.post("/control:arm")

    def control_of(name, **options):
        page = new_page(key=flown.key(name, Role.APPROVER), **options)
        page.add_init_script('localStorage.setItem("soo.spacecraft", "yamal-signs")')
        return open_view(page, "control")

    first = control_of("Carla", allowed=(403, 409))
    said = first.locator(".control-state > .said")
    first.get_by_label("Axis").select_option("roll")
    first.get_by_role("button", name="Check the sign").click()
    expect(first.locator("dl.facts").last).to_contain_text(re.compile(r"Roll: .*0 of \d turns reported"))
    automatic = "Ask for release automatic"
    first.get_by_role("button", name=automatic).click()
    expect(said).to_contain_text("when two approvers have asked")
    assert flown.client.get(flown.base).json()["control"]["release"] == "two_step"
    first.get_by_role("button", name=automatic).click()
    expect(said.get_by_role("alert")).to_be_visible()
    second = control_of("Boris")
    second.get_by_role("button", name=automatic).click()
    expect(second.locator(".control-state > .said")).to_contain_text("when two approvers have asked")
    assert flown.client.get(flown.base).json()["control"]["release"] == "automatic"
