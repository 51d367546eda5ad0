"""The shell of the console: signing in and out, header, language, theme, what is refused and what is cut."""

import re

import pytest
from playwright.sync_api import expect
from service_process import KEY

from service.records.operations.access import Role


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_header_and_sign_in_in_each_theme_and_language(
    new_page, ground, open_view, screenshot, axe_violations, theme, language
):
    page = open_view(new_page(theme=theme, language=language), "now")
    expect(page.locator("html")).to_have_attribute("data-theme", theme)
    expect(page.get_by_text({"en": "SIMULATED", "ru": "МОДЕЛЬ"}[language])).to_be_visible()
    expect(page.locator("header .utc")).to_contain_text("2027-01-15 10:15:00 UTC")
    assert axe_violations(page) == []
    screenshot(page, f"now-{theme}-{language}")
    page.get_by_role("button", name={"en": "Sign out", "ru": "Выйти"}[language]).click()
    expect(page.locator("#key")).to_be_visible()
    assert axe_violations(page) == []
    screenshot(page, f"sign-in-{theme}-{language}")


def test_a_wrong_key_is_refused_in_words_and_a_right_one_lets_in(new_page, ground):
    page = new_page(key=None, allowed=(401,))
    page.goto("/")
    page.get_by_label("Key").fill("wrong")
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("alert")).to_contain_text("not known, expired or revoked")
    expect(page.get_by_label("Key")).to_have_value("")
    page.get_by_label("Key").fill(KEY)
    page.keyboard.press("Enter")
    expect(page.locator(".link .symbol.normal")).to_be_visible()
    assert page.context.cookies()[0]["httpOnly"]


def test_language_and_theme_are_changed_and_kept(page, open_view):
    open_view(page, "now")
    page.get_by_role("button", name="RU").click()
    page.get_by_role("button", name="Светлая").click()
    page.reload()
    expect(page.get_by_role("link", name="Сейчас")).to_have_attribute("aria-current", "page")
    expect(page.locator("html")).to_have_attribute("data-theme", "light")


def test_a_key_revoked_while_somebody_looks_ends_the_session_with_words(new_page, ground, service):
    page = new_page(key=ground.key("Vera", Role.VIEWER), allowed=(401,))
    page.goto("/console/")
    expect(page.locator(".person")).to_have_text("Vera")
    ground.key("Vera", Role.VIEWER)
    expect(page.get_by_role("alert")).to_contain_text("Your session has ended")
    expect(page.get_by_label("Key")).to_be_visible()


def test_a_view_does_not_write_over_the_address_that_was_chosen_meanwhile(page, open_view):
    # one task: the view writes its address before the page hears of the other one, as an answer that comes then does
    open_view(page, "history")
    page.evaluate("location.hash = '#/carriers'; document.querySelector('.toolbar button:last-child').click()")
    expect(page.locator("nav a[aria-current]")).to_have_attribute("href", "#/carriers")
    open_view(page, "history")
    page.evaluate("location.hash = '#/history?span=7200'; document.querySelector('.toolbar button:last-child').click()")
    expect(page).to_have_url(re.compile("span=7200"))
