"""Gains of the gyro-orbitant law: those that are taken settle, sampled as they are, and others are refused."""

import math

import numpy as np
import pytest

from service.core.control.gyro_orbitant import does_rate_show_yaw, gyro_orbitant_torque
from service.core.control.gyro_orbitant_design import gyro_orbitant_law, sampled_growth
from service.core.control.quaternion_law import GEOSTATIONARY_RATE_RAD_S, inertia_about_angles
from service.core.dynamics.orbital_frame_model import OrbitalFrameGains

W0 = GEOSTATIONARY_RATE_RAD_S
INERTIA = np.array([[2600.0, 40.0, 0.0], [40.0, 1400.0, 0.0], [0.0, 0.0, 2500.0]])
TENSOR = inertia_about_angles(INERTIA)
DAMPING = 0.9


def gains_of(period_s: float) -> OrbitalFrameGains:
    """Return gains whose roll and pitch loops have some period, yaw four times slower than its damping."""
    w = 2.0 * math.pi / period_s
    yaw, roll, pitch = TENSOR.diagonal()
    k2 = 2.0 * DAMPING * w
    return OrbitalFrameGains(
        2.0 * roll * w**2, roll * k2, 2.0 * pitch * w**2, pitch * k2, math.sqrt(2.0) * 0.25 * w * yaw * k2, yaw * k2
    )


def flown_deg(gains: OrbitalFrameGains, period_s: float, delay: int, commands: int) -> list[float]:
    """Return the greatest angle after each command, in steps of a twentieth of the period."""
    law = gyro_orbitant_law(INERTIA, gains_of(40.0 * period_s), torque_limit_n_m=1e9, command_period_s=period_s)
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
def test_gains_that_are_taken_settle_and_those_that_are_refused_do_not(period_s: float, least_s: float) -> None:
    slow, fast = gains_of(least_s), gains_of(0.5 * least_s)
    gyro_orbitant_law(INERTIA, slow, torque_limit_n_m=1.0, command_period_s=period_s)
    with pytest.raises(ValueError, match="do not settle"):
        gyro_orbitant_law(INERTIA, fast, torque_limit_n_m=1.0, command_period_s=period_s)
    for delay in (0, 1):
        assert flown_deg(slow, period_s, delay, 400)[-1] < 0.05 * 0.03
    grown = flown_deg(fast, period_s, 1, 20)
    assert grown[-1] > 1.0 or math.isnan(grown[-1])


def test_growth_is_what_a_flight_shows() -> None:
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
def test_gains_that_cannot_be_are_refused_in_words(change: dict[str, float], words: str) -> None:
    gains = gains_of(2400.0)._replace(**change)
    with pytest.raises(ValueError, match=words):
        gyro_orbitant_law(INERTIA, gains, torque_limit_n_m=0.05, command_period_s=60.0)


def test_inertia_and_period_must_be_possible() -> None:
    for inertia, period_s in ((np.diag([1.0, 1.0, 3.0]), 60.0), (INERTIA, 0.0), (INERTIA, math.inf)):
        with pytest.raises(ValueError, match=r"exceeds the sum|command_period_s is"):
            gyro_orbitant_law(inertia, gains_of(2400.0), torque_limit_n_m=0.05, command_period_s=period_s)


@pytest.mark.parametrize(
    ("roll", "pitch", "is_told"),
    [(0.9, -1.0, True), (-1.0, -1.0, True), (1.1, -1.0, False), (-2.0, -1.0, False), (0.0, 0.1, False)],
)
def test_the_roll_rate_tells_yaw_up_to_the_orbital_rate(roll: float, pitch: float, is_told: bool) -> None:
    rate = np.degrees(W0) * np.array([0.0, roll, pitch])
    assert does_rate_show_yaw(rate, np.radians(np.degrees(W0)) * (1.0 + 1e-12)) is is_told
    assert not does_rate_show_yaw(np.array([math.nan, roll, pitch]), W0)
