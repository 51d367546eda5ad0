"""Disturbance: what is fed forward is told as a profile, never what is left of it."""

import json

import numpy as np
import pytest

from analyzer_sim.plant_lines import fed_forward_line
from analyzer_sim.world.disturbance import FED_FORWARD_SHARE, disturbance, fed_forward
from analyzer_sim.world.scenario import scenario_named
from analyzer_sim.world.world import World

STORY = scenario_named("nominal")


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_profile_is_the_share_that_is_fed_forward_of_the_torque_that_acts(seed: int) -> None:
    told = fed_forward(STORY, seed)
    epochs_us = STORY.operation_start_us + 3_600_000_000 * np.arange(48)
    acts = disturbance(STORY, seed, epochs_us).solar_n_m
    # the torque of a row is that of the middle of the step after it
    turns = (epochs_us + 0.5 * STORY.row_period_us - told.epoch_us) / (told.period_s * 1e6)
    phase = 2.0 * np.pi * turns[:, None]
    profile = np.cos(phase) * told.cosine_n_m + np.sin(phase) * told.sine_n_m
    np.testing.assert_allclose(profile, FED_FORWARD_SHARE * acts, atol=1e-16)


def test_the_line_says_nothing_of_what_is_wrong_with_it() -> None:
    line = json.loads(json.dumps(fed_forward_line(World(STORY, 1))))
    assert sorted(line) == ["constant_n_m", "cosine_n_m", "epoch", "period_s", "sine_n_m"]
    assert sorted(line["cosine_n_m"]) == ["pitch", "roll", "yaw"]
