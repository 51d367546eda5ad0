"""Slews in tracking: the closed loop they make, within the envelope, on a coupled craft under a disturbance."""

import numpy as np
import pytest

from service.core.control.envelope import Envelope, envelope_excesses
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, inertia_about_angles, loop_gains
from service.core.control.slew_schedule import Drive, plan_slew, predicted_effect
from service.core.control.tracking import tracking_request

INERTIA = np.diag([2600.0, 1400.0, 2600.0])
DRIVE = Drive(0.05, 0.002, 0.1, 0.001)
GAINS = loop_gains(INERTIA, period_s=7200.0, damping=0.9, torque_limit_n_m=0.05, command_period_s=600.0)
COUPLING = GEOSTATIONARY_RATE_RAD_S * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
#: what a feed-forward of 95 % leaves of the pressure of the Sun, N m, about yaw, roll, pitch
LEFT_N_M = np.array([3e-7, -5e-7, 4e-7])


def fly(start_deg, horizon_s, periods, sigma_deg, disturbance_n_m=LEFT_N_M):
    """Return angles (K, 3), deg, at the beginning of each command period, and what was sent, N m s."""
    rng = np.random.default_rng(20261122)
    tensor = inertia_about_angles(INERTIA)
    angle, inertial = np.radians(start_deg), -COUPLING @ np.radians(start_deg)
    track, sent = [], []
    for _ in range(periods):
        track.append(np.degrees(angle))
        seen_deg = np.degrees(angle) + rng.normal(size=3) * sigma_deg
        rate_deg_s = np.degrees(COUPLING @ angle + inertial)
        request = tracking_request(GAINS, seen_deg, rate_deg_s, horizon_s)
        pulses = plan_slew(request.angle_change_deg, request.rate_deg_s, tensor, horizon_s, DRIVE)
        effect = predicted_effect(pulses, tensor, np.eye(3), horizon_s)
        sent.append(effect.gross_impulse_n_m_s)
        assert envelope_excesses(effect, (0.0, 0.0, 0.0), Envelope()) == ()
        step_s = 10.0
        for k in range(round(horizon_s / step_s)):
            torque = disturbance_n_m.copy()
            for pulse in pulses:
                # a pulse is a step of the rate, given in the step in which its middle lies
                middle_s = pulse.start_s + pulse.duration_s / 2.0
                torque[pulse.axis] += pulse.impulse_n_m_s / step_s * (k * step_s <= middle_s < (k + 1) * step_s)
            inertial = inertial + np.linalg.solve(tensor, torque) * step_s
            angle = angle + (COUPLING @ angle + inertial) * step_s
    return np.array(track), np.array(sent)


@pytest.mark.parametrize("horizon_s", [600.0, 900.0])
def test_two_days_of_tracking_stay_within_the_envelope_and_near_zero(horizon_s):
    periods = round(2 * 86_400 / horizon_s)
    track, sent = fly([0.1, 0.1, -0.1], horizon_s, periods, [0.04, 0.017, 0.02])
    settled = track[round(6 * 3600 / horizon_s) :]
    assert np.abs(settled[:, 1:]).max() < 0.1
    assert np.abs(settled[:, 0]).max() < 0.4
    an_hour = round(3600 / horizon_s)
    hourly = np.array([sent[k : k + an_hour].sum(axis=0) for k in range(periods - an_hour)])
    assert hourly.max() < 0.1


def test_without_noise_the_error_shrinks_by_its_share_each_period():
    track, _ = fly([0.0, 0.1, 0.0], 1800.0, 6, [0.0, 0.0, 0.0], np.zeros(3))
    share = 1.0 - np.exp(-(2.0 * np.pi / 7200.0) / 1.8 * 1800.0)
    # pulses of one tick, and the exchange with yaw while the spacecraft sails
    np.testing.assert_allclose(track[1:4, 1] / track[:3, 1], 1.0 - share, atol=0.04)


@pytest.mark.parametrize(("angles", "horizon_s"), [([0.0, float("nan"), 0.0], 600.0), ([0.0] * 3, 0.0)])
def test_numbers_that_make_no_sense_are_refused(angles, horizon_s):
    with pytest.raises(ValueError, match="finite"):
        tracking_request(GAINS, angles, [0.0] * 3, horizon_s)
