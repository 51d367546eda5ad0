"""Simulated polarimeter: what the ratio follows, and that other stories have none."""

from dataclasses import replace

import numpy as np
import pytest

from analyzer_sim.world.polarimeter import body_turn_deg
from analyzer_sim.world.scenario.scenario import scenario_named
from analyzer_sim.world.world import World

EXACT = {"white_deg": 0.0, "leakage_deg": 0.0, "daily_deg": 0.0, "wander_deg": 0.0}


def world(name: str = "polarized", **changes: float) -> World:
    story = scenario_named(name, operation_days=0.2, quiet_days=0.2)
    assert story.polarimeter is not None
    return World(replace(story, polarimeter=replace(story.polarimeter, **changes)), 1)


def angles_deg(made: World) -> np.ndarray:
    ratio = np.array([report.ratio_db for report in made.polarization])
    return np.degrees(np.arctan(10.0 ** (ratio / 20.0))) - 10.0


def test_a_story_without_a_polarimeter_reports_nothing() -> None:
    assert World(scenario_named("nominal", operation_days=0.1), 1).polarization == ()


def test_the_angle_turns_one_to_one_with_yaw_and_little_with_roll_and_pitch() -> None:
    made = world()
    epochs_us, site = made.rows.epochs_us[:1], made.plan.receiving_site
    turns = [body_turn_deg(made.orbit, site, epochs_us, row[None, :])[0] for row in (np.zeros(3), *(0.1 * np.eye(3)))]
    np.testing.assert_allclose(np.diff([turns[0], turns[1]]), 0.099, atol=1e-3)
    assert np.abs(np.array(turns[2:]) - turns[0]).max() < 0.02


def test_an_exact_polarimeter_reports_turn_and_faraday_rotation() -> None:
    made = world(**EXACT)
    turn_deg = body_turn_deg(made.orbit, made.plan.receiving_site, made.rows.epochs_us, made.rows.attitude_deg)
    left_deg = (angles_deg(made) - turn_deg)[made.rows.downlink_fade_db == 0.0]
    # rotation of a quiet day at 11 GHz
    assert 0.01 < left_deg.min() < left_deg.max() < 0.16
    assert len(made.polarization) == len(made.rows.epochs_us)


@pytest.mark.parametrize(
    ("changes", "moved_deg"),
    [({"feed_turn_deg": 0.5, "feed_turn_from_h": 2.0}, 0.5), ({"leak_drift_deg_h": 0.1}, 0.2)],
)
def test_feed_and_leakage_move_the_angle_in_operation(changes: dict[str, float], moved_deg: float) -> None:
    plain, moved = world(**EXACT), world(**EXACT, **changes)
    hours = (plain.rows.epochs_us - plain.scenario.operation_start_us) / 3.6e9
    apart_deg = angles_deg(moved) - angles_deg(plain)
    assert np.abs(apart_deg[hours < 0.0]).max() == 0.0
    assert apart_deg[hours >= 2.0][1] == pytest.approx(moved_deg, rel=0.1)
