"""Operator who commands from the powers: he knows the truth through them alone, and keeps the attitude."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.world.payload.payload import sensitivity_db_per_deg
from analyzer_sim.world.scenario.scenario import KeepingErrors, scenario_named
from analyzer_sim.world.spacecraft.operator import CUT_DB, Operator, sensed_error_deg
from analyzer_sim.world.world import World

SEEDS = (1, 2, 3, 4, 5, 6)
KEEPING = KeepingErrors(is_steered_by_powers=True)


def operation_deg(world: World) -> np.ndarray:
    return world.rows.attitude_deg[world.rows.epochs_us >= world.scenario.operation_start_us]


def test_noise_looks_like_attitude_and_what_is_common_does_not() -> None:
    world = World(scenario_named("nominal", operation_days=0.1), 1)
    slopes = sensitivity_db_per_deg(world.plan, world.orbit)
    angles = np.array([0.1, -0.05, 0.08])
    noise = np.zeros((3, 16))
    noise[1], noise[2] = slopes @ angles + 3e-3, 5.0
    error, covariance = sensed_error_deg(slopes, noise, np.array([True, False, False]))
    np.testing.assert_allclose(error, [[0.0] * 3, angles, [0.0] * 3], atol=1e-12)  # rounding
    sigma = np.sqrt(np.diag(covariance))
    assert sigma[0] > 5.0 * sigma[2] > 5.0 * sigma[1]  # yaw is told worst, roll best


def test_a_storm_is_cut() -> None:
    slopes = np.column_stack([np.linspace(-1.0, 1.0, 8), np.cos(np.arange(8.0)), np.sin(np.arange(8.0))])
    storm = np.zeros((2, 8))
    storm[1, 3] = -9.0
    cut = np.clip(storm, -CUT_DB, CUT_DB)
    is_aligned = np.array([True, False])
    np.testing.assert_array_equal(
        sensed_error_deg(slopes, storm, is_aligned)[0], sensed_error_deg(slopes, cut, is_aligned)[0]
    )


def test_he_follows_what_the_powers_look_like_and_his_own_commands() -> None:
    operator = Operator(np.zeros(3), 1e-6 * np.eye(3), KEEPING)
    seen = np.array([0.03, -0.02, 0.01])
    np.testing.assert_allclose(operator.sense(seen), seen, atol=1e-3)  # he trusts them to 0.001 deg
    operator.predict(0.5, np.array([0.0, 0.0, -0.02]))
    blind = Operator(seen, 1e6 * np.eye(3), KEEPING)
    blind.predict(0.5, np.array([0.0, 0.0, -0.02]))
    assert blind.sense(np.ones(3))[2] == pytest.approx(0.0, abs=1e-6)  # 0.01 - 0.5 h * 0.02 deg/h


def test_weather_moves_the_attitude_and_without_it_worlds_stay_as_they_are() -> None:
    dry = replace(scenario_named("weather_far"), faults=())
    assert not np.array_equal(operation_deg(World(scenario_named("weather_far"), 6)), operation_deg(World(dry, 6)))
    # who knows the truth but for an error of his own is moved by nothing else
    told = [replace(scenario, keeping=KeepingErrors()) for scenario in (dry, scenario_named("weather_far"))]
    first, second = (operation_deg(World(scenario, 6)) for scenario in told)
    np.testing.assert_array_equal(first, second)


def test_the_attitude_is_kept_where_the_calibration_holds() -> None:
    worlds = [World(scenario_named("weather_far"), seed) for seed in SEEDS]
    rms = np.sqrt(np.mean([np.mean(operation_deg(world) ** 2, axis=0) for world in worlds], axis=0))
    greatest = np.max([np.abs(operation_deg(world)).max(axis=0) for world in worlds], axis=0)
    print(f"seeds {SEEDS}: rms yaw {rms[0]:.3f} roll {rms[1]:.3f} pitch {rms[2]:.3f} deg, greatest {greatest.round(2)}")
    assert np.all(rms < [0.2, 0.1, 0.1])  # deg: as large as in nominal and half again
    assert np.all(greatest < 0.5)  # deg: turns of the calibration reach so far
