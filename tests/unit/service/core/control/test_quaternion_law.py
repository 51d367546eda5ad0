"""Law by quaternion error: signs, decoupling, feed-forward, and what it refuses."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from service.core.control.quaternion_law import (
    GEOSTATIONARY_RATE_RAD_S,
    body_rate_rad_s,
    error_angles_rad,
    feedback_torque,
    inertia_about_angles,
    loop_gains,
)
from service.core.geometry.frames import body_from_nadir

INERTIA = np.diag([2600.0, 1400.0, 2500.0])
LOOP = {"period_s": 7200.0, "damping": 0.9, "torque_limit_n_m": 0.05, "command_period_s": 60.0}


def test_without_coupling_small_angles_give_the_law_of_three_axes():
    gains = loop_gains(INERTIA, **LOOP, orbital_rate_rad_s=0.0)
    angles, rates = np.array([0.05, -0.1, 0.08]), np.array([1e-5, 2e-5, -3e-5])
    omega = 2.0 * np.pi / 7200.0
    wanted = omega**2 * np.deg2rad(angles) + 1.8 * omega * np.deg2rad(rates)
    expected = -np.array([2500.0, 2600.0, 1400.0]) * wanted
    # products of two angles: 0.1 deg is 1.7e-3 rad
    np.testing.assert_allclose(feedback_torque(gains, angles, rates), expected, atol=2e-3 * np.abs(expected).max())


def test_the_error_is_the_rotation_from_target_to_body():
    attitude, target = [0.3, -0.2, 0.1], [0.1, 0.25, -0.15]
    error = error_angles_rad(attitude, target)
    yaw, roll, pitch = error / 2.0
    x, y, z, w = roll, pitch, yaw, math.sqrt(1.0 - float(error @ error) / 4.0)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)],
            [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)],
            [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    np.testing.assert_allclose(turn @ body_from_nadir(target), body_from_nadir(attitude), atol=1e-14)


def test_the_error_is_the_shorter_of_the_two_rotations_to_the_target():
    error = error_angles_rad([170.0, 0.0, 0.0], [-170.0, 0.0, 0.0])
    np.testing.assert_allclose(error, [-2.0 * math.sin(math.radians(10.0)), 0.0, 0.0], atol=1e-12)


def test_the_rate_about_the_body_axes_is_that_of_the_turning_frame():
    attitude, rates = np.array([20.0, -15.0, 10.0]), np.array([0.3, -0.2, 0.5])
    step_s = 1e-5
    before, after = body_from_nadir(attitude), body_from_nadir(attitude + rates * step_s)
    skew = -(after @ before.T - np.eye(3)) / step_s
    expected = np.array([skew[1, 0], skew[2, 1], skew[0, 2]])
    # first order in the step
    np.testing.assert_allclose(body_rate_rad_s(attitude, rates), expected, atol=1e-7)


def test_coupling_and_disturbance_are_cancelled_so_that_each_axis_is_a_damped_oscillator():
    """Flown on the coupled craft, sampled each second; the start has yaw only, and roll never notices."""
    gains = loop_gains(INERTIA, **LOOP)
    w0, disturbance = GEOSTATIONARY_RATE_RAD_S, np.array([1e-5, -2e-5, 5e-6])
    tensor = inertia_about_angles(INERTIA)
    coupling = w0 * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    angles = np.radians([0.2, 0.0, 0.0])
    # at rest against the orbit
    inertial = -coupling @ angles
    omega, damping = 2.0 * math.pi / 7200.0, 0.9
    free = expm(np.array([[0.0, 1.0], [-(omega**2), -2.0 * damping * omega]]) * 3600.0) @ [math.radians(0.2), 0.0]
    for _ in range(3600):
        rate = coupling @ angles + inertial
        torque = feedback_torque(gains, np.degrees(angles), np.degrees(rate), disturbance_n_m=disturbance)
        acceleration = np.linalg.solve(tensor, torque + disturbance)
        angles = angles + rate + 0.5 * (coupling @ rate + acceleration)
        inertial = inertial + acceleration
    # sampling each second of a loop of two hours
    assert angles[0] == pytest.approx(free[0], abs=1e-3 * math.radians(0.2))
    assert abs(angles[1]) < 1e-3 * math.radians(0.2)
    assert abs(angles[2]) < 1e-6 * math.radians(0.2)


@pytest.mark.parametrize(
    ("inertia", "message"),
    [
        (np.diag([1000.0, 1000.0, 2500.0]), "no body"),
        (np.diag([1000.0, -1000.0, 1000.0]), "positive"),
        (np.diag([1000.0, float("nan"), 1000.0]), "finite"),
        (np.array([[1000.0, 5.0, 0.0], [0.0, 1000.0, 0.0], [0.0, 0.0, 1000.0]]), "symmetric"),
        (np.eye(2), "3 x 3"),
    ],
)
def test_an_inertia_of_no_body_is_refused(inertia, message):
    with pytest.raises(ValueError, match=message):
        inertia_about_angles(inertia)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period_s": 100.0, "command_period_s": 1.0}, "saturate.*at least 120 s"),
        ({"period_s": 500.0}, "too short for commands"),
        ({"period_s": float("nan")}, "period_s is nan"),
        ({"damping": 0.0}, "damping is 0"),
        ({"torque_limit_n_m": -1.0}, "torque_limit_n_m"),
        ({"orbital_rate_rad_s": float("inf")}, "orbital_rate"),
    ],
)
def test_gains_that_cannot_work_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        loop_gains(INERTIA, **{**LOOP, **change})


def test_numbers_that_are_none_are_refused():
    gains = loop_gains(INERTIA, **LOOP)
    with pytest.raises(ValueError, match="three finite numbers"):
        feedback_torque(gains, [0.0, float("nan"), 0.0], [0.0, 0.0, 0.0])
