"""Flexible spacecraft: phi functions, roots, propagation and the motion of its modes."""

import math
from decimal import Decimal, getcontext

import numpy as np
import pytest
from scipy.optimize import brentq

from service.core.flexible.motion import Regulator, follow_motion
from service.core.flexible.phi_functions import SERIES_BELOW, SHORT_SERIES_BELOW, phi1, phi2, phi2_scalar
from service.core.flexible.propagation import BodyState, angle_and_rate_at, brent_root, newton_root, start_leg, state_at
from service.core.flexible.spacecraft import (
    Arm,
    HubMode,
    SwitchingLaw,
    WheelDrive,
    accelerations,
    require_drive,
    require_mode,
)

getcontext().prec = 50
SEAMS = [one * (1.0 + nudge) for one in (SHORT_SERIES_BELOW, SERIES_BELOW) for nudge in (-1e-12, 0.0, 1e-12)]
PLACES = [1e-300, 1e-12, 1e-5, 3e-3, *SEAMS, 0.3, 1.0, 30.0, 700.0, -1e-4, -0.2, -0.6, -5.0]


def exact_phi2(z):
    wide = Decimal(z)
    # the difference loses as many digits as z has zeros: below 1e-20 the limit is exact to all digits of a float
    return 0.5 if abs(z) < 1e-20 else float((wide - 1 + (-wide).exp()) / wide**2)


@pytest.mark.parametrize("place", range(len(PLACES)))
def test_phi2_has_all_digits(place):
    z, array = PLACES[place], np.array(PLACES)
    assert phi2_scalar(z) == pytest.approx(exact_phi2(z), rel=6e-16)
    assert phi2(array)[place] == pytest.approx(exact_phi2(z), rel=6e-16)
    assert phi1(array)[place] == pytest.approx(1.0 - z * exact_phi2(z), rel=1e-14)


def test_at_zero_and_for_nothing():
    assert phi2_scalar(0.0) == 0.5
    assert phi2(np.zeros(2)).tolist() == [0.5, 0.5]
    assert phi2(np.array([])).tolist() == []


FUNCTIONS = [
    (lambda x: x * x - 2.0, 0.0, 2.0),
    (lambda x: math.cos(x) - x, 0.0, 1.5),
    (lambda x: math.exp(-20.0 * x) - 1e-3, 0.0, 10.0),
    (lambda x: (x - 0.3) ** 3, -4.0, 1.0),
    (lambda x: math.atan(1e6 * (x - 0.7)), 0.0, 1.0),
]


@pytest.mark.parametrize(("function", "low", "high"), FUNCTIONS)
def test_the_root_is_that_of_a_known_program(function, low, high):
    found = brent_root(function, low, high)
    # a triple root is as wide as the cube root of rounding
    assert found == pytest.approx(
        brentq(function, low, high, xtol=1e-15, maxiter=1000), abs=1e-12 if function(found) == 0.0 else 1e-5
    )
    assert found == brent_root(function, high, low) or abs(function(found)) < 1e-12


def test_a_bound_that_is_the_root_is_returned():
    assert brent_root(lambda x: x - 1.0, 1.0, 3.0) == 1.0
    assert brent_root(lambda x: x - 3.0, 1.0, 3.0) == 3.0


def test_bounds_without_a_change_of_sign_are_refused():
    with pytest.raises(ValueError, match="no change of sign between 2 and 3: the function is 4 and 9"):
        brent_root(lambda x: x * x, 2.0, 3.0)


def test_a_jump_is_found_as_a_place_where_the_function_is_not_zero():
    step = brent_root(lambda x: -1.0 if x < 0.4 else 1.0, 0.0, 1.0)
    assert step == pytest.approx(0.4, abs=1e-12)


def test_newton_never_leaves_its_bounds():
    seen = []

    def flat_in_the_middle(x):
        seen.append(x)
        return x**3 - 1e-9, 3.0 * x * x

    found = newton_root(flat_in_the_middle, -1.0, 2.0)
    assert found == pytest.approx(1e-3, rel=1e-12)
    assert min(seen) >= -1.0
    assert max(seen) <= 2.0


def test_newton_on_a_falling_function():
    assert newton_root(lambda x: (2.0 - x * x, -2.0 * x), 0.5, 3.0) == pytest.approx(math.sqrt(2.0), rel=1e-15)


START = BodyState(0.0349, -1.3e-4, 2.1e-3, -7e-4, 0.8)
MODES = [None, HubMode(0.5, 0.005, 0.5), HubMode(3.0, 0.4, 2.0)]


def leg_of(mode, decay_1_s=1e-3):
    return start_leg(
        START, mode, inertia_kg_m2=1000.0, wheel_torque_n_m=-0.2, decay_1_s=decay_1_s, external_torque_n_m=1e-3
    )


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


DRIVE = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)


def test_accelerations_of_the_paper():
    found = accelerations(DRIVE)
    assert found.passive_rad_s2 == pytest.approx(1.05e-6, rel=1e-12)
    assert found.pulse_rad_s2 == pytest.approx(1.9895e-4, rel=1e-12)
    assert found.viscous_rate_1_s == pytest.approx(5e-6, rel=1e-12)


def test_the_sense_of_the_rotor_does_not_change_magnitudes():
    assert accelerations(DRIVE._replace(momentum_n_m_s=-10.0)) == accelerations(DRIVE)


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"inertia_kg_m2": 0.0}, "inertia_kg_m2 is 0, it must be a finite number above 0"),
        ({"inertia_kg_m2": -5.0}, "inertia_kg_m2 is -5"),
        ({"inertia_kg_m2": math.nan}, "inertia_kg_m2 is nan"),
        ({"motor_torque_n_m": math.inf}, "motor_torque_n_m is inf"),
        ({"dry_friction_n_m": -1e-3}, "dry_friction_n_m is -0.001, it must be a finite number, 0 or above"),
        ({"viscous_loss_n_m": math.nan}, "viscous_loss_n_m is nan"),
        ({"external_torque_n_m": math.inf}, "external_torque_n_m is inf, it must be a finite number"),
        ({"momentum_n_m_s": 21.0}, "momentum_n_m_s is 21, beyond momentum_limit_n_m_s 20; unload the wheel"),
    ],
)
def test_a_drive_that_cannot_exist_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        require_drive(DRIVE._replace(**changes))


def test_a_motor_weaker_than_its_friction_is_refused():
    with pytest.raises(ValueError, match=r"friction of 0\.2\d* N m is not below the motor torque of 0\.2 N m"):
        accelerations(DRIVE._replace(dry_friction_n_m=0.2))


def test_a_question_may_allow_a_mode_without_damping():
    require_mode(HubMode(0.5, 0.0, 0.4), may_be_undamped=True)
    with pytest.raises(ValueError, match="between 0 and 1, 1 excluded"):
        require_mode(HubMode(0.5, -1e-3, 0.4), may_be_undamped=True)


@pytest.mark.parametrize(
    ("mode", "reported"),
    [
        (HubMode(0.0, 0.01, 0.4), "omega_rad_s is 0"),
        (HubMode(0.5, 0.01, -0.4), "coupling is -0.4"),
        *(
            (HubMode(0.5, xi, 0.4), r"damping_ratio is .*, it must lie between 0 and 1, both excluded")
            for xi in (0.0, -0.01, 1.0, math.nan)
        ),
    ],
)
def test_a_mode_that_cannot_swing_is_refused(mode, reported):
    with pytest.raises(ValueError, match=reported):
        require_mode(mode)


FREE = WheelDrive(1000.0, 0.2, momentum_limit_n_m_s=1e6)
LAW = SwitchingLaw(0.0175, 0.0349, 1.0, 3, 2e-3)


def arms(motion):
    return [one.arm for one in motion.regulators]


def test_inside_the_lines_nothing_happens():
    motion = follow_motion(BodyState(0.0, 1e-5), FREE, None, LAW, 100.0)
    assert arms(motion) == [Arm.NEUTRAL]
    assert motion.end.angle_rad == pytest.approx(1e-3, rel=1e-14)
    assert len(motion.firing_times_s) == 0


def test_a_pulse_lasts_its_time_and_turns_the_body_back():
    motion = follow_motion(BodyState(0.0339, 1e-4), FREE, None, LAW, 60.0)
    assert motion.firing_times_s == pytest.approx([10.0], rel=1e-12)
    assert arms(motion) == [Arm.NEUTRAL, Arm.FIRING, Arm.COUNTING]
    assert motion.times_s == pytest.approx([0.0, 10.0, 11.0], rel=1e-12)
    assert motion.end.rate_rad_s == pytest.approx(-1e-4, rel=1e-12)


@pytest.mark.parametrize(("rate_rad_s", "pulses"), [(5e-4, 3), (9e-4, 5)])
def test_a_fast_body_meets_line_after_line_also_beyond_the_last(rate_rad_s, pulses):
    motion = follow_motion(BodyState(0.0349, rate_rad_s), FREE, None, LAW, 40.0)
    lines = motion.states(motion.firing_times_s)[:, 0]
    assert lines == pytest.approx([0.0349, 0.0369, 0.0389, 0.0409, 0.0429][:pulses], abs=1e-12)
    assert [one.counter for one in motion.regulators if one.is_on][:3] == [1, 2, 3]
    assert motion.end.rate_rad_s == pytest.approx(-1e-4, rel=1e-12)


def test_still_beyond_the_next_line_at_the_end_of_a_pulse_fires_at_once():
    motion = follow_motion(BodyState(0.0349, 5e-3), FREE, None, LAW, 2.0)
    assert motion.firing_times_s == pytest.approx([0.0, 1.0], abs=1e-12)


def test_control_is_released_at_alpha():
    motion = follow_motion(BodyState(0.0349, 1e-4), FREE, None, LAW, 400.0)
    assert motion.states(motion.release_times_s)[0, 0] == pytest.approx(0.0175, abs=1e-12)
    assert [one.arm for one in motion.regulators][-1] is Arm.NEUTRAL
    # on to the other side, where it begins again
    far = follow_motion(BodyState(0.0349, 1e-4), FREE, None, LAW, 800.0)
    assert far.states(far.firing_times_s)[1, 0] == pytest.approx(-0.0349, abs=1e-12)


@pytest.mark.parametrize(
    ("rate_rad_s", "pulse_s", "released_rad", "arm"),
    [(5e-4, 1.0, 0.0349, Arm.CAPPED), (1e-4, math.inf, 0.0175, Arm.RELAY_ON)],
)
def test_full_control_is_released_at_beta_and_a_relay_at_alpha(rate_rad_s, pulse_s, released_rad, arm):
    motion = follow_motion(BodyState(0.0349, rate_rad_s), FREE, None, LAW._replace(pulse_s=pulse_s), 200.0)
    assert motion.states(motion.release_times_s)[0, 0] == pytest.approx(released_rad, abs=1e-12)
    assert arm in arms(motion)


def test_falling_below_the_last_line_arms_it_again():
    # friction outward turns the body between the last line and beta
    drive = WheelDrive(1000.0, 0.2, 2e-3, momentum_limit_n_m_s=1e6)
    start = BodyState(0.0389, 1e-4, momentum_n_m_s=-1e3)
    motion = follow_motion(start, drive, None, LAW, 300.0, Regulator(Arm.CAPPED, 2, 1.0))
    angles = motion.states(motion.firing_times_s)[:2, 0]
    assert angles == pytest.approx([0.0389, 0.0389], abs=1e-12)
    assert arms(motion)[:4] == [Arm.FIRING, Arm.FULL, Arm.CAPPED, Arm.FIRING]


def test_a_rotor_is_stopped_by_dry_friction_and_held():
    drive = WheelDrive(1000.0, 0.2, 1e-3)
    start = BodyState(0.0, 1e-5, momentum_n_m_s=0.02)
    motion = follow_motion(start, drive, None, LAW, 100.0)
    assert motion.times_s == pytest.approx([0.0, 20.0], rel=1e-12)
    assert motion.end.momentum_n_m_s == 0.0
    assert motion.end.rate_rad_s == pytest.approx(1e-5 - 0.02 / 1000.0, rel=1e-12)


def test_friction_turns_with_the_rotor_in_a_pulse():
    drive = WheelDrive(1000.0, 0.2, 1e-3)
    start = BodyState(0.0349, 1e-4, momentum_n_m_s=0.1)
    motion = follow_motion(start, drive, None, LAW, 1.0)
    # against friction and motor until it stops, then the motor against friction
    stopped_s = 0.1 / 0.201
    assert motion.times_s == pytest.approx([0.0, stopped_s], rel=1e-12)
    assert motion.end.momentum_n_m_s == pytest.approx(-0.199 * (1.0 - stopped_s), rel=1e-12)


def test_at_its_limit_the_rotor_takes_no_more():
    drive = WheelDrive(1000.0, 0.2, momentum_limit_n_m_s=0.1, momentum_n_m_s=0.0)
    motion = follow_motion(BodyState(-0.0349, -2e-4), drive, None, LAW, 5.0)
    assert motion.end.momentum_n_m_s == 0.1
    # half a second of torque, then none
    assert motion.end.rate_rad_s == pytest.approx(-2e-4 + 0.1 / 1000.0, rel=1e-12)


def test_an_external_torque_fills_the_wheel_through_the_law():
    drive = WheelDrive(1000.0, 0.2, momentum_limit_n_m_s=4.0, external_torque_n_m=4e-3)
    motion = follow_motion(BodyState(0.0349, 0.0), drive, None, LAW, 2000.0)
    times_s = np.linspace(0.0, 2000.0, 300)
    momenta = motion.states(times_s)[:, 4]
    # pulses of -0.2 N m s take up 4e-3 N m: the limit comes after 1000 s, and then the body is lost
    assert momenta.min() == pytest.approx(-4.0, abs=1e-12)
    assert times_s[np.flatnonzero(momenta <= -3.99)[0]] == pytest.approx(1000.0, rel=0.15)
    assert abs(motion.end.angle_rad) > 0.5


def test_states_are_continuous_over_events():
    drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-3, momentum_n_m_s=1.0)
    mode = HubMode(0.5, 0.01, 1.0)
    motion = follow_motion(BodyState(0.03, 4e-4, 1e-3, 0.0, 1.4), drive, mode, LAW, 300.0)
    assert len(motion.legs) > 5
    for later in motion.times_s[1:]:
        before, after = motion.states(np.array([later - 1e-9, later + 1e-9]))
        np.testing.assert_allclose(before, after, atol=1e-9)


def test_a_law_that_chatters_is_refused_and_said_so(monkeypatch):
    monkeypatch.setattr("service.core.flexible.motion.MOST_EVENTS", 3)
    relay = SwitchingLaw(0.0349, 0.0349, math.inf)
    with pytest.raises(ValueError, match=r"more than 3 events in .* the law chatters; widen the distance"):
        follow_motion(BodyState(0.0349, 1e-4, 0.0, 0.01), FREE, HubMode(2.0, 0.01, 3.0), relay, 100.0)


def test_what_is_not_physical_is_refused():
    with pytest.raises(ValueError, match="inertia_kg_m2"):
        follow_motion(BodyState(0.0, 0.0), FREE._replace(inertia_kg_m2=-1.0), None, LAW, 1.0)
    with pytest.raises(ValueError, match="damping_ratio"):
        follow_motion(BodyState(0.0, 0.0), FREE, HubMode(1.0, 0.0, 1.0), LAW, 1.0)
    with pytest.raises(ValueError, match="pulse_s"):
        follow_motion(BodyState(0.0, 0.0), FREE, None, LAW._replace(pulse_s=-1.0), 1.0)
