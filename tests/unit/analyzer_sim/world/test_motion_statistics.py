"""Statistics of measured motion: those of the story, null where it measures nothing."""

from dataclasses import asdict

import numpy as np
import pytest

from analyzer_sim.world.motion_statistics import motion_statistics
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.spacecraft.stored_momentum import UNLOADED_SHARE, unloaded
from analyzer_sim.world.world import World


def stated(name):
    world = World(scenario_named(name, quiet_days=0.5, operation_days=0.1), 1)
    return world, motion_statistics(world)


def test_a_story_without_measured_motion_has_none():
    assert stated("nominal")[1] == {"wheels": None, "rates": None, "polarimeter": None}


def test_wheels_state_their_unloadings_and_what_these_leave():
    world, found = stated("wheels")
    wheels = found["wheels"]
    figures = asdict(world.scenario.wheels)
    size_n_m = figures.pop("torque_n_m")
    assert {name: wheels[name] for name in figures} == figures
    assert wheels["torque_n_m"] == [size_n_m] * 3
    assert 0.5 * size_n_m < wheels["constant_n_m"][0] < size_n_m
    assert wheels["unloading_us"] == [world.scenario.start_us + 12 * 3_600_000_000]
    left = np.array([unloaded(world.scenario.wheels, seed, number) for seed in range(200) for number in range(5)])
    # a thousand draws of two axes: the standard error of their rms is a percent
    assert np.sqrt(np.mean(left[:, [0, 2]] ** 2)) == pytest.approx(wheels["unloaded_n_m_s"], rel=0.04)
    assert np.abs(left[:, [0, 2]]).max() <= UNLOADED_SHARE * world.scenario.wheels.unloading_n_m_s


def test_rates_state_how_often_the_bias_is_as_large_as_the_catalogue_says():
    assert stated("rates_biased")[1]["rates"]["bias_factor"] == 5.0


def test_a_polarimeter_follows_yaw_and_states_when_its_feed_turns():
    world, found = stated("feed_turned")
    polarimeter = found["polarimeter"]
    assert np.linalg.norm(polarimeter["sight"]) == pytest.approx(1.0, abs=0.01)
    assert polarimeter["sight"][0] > 0.9
    assert polarimeter["feed_turn_from_us"] == world.scenario.operation_start_us + 20 * 3_600_000_000
    assert 0.1 / 3.0 < polarimeter["rain_deg_db"] < 0.3 / 3.0
