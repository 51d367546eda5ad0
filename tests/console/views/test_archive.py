"""The archive in a browser: days with their SHA-256, files of every kind, gaps, replays, and what a role may not do."""

import re
from datetime import date, timedelta
from hashlib import sha256
from urllib.parse import parse_qs, urlsplit

import pytest
from geometry_flight import HOUR
from playwright.sync_api import expect
from release_ground import record, until

from service.api.export.export_files import OFFERED
from service.records.operations.access import Role

SC, EMPTY = "yamal-202", "yamal-empty"
CRAFTS = (record(SC), record(EMPTY))
HOSTILE = "<img src=x onerror=alert(1)> \u202egnorw " + "long " * 80
FILES = sum(len(formats) for formats in OFFERED.values()) + len(OFFERED["attitude"]) + len(OFFERED["joined"])


@pytest.fixture(scope="module")
def ground(ground):
    """Give the station after a gap of a day, with one finished replay."""
    until(lambda: bool(replayed(ground)["state"] == "done"), "the replay is done")
    ground.now_us += 24 * HOUR
    ground.rows(5, (0.0, 0.03, 0.0))
    return ground


def replayed(ground):
    """Return the first replay, which is asked for where there is none."""
    if not ground.get("/replays")["rows"]:
        ground.post("/replays", {"start": ground.epoch(-600), "stop": ground.epoch(1)}, status=202)
    return ground.get("/replays")["rows"][0]


def part(page, title):
    """Return the table of a part of the view."""
    return page.locator("main").get_by_role("group", name=title, exact=True)


def days(ground, series, file_format="csv"):
    """Return the manifest's days of everything."""
    return ground.get(f"/archive/{series}:manifest?format={file_format}")["parts"]


def parameters(page):
    return {key: value for key, (value,) in parse_qs(urlsplit(page.url).fragment.partition("?")[2]).items()}


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("language", ["en", "ru"])
def test_days_files_gaps_and_replays_are_shown(
    ground, new_page, open_view, screenshot, axe_violations, theme, language
):
    page = open_view(new_page(theme=theme, language=language), "archive")
    for known in days(ground, "measurements"):
        day = page.locator("main tbody tr", has_text=known["sha256"])
        for shown in (known["start"][:10], str(known["rows"]), str(known["bytes"])):
            expect(day).to_contain_text(shown)
        if language == "en":
            expect(day).to_contain_text("closed" if known["closed"] else "open")
    (gap,) = ground.get("/archive/gaps")["gaps"]
    expect(page.locator("main tbody tr", has_text=gap["stop"][:19].replace("T", " ")).first).to_be_visible()
    expect(page.locator("main tbody tr", has_text="replay-1")).to_be_visible()
    assert axe_violations(page) == []
    screenshot(page, f"archive-{theme}-{language}")


def test_a_day_that_is_downloaded_has_its_sha256(page, ground, open_view):
    open_view(page, "archive")
    rows = part(page, "Days, a file each").locator("tbody tr")
    known = days(ground, "measurements")
    expect(rows).to_have_count(len(known))
    for row, each in zip(rows.all(), known, strict=True):
        with page.expect_download() as download:
            row.get_by_role("link", name=f"Download {each['start'][:10]}").click()
        assert sha256(download.value.path().read_bytes()).hexdigest() == row.locator("code").inner_text()


def test_the_span_is_one_file_of_every_kind_and_format(page, ground, open_view):
    first, last = (each["start"] for each in (days(ground, "measurements")[0], days(ground, "measurements")[-1]))
    open_view(page, "archive", f"?start={first}&stop={last}")
    links = part(page, "The whole span, one file").get_by_role("link")
    expect(links).to_have_count(FILES)
    for link in links.all():
        address = link.get_attribute("href")
        answer = page.context.request.get(address)
        assert answer.ok, f"{address}: {answer.text()}"
        assert parse_qs(urlsplit(address).query)["start"] == [f"{first[:10]}T00:00:00.000Z"]
        assert "attachment" in answer.headers["content-disposition"]


def test_what_is_chosen_stands_in_the_address_and_comes_back_with_it(page, ground, open_view):
    day = days(ground, "attitude")[0]["start"][:10]
    open_view(page, "archive")
    expect(part(page, "Days, a file each")).to_be_visible()
    page.get_by_label("Series").select_option("attitude")
    page.get_by_label("Format").select_option("ndjson")
    page.get_by_label("Method").select_option("paper")
    # the later day first
    page.get_by_label("First day").fill(f"{date.fromisoformat(day) + timedelta(days=1)}")
    page.get_by_label("Last day").fill(day)
    page.get_by_role("button", name="Show").click()
    known = days(ground, "attitude", "ndjson&method=paper")
    for _ in range(2):
        expect(part(page, "Days, a file each").locator("code")).to_have_text([each["sha256"] for each in known])
        assert parameters(page)["start"] == f"{day}T00:00:00.000Z"
        assert [parameters(page)[key] for key in ("series", "format", "method")] == ["attitude", "ndjson", "paper"]
        page.reload()
    page.get_by_label("Series").select_option("events")
    expect(page.get_by_label("Format").locator("option")).to_have_text(OFFERED["events"])
    expect(page.get_by_label("Method")).to_be_disabled()
    expect(page.get_by_label("Version")).to_be_disabled()


def test_a_span_that_is_none_is_said_and_the_newest_days_are_shown(page, ground, open_view):
    open_view(page, "archive", f"?start=yesterday&stop={HOSTILE}&series=secrets&format=exe")
    expect(page.get_by_role("alert").filter(has_text="names no span")).to_be_visible()
    expect(part(page, "Days, a file each").locator("tbody tr")).to_have_count(len(days(ground, "measurements")))
    expect(page.get_by_label("Series")).to_have_value("measurements")


def test_later_days_are_read_below_the_first(page, ground, open_view):
    known = days(ground, "measurements")
    page.route(
        re.compile(r":manifest\?"),
        lambda route: route.continue_(url=re.sub(r"limit=\d+", "limit=1", route.request.url)),
    )
    open_view(page, "archive")
    codes = page.locator("main code")
    expect(codes).to_have_text([known[0]["sha256"]])
    page.get_by_role("button", name="Later days").click()
    expect(codes).to_have_text([each["sha256"] for each in known])
    expect(page.get_by_role("button", name="Later days")).to_have_count(0)


def test_the_files_of_a_replay_are_those_of_its_version(page, ground, open_view):
    open_view(page, "archive")
    page.locator("main tbody tr", has_text="replay-1").get_by_role("link", name="Files").click()
    expect(page.get_by_label("Version")).to_have_value("replay-1")
    (known,) = days(ground, "attitude", "csv&method=robust&version=replay-1")
    expect(part(page, "Days, a file each").locator("code")).to_have_text([known["sha256"]])
    expect(part(page, "The whole span, one file")).to_contain_text("replay-1")


def test_a_replay_is_followed_to_its_end_and_deleted_by_who_may(ground, new_page, open_view):
    page = open_view(new_page(key=ground.key("Anna", Role.OPERATOR)), "archive")
    expect(page.locator("main tbody tr", has_text="replay-1")).to_be_visible()
    started = ground.post("/replays", {"start": ground.epoch(-240), "stop": ground.epoch(1)}, status=202)
    row = page.locator("main tbody tr", has_text=started["version"])
    expect(row).to_contain_text("done", timeout=60_000)
    row.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    viewer = open_view(new_page(key=ground.key("Vera", Role.VIEWER)), "archive")
    expect(viewer.locator("main tbody tr", has_text=started["version"])).to_be_visible()
    expect(viewer.get_by_role("button", name="Delete")).to_have_count(0)
    row.get_by_role("button", name="Delete").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(row).to_have_count(0)
    assert started["version"] not in [each["version"] for each in ground.get("/replays")["rows"]]


def test_an_empty_archive_says_that_there_is_nothing(ground, new_page, open_view, axe_violations):
    page = open_view(new_page(), "archive")
    page.get_by_label("Spacecraft").select_option(EMPTY)
    expect(page.get_by_text("Nothing to show.")).to_have_count(3)
    expect(page.get_by_text("0 gaps")).to_be_visible()
    assert axe_violations(page) == []


def test_nulls_and_hostile_texts_are_shown(ground, new_page, open_view, screenshot):
    nothing = dict.fromkeys(("start", "stop", "rows", "bytes", "sha256", "closed", "href"))
    gap = {**dict.fromkeys(("start", "stop", "rows_missing"))}
    replay = {**replayed(ground), "state": "failed", "version": HOSTILE, "error": HOSTILE, "method": None, "stop": None}
    running = {**replay, "state": "running", "error": None, "progress": 0.25, "alignment_id": None}
    page = new_page()
    page.route(re.compile(r":manifest\?"), lambda route: route.fulfill(json={"parts": [nothing], "next": None}))
    sources = [{"id": HOSTILE, "rows": None, "rows_missing": None}]
    page.route("**/archive/gaps?*", lambda route: route.fulfill(json={"gaps": [gap] * 300, "sources": sources}))
    page.route("**/replays?*", lambda route: route.fulfill(json={"rows": [replay, running], "next": None}))
    open_view(page, "archive")
    expect(part(page, "Days, a file each").locator("tbody tr")).to_contain_text("–")
    expect(part(page, "Gaps").locator("tbody tr")).to_have_count(200)
    expect(page.get_by_text("The newest 200 are shown.")).to_be_visible()
    expect(part(page, "Replays").get_by_text("<img src=x").first).to_be_visible()
    expect(part(page, "Replays")).to_contain_text("25 %")
    expect(part(page, "Sources, all time").get_by_text("<img src=x")).to_be_visible()
    expect(page.locator("main img")).to_have_count(0)
    screenshot(page, "archive-hostile")


@pytest.mark.parametrize(
    ("path", "fault"),
    [("sources", 503), ("archive/*:manifest?*", 429), ("archive/gaps?*", "network"), ("replays?*", 503)],
)
def test_a_service_that_refuses_is_told_and_asked_again(ground, new_page, open_view, path, fault):
    page = open_view(new_page(allowed=(503, 429, "ERR_FAILED")), "now")
    answer = {"status": fault, "json": {"code": "no.such.code"}, "headers": {"Retry-After": "7"}}
    page.route(f"**/{path}", lambda route: route.abort() if fault == "network" else route.fulfill(**answer))
    page.get_by_role("link", name="Archive", exact=True).click()
    alert = page.locator("main [role=alert]")
    expect(alert).to_contain_text("The service does not answer" if fault == "network" else "Try again in 7 s")
    page.unroute_all()
    page.get_by_role("button", name="Read again").click()
    expect(alert).to_have_count(0)
    expect(part(page, "Days, a file each").locator("code")).to_have_count(len(days(ground, "measurements")))
