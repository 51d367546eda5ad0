"""Crossings of lines by rigid and flexible bodies, hidden ones among them, and of momenta."""

import math

import numpy as np
import pytest

from service.core.flexible.crossings import Line, crossing_time, momentum_time
from service.core.flexible.propagation import BodyState, angle_and_rate_at, start_leg, state_at, states_at
from service.core.flexible.spacecraft import HubMode

MODE = HubMode(0.5, 0.005, 0.5)


def leg_of(start, mode=None, wheel_n_m=0.0, decay_1_s=0.0, external_n_m=0.0):
    return start_leg(
        start,
        mode,
        inertia_kg_m2=1000.0,
        wheel_torque_n_m=wheel_n_m,
        decay_1_s=decay_1_s,
        external_torque_n_m=external_n_m,
    )


def scanned(leg, line, horizon_s):
    """Return the first crossing by a fine scan."""
    times = np.linspace(0.0, horizon_s, 40_001)
    states = states_at(leg, times)
    ahead = line.direction * (states[:, 0] + states[:, 2] - line.angle_rad)
    crossed = np.flatnonzero((ahead[:-1] < 0.0) & (ahead[1:] >= 0.0))
    return float(times[crossed[0]]) if len(crossed) else math.inf


@pytest.mark.parametrize("decay_1_s", [0.0, 5e-6, 1e-3, 0.02])
@pytest.mark.parametrize("external_n_m", [0.0, 3e-4, -3e-4])
@pytest.mark.parametrize("line", [Line(0.0307, 1.0), Line(0.029, -1.0), Line(0.0301, -1.0), Line(0.02, -1.0)])
def test_a_rigid_body_by_turns_and_newton(decay_1_s, external_n_m, line):
    leg = leg_of(BodyState(0.03, 6e-5), wheel_n_m=-1.5e-3, decay_1_s=decay_1_s, external_n_m=external_n_m)
    found, wanted = crossing_time(leg, line, 900.0), scanned(leg, line, 900.0)
    if math.isinf(wanted) or line == Line(0.0301, -1.0):
        # the line above the start is passed downwards already
        assert found == (0.0 if line == Line(0.0301, -1.0) else math.inf)
    else:
        assert found == pytest.approx(wanted, abs=0.03)
        assert angle_and_rate_at(leg, found)[0] == pytest.approx(line.angle_rad, abs=1e-15)


@pytest.mark.parametrize("angle_rad", [0.0305, 0.0335, 0.03499, 0.0352])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_flexible_body_by_scan_and_brent(angle_rad, direction):
    leg = leg_of(BodyState(0.03, 1e-5, -1e-3, 1e-3), MODE, wheel_n_m=1e-3)
    line = Line(angle_rad, direction)
    found = crossing_time(leg, line, 120.0)
    if direction > 0.0:
        assert found == pytest.approx(scanned(leg, line, 120.0), abs=0.01)
    else:
        assert found == 0.0


def test_a_line_touched_between_two_points_of_the_scan_is_found():
    leg = leg_of(BodyState(0.0, 0.0, 0.0, 1e-3), MODE)
    # the first top of the swing, between two points
    top_s = math.atan(math.sqrt(1.0 - MODE.damping_ratio**2) / MODE.damping_ratio) / leg.frequency_rad_s
    top_rad = state_at(leg, top_s).deflection_rad
    found = crossing_time(leg, Line(top_rad * (1.0 - 1e-7), 1.0), 20.0)
    assert 0.0 < top_s - found < 5e-3
    assert math.isinf(crossing_time(leg, Line(top_rad * (1.0 + 1e-9), 1.0), 20.0))


def test_on_the_line_the_rate_decides():
    line = Line(0.03, 1.0)
    assert crossing_time(leg_of(BodyState(0.03, 1e-6)), line, 10.0) == 0.0
    assert math.isinf(crossing_time(leg_of(BodyState(0.03, -1e-6)), line, 10.0))
    assert crossing_time(leg_of(BodyState(0.031, -1e-6)), line, 10.0) == 0.0


def test_a_leg_that_leaves_the_line_comes_back_to_it_later():
    leg = leg_of(BodyState(0.03, -1e-6, 0.0, -1e-4), MODE, wheel_n_m=1e-2)
    found = crossing_time(leg, Line(0.03, 1.0), 60.0)
    assert 0.05 < found < 60.0
    assert found == pytest.approx(scanned(leg, Line(0.03, 1.0), 60.0), abs=0.01)


def test_a_leg_that_comes_back_to_its_line_between_two_points():
    line = Line(0.03, 1.0)
    leg = leg_of(BodyState(0.03, -1e-6), MODE, wheel_n_m=0.2)
    # as a free body of inertia 1000 / (1 + kn)
    assert crossing_time(leg, line, 60.0) == pytest.approx(2e-6 / 3e-4, rel=1e-3)
    grazing = leg_of(BodyState(0.03, -1e-15), MODE, wheel_n_m=0.2)
    assert 0.0 <= crossing_time(grazing, line, 60.0) < 1e-6


@pytest.mark.parametrize("decay_1_s", [0.0, 1e-4, 0.01])
def test_when_the_momentum_comes_to_a_value(decay_1_s):
    leg = leg_of(BodyState(0.0, 0.0, momentum_n_m_s=2.0), wheel_n_m=-0.05, decay_1_s=decay_1_s)
    after_s = momentum_time(leg, 0.0)
    assert state_at(leg, after_s).momentum_n_m_s == pytest.approx(0.0, abs=1e-13)
    assert math.isinf(momentum_time(leg, 3.0))
    assert math.isinf(momentum_time(leg, 2.0))
    # the torque decays before the momentum is there
    far = momentum_time(leg, -20.0)
    assert math.isinf(far) if decay_1_s == 0.01 else math.isfinite(far)
