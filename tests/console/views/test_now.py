"""Now, keys and links: what stands on the pages, and who may change it."""

import re

import httpx
import pytest
from playwright.sync_api import expect
from release_ground import record

from service.records.operations.access import Role

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


KEY_HOSTILE = '<img src=x onerror="alert(1)">'


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_the_view_in_each_theme_and_language(new_page, ground, open_view, screenshot, axe_violations, theme, language):
    ground.key("Anna", Role.OPERATOR)
    page = open_view(new_page(theme=theme, language=language), "keys")
    expect(page.locator("main tbody tr", has_text="Anna")).to_be_visible()
    assert axe_violations(page) == []
    screenshot(page, f"keys-{theme}-{language}")


def test_a_key_is_made_shown_once_and_revoked(page, open_view, service):
    open_view(page, "keys")
    page.get_by_label("Holder").fill(KEY_HOSTILE)
    page.get_by_label("Role").select_option("station")
    page.get_by_label("Valid for").select_option("30")
    page.get_by_role("button", name="Make a key").click()
    secret = page.get_by_label("New key").input_value()
    with httpx.Client(base_url=service.url, headers={"Authorization": f"Bearer {secret}"}, trust_env=False) as client:
        assert client.get("/api/v1/session").json()["role"] == "station"
        page.get_by_role("button", name="Put away").click()
        expect(page.get_by_label("New key")).to_have_count(0)
        assert secret not in page.content()
        row = page.locator("main tbody tr", has_text=KEY_HOSTILE)
        expect(row).to_contain_text("valid")
        assert page.locator("main img").count() == 0
        row.get_by_role("button", name="Revoke").click()
        page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
        expect(row).to_have_count(0)
        assert client.get("/api/v1/session").status_code == 401
    page.get_by_label("Show revoked keys too").check()
    expect(row).to_contain_text("revoked")


def test_a_name_that_is_given_is_refused_in_words(new_page, ground, open_view):
    ground.key("Boris", Role.VIEWER)
    page = open_view(new_page(allowed=(409,)), "keys")
    page.get_by_label("Holder").fill("boris")
    page.get_by_role("button", name="Make a key").click()
    expect(page.get_by_role("alert").filter(has_text="A valid key has this name")).to_be_visible()
    expect(page.get_by_label("Holder")).to_have_value("boris")


def test_who_may_not_administer_is_not_offered_the_view(new_page, new_context, ground, open_view):
    page = open_view(new_page(new_context(key=ground.key("Clara", Role.APPROVER))), "now")
    expect(page.get_by_role("link", name="Audit")).to_be_visible()
    expect(page.get_by_role("link", name="Keys")).to_have_count(0)


def test_a_service_that_refuses_is_told_and_asked_again(new_page, ground):
    page = new_page(allowed=(503,))
    page.route("**/api/v1/keys?*", lambda route: route.fulfill(status=503, json={"code": "no.such.code"}))
    page.goto("/console/#/keys")
    expect(page.locator("main [role=alert]")).to_contain_text("503")
    page.unroute_all()
    page.get_by_role("button", name="Read again").click()
    expect(page.locator("main tbody tr").first).to_be_visible()


LINK_HOSTILE = "<img src=x onerror=alert(1)> \u202egnorw " + "long " * 80
WARNING = {"code": "spool.disk_full", "detail": LINK_HOSTILE, "since": "2027-01-15T10:00:00Z"}


def analyzer(state="MEASURE", rows=120, **changes):
    """Return the report of one analyzer."""
    detail = {"analyzer": LINK_HOSTILE, "last_fault": None, "last_failure": "", "period_s": 60.0}
    counters = {"rows": rows, "accepted": rows - 3, "refused": 2, "waiting": 1, "dropped_full": 4}
    known = {"id": "rack-1.a", "kind": "analyzer", "spacecraft_id": "yamal-202", "source": "sa-1"}
    return {**known, "state": state, "detail": detail, "counters": counters, "period_s": 5.0, **changes}


@pytest.fixture
def report(ground):
    """Give a function that reports links."""

    def send(*links):
        answer = ground.client.post("/api/v1/links:report", json={"links": links})
        assert answer.is_success, answer.text

    return send


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_links_and_sources_are_shown(ground, report, new_page, open_view, screenshot, axe_violations, theme, language):
    front_end = {"id": "rack-1", "kind": "front_end", "state": "SERVICE_AWAY", "counters": {"rows": 120}}
    stranger = analyzer("of_another_version", id="rack-2", last_good=ground.epoch(), warnings=[WARNING])
    report(analyzer(last_good=ground.epoch()), stranger, front_end)
    page = open_view(new_page(theme=theme, language=language), "links")
    expect(page.locator("[data-link]")).to_have_count(3)
    expect(page.locator("[data-link='rack-1.a'] .symbol.normal")).to_be_visible()
    expect(page.locator("[data-link='rack-1'] .symbol.serious")).to_be_visible()
    expect(page.locator("[data-link='rack-2']")).to_contain_text("of_another_version")
    expect(page.locator("[data-link='rack-2']")).to_contain_text("<img src=x onerror=alert(1)>")
    expect(page.locator("[data-source='sa-1']")).to_be_visible()
    assert axe_violations(page) == []
    screenshot(page, f"links-{theme}-{language}")


def test_a_source_shows_its_station_and_the_key_that_sent_last(page, open_view):
    known = {"role": "prime", "newest_epoch": "2026-11-21T03:00:00Z", "rows": 3, "rows_missing": None}
    sources = [
        {"id": "sa-1", "station": "Dubna", "key_id": "k7d2mzq9xa", **known},
        {"id": "sa-2", "station": None, "key_id": None, **known},
    ]
    page.route("**/sources", lambda route: route.fulfill(json={"rows": sources}))
    open_view(page, "links")
    expect(page.locator("[data-source='sa-1'] th")).to_have_text("sa-1Dubna, key k7d2mzq9xa")
    expect(page.locator("[data-source='sa-2'] th")).to_have_text("sa-2")


def test_an_operator_disables_a_link_and_a_viewer_is_not_offered_it(ground, report, new_page, open_view):
    report(analyzer())
    page = open_view(new_page(key=ground.key("Anna", Role.OPERATOR)), "links")
    row = page.locator("[data-link='rack-1.a']")
    row.get_by_role("button", name="Disable").click()
    expect(row.get_by_role("button", name="Enable")).to_be_visible()
    assert ground.client.get("/api/v1/links/rack-1.a").json()["enabled"] is False
    row.get_by_role("button", name="Reset").click()
    expect(row).to_contain_text("reset asked for")
    row.get_by_role("button", name="Enable").click()
    expect(row.get_by_role("button", name="Disable")).to_be_visible()
    viewer = open_view(new_page(key=ground.key("Vera", Role.VIEWER)), "links")
    expect(viewer.locator("[data-link='rack-1.a']")).to_be_visible()
    expect(viewer.locator("main button")).to_have_count(0)


def test_a_rate_is_that_between_two_reports(report, page, open_view):
    report(analyzer(rows=1000))
    open_view(page, "links")
    row = page.locator("[data-link='rack-1.a']")
    expect(row).to_contain_text("1000")
    expect(row).not_to_contain_text("rows/min")
    report(analyzer(rows=1010))
    expect(row).to_contain_text("rows/min")


def test_a_service_that_does_not_answer_is_told(ground, open_view, new_page):
    unsure = new_page(allowed=(503,))
    open_view(unsure, "now")
    unsure.route("**/api/v1/links", lambda route: route.fulfill(status=503, json={"code": "service.unavailable"}))
    unsure.get_by_role("link", name="Links").click()
    expect(unsure.locator("main .failure")).to_be_visible()
