"""Two persons release a torque of the demonstration over REST, and the spacecraft turns by what was predicted."""

import time
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest

from service.cli.demonstration.demo_run import Alone, own_station
from service.cli.demonstration.persons import two_persons
from service.client.problem import ProblemError
from service.client.service_client import ServiceClient
from service.records.epoch import parse_epoch
from service.study.closed_loop.plant_process import PlantProcess
from service.study.demonstration.demonstration import Scene, run_story
from service.study.demonstration.merit import AXES
from service.study.demonstration.two_step_centre import RowPaces, TwoStepCentre

pytestmark = [pytest.mark.system, pytest.mark.slow, pytest.mark.nightly]

SEED, DAYS, QUIET_DAYS = 1, 0.2, 0.5
CRAFT = "yamal-202"
TIMEOUT_S = 300.0


class Over(Exception):  # noqa: N818 - ends the story once the persons are done
    """The persons have what they came for."""


def until(client: ServiceClient, is_reached) -> None:
    deadline = time.monotonic() + TIMEOUT_S
    while not is_reached():
        assert time.monotonic() < deadline, client.control(CRAFT)
        time.sleep(0.1)


def release(anna: ServiceClient, boris: ServiceClient) -> dict:
    """Do what the two persons do, and return the command when it is reported."""

    def is_armed() -> bool:
        rows = anna.request("GET", "/spacecraft")["rows"]
        return bool(rows) and anna.control(CRAFT)["armed"]

    until(anna, is_armed)
    command = anna.prepare_torques(CRAFT, "roll and pitch are off")
    with pytest.raises(ProblemError) as refused:
        anna.confirm_torques(CRAFT, command["id"], command["digest"])
    assert refused.value.status == 403, "nobody confirms alone"
    boris.confirm_torques(CRAFT, command["id"], command["digest"], "pulses seen")
    until(anna, lambda: anna.command(CRAFT, command["id"])["state"] not in {"RELEASED", "SENT"})
    return anna.command(CRAFT, command["id"])


def show(persons: Future, scene: Scene) -> None:
    if persons.done() and parse_epoch(scene.until) > parse_epoch(persons.result()["stop"]):
        raise Over


def alone_deg(epoch_us: int) -> tuple[float, ...]:
    """Return the attitude of the same spacecraft that gets no command."""
    with PlantProcess("demo", SEED, "ideal", DAYS, ("--quiet-days", str(QUIET_DAYS))) as plant:
        plant.opening()
        for row in plant.rows():
            if row.truth.epoch_us == epoch_us:
                return row.truth.attitude_deg
            plant.send((), None)
    raise AssertionError(epoch_us)


def test_two_keys_release_a_torque_and_the_spacecraft_turns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # the compiler would take longer than the rows
    monkeypatch.setenv("SOO_KERNELS", "numpy")
    kept: list[Scene] = []
    alone = Alone(SEED, DAYS, QUIET_DAYS)
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
