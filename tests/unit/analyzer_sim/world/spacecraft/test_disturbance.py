"""Disturbance: what is fed forward is told as a profile, never what is left of it."""

import json

import numpy as np
import pytest

from analyzer_sim.plant.plant_lines import fed_forward_line
from analyzer_sim.world.ground.ground_bodies import spacecraft_body
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.scenario.story import Scenario
from analyzer_sim.world.spacecraft.disturbance import FED_FORWARD_SHARE, disturbance, fed_forward, gathered_profile
from analyzer_sim.world.world import World

STORY, WHEELS, UNSTATED = (scenario_named(name) for name in ("nominal", "wheels", "wheels_unstated"))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("story", [STORY, WHEELS, UNSTATED], ids=["nominal", "wheels", "wheels_unstated"])
def test_the_profile_is_the_share_that_is_fed_forward_of_the_torque_that_acts(story: Scenario, seed: int) -> None:
    reported = fed_forward(story, seed)
    epochs_us = story.operation_start_us + 3_600_000_000 * np.arange(48)
    acts = disturbance(story, seed, epochs_us).external_n_m
    # the torque of a row is that of the middle of the step after it
    turns = (epochs_us + 0.5 * story.row_period_us - reported.epoch_us) / (reported.period_s * 1e6)
    phase = 2.0 * np.pi * turns[:, None]
    wave = np.cos(phase) * reported.cosine_n_m + np.sin(phase) * reported.sine_n_m
    np.testing.assert_allclose(reported.constant_n_m + wave, FED_FORWARD_SHARE * acts, atol=1e-16)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_torque_that_gathers_in_wheels_is_the_same_before_operation_and_in_it(seed: int) -> None:
    assert WHEELS.wheels is not None
    profile = gathered_profile(WHEELS.wheels, seed)
    epochs_us = WHEELS.operation_start_us + 600_000_000 * np.arange(144)
    acts = disturbance(WHEELS, seed, epochs_us).external_n_m
    phase = 2.0 * np.pi * (epochs_us + WHEELS.row_period_us // 2 - WHEELS.start_us)[:, None] / 86_400_000_000
    gathered = profile.constant_n_m + profile.cosine_n_m * np.cos(phase) + profile.sine_n_m * np.sin(phase)
    # yaw, roll, pitch of roll, pitch, yaw
    np.testing.assert_allclose(acts, gathered[:, [2, 0, 1]], atol=1e-16)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_wheels_without_a_stated_profile_gather_the_torque_of_stories_without_wheels(seed: int) -> None:
    epochs_us = UNSTATED.operation_start_us + 600_000_000 * np.arange(144)
    for acts, expected in zip(disturbance(UNSTATED, seed, epochs_us), disturbance(STORY, seed, epochs_us), strict=True):
        np.testing.assert_allclose(acts, expected, atol=1e-20)
    world = World(UNSTATED, seed)
    assert fed_forward_line(world) is None
    for is_flown in (False, True):
        onboard = spacecraft_body(world, is_flown=is_flown)["onboard"]
        assert (onboard["residual_torque_n_m"], "torque" in onboard["momentum"]) == (None, False)


def test_the_line_says_nothing_of_what_is_wrong_with_it() -> None:
    line = json.loads(json.dumps(fed_forward_line(World(STORY, 1))))
    assert sorted(line) == ["constant_n_m", "cosine_n_m", "epoch", "period_s", "sine_n_m"]
    assert sorted(line["cosine_n_m"]) == ["pitch", "roll", "yaw"]


@pytest.mark.parametrize("seed", range(1, 21))
@pytest.mark.parametrize("name", ["unknown_residual_constant", "unknown_residual_daily"])
def test_a_torque_that_nobody_knows_has_its_size_and_is_not_announced(name: str, seed: int) -> None:
    story = scenario_named(name)
    epochs_us = story.operation_start_us + 600_000_000 * np.arange(144)
    acts = disturbance(story, seed, epochs_us)
    size_n_m = np.abs(acts.unseen_n_m).max(axis=0)
    assert ((size_n_m > 1.99e-7) & (size_n_m <= 2e-6)).all()
    mean_n_m = np.abs(acts.unseen_n_m.mean(axis=0))
    # a wave of a day has no mean, a constant nothing else
    np.testing.assert_allclose(mean_n_m, 0.0 * size_n_m if name.endswith("daily") else size_n_m, atol=1e-12)
    # all of the Sun's torque is fed forward
    nominal = disturbance(STORY, seed, epochs_us)
    np.testing.assert_allclose(acts.external_n_m - acts.unseen_n_m, nominal.external_n_m, atol=1e-20)
    assert fed_forward_line(World(story, seed)) is None
