"""Keys in a browser: made and shown once, revoked, refused in words, and offered to administrators alone."""

import httpx
import pytest
from playwright.sync_api import expect

from service.records.operations.access_key import Role

HOSTILE = '<img src=x onerror="alert(1)">'


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
    page.get_by_label("Holder").fill(HOSTILE)
    page.get_by_label("Role").select_option("station")
    page.get_by_label("Valid for").select_option("30")
    page.get_by_role("button", name="Make a key").click()
    secret = page.get_by_label("New key").input_value()
    with httpx.Client(base_url=service.url, headers={"Authorization": f"Bearer {secret}"}, trust_env=False) as client:
        assert client.get("/api/v1/session").json()["role"] == "station"
        page.get_by_role("button", name="Put away").click()
        expect(page.get_by_label("New key")).to_have_count(0)
        assert secret not in page.content()
        row = page.locator("main tbody tr", has_text=HOSTILE)
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
