"""Stored momentum: reported wheels follow attitude and torque; without wheels of its own a story stays as it was."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.scenario.story import Scenario, WheelTelemetry
from analyzer_sim.world.spacecraft.body_dynamics import INERTIA_KG_M2
from analyzer_sim.world.spacecraft.disturbance import gathered_profile
from analyzer_sim.world.spacecraft.stored_momentum import (
    QUANTUM_N_M_S,
    reported_momentum,
    unloadings_us,
)
from analyzer_sim.world.world import World

S = 1_000_000
EXACT = WheelTelemetry(
    noise_n_m_s=0.0, misalignment_deg=0.0, scale_error=0.0, torque_n_m=0.0, unknown_n_m=0.0, half_day_share=0.0
)


def reported_of(figures: WheelTelemetry, attitude_deg: np.ndarray, seed: int = 1) -> np.ndarray:
    story = replace(scenario_named("wheels"), wheels=figures)
    epochs_us = story.start_us + 60 * S * np.arange(len(attitude_deg), dtype=np.int64)
    return reported_momentum(story, figures, seed, INERTIA_KG_M2, epochs_us, attitude_deg)


def test_a_yaw_turn_turns_the_pitch_momentum_into_roll() -> None:
    still, turned = np.zeros((30, 3)), np.zeros((30, 3))
    turned[:, 0] = 0.5
    change = reported_of(EXACT, turned)[5] - reported_of(EXACT, still)[5]
    # 8.1 N m s along minus pitch and what the body itself turns with the orbit, 0.5 deg
    assert change[0] == pytest.approx(np.radians(0.5) * (-8.0 + 7.292e-5 * 2600.0), abs=1.5 * QUANTUM_N_M_S)
    assert change[1] == pytest.approx(0.0, abs=1.5 * QUANTUM_N_M_S)


def test_without_a_torque_momentum_stands_still_in_inertial_space() -> None:
    reported = reported_of(EXACT, np.zeros((360, 3)))
    across = reported[:, 0] + 1j * reported[:, 2]
    turned = across[0] * np.exp(-1j * 7.292115e-5 * 60.0 * np.arange(360))
    np.testing.assert_allclose(across, turned, atol=1.5 * QUANTUM_N_M_S)


def test_a_constant_torque_gathers_along_pitch_until_it_is_unloaded() -> None:
    figures = WheelTelemetry(
        noise_n_m_s=0.0, misalignment_deg=0.0, scale_error=0.0, unknown_n_m=0.0, half_day_share=0.0
    )
    reported = reported_of(figures, np.zeros((13 * 60, 3)))[:, 1]
    profile = gathered_profile(figures, 1)
    angle = 2.0 * np.pi / 24.0 * np.arange(660) / 60.0
    torque = profile.constant_n_m[1] + profile.cosine_n_m[1] * np.cos(angle) + profile.sine_n_m[1] * np.sin(angle)
    np.testing.assert_allclose(np.diff(reported[[0, 659]]), 60.0 * torque.sum(), atol=0.01)
    assert reported[12 * 60 + 1] == pytest.approx(-8.0 + 1400.0 * 7.292e-5, abs=0.02)


def short(name: str) -> Scenario:
    return replace(scenario_named(name), quiet_h=12.0, operation_h=3.0)


def test_wheels_of_its_own_change_nothing_else_in_a_world() -> None:
    wheels, plain = World(short("wheels"), 3), World(replace(short("wheels"), wheels=None), 3)
    np.testing.assert_array_equal(wheels.rows.power_dbm, plain.rows.power_dbm)
    np.testing.assert_array_equal(wheels.rows.attitude_deg, plain.rows.attitude_deg)
    assert plain.telemetry == World(short("nominal"), 3).telemetry
    assert len(wheels.telemetry) == pytest.approx(12 * len(plain.telemetry), abs=12)


def test_unloadings_are_marked_where_the_story_says_so() -> None:
    marked, unmarked = World(short("wheels"), 1).telemetry, World(short("wheels_unmarked"), 1).telemetry
    active_us = [record.reported_us for record in marked if record.thrusters_active]
    assert active_us == unloadings_us(short("wheels")).tolist()
    assert not any(record.thrusters_active for record in unmarked)
    reported = [record.wheel_momentum_n_m_s for record in marked]
    assert reported == [record.wheel_momentum_n_m_s for record in unmarked]
