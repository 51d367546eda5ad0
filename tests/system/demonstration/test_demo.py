"""The demonstration as a user runs it: both methods, faults that are injected, two-step operation."""

import csv
import json
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from datetime import datetime, timedelta
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from child_processes import children_of
from waiting import wait_until

from service.cli.demonstration.demo_run import Alone, own_station
from service.cli.demonstration.persons import two_persons
from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.records.epoch import parse_epoch
from service.study.closed_loop.plant_process import PlantProcess
from service.study.demonstration.control_centre import AXES, RowPaces, TwoStepCentre
from service.study.demonstration.demonstration import Scene, run_story

pytestmark = [pytest.mark.system, pytest.mark.slow]


KEY = "a-key-for-tests-only"
SEED = 1
#: an hour and a half beyond the settling hour; too short for the bounds of estimates, which the whole tour keeps
DAYS = 0.1
#: too short for the harmonics of a day; they hardly matter for hours
QUIET_DAYS = 0.5


def soo(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run one command to its end."""
    command = [sys.executable, "-m", "service", *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=540, check=False)


def statistics_of(environment: dict[str, str], *options: str) -> dict:
    """Run a short demonstration and return its figures."""
    print(f"seed {SEED}")
    lengths = ("--days", str(DAYS), "--quiet-days", str(QUIET_DAYS))
    ran = soo(environment, "demo", "--exit", "--json", "--seed", str(SEED), *lengths, *options)
    assert ran.stderr == ""
    assert len(ran.stdout.splitlines()) == 1
    figures = json.loads(ran.stdout)
    assert ran.returncode == bool(figures["missed"])
    return figures


@pytest.fixture(scope="module")
def kept(tmp_path_factory, compiled_environment) -> tuple[Path, dict]:
    """Run the demonstration once; give the folder it kept and its figures."""
    folder = tmp_path_factory.mktemp("demo")
    return folder, statistics_of(compiled_environment, "--keep", str(folder))


def require_whole(figures: dict) -> None:
    """Nothing is lost, nothing invented, live operation equals its replay."""
    assert figures["seed"] == SEED
    assert figures["rows"] == round(DAYS * 1440)
    assert figures["rows_measured"] == figures["rows_archived"] > figures["rows"]
    assert (figures["rows_lost"], figures["rows_not_measured"]) == (0, 0)
    assert figures["replay_rows"] == 2 * figures["rows"], "a row of each method"
    assert figures["replay_rows_different"] == 0


def test_no_row_is_lost_and_live_equals_its_replay(kept):
    require_whole(kept[1])


@pytest.mark.nightly
def test_no_row_is_lost_and_live_equals_its_replay_where_slews_are_followed(compiled_environment):
    figures = statistics_of(compiled_environment, "--open")
    require_whole(figures)
    assert figures["closed_loop"] is None
    # the only bounds that may be missed are those of accuracy
    assert figures["missed"] == figures["estimate_misses"]
    # the tour of slews is there to be followed
    assert all(merit["truth_rms_deg"] > 0.02 for merit in figures["axes"].values())


def test_torques_keep_the_craft_that_leaves_its_bounds_without_them(kept):
    loop = kept[1]["closed_loop"]
    commands = loop["commands"]
    assert commands["sent"] >= commands["executed"] > 20
    assert [commands[name] for name in ("late", "refused", "lost", "twice")] == [0, 0, 0, 0]
    assert loop["bounds_deg"] == {"yaw": 0.5, "roll": 0.3, "pitch": 0.3}
    assert commands["sent"] - commands["executed"] <= 1, "the last one is on its way"
    assert all(0.0 < impulse < 0.1 for impulse in loop["impulse_n_m_s"].values())
    assert (loop["missed"], kept[1]["missed"]) == ([], [])
    alone = loop["control_off"]
    assert alone["missed"]
    assert alone["hours_within_bounds"] < alone["hours"] < 24 * DAYS
    for axis in ("roll", "pitch"):
        assert loop["largest_deg"][axis] < 0.5 * alone["largest_deg"][axis]


def test_the_kept_database_serves_exports_and_replays(kept, start_service, compiled_environment, tmp_path):
    folder, figures = kept
    service = start_service(database=folder / "soo.db")
    environment = {**compiled_environment, "SOO_KEY": KEY}
    with service.client() as client:
        (record,) = client.get("/api/v1/spacecraft").json()["rows"]
        known = record["id"]
        carriers = client.get(f"/api/v1/spacecraft/{known}/carriers").json()["carriers"]
        newest = client.get(f"/api/v1/spacecraft/{known}/status").json()["newest_measurement"]
        alignment = client.get(f"/api/v1/spacecraft/{known}/alignments").json()["rows"][0]["epoch"]
    # what the spacecraft said of its loop, and nothing besides
    reported = record["onboard"]["fed_forward_torque"]
    sizes = [abs(reported[part][axis]) for part in ("cosine_n_m", "sine_n_m") for axis in ("yaw", "roll", "pitch")]
    assert 1e-6 < max(sizes) < 2e-5, "the Sun's light"
    assert record["onboard"]["residual_torque_n_m"] == 0.0
    where = ("--service", service.url, "--spacecraft", known)
    wide = ("--start", "2020-01-01T00:00:00Z", "--stop", "2040-01-01T00:00:00Z")
    table = tmp_path / "measurements.csv"
    ran = soo(environment, "export", *where, "--series", "measurements", *wide, "--output", str(table))
    assert ran.returncode == 0, ran.stderr
    with table.open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["epoch", "source", *(f"{carrier['id']}_dbm" for carrier in carriers)]
    assert len(rows) == 1 + figures["rows_archived"]
    # one row a minute, none left out, from the first to the newest
    assert rows[-1][0] == newest
    instants = [datetime.fromisoformat(row[0]) for row in rows[1:]]
    assert {later - earlier for earlier, later in pairwise(instants)} == {timedelta(minutes=1)}
    ran = soo(
        environment, "replay", *where, "--start", alignment, "--stop", "2040-01-01T00:00:00Z", "--compare", "--json"
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    report = json.loads(ran.stdout)
    assert report["rows_different"] == 0
    assert report["rows_equal"] == report["rows"] >= figures["rows"]


def test_a_folder_with_a_database_is_not_used_again(kept, compiled_environment):
    folder, _ = kept
    ran = soo(compiled_environment, "demo", "--exit", "--keep", str(folder))
    assert ran.returncode == 2
    assert "name another folder" in ran.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly)])
def test_a_signal_ends_it_with_all_its_processes(number, compiled_environment, tmp_path):
    command = [sys.executable, "-m", "service", "demo", "--keep", str(tmp_path / "kept")]
    with (tmp_path / "out").open("wb") as output:
        process = subprocess.Popen(command, env=compiled_environment, stdout=output, stderr=output)
    log = tmp_path / "kept" / "acquire.log"
    try:
        wait_until(lambda: log.exists() and log.stat().st_size, (tmp_path / "out").read_text)
        children = children_of(process.pid)
        assert len(children) == 3
        process.send_signal(number)
        assert process.wait(120) == 0, (tmp_path / "out").read_text()
    finally:
        process.kill()
        process.wait()
    assert not [child for child in children if Path(f"/proc/{child}").exists()]
    assert "stopped" in (tmp_path / "out").read_text()
    assert "Traceback" not in (tmp_path / "out").read_text()


@pytest.mark.nightly
def test_two_days_on_a_tour_of_slews_keep_every_bound(compiled_environment):
    print(f"seed {SEED}")
    ran = soo(compiled_environment, "demo", "--open", "--exit", "--json", "--seed", str(SEED))
    print(ran.stdout)
    assert (json.loads(ran.stdout)["missed"], ran.returncode) == ([], 0)


CRAFT = "yamal-202"
#: bounds hangs; half a quiet day is measured first
TIMEOUT_S = 500.0
until = partial(wait_until, patience_s=TIMEOUT_S)


@pytest.fixture(scope="module")
def environment(tmp_path_factory, compiled_environment) -> dict[str, str]:
    """Return the environment of both terminals."""
    return {**compiled_environment, "XDG_RUNTIME_DIR": str(tmp_path_factory.mktemp("run"))}


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


@pytest.mark.nightly
def test_what_is_injected_has_its_answer_and_no_wrong_torque(client, environment):
    """One story: each change begins in the state that the one before it left."""
    ran = inject(environment, "step", "--carrier", "c99")
    assert (ran.returncode, "the carriers are c00" in ran.stderr) == (2, True)
    for kind, carrier in (("dead-carrier", "c03"), ("step", "c05")):
        _a_carrier_that_changes_is_left_out_and_control_goes_on(client, environment, kind, carrier)
    _rain_over_the_receiving_site_inhibits_until_it_is_over(client, environment)
    _wheels_that_reverse_end_control(client, environment)
    _a_stop_trips_control_until_it_is_reset(client, environment)


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


TWO_STEP_SEED, TWO_STEP_DAYS, TWO_STEP_QUIET_DAYS = 1, 0.2, 0.5
TWO_STEP_TIMEOUT_S = 300.0


class Over(Exception):  # noqa: N818 - ends the story once the persons are done
    """The persons have what they came for."""


def release(anna: ServiceClient, boris: ServiceClient) -> dict:
    """Do what the two persons do, and return the command when it is reported."""

    def is_armed() -> bool:
        rows = anna.request("GET", "/spacecraft")["rows"]
        return bool(rows) and anna.control(CRAFT)["armed"]

    wait_until(is_armed, lambda: anna.control(CRAFT), TWO_STEP_TIMEOUT_S)
    command = anna.prepare_torques(CRAFT, "roll and pitch are off")
    with pytest.raises(ProblemError) as refused:
        anna.confirm_torques(CRAFT, command["id"], command["digest"])
    assert refused.value.status == 403, "nobody confirms alone"
    boris.confirm_torques(CRAFT, command["id"], command["digest"], "pulses seen")
    wait_until(
        lambda: anna.command(CRAFT, command["id"])["state"] not in {"RELEASED", "SENT"}, "a report", TWO_STEP_TIMEOUT_S
    )
    return anna.command(CRAFT, command["id"])


def show(persons: Future, scene: Scene) -> None:
    if persons.done() and parse_epoch(scene.until) > parse_epoch(persons.result()["stop"]):
        raise Over


def alone_deg(epoch_us: int) -> tuple[float, ...]:
    """Return the attitude of the same spacecraft that gets no command."""
    with PlantProcess(
        "demo", TWO_STEP_SEED, "ideal", TWO_STEP_DAYS, ("--quiet-days", str(TWO_STEP_QUIET_DAYS))
    ) as plant:
        plant.opening()
        for row in plant.rows():
            if row.truth.epoch_us == epoch_us:
                return row.truth.attitude_deg
            plant.send((), None)
    raise AssertionError(epoch_us)


@pytest.mark.nightly
def test_two_keys_release_a_torque_and_the_spacecraft_turns(tmp_path: Path) -> None:
    kept: list[Scene] = []
    alone = Alone(TWO_STEP_SEED, TWO_STEP_DAYS, TWO_STEP_QUIET_DAYS)
    with ExitStack() as stack:
        endpoints = stack.enter_context(own_station(tmp_path, alone, "two_step"))
        client = stack.enter_context(ServiceClient(endpoints.service_url, endpoints.key, timeout_s=60.0))
        with ThreadPoolExecutor(1) as pool:
            persons = two_persons(client, tmp_path)
            assert [person.key_file.stat().st_mode & 0o777 for person in persons] == [0o600, 0o600]
            anna, boris = (
                stack.enter_context(ServiceClient(endpoints.service_url, person.key, timeout_s=60.0))
                for person in persons
            )
            work = pool.submit(release, anna, boris)
            centre_of = partial(TwoStepCentre, operator=anna, paces=RowPaces(0.5, 3.0, 0.0))

            def keep(scene: Scene) -> None:
                kept[:] = [scene]
                show(work, scene)

            with pytest.raises(Over):
                run_story(tmp_path, endpoints, client, keep, centre_of)
    command, story = work.result(), kept[0].story
    assert (command["state"], command["prepared_by"], command["confirmed_by"]) == ("EXECUTED", "Anna", "Boris")
    assert command["executed"] == command["schedule"]
    assert story.centre.log.counts()["executed"] == len(story.centre.log.sent) == 1, "nothing else went up"
    stop_us = min(epoch_us for epoch_us in story.truth_deg if epoch_us >= parse_epoch(command["stop"]))
    predicted = command["predicted"]["angle_change_deg"]
    assert max(abs(predicted[axis]) for axis in AXES) > 0.005, "a turn that can be seen"
    for axis, flown_deg, left_deg in zip(AXES, story.truth_deg[stop_us], alone_deg(stop_us), strict=True):
        assert flown_deg - left_deg == pytest.approx(predicted[axis], abs=0.003)
