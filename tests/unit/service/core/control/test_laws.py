"""The quaternion law and the gyro-orbitant law with its design."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from service.core.control.gyro_orbitant import (
    does_rate_show_yaw,
    gyro_orbitant_law,
    gyro_orbitant_torque,
    sampled_growth,
)
from service.core.control.quaternion_law import (
    GEOSTATIONARY_RATE_RAD_S,
    body_rate_rad_s,
    error_angles_rad,
    feedback_torque,
    inertia_about_angles,
    loop_gains,
)
from service.core.dynamics.orbital_frame_model import MAX_GAINS, Law, OrbitalFrameGains
from service.core.geometry.frames import body_from_nadir

INERTIA = np.diag([2600.0, 1400.0, 2500.0])
STILL = np.zeros(3)
LOOP = {"period_s": 7200.0, "damping": 0.9, "torque_limit_n_m": 0.05, "command_period_s": 60.0}


def test_without_coupling_small_angles_give_the_law_of_three_axes():
    gains = loop_gains(INERTIA, **LOOP, orbital_rate_rad_s=0.0)
    angles, rates = np.array([0.05, -0.1, 0.08]), np.array([1e-5, 2e-5, -3e-5])
    omega = 2.0 * np.pi / 7200.0
    wanted = omega**2 * np.deg2rad(angles) + 1.8 * omega * np.deg2rad(rates)
    expected = -np.array([2500.0, 2600.0, 1400.0]) * wanted
    # products of two angles: 0.1 deg is 1.7e-3 rad
    np.testing.assert_allclose(
        feedback_torque(gains, angles, rates, STILL, STILL), expected, atol=2e-3 * np.abs(expected).max()
    )


def test_the_error_is_the_rotation_from_target_to_body():
    attitude, target = [0.3, -0.2, 0.1], [0.1, 0.25, -0.15]
    error = error_angles_rad(np.array(attitude), np.array(target))
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
    error = error_angles_rad(np.array([170.0, 0.0, 0.0]), np.array([-170.0, 0.0, 0.0]))
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
        torque = feedback_torque(gains, np.degrees(angles), np.degrees(rate), STILL, disturbance)
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


def test_numbers_that_are_none_give_no_torque():
    gains = loop_gains(INERTIA, **LOOP)
    assert np.isnan(feedback_torque(gains, np.array([0.0, math.nan, 0.0]), STILL, STILL, STILL)).all()


W0_RAD_S = 2.0 * math.pi / (101.35 * 60.0)
LAW = Law(gains=MAX_GAINS, orbital_rate_rad_s=W0_RAD_S)


def test_no_torque_at_zero_attitude():
    at_rest = np.array([0.0, 0.0, -math.degrees(W0_RAD_S)])
    assert gyro_orbitant_torque(0.0, 0.0, at_rest, LAW, 0.25) == pytest.approx(np.zeros(3), abs=1e-12)


def test_roll_and_pitch_are_pushed_back():
    at_rest = np.array([0.0, 0.0, -math.degrees(W0_RAD_S)])
    yaw, roll, pitch = gyro_orbitant_torque(0.1, 0.2, at_rest, LAW, 0.25)
    assert yaw == pytest.approx(0.0, abs=1e-12)
    assert roll == pytest.approx(-20.0 * math.radians(0.1), rel=1e-3)
    assert pitch == pytest.approx(-40.0 * math.radians(0.2), rel=1e-3)


def test_limit_cuts_each_axis():
    torque = gyro_orbitant_torque(2.0, -2.0, np.array([1.0, 0.0, 0.0]), LAW, 0.05)
    assert np.abs(torque).max() == pytest.approx(0.05)


@pytest.mark.parametrize("rate", [np.array([0.0, math.nan, 0.0]), np.array([math.inf, 0.0, 0.0])])
def test_values_that_are_none_are_refused(rate):
    with pytest.raises(ValueError, match="no torque"):
        gyro_orbitant_torque(0.0, 0.0, rate, LAW, 0.05)


def test_imaginary_yaw_is_refused_never_cut():
    fast = np.array([0.0, 2.0 * math.degrees(W0_RAD_S), -math.degrees(W0_RAD_S)])
    printed = Law(gains=OrbitalFrameGains(), orbital_rate_rad_s=W0_RAD_S, is_guarded=False)
    with pytest.raises(ValueError, match="not guarded"):
        gyro_orbitant_torque(0.0, 0.0, fast, printed, 0.05)
    assert np.isfinite(gyro_orbitant_torque(0.0, 0.0, fast, LAW, 0.05)).all()


W0 = GEOSTATIONARY_RATE_RAD_S
DESIGN_INERTIA = np.array([[2600.0, 40.0, 0.0], [40.0, 1400.0, 0.0], [0.0, 0.0, 2500.0]])
TENSOR = inertia_about_angles(DESIGN_INERTIA)
DAMPING = 0.9


def gains_of(period_s):
    """Return gains whose roll and pitch loops have some period, yaw four times slower than its damping."""
    w = 2.0 * math.pi / period_s
    yaw, roll, pitch = TENSOR.diagonal()
    k2 = 2.0 * DAMPING * w
    return OrbitalFrameGains(
        2.0 * roll * w**2, roll * k2, 2.0 * pitch * w**2, pitch * k2, math.sqrt(2.0) * 0.25 * w * yaw * k2, yaw * k2
    )


def flown_deg(gains, period_s, delay, commands):
    """Return the greatest angle after each command, in steps of a twentieth of the period."""
    law = gyro_orbitant_law(DESIGN_INERTIA, gains_of(40.0 * period_s), torque_limit_n_m=1e9, command_period_s=period_s)
    law = law._replace(gains=gains)
    angles, rates = np.radians([0.02, 0.03, -0.02]), np.zeros(3)
    seen, greatest = [(angles, rates)] * (delay + 1), []
    for _ in range(commands):
        of, against = seen[-1 - delay]
        reported = np.degrees(against + np.array([0.0, 0.0, -W0]))
        torque = gyro_orbitant_torque(math.degrees(of[1]), math.degrees(of[2]), reported, law, math.inf)
        for _ in range(20):
            step = period_s / 20.0
            rates = rates + step * np.linalg.solve(TENSOR, torque)
            angles = angles + step * (rates + W0 * np.array([-angles[1], angles[0], 0.0]))
        seen.append((angles, rates))
        greatest.append(float(np.degrees(np.abs(angles).max())))
    return greatest


@pytest.mark.parametrize(("period_s", "least_s"), [(60.0, 960.0), (900.0, 14_400.0)])
def test_gains_that_are_taken_settle_and_those_that_are_refused_do_not(period_s, least_s):
    slow, fast = gains_of(least_s), gains_of(0.5 * least_s)
    gyro_orbitant_law(DESIGN_INERTIA, slow, torque_limit_n_m=1.0, command_period_s=period_s)
    with pytest.raises(ValueError, match="do not settle"):
        gyro_orbitant_law(DESIGN_INERTIA, fast, torque_limit_n_m=1.0, command_period_s=period_s)
    for delay in (0, 1):
        assert flown_deg(slow, period_s, delay, 400)[-1] < 0.05 * 0.03
    grown = flown_deg(fast, period_s, 1, 20)
    assert grown[-1] > 1.0 or math.isnan(grown[-1])


def test_growth_is_what_a_flight_shows():
    gains = gains_of(2400.0)
    reported = sampled_growth(TENSOR, gains, W0, 60.0)
    late = flown_deg(gains, 60.0, 1, 220)
    # a mode that oscillates shows its envelope, from one hour to the next; two modes are nearly as slow
    assert reported**60 == pytest.approx(max(late[160:220]) / max(late[100:160]), rel=0.2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"roll_stiffness": 0.0}, "roll_stiffness is 0"),
        ({"yaw_damping": -1.0}, "yaw_damping is -1"),
        ({"pitch_damping": math.nan}, "pitch_damping is nan"),
        ({"yaw_stiffness": 2.5}, "saturate: yaw"),
        ({"roll_stiffness": 40.0}, "saturate: roll"),
        ({"pitch_damping": 2000.0}, "saturate: pitch"),
        ({"roll_damping": 1e-3}, "do not settle"),
    ],
)
def test_gains_that_cannot_be_are_refused_in_words(change, words):
    gains = gains_of(2400.0)._replace(**change)
    with pytest.raises(ValueError, match=words):
        gyro_orbitant_law(DESIGN_INERTIA, gains, torque_limit_n_m=0.05, command_period_s=60.0)


def test_inertia_and_period_must_be_possible():
    for inertia, period_s in ((np.diag([1.0, 1.0, 3.0]), 60.0), (DESIGN_INERTIA, 0.0), (DESIGN_INERTIA, math.inf)):
        with pytest.raises(ValueError, match=r"exceeds the sum|command_period_s is"):
            gyro_orbitant_law(inertia, gains_of(2400.0), torque_limit_n_m=0.05, command_period_s=period_s)


@pytest.mark.parametrize(
    ("roll", "pitch", "is_told"),
    [(0.9, -1.0, True), (-1.0, -1.0, True), (1.1, -1.0, False), (-2.0, -1.0, False), (0.0, 0.1, False)],
)
def test_the_roll_rate_tells_yaw_up_to_the_orbital_rate(roll, pitch, is_told):
    rate = np.degrees(W0) * np.array([0.0, roll, pitch])
    assert does_rate_show_yaw(rate, np.radians(np.degrees(W0)) * (1.0 + 1e-12)) is is_told
    assert not does_rate_show_yaw(np.array([math.nan, roll, pitch]), W0)
