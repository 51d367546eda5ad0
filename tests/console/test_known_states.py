"""Known states on view Now: what the page says of each, and a picture for a reader who never saw it.

The pictures are ``build/console/state-*.png``; the state of each stands in `STATES`, not in the picture's name.
Those of the two worst hours are, in 255 colours, ``docs/images/hour-*.png``.
"""

import os
import re
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from playwright.sync_api import expect
from release_ground import PAYLOAD, ReleaseGround, record
from service_process import KEY

from service.records.epoch import format_epoch
from service.records.operations.access import Role

GOOD_DEG = (0.0, 0.03, 0.0)
FADE_ROWS = 15
CARRIERS = len(PAYLOAD.carriers())


def armed(ground: ReleaseGround) -> None:
    """Bring a spacecraft into good, armed operation."""
    ground.align()
    ground.rows(FADE_ROWS, GOOD_DEG)
    ground.post("/control:arm")


def downlink_fade(ground: ReleaseGround) -> None:
    """Fade all carriers by up to 4 dB, as rain over the receiving station does."""
    armed(ground)
    ground.rows(FADE_ROWS, GOOD_DEG, -np.linspace(0.4, 4.0, FADE_ROWS)[:, None])


def uplink_fade(ground: ReleaseGround) -> None:
    """Fade the carriers of one station by up to 6 dB."""
    armed(ground)
    stations = [each.station for each in PAYLOAD.carriers()]
    ground.rows(
        FADE_ROWS, GOOD_DEG, np.outer(-np.linspace(0.4, 6.0, FADE_ROWS), [each == stations[0] for each in stations])
    )


def operation(ground: ReleaseGround) -> None:
    """Declare station keeping that forbids torques."""
    armed(ground)
    span = {"start": ground.epoch(30.0), "stop": ground.epoch(1200.0)}
    ground.post("/operations", {"kind": "station_keeping", "inhibit_control": True, **span}, status=201)
    ground.rows(1, GOOD_DEG)


def prepared(ground: ReleaseGround) -> None:
    """Let an operator prepare a command that waits for the second person."""
    armed(ground)
    drift = np.zeros((FADE_ROWS, 3))
    drift[:, 1] = np.linspace(0.03, 0.06, FADE_ROWS)
    ground.rows(FADE_ROWS, drift)
    ground.post("/torques:prepare", {"reason": "roll is off"}, status=201, key=ground.key("Anna", Role.OPERATOR))


def stopped(ground: ReleaseGround) -> None:
    """Stop control."""
    armed(ground)
    ground.post("/control:stop")


def roll_drift(ground: ReleaseGround) -> None:
    """Let roll drift to half a degree."""
    armed(ground)
    drift = np.zeros((30, 3))
    drift[:, 1] = np.linspace(0.03, 0.55, 30)
    ground.rows(30, drift)


def dark(ground: ReleaseGround) -> None:
    """Let roll drift by five degrees in three hours, then let every carrier leave the air for an hour."""
    armed(ground)
    drift = np.zeros((180, 3))
    drift[:, 1] = np.linspace(0.03, 4.98, 180)
    ground.rows(180, drift)
    ground.rows(60, drift[-1], np.nan)


def stopped_and_growing(ground: ReleaseGround) -> None:
    """Stop control, then let pitch drift by two and a half degrees in three hours."""
    stopped(ground)
    drift = np.zeros((170, 3))
    drift[:, 2] = np.linspace(0.0, 2.56, 170)
    ground.rows(170, drift)


def too_few_carriers(ground: ReleaseGround) -> None:
    """Let nine of twelve carriers leave the air."""
    armed(ground)
    ground.rows(FADE_ROWS, GOOD_DEG, np.where(np.arange(CARRIERS) < CARRIERS - 3, np.nan, 0.0))


def empty(_ground: ReleaseGround) -> None:
    """Send nothing."""


def not_aligned(ground: ReleaseGround) -> None:
    """Send rows of a spacecraft that was calibrated and never aligned."""
    ground.rows(FADE_ROWS, GOOD_DEG)


def no_calibration(ground: ReleaseGround) -> None:
    """Add a spacecraft that was never calibrated, and send its rows."""
    calibrated = ground.client.get("/api/v1/spacecraft/yamal-202").json()
    added = ground.client.post("/api/v1/spacecraft", json={**calibrated, "id": ground.spacecraft_id})
    assert added.status_code == 201, added.text
    plan = ground.client.get("/api/v1/spacecraft/yamal-202/carriers").json()
    carriers = [{**each, "band": "Ku"} for each in plan["carriers"]]
    stored = ground.client.put(f"{ground.base}/carriers", json={"carriers": carriers})
    assert stored.is_success, stored.text
    nodes = [format_epoch(epoch_us) for epoch_us in PAYLOAD.ephemeris().ascending_nodes_us]
    assert ground.client.put(f"{ground.base}/ephemeris", json={"ascending_nodes": nodes}).is_success
    ground.rows(FADE_ROWS, GOOD_DEG)


#: states in which no row of the last hour has angles
WITHOUT_ANGLES = ("d", "g", "i")
#: state -> how it is made, what the heading says
STATES: dict[str, tuple[Callable[[ReleaseGround], None], str]] = {
    "a": (too_few_carriers, "too few carriers"),
    "b": (armed, "torques may go"),
    "c": (stopped, "an operator stopped control"),
    "d": (not_aligned, "no alignment holds"),
    "e": (downlink_fade, "downlink fade"),
    "f": (prepared, "waits for a second person"),
    "g": (empty, "no row has come yet; no torque: no attitude has been computed yet"),
    "h": (uplink_fade, "torques may go"),
    "i": (no_calibration, "no calibration"),
    "j": (operation, "a declared operation forbids torques"),
    "k": (roll_drift, "is beyond its limit of 0.40 deg and grows by"),
}
#: hour -> how it is made, the sentence
HOURS: dict[str, tuple[Callable[[ReleaseGround], None], str]] = {
    "dark": (
        dark,
        r"no carrier is on the air, roll was 5\.\d\d deg; "
        "no torque; look at the receiving chain and the satellite first",
    ),
    "stopped": (
        stopped_and_growing,
        r"pitch 2\.5\d deg is beyond its limit of 0\.40 deg and grows by 0\.\d\d deg/h; "
        r"no torque: an operator stopped control since \d\d:\d\d \(and \d more\); find the cause, then reset control",
    ),
}
CRAFTS = (record("yamal-202"), *(record(f"sat-{name}") for name in (*STATES, "m", *HOURS) if name != "i"))


@pytest.mark.parametrize("name", STATES)
def test_a_known_state_is_said_with_reason_and_next_step(page, ground, open_view, screenshot, fits, name):
    make, said = STATES[name]
    make(ReleaseGround(ground.client, f"sat-{name}"))
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option(f"sat-{name}")
    expect(page.get_by_role("heading", level=1)).to_contain_text(said)
    expect(page.locator(".link .symbol.normal")).to_be_visible()
    expect(page.locator("main")).not_to_contain_text("NaN")
    hour = "No angle in the last hour" if name in WITHOUT_ANGLES else "Last hour, deg"
    expect(page.locator(".hour")).to_have_text([re.compile(hour)] * 3)
    assert fits(page)
    screenshot(page, f"state-{name}")


@pytest.mark.parametrize("name", HOURS)
def test_the_worst_of_a_bad_hour_is_said_first_in_red_by_console_terminal_and_alarm(
    page, ground, open_view, screenshot, fits, service, name
):
    make, said = HOURS[name]
    make(ReleaseGround(ground.client, f"sat-{name}"))
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option(f"sat-{name}")
    heading = page.get_by_role("heading", level=1)
    expect(heading).to_have_text(re.compile(said, re.IGNORECASE))
    expect(heading.locator(".symbol.critical")).to_be_visible()
    worst = {"dark": "no carrier is received", "stopped": "angle beyond its limit"}[name]
    expect(page.locator("header .alarms a")).to_contain_text(worst)
    assert fits(page)
    screenshot(page, f"hour-{name}")
    command = [sys.executable, "-m", "service", "status", "--spacecraft", f"sat-{name}", "--service", service.url]
    environment = os.environ | {"SOO_KEY": KEY, "COLUMNS": "999"}
    printed = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert printed.stdout.splitlines()[0].lower() == f"sat-{name}: {heading.inner_text().lower()}", printed.stderr


def test_a_sudden_motion_is_said_with_the_rate_and_the_time_that_the_service_finds(page, ground, open_view, screenshot):
    moved = ReleaseGround(ground.client, "sat-m")
    armed(moved)
    drift = np.zeros((20, 3))
    drift[:, 1] = 0.03 + np.linspace(0.01, 0.2, 20)
    moved.rows(20, drift)
    situation = moved.get("/status")["control"]["situation"]
    (found,) = [each for each in situation["axes"] if each["axis"] == "roll"]
    filter_deg_h = 3600.0 * moved.get("/attitude")["rates_deg_s"]["roll"]
    assert filter_deg_h < 0.1 < found["rate_deg_h"], "0.6 deg/h, which the filter does not follow"
    # from 0.23 deg on
    assert 10.0 < 60.0 * found["hours_to_limit"] < 30.0
    open_view(page, "now")
    page.get_by_label("Spacecraft").select_option("sat-m")
    entries = page.get_by_role("region", name="Roll", exact=True).locator("dd")
    expect(entries.nth(0)).to_have_text(f"{found['rate_deg_h']:.3f} deg/h")
    expect(entries.nth(1)).to_have_text(f"{int(60.0 * found['hours_to_limit'])} min")
    heading = page.get_by_role("heading", level=1)
    expect(heading).to_contain_text(f"meets its limit of 0.40 deg in {situation['hours_to_limit']:.2f} h")
    expect(page.get_by_role("region", name="Pitch", exact=True).locator("dd").nth(1)).to_have_text("over a day")
    screenshot(page, "state-m")
    page.goto("/console/#/shift")
    expect(page.locator("main")).to_contain_text(f"meets its limit of 0.40 deg in {situation['hours_to_limit']:.2f} h")


def test_a_service_that_is_gone_is_said_beside_the_last_that_is_known(new_page, ground, service, open_view, screenshot):
    page = open_view(new_page(allowed=("ERR_CONNECTION", "ERR_INCOMPLETE", "ERR_EMPTY")), "now")
    page.get_by_label("Spacecraft").select_option("yamal-202")
    expect(page.get_by_role("heading", level=1)).to_contain_text("torques may go")
    service.process.kill()
    expect(page.locator("header .link")).not_to_contain_text("live")
    expect(page.get_by_role("heading", level=1)).to_contain_text("not known")
    screenshot(page, "state-l")
