"""Momentum that the simulator's wheels report during the calibration turns, and what may be wrong with it."""

from typing import NamedTuple

import numpy as np

from analyzer_sim.world.scenario.story import Scenario, WheelTelemetry
from analyzer_sim.world.spacecraft.telemetry import reported_momentum
from service.core.estimation.design import recommended_turns

MINUTE_US = 60_000_000
#: about roll, pitch, yaw
INERTIA_KG_M2 = (2600.0, 1400.0, 2600.0)
SCENARIO = Scenario("turned_wheels", "Calibration turns alone.")
#: minutes between two records, of a slew, and one sigma of a sensor's angle, deg
EVERY, SLEW, SENSOR_DEG = 5, 3, 0.01
#: faults: what is reported is the matrix times the truth; roll, pitch, yaw
WRONG = {
    "sign of roll": np.diag([-1.0, 1.0, 1.0]),
    "sign of pitch": np.diag([1.0, -1.0, 1.0]),
    "sign of yaw": np.diag([1.0, 1.0, -1.0]),
    "signs of roll and yaw": np.diag([-1.0, 1.0, -1.0]),
    "roll and pitch exchanged": np.eye(3)[[1, 0, 2]],
    "roll and yaw exchanged": np.eye(3)[[2, 1, 0]],
    "pitch and yaw exchanged": np.eye(3)[[0, 2, 1]],
    "all exchanged": np.eye(3)[[1, 2, 0]],
    "all exchanged the other way": np.eye(3)[[2, 0, 1]],
    "roll times 1000": np.diag([1000.0, 1.0, 1.0]),
    "pitch times 1000": np.diag([1.0, 1000.0, 1.0]),
    "yaw times 0.6": np.diag([1.0, 1.0, 0.6]),
    "pitch times 0.6": np.diag([1.0, 0.6, 1.0]),
}
#: the same, of all axes alike
ALIKE = {"N mm s": 1000.0, "lbf ft s": 0.7376, "sign of all": -1.0, "scale 0.8": 0.8, "scale 1.2": 1.2}


class Turned(NamedTuple):
    """K records of the turns."""

    epochs_us: np.ndarray
    #: (K, 3) N m s, along roll, pitch, yaw
    momentum: np.ndarray
    #: (K, 3) deg, yaw, roll, pitch by a sensor, and whether the spacecraft slews
    attitude_deg: np.ndarray
    is_slewing: np.ndarray


def turned_deg() -> np.ndarray:
    """Return the attitude (T, 3) of the turns, one row a minute, deg; each level is reached by a slew."""
    held = np.concatenate([np.tile(turn.attitude_deg, (round(turn.minutes), 1)) for turn in recommended_turns()])
    padded = np.concatenate([np.zeros((SLEW, 3)), held])
    return np.mean([padded[SLEW - k : len(padded) - k] for k in range(SLEW)], axis=0)


def turned_wheels(seed: int, figures: WheelTelemetry | None = None, *, start_h: float = 1.0) -> Turned:
    """Return the records of one seed; the turns begin some hours after the story, which unloads at 12 h."""
    rows_deg = turned_deg()
    before = round(60 * start_h)
    attitude_deg = np.concatenate([np.zeros((before, 3)), rows_deg])
    epochs_us = SCENARIO.start_us + MINUTE_US * np.arange(len(attitude_deg))
    wheels = figures or WheelTelemetry()
    reported = reported_momentum(SCENARIO, wheels, seed, INERTIA_KG_M2, epochs_us, attitude_deg)
    rows = np.arange(before, len(attitude_deg), EVERY)
    measured_deg = attitude_deg + np.random.default_rng(seed).normal(0.0, SENSOR_DEG, attitude_deg.shape)
    moved_deg = np.abs(attitude_deg[np.minimum(rows + 1, len(attitude_deg) - 1)] - attitude_deg[rows - 1])
    return Turned(epochs_us[rows], reported[rows], measured_deg[rows], moved_deg.max(axis=1) > 0.05)
