"""From ``soo demo --release two_step`` to a torque that is reported executed, in the browser, by two key files.

``build/console/demonstration-*.png`` are the pictures of ``docs/images/demo/console-*.png``.
"""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from playwright.sync_api import expect

pytestmark = pytest.mark.nightly

#: bounds hangs; half a quiet day is measured before control is armed
START_TIMEOUT_S = 900.0
WAIT_MS = 900_000


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """Start the demonstration as a user does; give its address and the time of its start."""
    folder = tmp_path_factory.mktemp("demonstration")
    output = folder / "output"
    command = [sys.executable, "-m", "service", "demo", "--release", "two_step", "--keep", str(folder / "kept")]
    command += ["--quiet-days", "0.5"]
    began = time.monotonic()
    with output.open("wb") as stream:
        process = subprocess.Popen(command, stdout=stream, stderr=stream)
    try:
        while not (address := re.search(r"(http://[\d.]+:\d+)/console/", output.read_text())):
            assert process.poll() is None, output.read_text()
            assert time.monotonic() < began + START_TIMEOUT_S, output.read_text()
            time.sleep(0.1)
        yield SimpleNamespace(url=address[1], began=began, output=output)
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(120)
        # of a failure: what the user would have seen, and what the service logged
        print(output.read_text()[-4000:])
        print(*[line for line in (folder / "kept" / "service.log").read_text().splitlines() if "500" in line], sep="\n")


def printed_key(output: Path, role: str) -> str:
    """Return the key of the file that was printed for a role."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while not (found := re.search(rf"{role}, .* with the key in (\S+)\n", output.read_text())):
        assert time.monotonic() < deadline, output.read_text()
        time.sleep(0.1)
    path = Path(found[1])
    assert path.stat().st_mode & 0o777 == 0o600
    return path.read_text().strip()


def test_from_the_command_to_a_confirmed_torque(service, new_page, screenshot):
    page = new_page(key=None, allowed=(401, 404))
    page.goto("/")
    page.get_by_label("Key").fill(printed_key(service.output, "operator"))
    page.get_by_role("button", name="Sign in").click()
    expect(page.get_by_role("button", name="Sign out")).to_be_visible()
    page.goto("/console/#/control")
    expect(page.locator(".state.present")).to_have_text("ARMED", timeout=WAIT_MS)
    armed_s = time.monotonic() - service.began
    page.goto("/console/#/now")
    expect(page.get_by_role("heading", level=1)).to_contain_text("torques may go")
    expect(page.locator(".hour").first).to_contain_text("Last hour")
    screenshot(page, "demonstration-now")
    page.goto("/console/#/control")
    page.get_by_label("Reason", exact=True).fill("roll is off")
    page.get_by_role("button", name="Prepare", exact=True).click()
    card = page.locator(".card.waiting")
    expect(card).to_be_visible()
    counter = card.get_attribute("data-command")
    screenshot(page, "demonstration-prepared")
    card.get_by_label("Key of the second person").fill(printed_key(service.output, "approver"))
    card.get_by_role("button", name="Confirm with this key").click()
    history = page.locator(f".control-history [data-command='{counter}']")
    expect(history).to_contain_text("Anna + Boris", timeout=WAIT_MS)
    confirmed_s = time.monotonic() - service.began
    answer = f"/api/v1/spacecraft/yamal-202/torques/{counter}"
    deadline = time.monotonic() + START_TIMEOUT_S
    while (state := page.context.request.get(answer).json()["state"]) != "EXECUTED":
        assert state in {"RELEASED", "SENT"}
        assert time.monotonic() < deadline
        time.sleep(0.2)
    executed_s = time.monotonic() - service.began
    expect(page.locator(".card.owed")).to_have_count(0)
    screenshot(page, "demonstration-executed")
    print(f"from the command: armed {armed_s:.0f} s, confirmed {confirmed_s:.0f} s, executed {executed_s:.0f} s")
