"""Alarms, Shift and Audit in a browser: what they show, what is pressed in them, what is refused, hostile texts."""

import os
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from geometry_flight import START_US, S
from playwright.sync_api import Page, expect
from release_ground import OPERATION_US, PAYLOAD, ReleaseGround, record, seed_archive, until
from service_process import ServiceProcess, serving_on

from db.storage import SqlStorage
from service.records.operations.access import Role
from service.records.operations.alarms import Alarm, AlarmChange, ChangeKind, Cover, Note, Process, Severity

SC = "yamal-202"
HOSTILE = '<img src=x onerror="window.broken = 1">\u202e' + "x" * 950
#: carriers that are absent, so that their alarms stand
ABSENT = (3, 4, 5, 6, 7)
#: condition, thing, severity
ALARMS = (
    ("carrier_level", "c90", Severity.WATCH),
    ("carrier_absent", HOSTILE[:60], Severity.WARNING),
    ("attitude_angle", "ghost", Severity.CRITICAL),
    ("carrier_residual", "c91", Severity.WARNING),
    ("carrier_c_n0", "c92", Severity.DISTRESS),
    ("carrier_level", "c93", Severity.DISTRESS),
)


def alarm(number: int, condition: str, thing: str, severity: Severity) -> Alarm:
    """Return an alarm of a thing that no row has, so that it is gone; of one no figure is known."""
    at_us = OPERATION_US - (60 - number) * S
    value = float("nan") if number == 2 else 4.5
    instance = (SC, condition, thing, Process.UNACKNOWLEDGED, Cover.NONE, severity)
    return Alarm(0, *instance, at_us, at_us, at_us, value, 3.0, "dB", "told by a test")


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ServiceProcess]:
    database = tmp_path_factory.mktemp("console") / "soo.db"
    url = f"sqlite:///{database}"
    seed_archive(url, record(SC))
    storage = SqlStorage(url)
    for number, each in enumerate(ALARMS):
        raised = alarm(number, *each)
        storage.alarms.save([AlarmChange(ChangeKind.RAISED, raised, raised.raised_at_us, is_told=True)])
    storage.notes.add(Note(0, SC, START_US, START_US, "Anna", HOSTILE, ("night",), None))
    storage.notes.add(Note(0, None, START_US, START_US, "Anna", "all well", (), 1))
    storage.close()
    with serving_on(database, os.environ) as started:
        yield started


@pytest.fixture(scope="module")
def ground(ground: ReleaseGround) -> ReleaseGround:
    """Give the station after five minutes in which some carriers were absent."""
    minutes = np.arange(1, 6) * 60 * S
    power_dbm = PAYLOAD.power_dbm(ground.now_us + minutes, (0.0, 0.03, 0.0))
    power_dbm[:, ABSENT] = np.nan
    ground.send(ground.now_us + minutes, power_dbm)
    ground.now_us += int(minutes[-1])
    until(
        lambda: sum(each["is_active"] for each in ground.get("/alarms")["rows"]) >= len(ABSENT), "carriers are absent"
    )
    return ground


def row(page: Page, text: str) -> Any:
    return page.locator("main tbody tr", has_text=text)


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_the_views_in_each_theme_and_language(new_page, ground, open_view, screenshot, axe_violations, theme, language):
    page = new_page(theme=theme, language=language)
    for view, shown in (("alarms", "c93"), ("shift", "all well"), ("audit", "arm_control")):
        open_view(page, view)
        expect(page.locator("main").get_by_text(shown).first).to_be_visible()
        assert axe_violations(page) == [], view
        screenshot(page, f"{view}-{theme}-{language}")


def test_worst_comes_first_with_its_next_step_and_a_value_that_is_not_known_is_a_dash(page, open_view):
    open_view(page, "alarms")
    rows = page.locator("main tbody tr")
    expect(rows.first).to_contain_text("angle beyond its limit")
    expect(rows.first).to_contain_text("check with another sensor")
    expect(rows.first).to_contain_text("–")
    words = [" ".join(each.split()) for each in rows.locator("th").all_inner_texts()]
    assert words == sorted(words, key=["critical", "distress", "warning", "watch"].index)
    assert len(words) >= len(ALARMS)
    expect(page.get_by_label("Sound for new alarms")).not_to_be_checked()


@pytest.mark.parametrize("language", ["en", "ru"])
def test_now_fits_one_screen_beside_alarms(new_page, open_view, screenshot, fits, language):
    page = open_view(new_page(language=language), "now")
    expect(page.locator(".alarms button")).to_be_visible()
    expect(page.locator("main h1")).to_be_visible()
    assert fits(page)
    screenshot(page, f"now-alarms-{language}")


def test_a_hostile_name_is_text(page, open_view):
    open_view(page, "alarms")
    expect(row(page, "onerror").locator("bdi").first).to_have_text(HOSTILE[:60])
    assert page.locator("main img").count() == 0


def test_two_people_acknowledge_at_once_and_each_sees_it(new_page, new_context, ground, open_view):
    first, second = (
        open_view(new_page(new_context(key=ground.key(name, Role.OPERATOR))), "alarms") for name in ("Ann", "Bob")
    )
    for page in (first, second):
        expect(row(page, "c03").get_by_role("button", name="Acknowledge")).to_be_visible()
    for page in (first, second):
        row(page, "c03").get_by_role("button", name="Acknowledge").click(no_wait_after=True)
    for page in (first, second):
        expect(row(page, "c03")).to_contain_text(re.compile(r"acknowledged\s*by (Ann|Bob)"))
        expect(row(page, "c03").get_by_role("button", name="Acknowledge")).to_have_count(0)


def test_an_alarm_is_shelved_with_time_and_comment_and_comes_back(page, open_view, screenshot):
    open_view(page, "alarms")
    row(page, "c04").get_by_role("button", name="Shelve").click()
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("For").select_option("60")
    dialog.get_by_label("Comment").fill(HOSTILE[:60])
    screenshot(page, "alarms-shelve")
    dialog.get_by_role("button", name="Shelve").click()
    expect(row(page, "c04")).to_have_count(0)
    page.get_by_role("button", name="Shelved, suppressed").click()
    expect(row(page, "c04")).to_contain_text("shelved until")
    expect(row(page, "c04")).to_contain_text(HOSTILE[:60])
    row(page, "c04").get_by_role("button", name="What happened").click()
    expect(row(page, "c04").locator("li")).to_have_count(2)
    row(page, "c04").get_by_role("button", name="End shelving").click()
    expect(row(page, "c04")).to_have_count(0)
    page.get_by_role("button", name="Open", exact=True).click()
    expect(row(page, "c04")).to_be_visible()


def test_an_opened_history_stays_and_is_renewed_while_the_list_is_read_again(page, open_view):
    open_view(page, "alarms")
    history = row(page, "c07").locator("li")
    row(page, "c07").get_by_role("button", name="What happened").click()
    expect(history).to_have_count(1)
    row(page, "c07").get_by_role("button", name="Acknowledge").click()
    expect(history).to_have_count(2)
    row(page, "c07").get_by_role("button", name="What happened").click()
    expect(history).to_have_count(0)


def test_limits_in_force_are_shown(page, open_view):
    open_view(page, "alarms", "?list=limits")
    expect(row(page, "carrier absent")).to_contain_text("3600.00")
    expect(page.get_by_text("Limits in force: normal.")).to_be_visible()


def test_all_that_are_shown_are_acknowledged(page, open_view):
    def shown(route: Any) -> None:
        document = route.fetch().json()
        route.fulfill(json={**document, "rows": [each for each in document["rows"] if each["thing"] in {"c05", "c06"}]})

    page.route("**/alarms?*", shown)
    open_view(page, "alarms")
    page.locator("main").get_by_role("button", name="Acknowledge all 2 shown").click()
    expect(page.locator("main").get_by_role("button", name=re.compile("^Acknowledge"))).to_have_count(0)
    for thing in ("c05", "c06"):
        expect(row(page, thing)).to_contain_text(re.compile(r"acknowledged\s*by bootstrap"))


def test_an_alarm_that_was_closed_meanwhile_is_told(new_page, ground, open_view, service):
    page = open_view(new_page(allowed=(409,)), "alarms")
    with service.client() as client:
        known = client.get(f"/api/v1/spacecraft/{SC}/alarms").json()["rows"]
        (one,) = [each for each in known if each["thing"] == "c90"]
        page.route(
            "**/alarms?*", lambda route: route.fulfill(json={"rows": [{**one, "state": "latched"}], "next": None})
        )
        page.reload()
        button = row(page, "c90").get_by_role("button", name="Clear")
        expect(button).to_be_visible()
        assert client.post(f"/api/v1/alarms/{one['id']}:clear").is_success
        button.click()
        expect(page.get_by_role("alert").filter(has_text="The alarm is closed")).to_be_visible()


@pytest.mark.parametrize(("status", "words"), [(503, "503"), (429, "429")])
@pytest.mark.parametrize(("view", "path"), [("alarms", "alarms?*"), ("shift", "handover"), ("audit", "audit?*")])
def test_a_service_that_refuses_is_told_and_asked_again(new_page, ground, open_view, status, words, view, path):
    page = new_page(allowed=(status,))
    problem = {"status": status, "code": "no.such.code", "title": "busy"}
    page.route(
        f"**/api/v1/**{path}", lambda route: route.fulfill(status=status, headers={"Retry-After": "7"}, json=problem)
    )
    page.goto(f"/console/#/{view}")
    expect(page.locator("main [role=alert]").first).to_contain_text(words)
    expect(page.locator("main [role=alert]").first).to_contain_text("Try again in 7 s")
    page.unroute_all()
    page.get_by_role("button", name="Read again").first.click()
    expect(page.locator("main [role=alert]")).to_have_count(0)


@pytest.mark.parametrize("view", ["alarms", "shift", "audit"])
def test_a_network_that_is_cut_is_told(new_context, ground, open_view, view):
    page = new_context().new_page()
    page.goto("/console/#/now")
    page.route("**/api/v1/**", lambda route: route.abort())
    page.goto(f"/console/#/{view}")
    expect(page.locator("main [role=alert]").first).to_contain_text("The service does not answer")


def test_what_a_role_may_not_do_is_not_offered(new_page, new_context, ground, open_view):
    page = open_view(new_page(new_context(key=ground.key("Vera", Role.VIEWER))), "alarms")
    expect(row(page, "c93")).to_be_visible()
    for name in ("Acknowledge", "Shelve"):
        assert page.locator("main").get_by_role("button", name=name, exact=True).count() == 0
    expect(page.get_by_role("link", name="Audit")).to_have_count(0)
    open_view(page, "shift")
    expect(page.get_by_text("all well")).to_be_visible()
    expect(page.get_by_label("New note")).to_have_count(0)
    page.goto("/console/#/audit")
    expect(page.get_by_role("heading", name="Audit")).to_have_count(0)


def test_a_note_is_written_and_corrected_and_a_hostile_one_is_text(page, open_view, screenshot):
    open_view(page, "shift")
    notes = page.locator(".notes li")
    expect(notes.last.locator(".text")).to_have_text(HOSTILE)
    assert page.locator("main img").count() == 0
    page.get_by_label("New note").fill("pump \u202e tested")
    page.get_by_role("button", name="Write").click()
    expect(notes.first.locator(".text")).to_have_text("pump \u202e tested")
    notes.first.get_by_role("button").click()
    page.get_by_label("New note").fill("valve tested")
    page.get_by_role("button", name="Write").click()
    expect(notes.first).to_contain_text("corrects 3")
    expect(page.get_by_label("New note")).to_have_value("")
    page.emulate_media(media="print")
    expect(page.get_by_label("New note")).not_to_be_visible()
    expect(page.locator("nav")).not_to_be_visible()
    expect(notes.first).to_be_visible()
    screenshot(page, "shift-print")


def test_a_note_that_another_writes_comes_by_itself(page, open_view, service):
    open_view(page, "shift")
    with service.client() as client:
        assert client.post("/api/v1/notes", json={"text": "from afar", "spacecraft_id": SC}).is_success
    expect(page.locator(".notes").get_by_text("from afar")).to_be_visible()


def test_who_did_what_is_told(page, open_view):
    open_view(page, "shift")
    expect(row(page, "arm_control").first).to_contain_text("bootstrap")
    page.get_by_role("button", name="last 24 h").click()
    expect(row(page, "angle beyond its limit").first).to_be_visible()


def test_entries_of_the_audit_log_are_filtered_and_their_chain_is_checked(page, open_view, ground):
    ground.key("<b>Zoë</b>\u4e2d", Role.OPERATOR)
    open_view(page, "audit")
    expect(page.get_by_role("status").filter(has_text="fit the chain")).to_be_visible()
    page.get_by_label("What", exact=True).fill("no_such_action")
    page.get_by_role("button", name="Show").click()
    expect(page.get_by_text("Nothing to show.")).to_be_visible()
    page.goto("/console/#/audit?target=/keys")
    expect(page.locator("main tbody tr").first).to_contain_text("bootstrap")
    for written, is_shown in (("2026-02-31", False), ("2000-01-01 12:00", True)):
        page.get_by_label("From, UTC").fill(written)
        page.get_by_role("button", name="Show").click()
        assert ("start=2000-01-01T12" in page.url) == is_shown, "what is no day asks for nothing"
    expect(page.get_by_label("From, UTC")).to_have_value("2000-01-01 12:00:00")
    expect(page.locator("main tbody tr").first).to_contain_text("bootstrap")
    expect(page.get_by_role("status").filter(has_text="the chain")).to_be_visible()


def test_an_entry_that_was_changed_does_not_fit(page, open_view):
    def changed(route: Any) -> None:
        answer = route.fetch()
        document = answer.json()
        document["rows"][1]["who"] = "somebody else"
        route.fulfill(response=answer, json=document)

    page.route("**/api/v1/audit?*", changed)
    open_view(page, "audit")
    expect(page.get_by_role("status").filter(has_text="does not fit the chain")).to_be_visible()
    expect(row(page, "somebody else")).to_contain_text("does not fit")
