"""Legs: their start, their end, and one number at a time."""

import numpy as np
import pytest

from service.core.flexible.propagation import BodyState, angle_and_rate_at, start_leg, state_at, states_at
from service.core.flexible.spacecraft import HubMode

START = BodyState(0.0349, -1.3e-4, 2.1e-3, -7e-4, 0.8)
MODES = [None, HubMode(0.5, 0.005, 0.5), HubMode(3.0, 0.4, 2.0)]


def leg_of(mode, decay_1_s=1e-3):
    return start_leg(
        START,
        mode,
        inertia_kg_m2=1000.0,
        wheel_torque_n_m=-0.2,
        decay_1_s=decay_1_s,
        external_torque_n_m=1e-3,
    )


@pytest.mark.parametrize("mode", MODES[1:])
def test_a_leg_begins_where_it_starts(mode):
    np.testing.assert_allclose(state_at(leg_of(mode), 0.0), START, rtol=1e-14)


def test_a_rigid_leg_has_no_deflection():
    assert state_at(leg_of(None), 20.0)[2:4] == (0.0, 0.0)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("decay_1_s", [0.0, 1e-3, 0.1])
def test_one_number_at_a_time_is_the_sum_of_both_sheets(mode, decay_1_s):
    leg = leg_of(mode, decay_1_s)
    for t in (0.0, 0.3, 7.0, 60.0):
        state = state_at(leg, t)
        wanted = (state.angle_rad + state.deflection_rad, state.rate_rad_s + state.deflection_rate_rad_s)
        if mode is None:
            wanted = (state.angle_rad, state.rate_rad_s)
        assert angle_and_rate_at(leg, t) == pytest.approx(wanted, rel=1e-13, abs=1e-17)


@pytest.mark.parametrize("mode", MODES)
def test_rates_are_the_slopes_of_angles(mode):
    leg, step = leg_of(mode), 1e-4
    before, at, after = states_at(leg, np.array([5.0 - step, 5.0, 5.0 + step]))
    assert (after[0] - before[0]) / (2.0 * step) == pytest.approx(at[1], rel=1e-8)
    assert (after[2] - before[2]) / (2.0 * step) == pytest.approx(at[3], rel=1e-6, abs=1e-15)


def test_under_constant_torque_a_damped_mode_comes_to_its_centre():
    mode = HubMode(3.0, 0.4, 2.0)
    leg = start_leg(START, mode, inertia_kg_m2=1000.0, wheel_torque_n_m=-0.2)
    assert state_at(leg, 60.0).deflection_rad == pytest.approx(-2.0 * 0.2 / 1000.0 / 9.0, rel=1e-12)
