"""What holds for every body, mode and law: balances of momentum and energy, mirrors, legs that can be cut anywhere."""

import math

import numpy as np
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from service.core.flexible.motion import follow_motion
from service.core.flexible.propagation import BodyState, start_leg, state_at, states_at
from service.core.flexible.spacecraft import HubMode, WheelDrive
from service.core.flexible.switching_law import SwitchingLaw

MODES = st.builds(HubMode, st.floats(0.1, 4.0), st.floats(1e-4, 0.5), st.floats(0.0, 3.0))
STATES = st.builds(
    BodyState,
    st.floats(-0.06, 0.06),
    st.floats(-1e-3, 1e-3),
    st.floats(-5e-3, 5e-3),
    st.floats(-5e-3, 5e-3),
    st.floats(-15.0, 15.0),
)
LAWS = st.one_of(
    st.builds(
        SwitchingLaw,
        st.just(0.0175),
        st.sampled_from([0.0175, 0.0349]),
        st.floats(0.3, 3.0),
        st.integers(1, 5),
        st.floats(1e-3, 4e-3),
    ),
    st.just(SwitchingLaw(0.0175, 0.0349, math.inf)),
)
DRIVES = st.builds(
    WheelDrive,
    st.just(1000.0),
    st.floats(0.05, 0.5),
    st.floats(0.0, 2e-3),
    st.floats(0.0, 5e-3),
    st.just(20.0),
    st.just(0.0),
    st.floats(-1e-4, 1e-4),
)
# nodes and weights of a rule of twenty points
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)


@given(STATES, MODES, DRIVES, LAWS)
@settings(max_examples=examples(60), deadline=None)
def test_body_and_rotor_exchange_momentum(start, mode, drive, law):
    motion = follow_motion(start, drive, mode, law, 120.0)
    states = motion.states(np.linspace(0.0, 120.0, 50))
    balance = states[:, 4] - drive.inertia_kg_m2 * states[:, 1]
    given_n_m_s = drive.external_torque_n_m * np.linspace(0.0, 120.0, 50)
    # the instant at which the rotor reaches its limit is found within nanoseconds, its torque is 0.2 N m
    np.testing.assert_allclose(balance + given_n_m_s, balance[0], atol=1e-9)


@given(STATES, MODES, DRIVES, LAWS)
@settings(max_examples=examples(60), deadline=None)
def test_the_rotor_stays_within_its_limit(start, mode, drive, law):
    motion = follow_motion(start, drive, mode, law, 400.0)
    momenta = motion.states(np.linspace(0.0, 400.0, 200))[:, 4]
    assert np.abs(momenta).max() <= drive.momentum_limit_n_m_s * (1.0 + 1e-12)


@given(STATES, MODES, st.floats(-0.3, 0.3), st.floats(0.0, 0.05), st.floats(-1e-3, 1e-3))
def test_energy_of_a_mode_is_work_less_damping(start, mode, wheel_n_m, decay_1_s, external_n_m):
    leg = start_leg(
        start,
        mode,
        inertia_kg_m2=1000.0,
        wheel_torque_n_m=wheel_n_m,
        decay_1_s=decay_1_s,
        external_torque_n_m=external_n_m,
    )
    # a fifth of a period: twenty points of Gauss integrate it to rounding
    duration_s = 1.2 / mode.omega_rad_s
    times = 0.5 * duration_s * (NODES + 1.0)
    states = states_at(leg, times)
    torque_n_m = external_n_m + wheel_n_m * np.exp(-decay_1_s * times)
    rate = states[:, 3]
    power = mode.coupling * torque_n_m / 1000.0 * rate - 2.0 * mode.damping_ratio * mode.omega_rad_s * rate**2

    def energy(state):
        return 0.5 * state[3] ** 2 + 0.5 * (mode.omega_rad_s * state[2]) ** 2

    first, last = states_at(leg, np.array([0.0, duration_s]))
    scale = 1e-12 * (energy(first) + energy(last) + np.abs(power).max() * duration_s) + 1e-30
    assert abs(energy(last) - energy(first) - 0.5 * duration_s * float(WEIGHTS @ power)) <= scale


@given(STATES, MODES, DRIVES, LAWS)
@settings(max_examples=examples(60), deadline=None)
def test_a_mirrored_start_gives_the_mirrored_motion(start, mode, drive, law):
    mirrored = BodyState(*(-value for value in start))
    against = drive._replace(external_torque_n_m=-drive.external_torque_n_m)
    one, other = follow_motion(start, drive, mode, law, 90.0), follow_motion(mirrored, against, mode, law, 90.0)
    np.testing.assert_array_equal(one.firing_times_s, other.firing_times_s)
    np.testing.assert_array_equal(np.array(one.end), -np.array(other.end))


@given(STATES, MODES, st.floats(-0.3, 0.3), st.floats(0.0, 0.05), st.floats(1e-3, 200.0), st.floats(0.0, 1.0))
def test_a_leg_may_be_cut_anywhere(start, mode, wheel_n_m, decay_1_s, duration_s, share):
    def run(state, torque_n_m, seconds):
        leg = start_leg(state, mode, inertia_kg_m2=1000.0, wheel_torque_n_m=torque_n_m, decay_1_s=decay_1_s)
        return state_at(leg, seconds)

    whole = run(start, wheel_n_m, duration_s)
    middle = run(start, wheel_n_m, share * duration_s)
    left_n_m = wheel_n_m * math.exp(-decay_1_s * share * duration_s)
    parts = run(middle, left_n_m, (1.0 - share) * duration_s)
    np.testing.assert_allclose(parts, whole, rtol=1e-11, atol=1e-12)


@given(STATES, MODES, DRIVES, LAWS)
@settings(max_examples=examples(60), deadline=None)
def test_without_a_mode_the_sensor_sees_the_rigid_body_and_with_no_coupling_too(start, mode, drive, law):
    still = start._replace(deflection_rad=0.0, deflection_rate_rad_s=0.0)
    rigid = follow_motion(still, drive, None, law, 90.0)
    uncoupled = follow_motion(still, drive, mode._replace(coupling=0.0), law, 90.0)
    # two searches for the same events: by turns and by a scan; a grazed line is found by one of them or by none
    if len(rigid.firing_times_s) == len(uncoupled.firing_times_s):
        np.testing.assert_allclose(rigid.end, uncoupled.end, rtol=1e-7, atol=1e-9)
    else:
        states = rigid.states(np.linspace(0.0, rigid.end_s, 4000))
        lines = [law.alpha_rad, *(law.beta_rad + k * law.line_step_rad for k in range(law.pulse_count + 30))]
        assert min(np.abs(np.abs(states[:, 0]) - line).min() for line in lines) < 1e-6
