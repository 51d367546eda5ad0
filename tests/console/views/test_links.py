"""The links view: what front ends report, what is wrong in words, and what an operator may order."""

import pytest
from playwright.sync_api import expect

from service.records.operations.access_key import Role

HOSTILE = "<img src=x onerror=alert(1)> \u202egnorw " + "long " * 80
WARNING = {"code": "spool.disk_full", "detail": HOSTILE, "since": "2027-01-15T10:00:00Z"}


def analyzer(state="MEASURE", rows=120, **changes):
    """Return the report of one analyzer."""
    detail = {"analyzer": HOSTILE, "last_fault": None, "last_failure": "", "period_s": 60.0}
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
