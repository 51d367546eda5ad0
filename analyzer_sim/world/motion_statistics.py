"""Statistics of measured motion: what errors of wheels, rates and polarimeter were drawn from, for the judge alone.

Each is the figures of the story by their names, null where the story has none, and beside them

    wheels       torque_n_m, constant_n_m (3,) amplitude of the daily wave and constant torque along roll, pitch, yaw;
                 quantum_n_m_s of a report, unloading_us (U,) epochs of the unloadings, unloaded_n_m_s what each leaves
                 along roll and yaw
    polarimeter  sight (3,) turn that it follows by yaw, roll, pitch, deg/deg; storm_from_us, feed_turn_from_us;
                 rain_deg_db turn by rain, wander_tau_s

Sizes are one standard deviation.
"""

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from analyzer_sim.epochs import US_PER_H
from analyzer_sim.world.polarimeter import RAIN_DEG, WANDER_TAU_S, body_turn_deg
from analyzer_sim.world.scenario.story import PolarimeterFigures, WheelTelemetry
from analyzer_sim.world.spacecraft.telemetry import (
    CONSTANT_SHARE,
    QUANTUM_N_M_S,
    UNLOADED_SHARE,
    unloadings_us,
    wave_size_n_m,
)
from analyzer_sim.world.world import World

#: turn by which the sight is measured, deg
_TURN_DEG = 0.1


def motion_statistics(world: World) -> dict[str, dict[str, Any] | None]:
    """Return the statistics of wheels, rates and polarimeter by name."""
    story = world.scenario
    return {
        "wheels": None if story.wheels is None else _of_wheels(world, story.wheels),
        "rates": None if story.rates is None else asdict(story.rates),
        "polarimeter": None if story.polarimeter is None else _of_polarimeter(world, story.polarimeter),
    }


def _of_wheels(world: World, figures: WheelTelemetry) -> dict[str, Any]:
    """Return the figures of the wheels with their unloadings."""
    # the light of the Sun has no constant part
    constant = 0.0 if figures.torque_n_m is None else _uniform_rms(*CONSTANT_SHARE)
    wave_n_m = wave_size_n_m(figures)
    return {
        **asdict(figures),
        "torque_n_m": wave_n_m.tolist(),
        "constant_n_m": (constant * wave_n_m).tolist(),
        "quantum_n_m_s": QUANTUM_N_M_S,
        "unloaded_n_m_s": figures.unloading_n_m_s * _uniform_rms(-UNLOADED_SHARE, UNLOADED_SHARE),
        "unloading_us": unloadings_us(world.scenario).tolist(),
    }


def _of_polarimeter(world: World, figures: PolarimeterFigures) -> dict[str, Any]:
    """Return the figures of the polarimeter with its line of sight and the epochs of its events."""
    attitudes = np.vstack([np.zeros(3), _TURN_DEG * np.eye(3)])
    epochs_us = np.repeat(world.rows.epochs_us[:1], len(attitudes))
    turns = body_turn_deg(world.orbit, world.plan.receiving_site, epochs_us, attitudes)
    start_us = world.scenario.operation_start_us
    return {
        **asdict(figures),
        "rain_deg_db": _uniform_rms(*RAIN_DEG) / 3.0,
        "wander_tau_s": WANDER_TAU_S,
        "sight": ((turns[1:] - turns[0]) / _TURN_DEG).tolist(),
        "storm_from_us": start_us + round(figures.storm_from_h * US_PER_H),
        "feed_turn_from_us": start_us + round(figures.feed_turn_from_h * US_PER_H),
    }


def _uniform_rms(low: float, high: float) -> float:
    """Return the root mean square of a number drawn evenly between two."""
    return math.sqrt((low**2 + low * high + high**2) / 3.0)
