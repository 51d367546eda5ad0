"""``soo demo inject`` from a second terminal: the service says the right thing, and no wrong torque is sent."""

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from service.client.service_client import ServiceClient

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]

CRAFT = "yamal-202"
#: bounds hangs; half a quiet day is measured first
TIMEOUT_S = 500.0


def until(reached: Callable[[], Any], what: str) -> Any:
    """Wait until something is true and return it."""
    deadline = time.monotonic() + TIMEOUT_S
    while not (found := reached()):
        assert time.monotonic() < deadline, what
        time.sleep(0.05)
    return found


@pytest.fixture(scope="module")
def environment(tmp_path_factory, compiled_environment) -> dict[str, str]:
    """Return the environment of both terminals; the compiler would take longer than the rows."""
    return {**compiled_environment, "XDG_RUNTIME_DIR": str(tmp_path_factory.mktemp("run")), "SOO_KERNELS": "numpy"}


@pytest.fixture(scope="module")
def client(environment, tmp_path_factory) -> Iterator[ServiceClient]:
    """Start the demonstration, wait until it steers, and give a client of its service."""
    folder = tmp_path_factory.mktemp("demo")
    output = folder / "output"
    lengths = ("--quiet-days", "0.5", "--rows-per-second", "60")
    command = [sys.executable, "-m", "service", "demo", "--keep", str(folder / "kept"), *lengths]
    with output.open("wb") as stream:
        process = subprocess.Popen(command, env=environment, stdout=stream, stderr=stream)
    try:

        def address() -> re.Match[str] | None:
            assert process.poll() is None, output.read_text()
            return re.search(r"console (http://[\d.:]+)/console/, sign in", output.read_text())

        url = until(address, "the console is announced")[1]
        key = (folder / "kept" / "administrator.key").read_text().strip()
        with ServiceClient(url, key, timeout_s=60.0) as made:
            until(lambda: made.control(CRAFT)["state"] == "ENGAGED", output.read_text())
            yield made
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(120)


def inject(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "service", "demo", "inject", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


def injected(environment: dict[str, str], *arguments: str) -> dict[str, Any]:
    ran = inject(environment, *arguments, "--json")
    assert ran.returncode == 0, ran.stderr
    return dict(json.loads(ran.stdout))


def torque_is_zero(client: ServiceClient) -> bool:
    torques = client.torques(CRAFT)
    return not torques["control"]["allowed"] and not any(torques[f"{axis}_n_m"] for axis in ("yaw", "roll", "pitch"))


def excluded(client: ServiceClient) -> set[str]:
    return {item["carrier"] for item in client.attitude(CRAFT)["excluded"]}


def test_no_demonstration_is_changed_where_none_runs(environment, tmp_path):
    ran = inject({**environment, "XDG_RUNTIME_DIR": str(tmp_path)}, "rain")
    assert (ran.returncode, "start one with soo demo" in ran.stderr) == (1, True)


def test_what_is_injected_has_its_answer_and_no_wrong_torque(client, environment):
    """One story: each change begins in the state that the one before it left."""
    _its_addresses_are_for_its_user_alone(environment)
    ran = inject(environment, "step", "--carrier", "c99")
    assert (ran.returncode, "the carriers are c00" in ran.stderr) == (2, True)
    for kind, carrier in (("dead-carrier", "c03"), ("step", "c05")):
        _a_carrier_that_changes_is_left_out_and_control_goes_on(client, environment, kind, carrier)
    _rain_over_the_receiving_site_inhibits_until_it_is_over(client, environment)
    _wheels_that_reverse_end_control(client, environment)
    _a_stop_trips_control_until_it_is_reset(client, environment)


def _its_addresses_are_for_its_user_alone(environment):
    path = Path(environment["XDG_RUNTIME_DIR"]) / "soo" / "demonstration.json"
    assert path.stat().st_mode & 0o777 == 0o600


def _a_carrier_that_changes_is_left_out_and_control_goes_on(client, environment, kind, carrier):
    until(lambda: client.control(CRAFT)["state"] == "ENGAGED", "control goes")
    assert injected(environment, kind, "--carrier", carrier, "--minutes", "60")["carrier"] == carrier
    until(lambda: carrier in excluded(client), f"{carrier} is left out")
    assert client.control(CRAFT)["state"] == "ENGAGED"


def _rain_over_the_receiving_site_inhibits_until_it_is_over(client, environment):
    # short: nobody keeps the spacecraft until ten good minutes after it
    injected(environment, "rain", "--minutes", "10")
    until(lambda: "fade" in client.control(CRAFT)["reasons"], "the fade inhibits")
    until(lambda: torque_is_zero(client), "no torque goes")
    until(lambda: client.control(CRAFT)["state"] == "ENGAGED", "control resumes by itself")


def _wheels_that_reverse_end_control(client, environment):
    injected(environment, "sign", "--minutes", "720")
    # by the response that was missed, or at the latest where roll or pitch leaves the range of control
    until(lambda: {"response_missed", "hand_over"} & set(client.control(CRAFT)["reasons"]), "control ends")
    until(lambda: torque_is_zero(client), "no torque goes")


def _a_stop_trips_control_until_it_is_reset(client, environment):
    assert injected(environment, "stop") == {"type": "stopped", "state": "TRIPPED"}
    assert "stop" in client.control(CRAFT)["trips"]
    until(lambda: torque_is_zero(client), "no torque goes")
