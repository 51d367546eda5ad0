"""The switching law of one line and of both lines."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from service.core.flexible.both_lines import crossing_speed_rad_s, find_cycles_over_both_lines, return_over_both_lines
from service.core.flexible.spacecraft import WheelDrive
from service.core.flexible.switching_law import WATCHES, Arm, SwitchingLaw, arm_after_pulse, require_law

LAW = SwitchingLaw(0.0175, 0.0349, 1.0, 3, 2e-3)


def test_every_state_has_its_row():
    assert set(WATCHES) == set(Arm)
    assert {watch.line for row in WATCHES.values() for watch in row} == {"line", "alpha", "beta", "last"}


def test_lines_stand_a_step_apart_and_go_on_beyond_the_last():
    assert [LAW.next_line_rad(counter) for counter in range(4)] == pytest.approx([0.0349, 0.0369, 0.0389, 0.0409])
    assert LAW.last_line_rad == pytest.approx(0.0389)


def test_a_single_line_without_a_step_has_none_after_it():
    single = SwitchingLaw(0.0175, 0.0349, 1.0)
    assert single.next_line_rad(0) == 0.0349
    assert math.isinf(single.next_line_rad(1))


@pytest.mark.parametrize(("counter", "arm"), [(1, Arm.COUNTING), (2, Arm.COUNTING), (3, Arm.FULL), (4, Arm.FULL)])
def test_after_a_pulse(counter, arm):
    assert arm_after_pulse(counter, LAW) is arm


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"alpha_rad": 0.04}, "alpha_rad 0.04 is not at or below beta_rad 0.0349"),
        ({"alpha_rad": 0.0}, "alpha_rad is 0"),
        ({"beta_rad": math.inf}, "not at or below beta_rad inf"),
        ({"pulse_s": 0.0}, "pulse_s is 0, it must be above 0"),
        ({"pulse_s": math.nan}, "pulse_s is nan"),
        ({"pulse_count": 0}, "pulse_count is 0, it must be 1 or more"),
        ({"line_step_rad": 0.0}, "line_step_rad is 0"),
        ({"line_step_rad": -1e-3}, "line_step_rad is -0.001"),
    ],
)
def test_a_law_that_cannot_switch_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        require_law(LAW._replace(**changes))


def test_one_line_for_on_and_off_is_a_law():
    require_law(LAW._replace(alpha_rad=0.0349))
    assert LAW._replace(pulse_s=math.inf).is_relay


DRIVE = WheelDrive(1000.0, 0.2, 3e-4, 1e-4, momentum_n_m_s=10.0)
TWO_LINES = SwitchingLaw(0.0175, 0.0349, 2.0)


@pytest.mark.parametrize("momentum_n_m_s", [10.0, -10.0])
def test_the_side_to_which_friction_turns_fires_once_more(momentum_n_m_s):
    """Two pulses there, one on the other side: N - N' pulses make good what friction takes in a period."""
    (cycle,) = find_cycles_over_both_lines(DRIVE._replace(momentum_n_m_s=momentum_n_m_s), TWO_LINES)
    assert cycle.motion.pulses == (2, 1)
    assert cycle.motion.period_s == pytest.approx(0.2 * 2.0 / (3e-4 + 5e-5), rel=1e-9)
    assert cycle.multiplier == pytest.approx(-1.007, abs=2e-3)
    assert not cycle.is_stable
    assert cycle.motion.outer_rad > TWO_LINES.beta_rad


def test_a_step_between_lines_makes_it_stable():
    drive, law = (
        DRIVE._replace(dry_friction_n_m=1e-4),
        TWO_LINES._replace(pulse_s=1.0, pulse_count=2, line_step_rad=1.5e-3),
    )
    (cycle,) = find_cycles_over_both_lines(drive, law)
    assert cycle.is_stable
    assert cycle.multiplier == pytest.approx(-0.771, abs=2e-3)
    speed = 1.005 * cycle.motion.speed_rad_s
    for _ in range(40):
        speed = return_over_both_lines(speed, drive, law).speed_rad_s
    assert speed == pytest.approx(cycle.motion.speed_rad_s, rel=1e-4)


def test_a_return_is_that_of_an_integrator():
    """The same visit by DOP853 between the same events, counted outward from the line of arrival."""
    (cycle,) = find_cycles_over_both_lines(DRIVE, TWO_LINES)
    passive, motor, loss_1_s = (3e-4 + 1e-4 * 10.0 / 20.0) / 1000.0, 0.2 / 1000.0, 1e-4 / 20.0

    def leg(y, u, push, for_s, level=None):
        def slope(_t, z):
            return [z[1], push + passive - loss_1_s * z[1]]

        def gap(_t, z):
            return z[0] - level

        gap.terminal, gap.direction = True, math.copysign(1.0, level or 1.0)
        events = None if level is None else gap
        solved = solve_ivp(slope, (0.0, for_s), [y, u], method="DOP853", rtol=1e-11, atol=1e-16, events=events)
        return solved.t[-1], *solved.y[:, -1]

    beta, total = TWO_LINES.beta_rad, 0.0
    y, u = beta, cycle.motion.speed_rad_s
    for push, for_s, level in (
        (-motor, 2.0, None),  # first pulse at the line of arrival
        (0.0, 1e5, beta),  # friction brings the body back to it
        (-motor, 2.0, None),  # second pulse
        (0.0, 1e5, -beta),  # through neutral
        (motor, 2.0, None),  # one pulse on the other side
        (0.0, 1e5, beta),  # and back
    ):
        taken, y, u = leg(y, u, push, for_s, level)
        total += taken
    assert u == pytest.approx(cycle.motion.speed_rad_s, rel=1e-6)
    assert total == pytest.approx(cycle.motion.period_s, rel=1e-6)


def test_three_pulses_a_side_where_the_rotor_passes_through_rest():
    drive = DRIVE._replace(dry_friction_n_m=1e-4, momentum_n_m_s=0.0)
    law = SwitchingLaw(0.0175, 0.0349, 4.0, 3, 1.5e-3)
    found = {cycle.motion.pulses: cycle for cycle in find_cycles_over_both_lines(drive, law)}
    assert (3, 3) in found
    # symmetric: friction opposes the motion, and as much speed leaves a side as comes
    assert found[3, 3].motion.speed_rad_s == pytest.approx(1.5 * 0.2 * 4.0 / 1000.0, rel=0.01)


def test_no_cycle_where_a_pulse_does_not_reach_through_neutral():
    drive, law = DRIVE._replace(dry_friction_n_m=1e-3), TWO_LINES._replace(pulse_s=1.0)
    assert crossing_speed_rad_s(drive, law) == pytest.approx(math.sqrt(4 * 1.05e-6 * 0.0349), rel=1e-9)
    assert find_cycles_over_both_lines(drive, law) == ()
    assert all(return_over_both_lines(float(w), drive, law) is None for w in np.linspace(2e-5, 1.8e-4, 9))
