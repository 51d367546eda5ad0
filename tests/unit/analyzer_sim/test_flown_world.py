"""Flown world: the story until operation, then a spacecraft that answers torques; changes act until their end."""

import asyncio
import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from analyzer_sim.emission import Emission, EndOfScenario, Signal
from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.flown_world import (
    MAX_LINE_BYTES,
    SCHEDULES_A_ROW,
    ChangeError,
    FlownWorld,
    changed_emission,
    parse_change,
    response_factor,
)
from analyzer_sim.plant.plant import Plant, PlantOptions, ScheduleError, parse_schedule
from analyzer_sim.serving import serve_changes
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


def test_a_line_that_is_no_schedule_changes_nothing() -> None:
    flown, quiet = in_operation(), in_operation()
    with pytest.raises(ScheduleError):
        flown.send('{"schedule": 1}')
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


CARRIERS = ("c00", "c01")
AT_US, CHANGE_MINUTE_US = 1_000_000_000, 60_000_000


def change_line(kind: object, duration_s: object = 60.0, **fields: object) -> str:
    return json.dumps({"change": kind, "duration_s": duration_s, **fields})


def emission(epoch_us: int) -> Emission:
    signals = tuple(Signal(name, 1e9, 1e6, 0.2, -50.0) for name in CARRIERS)
    return Emission(epoch_us, signals, -140.0)


def powers(kind: str, epoch_us: int, **fields: object) -> dict[str, float]:
    change = parse_change(change_line(kind, **fields), AT_US, CARRIERS)
    return {signal.carrier: signal.power_dbm for signal in changed_emission(emission(epoch_us), [change]).signals}


@pytest.mark.parametrize(
    ("kind", "fields", "expected"),
    [
        ("rain", {}, {"c00": -56.0, "c01": -56.0}),
        ("step", {}, {"c00": -47.0, "c01": -50.0}),
        ("step", {"carrier": "c01"}, {"c00": -50.0, "c01": -47.0}),
        ("dead-carrier", {"carrier": "c01"}, {"c00": -50.0}),
        ("sign", {}, {"c00": -50.0, "c01": -50.0}),
    ],
)
def test_it_acts_from_the_next_row_until_its_end(kind, fields, expected):
    unchanged = dict.fromkeys(CARRIERS, -50.0)
    assert powers(kind, AT_US, **fields) == unchanged
    assert powers(kind, AT_US + CHANGE_MINUTE_US, **fields) == expected
    assert powers(kind, AT_US + CHANGE_MINUTE_US + 1, **fields) == unchanged


def test_rain_raises_the_noise_and_the_reversed_wheels_alone_reverse():
    rain, sign = (parse_change(change_line(kind), AT_US, CARRIERS) for kind in ("rain", "sign"))
    assert changed_emission(emission(AT_US + 1), [rain]).noise_dbm_hz == -138.0
    factors = [
        response_factor([rain, sign], AT_US + later_us) for later_us in (0, 1, CHANGE_MINUTE_US, CHANGE_MINUTE_US + 1)
    ]
    assert factors == [1.0, -1.0, -1.0, 1.0]
    assert response_factor([rain], AT_US + 1) == 1.0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '"rain"',
        change_line("snow"),
        change_line(["rain"]),
        change_line("rain", 0),
        change_line("rain", 1e9),
        change_line("rain", True),
        '{"change": "rain", "duration_s": NaN}',
        '{"change": "rain"}',
        change_line("rain", carrier="c00"),
        change_line("step", carrier="c99"),
        change_line("dead-carrier", carrier=["c00"]),
    ],
)
def test_what_is_no_change_is_refused(text):
    with pytest.raises(ChangeError):
        parse_change(text, AT_US, CARRIERS)


def test_the_world_that_is_flown_shows_it_and_the_spacecraft_answers_reversed():
    flown = FlownWorld(SHORT, 1, PlantOptions())
    with pytest.raises(ChangeError, match="before the operation has begun"):
        flown.change(change_line("sign"))
    while flown.epoch_us is None:
        flown.advance()
    plain = {signal.carrier: signal.power_dbm for signal in flown.advance().signals}
    flown.change(change_line("sign", 120))
    gone = flown.change(change_line("dead-carrier", 60)).carrier
    shown = {signal.carrier for signal in flown.advance().signals}
    assert set(plain) - shown == {gone}
    assert flown._plant.flown.response == (-1.0, -1.0, -1.0)
    flown.advance()
    assert gone in {signal.carrier for signal in flown.advance().signals}
    assert flown._plant.flown.response == (1.0, 1.0, 1.0)


FLOWN = SimpleNamespace(change=lambda text: parse_change(text, 0, CARRIERS))


def answers(*lines: bytes) -> list[dict]:
    """Return what the port answers to some lines of one client."""

    async def converse() -> list[dict]:
        server = await serve_changes(FLOWN, "127.0.0.1", 0)
        async with server:
            reader, writer = await asyncio.open_connection(*server.sockets[0].getsockname()[:2])
            writer.write(b"".join(lines))
            writer.write_eof()
            text = await reader.read()
            writer.close()
        return [json.loads(line) for line in text.splitlines()]

    return asyncio.run(converse())


def test_a_change_is_answered_with_its_span():
    (answer,) = answers(b'{"change":"step","duration_s":60}\n')
    assert answer["type"] == "changed"
    assert (answer["change"], answer["carrier"]) == ("step", "c00")
    assert (answer["from"], answer["until"]) == ("1970-01-01T00:00:00.000000Z", "1970-01-01T00:01:00.000000Z")


def test_a_line_that_is_none_is_answered_and_the_next_one_too():
    said = answers(b"\xff\n", b'{"change":"rain","duration_s":-1}\n', b'{"change":"rain","duration_s":1}\n')
    assert [answer["type"] for answer in said] == ["error", "error", "changed"]


def test_a_line_that_is_too_long_is_refused():
    (answer,) = answers(b"x" * (2 * MAX_LINE_BYTES) + b"\n")
    assert f"{MAX_LINE_BYTES} bytes" in answer["detail"]
