"""Motion from event to event: pulses, lines, release, and the rotor at rest and at its limit."""

import math

import numpy as np
import pytest

from service.core.flexible.motion import Regulator, follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.spacecraft import HubMode, WheelDrive
from service.core.flexible.switching_law import Arm, SwitchingLaw

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


def test_a_fast_body_meets_line_after_line():
    motion = follow_motion(BodyState(0.0349, 5e-4), FREE, None, LAW, 40.0)
    lines = motion.states(motion.firing_times_s)[:, 0]
    assert lines == pytest.approx([0.0349, 0.0369, 0.0389], abs=1e-12)
    assert [one.counter for one in motion.regulators if one.is_on] == [1, 2, 3]
    assert motion.end.rate_rad_s == pytest.approx(-1e-4, rel=1e-12)


def test_beyond_the_last_line_further_ones_follow_at_the_same_step():
    motion = follow_motion(BodyState(0.0349, 9e-4), FREE, None, LAW, 40.0)
    lines = motion.states(motion.firing_times_s)[:, 0]
    assert lines == pytest.approx([0.0349, 0.0369, 0.0389, 0.0409, 0.0429], abs=1e-12)


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


def test_full_control_is_released_at_beta():
    motion = follow_motion(BodyState(0.0349, 5e-4), FREE, None, LAW, 200.0)
    assert motion.states(motion.release_times_s)[0, 0] == pytest.approx(0.0349, abs=1e-12)
    assert Arm.CAPPED in arms(motion)


def test_falling_below_the_last_line_arms_it_again():
    # friction outward turns the body between the last line and beta
    drive = WheelDrive(1000.0, 0.2, 2e-3, momentum_limit_n_m_s=1e6)
    start = BodyState(0.0389, 1e-4, momentum_n_m_s=-1e3)
    motion = follow_motion(start, drive, None, LAW, 300.0, Regulator(Arm.CAPPED, 2, 1.0))
    angles = motion.states(motion.firing_times_s)[:2, 0]
    assert angles == pytest.approx([0.0389, 0.0389], abs=1e-12)
    assert arms(motion)[:4] == [Arm.FIRING, Arm.FULL, Arm.CAPPED, Arm.FIRING]


def test_a_relay_is_off_where_the_angle_has_fallen_to_alpha():
    relay = SwitchingLaw(0.0175, 0.0349, math.inf)
    motion = follow_motion(BodyState(0.0349, 1e-4), FREE, None, relay, 40.0)
    assert arms(motion)[:2] == [Arm.RELAY_ON, Arm.NEUTRAL]
    assert motion.states(motion.release_times_s)[0, 0] == pytest.approx(0.0175, abs=1e-12)


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
