"""The orbital frame and the analysis of its rates."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.core.dynamics.orbital_frame_analysis import (
    Start,
    fly_spacecraft,
    harmonic_amplitude,
    largest_after,
    time_within,
    tone_steps,
)
from service.core.dynamics.orbital_frame_kernel import command, rotor_torque, rounded
from service.core.dynamics.orbital_frame_model import (
    AS_PRINTED,
    DOWN,
    NEAREST,
    NOMINAL_INERTIA,
    ORBITAL_RATE_RAD_S,
    TILT_FIRST,
    TO_ZERO,
    YAW_FIRST,
    AxisWheels,
    Computer,
    Inertia,
    Law,
    OrbitalFrameGains,
    OrbitalFrameSpacecraft,
    Tones,
    refusals,
    rigid_spacecraft,
)
from service.core.dynamics.orbital_frame_step import body_rate, half_angles, inverse_inertia, wanted_torque

FREE = OrbitalFrameGains(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
_TILT = st.floats(-0.035, 0.035)


@given(_TILT, _TILT, st.floats(-1.0, 1.0), st.sampled_from([TILT_FIRST, YAW_FIRST]))
def test_quaternion_of_the_law_has_unit_length(roll, pitch, c, product):
    rate = (c * ORBITAL_RATE_RAD_S, ORBITAL_RATE_RAD_S, 0.0)
    quaternion = half_angles(Law(product=product), roll, pitch, rate)
    assert math.fsum(part**2 for part in quaternion) == pytest.approx(1.0, abs=1e-12)


def test_printed_product_has_not():
    rate = (ORBITAL_RATE_RAD_S, ORBITAL_RATE_RAD_S, 0.0)
    quaternion = half_angles(Law(product=AS_PRINTED), 0.03, 0.03, rate)
    assert abs(math.fsum(part**2 for part in quaternion) - 1.0) > 1e-4


def test_yaw_behind_the_craft_is_told_by_the_sign_of_the_roll_rate():
    for c in (0.3, -0.3, 1.2, -1.2):
        rate = (c * ORBITAL_RATE_RAD_S, -0.5 * ORBITAL_RATE_RAD_S, 0.0)
        assert half_angles(Law(), 0.0, 0.0, rate)[3] == pytest.approx(math.copysign(math.sqrt(0.5), c))


def test_law_has_no_torque_where_the_craft_should_be():
    assert wanted_torque(Law(), 0.0, 0.0, (0.0, ORBITAL_RATE_RAD_S, 0.0)) == pytest.approx((0.0, 0.0, 0.0), abs=1e-15)


def test_tumbling_without_gravity_keeps_the_inertial_momentum():
    spacecraft = rigid_spacecraft(FREE, NOMINAL_INERTIA)._replace(has_gravity_torque=False)
    start = Start(20.0, -30.0, 40.0, rate_rad_s=(0.01, 0.02, -0.015))
    short, long = fly_spacecraft(spacecraft, start, 0.125), fly_spacecraft(spacecraft, start, 3000.0)
    norm = [math.sqrt(sum(k**2 for k in flight.end[4:7])) for flight in (short, long)]
    assert norm[1] == pytest.approx(norm[0], rel=1e-10)
    # the printed equation dk/dt = w x k is the same motion with the rate reversed: it keeps the length, not the energy
    energies = []
    for flight in (short, long):
        rate = np.array(body_rate(flight.end, inverse_inertia(*_tensor(NOMINAL_INERTIA))))
        energies.append(0.5 * rate @ np.array(flight.end[4:7]))
    assert energies[1] == pytest.approx(energies[0], rel=1e-9)


def _tensor(j):
    return j.xx, j.yy, j.zz, j.xy, j.xz, j.yz


def test_quaternion_stays_at_unit_length():
    end = fly_spacecraft(rigid_spacecraft(), Start(yaw_deg=10.0), 100.0).end
    assert math.fsum(part**2 for part in end[:4]) == pytest.approx(1.0, abs=1e-12)


def test_rounding_rules():
    assert [rounded(x, 2.0, NEAREST) for x in (0.9, 1.1, -0.9, -1.1)] == [0.0, 2.0, 0.0, -2.0]
    assert [rounded(x, 2.0, TO_ZERO) for x in (1.9, 2.1, -1.9, -2.1)] == [0.0, 2.0, 0.0, -2.0]
    assert [rounded(x, 2.0, DOWN) for x in (1.9, 2.1, -0.1, -2.1)] == [0.0, 2.0, -2.0, -4.0]


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_commands_are_multiples_of_the_quantum_within_the_limit(wanted):
    computer = Computer()
    for asked in command(computer, wanted):
        codes = asked / computer.torque_quantum_n_m
        assert codes == pytest.approx(round(codes), abs=1e-9)
        assert abs(codes) <= 127.0 + 1e-9


def test_dry_friction_holds_a_rotor_at_rest():
    wheels = AxisWheels(cogging_n_m=0.0)
    assert rotor_torque(wheels, 1.9e-3, 0.0, 0.0, 0.125) == 0.0
    assert rotor_torque(wheels, 3e-3, 0.0, 0.0, 0.125) == pytest.approx(-1e-3)
    # a rotor that would pass through rest under less than the friction stops there
    momentum = 1e-4
    assert momentum + 0.125 * rotor_torque(wheels, 0.0, momentum, 0.0, 0.125) == pytest.approx(0.0, abs=1e-18)


def test_wheel_at_its_limit_takes_no_more():
    wheels = AxisWheels()
    assert rotor_torque(wheels, -0.2, wheels.momentum_limit_n_m_s, 0.0, 0.125) <= 0.0
    slow = rotor_torque(wheels, -0.2, 19.9999, 0.0, 0.125)
    assert 19.9999 + 0.125 * slow <= wheels.momentum_limit_n_m_s + 1e-12


def test_cogging_over_whole_turns_is_nothing():
    wheels = AxisWheels(dry_friction_n_m=0.0, viscous_friction_n_m_s=0.0)
    momentum = wheels.inertia_kg_m2 * 2.0 * math.pi / 0.125  # one turn a period
    assert rotor_torque(wheels, 0.0, momentum, 0.3, 0.125) == pytest.approx(0.0, abs=1e-12)


def test_tones_step_exactly():
    spacecraft = OrbitalFrameSpacecraft(tones=Tones())
    steps = tone_steps(spacecraft)
    omega = 2.0 * math.pi * spacecraft.tones.yaw_hz[1]
    # against the differential equation in small steps
    angle, rate, drive = 1e-3, 0.0, 0.2
    push = spacecraft.tones.gains[1] * drive / spacecraft.inertia.zz
    fine = 200_000
    h = 0.125 / fine
    for _ in range(fine):
        rate += h * (push - 2.0 * spacecraft.tones.damping_ratio * omega * rate - omega**2 * angle)
        angle += h * rate
    a = steps[4]
    assert a[0] * 1e-3 + a[4] * drive == pytest.approx(angle, rel=1e-4)
    assert a[2] * 1e-3 + a[5] * drive == pytest.approx(rate, rel=1e-4)


@pytest.mark.parametrize(
    ("spacecraft", "named"),
    [
        (rigid_spacecraft(inertia=Inertia(xx=-1.0)), "inertia"),
        (rigid_spacecraft(inertia=Inertia(xy=7000.0)), "positive definite"),
        (rigid_spacecraft(inertia=Inertia(xx=20_000.0)), "triangle"),
        (rigid_spacecraft()._replace(law=Law(orbital_rate_rad_s=0.0)), "orbital_rate"),
        (rigid_spacecraft()._replace(computer=Computer(period_s=0.0)), "period_s"),
        (rigid_spacecraft()._replace(computer=Computer(torque_quantum_n_m=-1.0)), "torque_quantum"),
        (rigid_spacecraft()._replace(wheels=AxisWheels(inertia_kg_m2=0.0)), "wheels.inertia"),
        (rigid_spacecraft()._replace(tones=Tones(damping_ratio=0.0)), "damping_ratio"),
        (rigid_spacecraft(steps=0), "steps"),
    ],
)
def test_what_cannot_be_is_refused_by_name(spacecraft, named):
    assert any(named in text for text in refusals(spacecraft))
    with pytest.raises(ValueError, match=named):
        fly_spacecraft(spacecraft, Start(), 10.0)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, math.nan, math.inf, 1e9])
def test_durations_that_are_none(duration_s):
    with pytest.raises(ValueError, match="duration"):
        fly_spacecraft(rigid_spacecraft(), Start(), duration_s)


def test_printed_condition_is_refused_with_a_message_at_a_fast_roll():
    fast = Start(rate_rad_s=(2.0 * ORBITAL_RATE_RAD_S, ORBITAL_RATE_RAD_S, 0.0))
    printed = rigid_spacecraft()._replace(law=Law(is_guarded=False))
    with pytest.raises(ValueError, match="nu0 of the printed law is imaginary"):
        fly_spacecraft(printed, fast, 100.0)
    assert np.isfinite(fly_spacecraft(rigid_spacecraft(), fast, 100.0).yaw_deg).all()


def test_figures_of_merit():
    time_s = np.arange(0.0, 100.0, 0.5)
    assert math.isnan(time_within(time_s, np.ones_like(time_s), 0.5))
    assert time_within(time_s, np.zeros_like(time_s), 0.5) == 0.0
    wave = 0.3 * np.sin(2.0 * math.pi * time_s / 20.0) + 5.0 + 0.01 * time_s
    assert harmonic_amplitude(time_s, wave, 20.0) == pytest.approx(0.3, rel=1e-9)
    flight = fly_spacecraft(rigid_spacecraft(), Start(yaw_deg=10.0), 20.0)
    assert largest_after(flight, 0.0)[2] == pytest.approx(10.0, abs=0.05)


def test_same_seed_same_flight():
    spacecraft = OrbitalFrameSpacecraft()
    one, same, other = (fly_spacecraft(spacecraft, Start(), 30.0, seed) for seed in (3, 3, 4))
    assert one.yaw_deg.tobytes() == same.yaw_deg.tobytes()
    assert one.yaw_deg.tobytes() != other.yaw_deg.tobytes()
    assert all(later > earlier for earlier, later in pairwise(one.time_s.tolist()))
