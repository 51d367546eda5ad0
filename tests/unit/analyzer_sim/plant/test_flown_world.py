"""Flown world: before operation the story, from then on a spacecraft that answers torques; what is shown was flown."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from analyzer_sim.emission import EndOfScenario
from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.flown_world import SCHEDULES_A_ROW, FlownWorld
from analyzer_sim.plant.plant import Plant, PlantOptions
from analyzer_sim.plant.schedule_lines import ScheduleError, parse_schedule
from analyzer_sim.world.scenario.events import Gap
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.world import World

SEED = 1
MINUTE_US = 60_000_000
SHORT = replace(scenario_named("nominal"), quiet_h=1.0, operation_h=1.0)


@cache
def open_world() -> World:
    return World(SHORT, SEED)


def in_operation(rows: int = 1, scenario: Scenario = SHORT, uplink: str = "ideal") -> FlownWorld:
    """Return a world of which some rows of operation were swept."""
    flown = FlownWorld(scenario, SEED, PlantOptions(uplink))
    while flown.epoch_us is None:
        flown.advance()
    for _ in range(rows - 1):
        flown.advance()
    return flown


def line(flown: FlownWorld, counter: int | None = None, pitch_n_m: float = 0.04, minutes: int = 0) -> str:
    start_us = flown.epoch_us + minutes * MINUTE_US
    element = {"start": rfc3339(start_us), "duration_s": 30.0, "roll_n_m": 0.0, "pitch_n_m": pitch_n_m, "yaw_n_m": 0.0}
    reported = {"schedule": [element]}
    return json.dumps(reported if counter is None else {**reported, "counter": counter})


def truth(flown: FlownWorld, row: int) -> dict:
    return next(one["rows"][0] for one in flown.reported_after(row, row) if one["kind"] == "truth")


def test_before_operation_it_is_the_story() -> None:
    flown, story = FlownWorld(SHORT, SEED, PlantOptions()), World(SHORT, SEED)
    assert flown.current() == story.current()
    while story.next_epoch_us < SHORT.operation_start_us:
        assert flown.advance() == story.advance()
    assert flown.epoch_us is None
    with pytest.raises(ScheduleError, match="under its sensors until 2026-11-01T10:30"):
        flown.send('{"schedule": []}')


def test_it_flies_as_the_plant_does_and_shows_the_powers_of_what_was_flown() -> None:
    flown, plant = in_operation(), Plant(SHORT, SEED, 0.0)
    assert flown.epoch_us == plant.epoch_us == SHORT.operation_start_us
    for number in range(1, 20):
        text = line(flown, number, 0.04 if number % 2 else -0.04)
        assert flown.send(text) == number
        plant.advance(parse_schedule(text, plant.epoch_us))
        emission = flown.advance()
        assert emission == flown.current()
        assert emission.epoch_us == flown.epoch_us == plant.epoch_us
        reported = truth(flown, plant.row)
        angles_deg = [reported[f"{axis}_deg"] for axis in ("yaw", "roll", "pitch")]
        assert angles_deg == pytest.approx(plant.state.attitude_deg, abs=1e-7)
        shown = {signal.carrier: signal.power_dbm for signal in emission.signals}
        wanted = dict(zip(plant.world.carrier_ids, plant.power_dbm().tolist(), strict=True))
        assert shown == pytest.approx({name: power for name, power in wanted.items() if not np.isnan(power)})
    # ten turns of 3 deg: the powers are not those of the story any more
    assert abs(plant.state.attitude_deg[2] - open_world().rows.attitude_deg[plant.row, 2]) > 10.0


def test_a_schedule_acts_and_its_report_comes_with_the_row_in_which_it_ends() -> None:
    flown, quiet = in_operation(), in_operation()
    heard: list[tuple[int, list[dict]]] = []
    flown.listen(lambda epoch_us, lines: heard.append((epoch_us, lines)))
    assert flown.send(line(flown, 7, minutes=1)) == 7
    for world in (flown, quiet):
        world.advance()
        world.advance()
        world.advance()
    (early_us, nothing), (_, reports), (_, later) = heard
    assert (early_us, nothing, later) == (SHORT.operation_start_us + MINUTE_US, [], [])
    (report,) = reports
    assert (report["counter"], report["state"]) == (7, "executed")
    assert report["impulse_n_m_s"]["pitch"] == pytest.approx(1.2)
    row = flown.world.row_index
    # 1.2 N m s on 1400 kg m2, half of it gained on average for 30 s, then for 90 s
    turned = truth(flown, row)["pitch_deg"] - truth(quiet, row)["pitch_deg"]
    assert turned == pytest.approx(np.rad2deg(1.2 / 1400.0) * 105.0, rel=0.02)


def test_a_counter_is_executed_once() -> None:
    flown = in_operation()
    heard: list[dict] = []
    flown.listen(lambda _, lines: heard.extend(lines))
    for _ in range(2):
        flown.send(line(flown, 3))
    flown.advance()
    assert sorted(report["state"] for report in heard) == ["executed", "repeated"]


def test_over_the_link_a_schedule_arrives_later() -> None:
    flown = in_operation(uplink="link")
    heard: list[dict] = []
    flown.listen(lambda _, lines: heard.extend(lines))
    sent_us = flown.epoch_us
    flown.send(line(flown, 1))  # begins before it can be there
    flown.send(line(flown, 2, minutes=3))
    for _ in range(5):
        flown.advance()
    assert {report["counter"]: report["state"] for report in heard} == {1: "late", 2: "executed"}
    received = min(report["received"] for report in heard)
    assert rfc3339(sent_us + MINUTE_US // 2) <= received


def test_an_empty_schedule_sends_nothing_and_too_many_are_refused() -> None:
    flown = in_operation()
    assert flown.send('{"schedule": []}') is None
    for _ in range(SCHEDULES_A_ROW - 1):
        flown.send(line(flown))
    with pytest.raises(ScheduleError, match="more than 100 schedules"):
        flown.send(line(flown))
    flown.advance()
    assert flown.send(line(flown)) == SCHEDULES_A_ROW


@pytest.mark.parametrize("text", ["", "[]", "\N{REPLACEMENT CHARACTER}", '{"schedule": 1}', '{"schedule": [], "x": 1}'])
def test_a_line_that_is_no_schedule_changes_nothing(text: str) -> None:
    flown, quiet = in_operation(), in_operation()
    with pytest.raises(ScheduleError):
        flown.send(text)
    assert flown.advance() == quiet.advance()


def test_it_flies_on_through_a_gap_and_tells_its_truth() -> None:
    gap = replace(SHORT, faults=(Gap("gap", 1, (0.2, 0.2), (20.0, 20.0)),))
    flown, plant = in_operation(scenario=gap), Plant(gap, SEED, 0.0)
    flown.send(line(flown))
    plant.advance(parse_schedule(line(flown), plant.epoch_us))
    epochs_us = [flown.epoch_us]
    while flown.world.next_epoch_us is not None:
        flown.advance()
        epochs_us.append(flown.epoch_us)
    with pytest.raises(EndOfScenario):
        flown.advance()
    assert max(np.diff(epochs_us)) > 20 * MINUTE_US
    while plant.row < flown.world.row_index:
        plant.advance(parse_schedule('{"schedule": []}', plant.epoch_us))
    assert truth(flown, plant.row)["pitch_deg"] == pytest.approx(plant.state.attitude_deg[2], abs=1e-6)


def test_telemetry_of_the_craft_goes_with_the_rows_of_its_hours() -> None:
    flown = in_operation(30)
    row = flown.world.row_index
    kinds = [reported["kind"] for reported in flown.reported_after(row, row)]
    hour = [reported["kind"] for reported in flown.reported_after(row - 59, row)]
    assert (kinds, hour) == (["truth"], ["telemetry", "truth"])


def test_power_control_remembers_what_was_flown() -> None:
    story = replace(scenario_named("alc"), quiet_h=1.0, operation_h=0.2)
    flown, plant = in_operation(scenario=story), Plant(story, SEED, 0.0)
    for _ in range(5):
        flown.send(line(flown))
        plant.advance(parse_schedule(line(flown), plant.epoch_us))
        emission = flown.advance()
    shown = [signal.power_dbm for signal in emission.signals]
    assert shown == pytest.approx([power for power in plant.power_dbm().tolist() if not np.isnan(power)])
