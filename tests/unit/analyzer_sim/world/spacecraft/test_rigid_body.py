"""Rigid body: pulses turn it as torque over inertia says; the steps are those of an integrator of high order."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S
from analyzer_sim.world.spacecraft.rigid_body import BodyState, RigidBody, TorqueElement

S = 1_000_000
#: about yaw, roll, pitch
INERTIA = (2600.0, 2600.0, 1400.0)
REST = BodyState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_a_pulse_changes_rate_and_angle_as_torque_over_inertia_says() -> None:
    pulse = TorqueElement(10 * S, 30 * S, (0.01, -0.02, 0.03))
    after = RigidBody(INERTIA, 0.0).fly(REST, (0, 60 * S), [pulse])
    for axis in range(3):
        acceleration = math.degrees(pulse.torque_n_m[axis] / INERTIA[axis])
        # exact but for rounding
        assert after.rate_deg_s[axis] == pytest.approx(20.0 * acceleration, rel=1e-12)
        assert after.attitude_deg[axis] == pytest.approx((200.0 + 20.0 * 30.0) * acceleration, rel=1e-12)


def test_kinetic_energy_is_the_work_done() -> None:
    pulse = TorqueElement(0, 40 * S, (0.0, 0.0, 0.03))
    after = RigidBody(INERTIA, 0.0).fly(REST, (0, 40 * S), [pulse])
    energy = 0.5 * INERTIA[2] * math.radians(after.rate_deg_s[2]) ** 2
    assert energy == pytest.approx(0.03 * math.radians(after.attitude_deg[2]), rel=1e-12)


def test_a_torque_free_body_only_exchanges_roll_and_yaw() -> None:
    body = RigidBody(INERTIA, EARTH_RATE_RAD_S)
    quarter_us = round(0.5 * math.pi / EARTH_RATE_RAD_S * S)
    state = BodyState((0.2, 0.0, 0.1), (0.0, 0.0, 0.0))
    for begin_us in range(0, quarter_us, 300 * S):
        state = body.fly(state, (begin_us, min(quarter_us, begin_us + 300 * S)), [])
    # the quarter is rounded to a microsecond; 72 steps of rounding
    np.testing.assert_allclose(state.attitude_deg, (0.0, 0.2, 0.1), atol=1e-10)


@pytest.mark.parametrize("rate_rad_s", [0.0, EARTH_RATE_RAD_S])
def test_steps_agree_with_an_integrator(rate_rad_s: float) -> None:
    drift, disturbance = (2e-5, -1e-5, 1e-5), (5e-7, -8e-7, 4e-7)
    schedule = [
        TorqueElement(5 * S, 25 * S, (2e-3, -1e-3, 3e-3)),
        TorqueElement(20 * S, 47 * S + 250_000, (-1e-3, 2e-3, 1e-3)),
        TorqueElement(400 * S, 900 * S, (1e-5, 2e-5, -1e-5)),
    ]
    start = BodyState((0.1, -0.2, 0.05), (1e-5, -2e-5, 1e-5))
    flown = RigidBody(INERTIA, rate_rad_s).fly(start, (0, 600 * S), schedule, drift, disturbance)

    def slope(t: float, x: np.ndarray, torque: np.ndarray) -> np.ndarray:
        acceleration = np.degrees(torque / INERTIA)
        coupling = rate_rad_s * np.array([-x[1], x[0], 0.0])
        return np.concatenate([coupling + drift + x[3:], acceleration])

    x = np.concatenate(start)
    edges = [0.0, 5.0, 20.0, 25.0, 47.25, 400.0, 600.0]
    for begin, end in pairwise(edges):
        acting = [e.torque_n_m for e in schedule if e.start_us / S <= begin and e.stop_us / S >= end]
        torque = np.sum([disturbance, *acting], axis=0)
        x = solve_ivp(slope, (begin, end), x, args=(torque,), rtol=1e-12, atol=1e-14).y[:, -1]
    # bound of the integrator
    np.testing.assert_allclose(np.concatenate(flown), x, rtol=1e-9, atol=1e-12)


def test_cutting_a_span_changes_nothing() -> None:
    body, pulse = RigidBody(INERTIA, EARTH_RATE_RAD_S), TorqueElement(3 * S, 200 * S, (1e-3, 2e-3, -1e-3))
    whole = body.fly(REST, (0, 300 * S), [pulse])
    state = REST
    for begin in (0, 60, 120, 180, 240):
        state = body.fly(state, (begin * S, (begin + 60) * S), [pulse])
    np.testing.assert_allclose(np.concatenate(state), np.concatenate(whole), rtol=1e-12)  # rounding of five steps
