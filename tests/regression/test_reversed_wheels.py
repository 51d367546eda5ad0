"""Wheels that do the opposite of each torque, against the plant, under release automatic.

Figures: found 42, 61 and 54 min after the first torque (seeds 1 to 3), with roll and pitch below 0.20 deg. A watch that
counts angles of commands alone, not the rates that torques leave, finds it never: control ended by the range of
control, with 0.62 deg of pitch.
"""

import numpy as np
import pytest

from service.study.closed_loop import run
from service.study.closed_loop.controllers import Sensing
from service.study.closed_loop.plant_process import PlantProcess

REVERSED = [word for axis in ("yaw", "roll", "pitch") for word in ("--response", f"{axis}=-1")]


@pytest.mark.parametrize("seed", range(1, 4))
def test_reversed_torques_are_found_before_they_carry_roll_or_pitch_far(monkeypatch, seed):
    monkeypatch.setattr(run, "PlantProcess", lambda *arguments: PlantProcess(*arguments[:4], REVERSED))
    flight = run.fly_unit(run.LoopUnit("demo", seed, Sensing.AUTOMATIC, "ideal", 0.06)).flight
    sizes_deg = np.abs(flight.truth_deg[:, 1:]).max(axis=1)
    # from here on nothing goes: an hour of doubt, and longer where roll or pitch went beyond their range meanwhile
    found = len(sizes_deg) - int(np.argmin(flight.is_inhibited[::-1]))
    assert found < len(sizes_deg), "torques went to the end"
    print(f"seed {seed}: found after {flight.hours[found]:.2f} h, roll or pitch at {sizes_deg[found]:.3f} deg")
    assert flight.hours[found] < 1.2
    assert sizes_deg[found] < 0.25
