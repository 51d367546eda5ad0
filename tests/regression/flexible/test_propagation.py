"""Exact legs of the flexible spacecraft against an integrator of eighth order, and the invariant of equation (11)."""

import math

import numpy as np
import pytest
from flexible_oracles import bi_plane_invariant
from scipy.integrate import solve_ivp

from service.core.flexible.propagation import BodyState, start_leg, state_at, states_at
from service.core.flexible.spacecraft import HubMode

INERTIA = 1000.0
START = BodyState(0.0349, -1.3e-4, 2.1e-3, -7e-4, 0.8)


def integrated(mode: HubMode, decay_1_s: float, wheel_n_m: float, external_n_m: float, duration_s: float):
    """Return the state by DOP853 at relative tolerance 1e-12; the wheel's torque follows its own momentum."""

    def derivative(_: float, y: np.ndarray) -> list[float]:
        wheel = wheel_n_m - decay_1_s * (y[4] - START.momentum_n_m_s)
        drive = (external_n_m + wheel) / INERTIA
        omega, xi, coupling = mode
        return [y[1], drive, y[3], coupling * drive - 2.0 * xi * omega * y[3] - omega**2 * y[2], wheel]

    # angles of 1e-3: an absolute tolerance far below the last digit that is compared
    solution = solve_ivp(derivative, (0.0, duration_s), START, "DOP853", rtol=1e-12, atol=1e-17)
    return solution.y[:, -1]


@pytest.mark.parametrize("decay_1_s", [0.0, 5e-6, 1e-3, 0.05])
@pytest.mark.parametrize("external_n_m", [0.0, 2e-3])
def test_a_leg_of_a_minute_agrees_with_the_integrator(decay_1_s: float, external_n_m: float) -> None:
    mode = HubMode(0.5, 0.005, 0.5)
    leg = start_leg(
        START,
        mode,
        inertia_kg_m2=INERTIA,
        wheel_torque_n_m=-0.011,
        decay_1_s=decay_1_s,
        external_torque_n_m=external_n_m,
    )
    found = np.array(state_at(leg, 60.0))
    wanted = integrated(mode, decay_1_s, -0.011, external_n_m, 60.0)
    np.testing.assert_allclose(found, wanted, rtol=0.0, atol=2e-14)


def test_without_the_decaying_part_the_comparison_fails() -> None:
    mode = HubMode(0.5, 0.005, 0.5)
    leg = start_leg(START, mode, inertia_kg_m2=INERTIA, wheel_torque_n_m=-0.011)
    wanted = integrated(mode, 5e-6, -0.011, 0.0, 60.0)
    assert np.abs(np.array(state_at(leg, 60.0))[:4] - wanted[:4]).max() > 1e-9


@pytest.mark.parametrize("xi", [1e-4, 0.005, 0.3])
def test_the_invariant_of_the_bi_plane_stays_to_fourteen_digits(xi: float) -> None:
    mode = HubMode(0.7, xi, 0.4)
    leg = start_leg(START, mode, inertia_kg_m2=INERTIA, wheel_torque_n_m=-0.2)
    # with heavy damping the swing itself falls below its rounding
    times = np.linspace(0.0, min(20.0, 0.3 / xi) * 2.0 * math.pi / mode.omega_rad_s, 400)
    invariant = bi_plane_invariant(leg, mode, times)
    np.testing.assert_allclose(invariant, invariant[0], rtol=1e-14)


def test_the_printed_sign_would_break_the_invariant() -> None:
    # (8) with the printed minus, put into (9) and (11)
    mode = HubMode(0.7, 0.05, 0.4)
    leg = start_leg(START, mode, inertia_kg_m2=INERTIA, wheel_torque_n_m=-0.2)
    states = states_at(leg, np.linspace(0.0, 20.0, 200))
    away = states[:, 2] - leg.decaying_rad
    nu, y = math.sqrt(1.0 - 0.05**2), states[:, 3] / mode.omega_rad_s

    def spread(sign: float) -> float:
        u, v = nu * away, y + sign * 0.05 * away
        invariant = (u**2 + v**2) * np.exp(-2.0 * 0.05 / nu * np.unwrap(np.arctan2(v, u)))
        return float(invariant.max() / invariant.min())

    assert spread(1.0) == pytest.approx(1.0, abs=1e-13)
    assert spread(-1.0) > 1.1
