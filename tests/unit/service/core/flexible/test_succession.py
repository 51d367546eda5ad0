"""Flexible spacecraft: the switching law, arrivals, crossings of lines and limit cycles."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from service.core.flexible.limit_cycle import (
    crossing_speed_rad_s,
    find_cycles_over_both_lines,
    find_limit_cycles,
    koenigs_lamerey,
    one_sided_motion,
    return_over_both_lines,
    succession,
)
from service.core.flexible.propagation import (
    BodyState,
    Line,
    angle_and_rate_at,
    crossing_time,
    momentum_time,
    start_leg,
    state_at,
    states_at,
)
from service.core.flexible.return_kernels import advance, arrival_time, follow, one_return, turning_time
from service.core.flexible.spacecraft import (
    WATCHES,
    Arm,
    HubMode,
    SwitchingLaw,
    WheelDrive,
    arm_after_pulse,
    require_law,
)

DRIVE = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)
LAW = SwitchingLaw(0.0175, 0.0349, 1.0, 3, 3e-3)


@pytest.mark.parametrize(
    ("drive", "law", "reported"),
    [
        (DRIVE._replace(external_torque_n_m=1e-5), LAW, "external_torque_n_m is 1e-05: momentum drifts"),
        (DRIVE._replace(dry_friction_n_m=0.0, viscous_loss_n_m=0.0), LAW, "neither dry nor viscous friction"),
        (DRIVE, LAW._replace(pulse_s=math.inf), "pulse_s is infinite: a relay has no cycle of pulses"),
        (DRIVE, LAW._replace(alpha_rad=0.05), "alpha_rad 0.05 is not at or below"),
    ],
)
def test_what_has_no_one_sided_cycle_is_refused(drive, law, reported):
    with pytest.raises(ValueError, match=reported):
        one_sided_motion(drive, law)


@pytest.mark.parametrize("c", [0.0, 5e-6, 0.01])
def test_turns_and_arrivals_are_where_the_motion_is(c):
    turn_s = turning_time(-1e-4, 1e-6, c)
    assert advance(0.03, -1e-4, 1e-6, c, turn_s)[1] == pytest.approx(0.0, abs=1e-18)
    arrival_s = arrival_time(0.03, 1e-4, 1e-6, c, 0.0349, 40.0)
    assert advance(0.03, 1e-4, 1e-6, c, arrival_s)[0] == pytest.approx(0.0349, rel=1e-15)


def test_a_visit_tells_its_extremes():
    motion = one_sided_motion(DRIVE, LAW)
    visit = one_return(4e-5, motion)
    assert visit.pulses == 3
    assert LAW.alpha_rad < visit.inner_rad < 0.025
    assert LAW.last_line_rad < visit.outer_rad < LAW.last_line_rad + 1e-4
    assert visit.rate_min_rad_s < -1e-4 < 4e-5 <= visit.rate_max_rad_s


def test_a_visit_may_bounce_at_its_last_line_for_hours():
    visit = one_return(8e-5, one_sided_motion(DRIVE, LAW))
    assert visit.pulses > 50
    assert visit.elapsed_s > 3600.0
    assert 0.0 < visit.rate_rad_s < 2e-4


def test_a_body_that_reaches_the_other_side_does_not_return():
    weak = one_sided_motion(DRIVE._replace(dry_friction_n_m=1e-5, viscous_loss_n_m=0.0), LAW)
    assert math.isnan(one_return(1e-6, weak).rate_rad_s)


def test_a_body_that_the_pulses_cannot_turn_does_not_return():
    motion = one_sided_motion(DRIVE, SwitchingLaw(0.0175, 0.0349, 1.0))
    assert math.isnan(one_return(5e-4, motion).rate_rad_s)
    assert np.isnan(follow(np.array([5e-4]), 4, motion)[0, 1:]).all()


def test_a_body_too_high_to_fall_back_is_given_up_soon():
    # each pulse takes less than friction gives from line to line
    motion = one_sided_motion(DRIVE, SwitchingLaw(0.0175, 0.0349, 0.1, 1, 1e-3))
    lost = one_return(6e-5, motion)
    assert math.isnan(lost.rate_rad_s)
    assert lost.pulses < 20


def test_a_visit_of_too_many_pulses_is_none():
    motion = one_sided_motion(DRIVE, LAW)
    assert math.isnan(one_return(8e-5, motion._replace(most_pulses=20)).rate_rad_s)


def test_the_ladder_steps_between_diagonal_and_function():
    motion = one_sided_motion(DRIVE, LAW)
    ladder = koenigs_lamerey(1.2e-4, 6, motion)
    speeds = follow(np.array([1.2e-4]), 6, motion)[0]
    assert ladder.shape == (13, 2)
    np.testing.assert_array_equal(ladder[::2, 0], ladder[::2, 1])
    np.testing.assert_array_equal(ladder[::2, 0], speeds)
    np.testing.assert_allclose(succession(ladder[1::2, 0], motion), ladder[1::2, 1], rtol=1e-14)


def test_a_ladder_ends_where_the_body_does_not_return():
    single = one_sided_motion(DRIVE, SwitchingLaw(0.0175, 0.0349, 1.0))
    assert koenigs_lamerey(5e-4, 6, single).tolist() == [[5e-4, 5e-4]]


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


def test_the_sense_of_the_rotor_mirrors_the_cycle():
    drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, 20.0, -10.0)
    (cycle,) = find_limit_cycles(drive, SwitchingLaw(0.0175, 0.0349, 1.0))
    low, high = cycle.momentum_n_m_s
    assert -11.0 < low < -10.0 < high < -9.0
    assert cycle.is_momentum_consistent


def test_a_wheel_near_its_limit_is_told():
    drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, 10.05, 10.0)
    (cycle,) = find_limit_cycles(drive, SwitchingLaw(0.0175, 0.0349, 1.0))
    assert cycle.momentum_n_m_s[1] > 10.05
    assert not cycle.is_momentum_consistent


THREE_LINES = SwitchingLaw(0.0175, 0.0349, 1.0, 3, 2e-3)


def test_every_state_has_its_row():
    assert set(WATCHES) == set(Arm)
    assert {watch.line for row in WATCHES.values() for watch in row} == {"line", "alpha", "beta", "last"}


def test_lines_stand_a_step_apart_and_go_on_beyond_the_last():
    assert [THREE_LINES.next_line_rad(counter) for counter in range(4)] == pytest.approx(
        [0.0349, 0.0369, 0.0389, 0.0409]
    )
    assert THREE_LINES.last_line_rad == pytest.approx(0.0389)


def test_a_single_line_without_a_step_has_none_after_it():
    single = SwitchingLaw(0.0175, 0.0349, 1.0)
    assert single.next_line_rad(0) == 0.0349
    assert math.isinf(single.next_line_rad(1))


@pytest.mark.parametrize(("counter", "arm"), [(1, Arm.COUNTING), (2, Arm.COUNTING), (3, Arm.FULL), (4, Arm.FULL)])
def test_after_a_pulse(counter, arm):
    assert arm_after_pulse(counter, THREE_LINES) is arm


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
        require_law(THREE_LINES._replace(**changes))


def test_one_line_for_on_and_off_is_a_law():
    require_law(THREE_LINES._replace(alpha_rad=0.0349))
    assert THREE_LINES._replace(pulse_s=math.inf).is_relay


WEAK_DRIVE = WheelDrive(1000.0, 0.2, 3e-4, 1e-4, momentum_n_m_s=10.0)
TWO_LINES = SwitchingLaw(0.0175, 0.0349, 2.0)


@pytest.mark.parametrize("momentum_n_m_s", [10.0, -10.0])
def test_the_side_to_which_friction_turns_fires_once_more(momentum_n_m_s):
    """Two pulses there, one on the other side: N - N' pulses make good what friction takes in a period."""
    (cycle,) = find_cycles_over_both_lines(WEAK_DRIVE._replace(momentum_n_m_s=momentum_n_m_s), TWO_LINES)
    assert cycle.motion.pulses == (2, 1)
    assert cycle.motion.period_s == pytest.approx(0.2 * 2.0 / (3e-4 + 5e-5), rel=1e-9)
    assert cycle.multiplier == pytest.approx(-1.007, abs=2e-3)
    assert not cycle.is_stable
    assert cycle.motion.outer_rad > TWO_LINES.beta_rad


def test_a_step_between_lines_makes_it_stable():
    drive, law = (
        WEAK_DRIVE._replace(dry_friction_n_m=1e-4),
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
    (cycle,) = find_cycles_over_both_lines(WEAK_DRIVE, TWO_LINES)
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
    drive = WEAK_DRIVE._replace(dry_friction_n_m=1e-4, momentum_n_m_s=0.0)
    law = SwitchingLaw(0.0175, 0.0349, 4.0, 3, 1.5e-3)
    found = {cycle.motion.pulses: cycle for cycle in find_cycles_over_both_lines(drive, law)}
    assert (3, 3) in found
    # symmetric: friction opposes the motion, and as much speed leaves a side as comes
    assert found[3, 3].motion.speed_rad_s == pytest.approx(1.5 * 0.2 * 4.0 / 1000.0, rel=0.01)


def test_no_cycle_where_a_pulse_does_not_reach_through_neutral():
    drive, law = WEAK_DRIVE._replace(dry_friction_n_m=1e-3), TWO_LINES._replace(pulse_s=1.0)
    assert crossing_speed_rad_s(drive, law) == pytest.approx(math.sqrt(4 * 1.05e-6 * 0.0349), rel=1e-9)
    assert find_cycles_over_both_lines(drive, law) == ()
    assert all(return_over_both_lines(float(w), drive, law) is None for w in np.linspace(2e-5, 1.8e-4, 9))
