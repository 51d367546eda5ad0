"""Whatever is commanded, the spacecraft keeps its momentum, and the mirrored command mirrors what it does."""

import numpy as np
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer_sim.world.spacecraft.body_dynamics import INERTIA_KG_M2
from analyzer_sim.world.spacecraft.flown_spacecraft import spacecraft_at_rest
from analyzer_sim.world.spacecraft.rigid_body import TorqueElement
from analyzer_sim.world.spacecraft.wheels import QUANTUM_N_M, wheel_set

S = 1_000_000
STILL = (0.0, 0.0, 0.0)
MOMENTUM = (1.2, -8.0, 0.6)

torques = st.tuples(*[st.integers(-4, 4).map(lambda steps: steps * QUANTUM_N_M)] * 3)
pulses = st.builds(
    lambda start, duration, torque: TorqueElement(start * S, (start + duration) * S, torque),
    st.integers(0, 200),
    st.integers(1, 8),
    torques,
)


def flown(schedule: list[TorqueElement]) -> np.ndarray:
    """Return the attitude after five minutes, deg."""
    subject = spacecraft_at_rest(INERTIA_KG_M2, STILL, wheel_set(1, MOMENTUM))
    subject.fly((0, 300 * S), schedule, STILL, STILL, STILL)
    return np.array(subject.state.attitude_deg)


@settings(max_examples=examples(20), deadline=None)
@given(st.lists(pulses, max_size=3))
def test_mirrored_commands_mirror_the_motion(schedule):
    mirrored = [
        TorqueElement(e.start_us, e.stop_us, (-e.torque_n_m[0], -e.torque_n_m[1], -e.torque_n_m[2])) for e in schedule
    ]
    still = flown([])
    there, back = flown(schedule) - still, flown(mirrored) - still
    # beside the ripple of the drives, some 1e-4 deg, and products of the angles
    size = float(np.abs(there).max())
    np.testing.assert_allclose(there, -back, atol=1e-3 + 0.02 * size**2 + 1e-3 * size)


@settings(max_examples=examples(20), deadline=None)
@given(st.lists(pulses, max_size=3))
def test_a_command_is_stored_in_the_wheels(schedule):
    subject = spacecraft_at_rest(INERTIA_KG_M2, STILL, wheel_set(1, STILL))
    subject.orbital_rate_rad_s = 0.0
    subject.motion = subject.motion._replace(rate_y=0.0)
    subject.fly((0, 300 * S), schedule, STILL, STILL, STILL)
    stored = np.array([wheel.momentum_n_m_s for wheel in subject.wheels])
    body = np.array(INERTIA_KG_M2) * subject.motion.rate_rad_s
    # from rest without a torque from outside the whole is zero, to the product of momentum and angle
    size = float(np.abs(stored).max())
    np.testing.assert_allclose(body + stored, 0.0, atol=1e-9 + 0.02 * size)
