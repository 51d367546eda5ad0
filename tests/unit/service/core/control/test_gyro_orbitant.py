"""The gyro-orbitant law in the service's axes, on a rigid body written here in those axes."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from service.core.control.gyro_orbitant import gyro_orbitant_torque
from service.core.dynamics.orbital_frame_model import MAX_GAINS, Law, OrbitalFrameGains
from service.core.dynamics.orbital_frame_step import wanted_torque
from service.core.geometry.frames import body_from_nadir

W0_RAD_S = 2.0 * math.pi / (101.35 * 60.0)
LAW = Law(gains=MAX_GAINS, orbital_rate_rad_s=W0_RAD_S)
#: x East, y South, z nadir
INERTIA = np.diag([8000.0, 6000.0, 5000.0])


def _rate_at(attitude_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the inertial rate of a spacecraft that stands still in the turning nadir frame, deg/s: x, y, z."""
    return body_from_nadir(attitude_deg) @ np.array([0.0, -math.degrees(W0_RAD_S), 0.0])


def _flown(yaw_deg: float, *, is_converted: bool, duration_s: float = 1500.0) -> NDArray[np.float64]:
    """Return yaw, roll, pitch at the end; matrix and rate integrated in steps of a quarter of a second."""
    matrix = body_from_nadir([yaw_deg, 0.0, 0.0])
    rate = np.radians(_rate_at(np.array([yaw_deg, 0.0, 0.0])))
    momentum = INERTIA @ rate
    wheel = np.zeros(3)
    step_s = 0.25
    for _ in range(round(duration_s / step_s)):
        down = matrix[:, 2]
        roll, pitch = math.atan2(down[1], down[2]), math.atan2(-down[0], down[2])
        if is_converted:
            in_deg = np.degrees([rate[2], rate[0], rate[1]])
            yaw, roll, pitch = gyro_orbitant_torque(math.degrees(roll), math.degrees(pitch), in_deg, LAW, 0.25)
            torque = np.array([roll, pitch, yaw])
        else:
            # nadir taken for up and South for the orbit normal
            torque = np.clip(wanted_torque(LAW, roll, pitch, (rate[0], rate[1], rate[2])), -0.25, 0.25)
        gravity = 3.0 * W0_RAD_S**2 * np.cross(down, INERTIA @ down)
        momentum = momentum + step_s * (np.cross(momentum, rate) + gravity)
        wheel = wheel - step_s * torque
        rate = np.linalg.solve(INERTIA, momentum - wheel)
        relative = rate - matrix @ np.array([0.0, -W0_RAD_S, 0.0])
        x, y, z = relative * step_s
        matrix = matrix - np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ matrix
        u, _, vt = np.linalg.svd(matrix)
        matrix = u @ vt
    return np.degrees(
        [math.atan2(matrix[0, 1], matrix[0, 0]), math.atan2(matrix[1, 2], matrix[2, 2]), -math.asin(matrix[0, 2])]
    )


@pytest.mark.parametrize("yaw_deg", [1.0, -5.0])
def test_yaw_of_either_sign_is_brought_back(yaw_deg: float) -> None:
    end_deg = _flown(yaw_deg, is_converted=True)
    assert np.abs(end_deg).max() < 0.05 * abs(yaw_deg)


def test_unconverted_law_drives_yaw_away() -> None:
    assert abs(_flown(1.0, is_converted=False)[0]) > 5.0


def test_no_torque_at_zero_attitude() -> None:
    at_rest = np.array([0.0, 0.0, -math.degrees(W0_RAD_S)])
    assert gyro_orbitant_torque(0.0, 0.0, at_rest, LAW, 0.25) == pytest.approx(np.zeros(3), abs=1e-12)


def test_roll_and_pitch_are_pushed_back() -> None:
    at_rest = np.array([0.0, 0.0, -math.degrees(W0_RAD_S)])
    yaw, roll, pitch = gyro_orbitant_torque(0.1, 0.2, at_rest, LAW, 0.25)
    assert yaw == pytest.approx(0.0, abs=1e-12)
    assert roll == pytest.approx(-20.0 * math.radians(0.1), rel=1e-3)
    assert pitch == pytest.approx(-40.0 * math.radians(0.2), rel=1e-3)


def test_limit_cuts_each_axis() -> None:
    torque = gyro_orbitant_torque(2.0, -2.0, np.array([1.0, 0.0, 0.0]), LAW, 0.05)
    assert np.abs(torque).max() == pytest.approx(0.05)


@pytest.mark.parametrize("rate", [np.array([0.0, math.nan, 0.0]), np.array([math.inf, 0.0, 0.0])])
def test_values_that_are_none_are_refused(rate: NDArray[np.float64]) -> None:
    with pytest.raises(ValueError, match="no torque"):
        gyro_orbitant_torque(0.0, 0.0, rate, LAW, 0.05)


def test_imaginary_yaw_is_refused_never_cut() -> None:
    fast = np.array([0.0, 2.0 * math.degrees(W0_RAD_S), -math.degrees(W0_RAD_S)])
    printed = Law(gains=OrbitalFrameGains(), orbital_rate_rad_s=W0_RAD_S, is_guarded=False)
    with pytest.raises(ValueError, match="not guarded"):
        gyro_orbitant_torque(0.0, 0.0, fast, printed, 0.05)
    assert np.isfinite(gyro_orbitant_torque(0.0, 0.0, fast, LAW, 0.05)).all()
