"""The live stream as seen on the page: cut and restored, shared by tabs, clocks that differ, a killed service."""

import os
import re
import signal
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from geometry_flight import HOUR
from playwright.sync_api import expect
from release_ground import ReleaseGround, record, seed_archive, until
from service_process import KEY, PLAIN, ServiceProcess

from service.records.epoch import format_epoch

TABS = 7


def roll_of(ground: ReleaseGround) -> str:
    """Return the newest roll angle as the page writes it."""
    return f"{round(ground.get('/attitude')['roll_deg'], 3) + 0.0:.3f}"


class Restarted:
    """A service that a test kills and starts again at the same address."""

    def __init__(self, folder: Path) -> None:
        self._folder, self._database, self._backup = folder, folder / "soo.db", folder / "backup.db"
        seed_archive(f"sqlite:///{self._database}", record("yamal-202"))
        self._port = "0"
        self.start()

    def start(self) -> None:
        """Start it and wait until it listens."""
        arguments = ["--port", self._port, "--clock", "data"]
        self.process = ServiceProcess(self._folder, self._database, arguments, {**os.environ, **PLAIN})
        self.url = self.process.url
        self._port = self.url.rpartition(":")[2]

    def kill(self) -> None:
        """End it as a lost machine does."""
        self.process.process.send_signal(signal.SIGKILL)
        self.process.process.wait()

    def back_up(self) -> None:
        """Copy the archive while the service writes it."""
        with sqlite3.connect(self._database) as source, sqlite3.connect(self._backup) as target:
            source.backup(target)
        source.close()
        target.close()

    def restore(self) -> None:
        """Put the copy in the place of the archive of a service that has ended."""
        for end in ("-wal", "-shm"):
            self._database.with_name(f"{self._database.name}{end}").unlink(missing_ok=True)
        self._backup.replace(self._database)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Restarted]:
    restarted = Restarted(tmp_path_factory.mktemp("restarted"))
    yield restarted
    restarted.kill()


@pytest.fixture(scope="module")
def ground(service: Restarted) -> Iterator[ReleaseGround]:
    with httpx.Client(base_url=service.url, headers={"Authorization": f"Bearer {KEY}"}, timeout=120.0) as client:
        station = ReleaseGround(client, "yamal-202")
        station.align()
        station.rows(5)
        yield station


def test_a_killed_service_is_told_and_its_rows_come_after_the_start_once_each(new_context, service, ground, open_view):
    # the browser itself logs each connection that it cannot make
    page = new_context().new_page()
    open_view(page, "now")
    service.kill()
    expect(page.get_by_text("cut since")).to_be_visible()
    expect(page.locator(".gauge.is-stale")).to_have_count(3)
    expect(page.get_by_role("region", name="Roll", exact=True).locator(".age")).to_contain_text("old")
    service.start()
    ground.rows(3)
    expect(page.get_by_text("cut since")).to_have_count(0)
    expect(page.locator(".gauge.is-stale")).to_have_count(0)
    expect(page.get_by_role("region", name="Roll", exact=True).locator(".value")).to_have_text(roll_of(ground))


def test_rows_of_a_cut_before_the_first_event_are_shown_when_the_stream_begins(new_context, ground):
    page = new_context().new_page()
    page.route("**/stream", lambda route: route.abort())
    page.goto("/console/#/now")
    expect(page.get_by_text("cut since")).to_be_visible()
    expect(page.locator("time.row")).not_to_have_text("")
    ground.rows(1)
    page.unroute("**/stream")
    expect(page.locator("time.row")).to_have_text(format_epoch(ground.now_us)[11:19])


def test_a_row_between_the_first_reading_and_the_begin_of_the_stream_is_shown(new_context, ground):
    """The stream begins with the present: what was stored between the page's reading and it comes by no event."""
    page = new_context().new_page()
    began: list[Any] = []
    # the first opening waits until the page has read and a row was stored; a second reading must bring it
    page.route("**/stream", lambda route: began.append(route))
    with page.expect_response("**/attitude?method=paper"):
        page.goto("/console/#/now")
    expect(page.locator("time.row")).not_to_have_text("")
    ground.rows(1)
    until(lambda: page.wait_for_timeout(20) is None and len(began) == 1, "the page asks for the stream")
    began[0].continue_()
    expect(page.locator("time.row")).to_have_text(format_epoch(ground.now_us)[11:19])


def test_an_answer_that_comes_late_does_not_hide_a_newer_row(new_context, ground, open_view):
    page = new_context().new_page()
    held = []
    page.route("**/attitude?method=robust", lambda route: held.append((route, route.fetch())))
    open_view(page, "now")
    expect(page.locator("time.row")).not_to_have_text("")
    ground.rows(1, (0.0, 0.01, 0.0))
    newest = format_epoch(ground.now_us)[11:19]
    expect(page.locator("time.row")).to_have_text(newest)
    with page.expect_response("**/attitude?method=robust"):
        for route, answer in held:
            route.fulfill(response=answer)
    page.wait_for_timeout(500)
    expect(page.locator("time.row")).to_have_text(newest)


def test_after_a_restored_backup_nothing_of_the_lost_hours_stays_and_rows_go_on(
    new_context, service, ground, open_view
):
    """The archive ends before what the page has seen: angles, curve, command, operation and alarms are those it has."""
    context = new_context()
    page, control = context.new_page(), context.new_page()
    ground.rows(2)
    kept_us, text = ground.now_us, roll_of(ground)
    service.back_up()
    # two hours later, so that the curve of the last hour has nothing in common
    ground.now_us += 2 * HOUR
    ground.rows(15, (0.0, 0.05, 0.0))
    ground.post("/operations", {"kind": "eclipse", "start": ground.epoch(60), "stop": ground.epoch(9000)}, status=201)
    ground.post("/control:arm")
    ground.post("/torques:prepare", {"reason": "of the lost hours"}, status=201)
    lost = roll_of(ground)
    open_view(page, "now")
    open_view(control, "control")
    roll = page.get_by_role("region", name="Roll", exact=True)
    expect(roll.locator(".value")).to_have_text(lost)
    expect(page.get_by_role("region", name="Operation", exact=True)).to_contain_text("eclipse")
    expect(control.locator(".card.waiting")).to_be_visible()
    service.kill()
    service.restore()
    service.start()
    expect(roll.locator(".value")).to_have_text(text)
    expect(page.get_by_role("region", name="Operation", exact=True)).to_contain_text("none")
    expect(page.locator("header .utc")).to_contain_text(format_epoch(kept_us)[11:19])
    expect(control.locator(".card.waiting")).to_have_count(0)
    expect(control.get_by_text("of the lost hours")).to_have_count(0)
    expect(roll.locator(".hour .curve")).to_have_attribute("d", re.compile(r"M3[78]\d(\.\d+)? |L3[78]\d(\.\d+)? "))
    open_alarms = len(ground.get("/alarms?state=open")["rows"])
    expect(page.locator("header .alarms")).to_contain_text("no alarm" if not open_alarms else f"{open_alarms}")
    ground.now_us = kept_us
    ground.rows(1, (0.0, 0.02, 0.0))
    expect(roll.locator(".value")).to_have_text(roll_of(ground))
    expect(page.get_by_text("cut since")).to_have_count(0)


def test_a_session_that_ends_while_somebody_looks_is_told(new_context, service, ground, open_view):
    context = new_context()
    page = open_view(context.new_page(), "now")
    # as the next desk does that has the same browser
    assert context.request.delete("/api/v1/session", headers={"Origin": service.url}).ok
    expect(page.get_by_role("alert").filter(has_text="Your session has ended")).to_be_visible(timeout=40_000)
    page.get_by_label("Key").fill(KEY)
    page.keyboard.press("Enter")
    expect(page.locator(".link .symbol.normal")).to_be_visible()


def test_seven_tabs_share_one_stream_and_the_next_goes_on_when_the_first_closes(new_context, ground, open_view):
    context = new_context()
    streams: list[str] = []
    context.on("request", lambda sent: streams.append(sent.url) if sent.url.endswith("/stream") else None)
    pages = [open_view(context.new_page(), "now") for _ in range(TABS)]
    assert len(streams) == 1
    ground.rows(1)
    text = roll_of(ground)
    for page in pages:
        expect(page.get_by_role("region", name="Roll", exact=True).locator(".value")).to_have_text(text)
    pages[0].close()
    with context.expect_event("request", lambda sent: sent.url.endswith("/stream")) as resumed:
        pass
    assert resumed.value.headers["last-event-id"].startswith("yamal-202:")
    ground.rows(1)
    text = roll_of(ground)
    for page in pages[1:]:
        expect(page.get_by_role("region", name="Roll", exact=True).locator(".value")).to_have_text(text)


@pytest.mark.parametrize(("hours", "said"), [(1, "ahead"), (-1, "behind")])
def test_a_workstation_an_hour_off_is_told(new_page, ground, open_view, hours, said):
    page = new_page()
    page.add_init_script(f"const now = Date.now; Date.now = () => now() + {hours * 3_600_000};")
    open_view(page, "now")
    expect(page.locator(".offset")).to_contain_text(re.compile(rf"this workstation is (1 hr|59 min) {said}"))
    expect(page.locator("header .utc")).to_contain_text("2027-01-15")


def test_a_service_that_is_busy_is_asked_again_after_the_time_it_names(new_page, ground, open_view):
    page = new_page(allowed=(503,))
    refused: list[Any] = []

    def refuse(route: Any) -> None:
        if len(refused) < 2:
            refused.append(route)
            problem = {"title": "Service Unavailable", "status": 503, "code": "stream.too_many", "detail": "full"}
            route.fulfill(status=503, json=problem, headers={"Retry-After": "1"})
        else:
            route.fallback()

    page.route("**/stream", refuse)
    page.goto("/console/")
    expect(page.locator(".link[title*='Too many live streams']")).to_be_visible()
    expect(page.locator(".link .symbol.normal")).to_be_visible()
