"""What holds for every schedule and mode: superposition, shift in time, bounds, and that more never looks like less."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.core.flexible.propagation import BodyState, start_leg, states_at
from service.core.flexible.schedule.schedule_check import analyse_schedule
from service.core.flexible.schedule.schedule_response import TorquePulse, carry_phasor, schedule_response
from service.core.flexible.spacecraft import HubMode

INERTIA = 4000.0
MODES = st.builds(HubMode, st.floats(0.1, 4.0), st.floats(1e-4, 0.3), st.floats(0.01, 3.0))
#: gaps and lengths make pulses that never overlap
PARTS = st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(0.01, 10.0), st.floats(-0.3, 0.3)), min_size=1, max_size=6)
CARRIED = st.complex_numbers(max_magnitude=1e-3, allow_nan=False, allow_infinity=False)


def schedule_of(parts):
    pulses, now_s = [], 0.0
    for gap_s, duration_s, torque_n_m in parts:
        pulses.append(TorquePulse(now_s + gap_s, duration_s, torque_n_m))
        now_s = pulses[-1].stop_s
    return tuple(pulses)


@given(PARTS, MODES, CARRIED)
def test_responses_superpose(parts, mode, carried):
    pulses = schedule_of(parts)
    whole = schedule_response(pulses, mode, INERTIA, carried_rad=carried)
    total = carry_phasor(carried, mode, whole.end_s)
    for pulse in pulses:
        alone = schedule_response((pulse,), mode, INERTIA)
        total += carry_phasor(complex(alone.phasor_rad[0]), mode, whole.end_s - alone.end_s)
    scale = 1e-3 + sum(0.6 * mode.coupling / (INERTIA * mode.omega_rad_s**2) for _ in pulses)
    assert abs(total - complex(whole.phasor_rad[0])) <= 1e-11 * scale


@given(PARTS, MODES, st.floats(0.0, 50.0))
def test_a_later_schedule_leaves_the_same(parts, mode, later_s):
    pulses = schedule_of(parts)
    moved = tuple(pulse._replace(start_s=pulse.start_s + later_s) for pulse in pulses)
    one, other = schedule_response(pulses, mode, INERTIA), schedule_response(moved, mode, INERTIA)
    np.testing.assert_allclose(other.peak_rad, one.peak_rad, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(other.residual_rad, one.residual_rad, rtol=1e-7, atol=1e-15)


@given(PARTS, MODES)
def test_twice_the_torque_is_twice_the_response(parts, mode):
    pulses = schedule_of(parts)
    doubled = tuple(pulse._replace(torque_n_m=2.0 * pulse.torque_n_m) for pulse in pulses)
    one, two = schedule_response(pulses, mode, INERTIA), schedule_response(doubled, mode, INERTIA)
    # torques of 1e-310 N m have fewer digits
    np.testing.assert_allclose(two.peak_rad, 2.0 * one.peak_rad, rtol=1e-12, atol=1e-300)


@given(PARTS, MODES, CARRIED)
def test_no_sample_of_the_motion_is_above_the_peak(parts, mode, carried):
    pulses = schedule_of(parts)
    response = schedule_response(pulses, mode, INERTIA, carried_rad=carried)
    nu = np.sqrt(1.0 - mode.damping_ratio**2)
    rate = (carried * mode.omega_rad_s * complex(-mode.damping_ratio, nu)).real
    state, now_s, greatest = BodyState(0.0, 0.0, carried.real, rate), 0.0, 0.0
    torques = [(pulse.start_s, 0.0, pulse.torque_n_m) for pulse in pulses]
    for number, (start_s, _, torque_n_m) in enumerate(torques):
        for until_s, wheel_n_m in ((start_s, 0.0), (pulses[number].stop_s, torque_n_m)):
            leg = start_leg(state, mode, inertia_kg_m2=INERTIA, wheel_torque_n_m=wheel_n_m)
            states = states_at(leg, np.linspace(0.0, until_s - now_s, 60))
            greatest = max(greatest, float(np.abs(states[:, 2]).max()))
            state, now_s = BodyState(*states[-1]), until_s
    leg = start_leg(state, mode, inertia_kg_m2=INERTIA, wheel_torque_n_m=0.0)
    after = states_at(leg, np.linspace(0.0, 12.0 / mode.omega_rad_s, 400))[:, 2]
    greatest = max(greatest, float(np.abs(after).max()))
    assert greatest <= response.peak_rad[0] * (1.0 + 1e-9) + 1e-18
    # sixty points a stretch come near the top, unless a stretch holds many periods
    assert response.swing_rad[0] >= response.residual_rad[0]


@given(PARTS, MODES)
def test_a_stronger_schedule_never_gets_a_better_verdict(parts, mode):
    rank = {"accept": 0, "warn": 1, "reject": 2}

    def verdict(factor):
        pulses = tuple((one.start_s, one.duration_s, factor * one.torque_n_m) for one in schedule_of(parts))
        found = analyse_schedule(
            pulses=pulses,
            inertia_kg_m2=INERTIA,
            modes=(tuple(mode),),
            peak_allowed_rad=2e-4,
            alpha_rad=0.0175,
            beta_rad=0.0349,
            pulse_s=1.0,
            motor_torque_n_m=0.2,
        )
        return rank[found.verdict]

    assert verdict(0.5) <= verdict(1.0) <= verdict(3.0)
