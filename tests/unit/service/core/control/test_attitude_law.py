"""Control law: signs, and the oscillator that the loop becomes."""

import numpy as np
import pytest

from service.core.control.attitude_law import proportional_derivative_torque

INERTIA = np.array([2600.0, 2600.0, 1400.0])
NAMES = ("yaw", "roll", "pitch")


@pytest.mark.parametrize("axis", range(3), ids=NAMES)
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_angle_and_a_rate_are_opposed_on_their_own_axis_alone(axis, sign):
    one = np.where(np.arange(3) == axis, sign, 0.0)
    for torque in (
        proportional_derivative_torque(0.1 * one, np.zeros(3), INERTIA, 7200.0, 0.9),
        proportional_derivative_torque(np.zeros(3), 1e-4 * one, INERTIA, 7200.0, 0.9),
    ):
        assert sign * torque[axis] < 0.0
        # exact: the axes are independent of one another
        assert np.count_nonzero(np.delete(torque, axis)) == 0


def test_stiffness_and_friction_are_those_of_a_damped_oscillator():
    omega = 2.0 * np.pi / 7200.0
    angle, rate = np.array([0.3, -0.2, 0.1]), np.array([1e-5, 2e-5, -3e-5])
    torque = proportional_derivative_torque(angle, rate, INERTIA, 7200.0, 0.9)
    expected = -INERTIA * (omega**2 * np.deg2rad(angle) + 1.8 * omega * np.deg2rad(rate))
    # the same formula in another order of operations: rounding only
    np.testing.assert_allclose(torque, expected, rtol=1e-14)


def fly(damping, periods, step_s=2.0, period_s=7200.0):
    """Integrate a free body about three axes under the law and return time (T,) and angles (T, 3)."""
    angle, rate = np.array([0.2, 0.3, -0.3]), np.zeros(3)
    count = int(periods * period_s / step_s)
    track = np.empty((count, 3))
    for k in range(count):
        torque = proportional_derivative_torque(angle, rate, INERTIA, period_s, damping)
        rate = rate + np.rad2deg(torque / INERTIA) * step_s
        angle = angle + rate * step_s
        track[k] = angle
    return (np.arange(count) + 1) * step_s, track


def test_the_loop_converges_with_the_stated_damping():
    _, track = fly(0.9, 2.0)
    # exp(-0.9 * 2 pi * 2) = 1e-5 of the start; a thousandth leaves room for the phase of the cosine
    assert np.abs(track[-1]).max() < 3e-4
    # overshoot of a damped oscillator: exp(-pi d / sqrt(1 - d^2)) = 0.15 %; the integration adds as much
    overshoot = (track / track[0]).min(axis=0)
    np.testing.assert_allclose(overshoot, -np.exp(-np.pi * 0.9 / np.sqrt(1 - 0.81)), atol=1.5e-3)


def test_the_loop_swings_with_the_stated_period():
    damping = 0.1
    time_s, track = fly(damping, 4.0)
    crossings = time_s[1:][np.diff(np.sign(track[:, 1])) != 0]
    # damped period = period / sqrt(1 - damping^2); two steps of 2 s on 7236 s
    np.testing.assert_allclose(2.0 * np.diff(crossings), 7200.0 / np.sqrt(1.0 - damping**2), rtol=2e-3)
