"""Changes of a flown world: each acts from the row after it was made until its end, and on nothing else."""

import json
from dataclasses import replace

import pytest

from analyzer_sim.emission import Emission, Signal
from analyzer_sim.plant.flown_world import FlownWorld
from analyzer_sim.plant.plant import PlantOptions
from analyzer_sim.plant.world_changes import ChangeError, changed_emission, parse_change, response_factor
from analyzer_sim.world.scenario.scenario import scenario_named

CARRIERS = ("c00", "c01")
AT_US, MINUTE_US = 1_000_000_000, 60_000_000
SHORT = replace(scenario_named("nominal"), quiet_h=1.0, operation_h=1.0)


def line(kind: object, duration_s: object = 60.0, **fields: object) -> str:
    return json.dumps({"change": kind, "duration_s": duration_s, **fields})


def emission(epoch_us: int) -> Emission:
    signals = tuple(Signal(name, 1e9, 1e6, 0.2, -50.0) for name in CARRIERS)
    return Emission(epoch_us, signals, -140.0)


def powers(kind: str, epoch_us: int, **fields: object) -> dict[str, float]:
    change = parse_change(line(kind, **fields), AT_US, CARRIERS)
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
    assert powers(kind, AT_US + MINUTE_US, **fields) == expected
    assert powers(kind, AT_US + MINUTE_US + 1, **fields) == unchanged


def test_rain_raises_the_noise_and_the_reversed_wheels_alone_reverse():
    rain, sign = (parse_change(line(kind), AT_US, CARRIERS) for kind in ("rain", "sign"))
    assert changed_emission(emission(AT_US + 1), [rain]).noise_dbm_hz == -138.0
    factors = [response_factor([rain, sign], AT_US + later_us) for later_us in (0, 1, MINUTE_US, MINUTE_US + 1)]
    assert factors == [1.0, -1.0, -1.0, 1.0]
    assert response_factor([rain], AT_US + 1) == 1.0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "null",
        '"rain"',
        line("snow"),
        line(["rain"]),
        line("rain", 0),
        line("rain", -1.0),
        line("rain", 1e9),
        line("rain", "60"),
        line("rain", True),
        '{"change": "rain", "duration_s": NaN}',
        '{"change": "rain", "duration_s": Infinity}',
        '{"change": "rain"}',
        line("rain", carrier="c00"),
        line("step", carrier="c99"),
        line("step", carrier=""),
        line("dead-carrier", carrier=["c00"]),
    ],
)
def test_what_is_no_change_is_refused(text):
    with pytest.raises(ChangeError):
        parse_change(text, AT_US, CARRIERS)


def test_the_world_that_is_flown_shows_it_and_the_spacecraft_answers_reversed():
    flown = FlownWorld(SHORT, 1, PlantOptions())
    with pytest.raises(ChangeError, match="before the operation has begun"):
        flown.change(line("sign"))
    while flown.epoch_us is None:
        flown.advance()
    plain = {signal.carrier: signal.power_dbm for signal in flown.advance().signals}
    flown.change(line("sign", 120))
    gone = flown.change(line("dead-carrier", 60)).carrier
    shown = {signal.carrier for signal in flown.advance().signals}
    assert set(plain) - shown == {gone}
    assert flown._plant.flown.response == (-1.0, -1.0, -1.0)
    flown.advance()
    assert gone in {signal.carrier for signal in flown.advance().signals}
    assert flown._plant.flown.response == (1.0, 1.0, 1.0)
