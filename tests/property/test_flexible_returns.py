"""The map and the motion leg by leg are two programs of one law: they agree for every drive and law."""

import math

import numpy as np
from example_counts import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from service.core.flexible.motion import follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.return_kernels import one_return
from service.core.flexible.spacecraft import WheelDrive
from service.core.flexible.succession import one_sided_motion
from service.core.flexible.switching_law import SwitchingLaw


# round numbers end pulses exactly on lines, where the last digit decides between firing and waiting: seeds do not
@given(st.integers(0, 10**9))
@settings(max_examples=examples(100), deadline=None)
def test_an_arrival_of_the_map_is_one_of_the_motion(seed):
    rng = np.random.default_rng(seed)
    frictions = (rng.uniform(5e-4, 3e-3), rng.uniform(0.0, 2e-3))
    drive = WheelDrive(1000.0, rng.uniform(0.1, 0.4), *frictions, 20.0, rng.uniform(5.0, 15.0))
    law = SwitchingLaw(0.0175, 0.0349, rng.uniform(0.5, 2.0), int(rng.integers(1, 6)), rng.uniform(1e-3, 4e-3))
    motion = one_sided_motion(drive, law)
    speed = rng.uniform(0.02, 1.5) * motion.pulse_rad_s2 * motion.pulse_s
    visit = one_return(speed, motion)
    # rounding grows from bounce to bounce: after a dozen two programs may part
    assume(math.isfinite(visit.rate_rad_s) and visit.pulses <= 12)
    # a rotor that turns the other way does the same on the other side
    sense = rng.choice([1.0, -1.0])
    turning = drive._replace(momentum_n_m_s=sense * drive.momentum_n_m_s)
    momentum = turning.momentum_n_m_s - sense * drive.inertia_kg_m2 * speed
    start = BodyState(-sense * law.beta_rad, -sense * speed, momentum_n_m_s=momentum)
    followed = follow_motion(start, turning, None, law, visit.elapsed_s * (1.0 + 1e-9) + 1e-6)
    arrival = followed.states(np.array([visit.elapsed_s]))[0]
    assert len(followed.firing_times_s) in {visit.pulses, visit.pulses + 1}
    np.testing.assert_allclose(-sense * arrival[0], law.beta_rad, atol=1e-9)
    np.testing.assert_allclose(-sense * arrival[1], visit.rate_rad_s, rtol=1e-6, atol=1e-11)
