"""Craft in flight: conservation laws, what happens without the fast loop, wheels and tones against closed forms."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from analyzer_sim.world.orbit.orbit import EARTH_RATE_RAD_S
from analyzer_sim.world.spacecraft.body_dynamics import INERTIA_KG_M2, Motion, Torques, orbit_normal_in_body, stepped
from analyzer_sim.world.spacecraft.flown_spacecraft import OrbitalFrameSpacecraft, spacecraft_at_rest
from analyzer_sim.world.spacecraft.hub_tones import HubTone, parse_tone
from analyzer_sim.world.spacecraft.rigid_body import TorqueElement
from analyzer_sim.world.spacecraft.wheels import MOMENTUM_LIMIT_N_M_S, QUANTUM_N_M, Wheel, friction_n_m, wheel_set

S = 1_000_000
STILL = (0.0, 0.0, 0.0)
INERTIA = np.array(INERTIA_KG_M2)


def body_from_orbit(motion: Motion) -> np.ndarray:
    """Return the rotation of the sequence yaw, pitch, roll."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a), math.cos(a)) for a in (motion.roll, motion.pitch, motion.yaw))
    about_x = np.array([[1, 0, 0], [0, cr, sr], [0, -sr, cr]])
    about_y = np.array([[cp, 0, -sp], [0, 1, 0], [sp, 0, cp]])
    about_z = np.array([[cy, sy, 0], [-sy, cy, 0], [0, 0, 1]])
    return np.asarray(about_x @ about_y @ about_z)


def inertial_momentum(flown: OrbitalFrameSpacecraft, elapsed_s: float) -> np.ndarray:
    """Return the momentum of body and wheels in a frame that does not turn."""
    stored = np.array([wheel.momentum_n_m_s for wheel in flown.wheels])
    in_orbit = body_from_orbit(flown.motion).T @ (INERTIA * flown.motion.rate_rad_s + stored)
    # the orbit turns about -y
    angle = -EARTH_RATE_RAD_S * elapsed_s
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ in_orbit


def flying(momentum: tuple[float, float, float], *, has_fast_loop: bool = True) -> OrbitalFrameSpacecraft:
    flown = spacecraft_at_rest(INERTIA_KG_M2, STILL, wheel_set(1, momentum))
    flown.has_fast_loop = has_fast_loop
    return flown


def test_the_normal_of_the_orbit_is_the_second_column_of_the_rotation():
    motion = Motion(0.0, 0.0, 0.0, 0.3, -0.2, 0.5)
    south = body_from_orbit(motion) @ [0.0, 1.0, 0.0]
    np.testing.assert_allclose(orbit_normal_in_body(*motion[3:]), south, atol=1e-15)  # rounding


def test_a_long_step_agrees_with_an_integrator_of_another_kind():
    torques = Torques((1e-5, 2e-5, -1e-5), (2e-3, -1e-3, 1e-3), (1.5, -8.0, 0.7))
    start = Motion(1e-4, -2e-4, 3e-4, 0.01, -0.02, 0.03)

    def slope(time_s: float, values: np.ndarray) -> np.ndarray:
        rate, motion = values[:3], Motion(*values)
        stored = np.array(torques.momentum_n_m_s) - time_s * np.array(torques.wheels_n_m)
        torque = np.add(torques.external_n_m, torques.wheels_n_m)
        gained = (torque - np.cross(rate, INERTIA * rate + stored)) / INERTIA
        p, q, r = rate + EARTH_RATE_RAD_S * body_from_orbit(motion)[:, 1]
        sr, cr = math.sin(motion.roll), math.cos(motion.roll)
        across = q * sr + r * cr
        turned = [p + across * math.tan(motion.pitch), q * cr - r * sr, across / math.cos(motion.pitch)]
        return np.array([*gained, *turned])

    exact = solve_ivp(slope, (0.0, 2.0), start, method="DOP853", rtol=1e-13, atol=1e-16).y[:, -1]
    once = stepped(start, torques, INERTIA_KG_M2, EARTH_RATE_RAD_S, 2.0)
    np.testing.assert_allclose(once, exact, atol=1e-13)  # rad, the error that the docstring states


@pytest.mark.parametrize("has_fast_loop", [True, False])
def test_momentum_is_conserved_whatever_the_wheels_do(has_fast_loop):
    flown = flying((1.5, -8.0, 0.7), has_fast_loop=has_fast_loop)
    before = inertial_momentum(flown, 0.0)
    schedule = [TorqueElement(k * 100 * S, k * 100 * S + 7 * S, (0.01, -0.02, 0.03 * (-1) ** k)) for k in range(6)]
    flown.fly((0, 600 * S), schedule, STILL, STILL, STILL)
    assert np.abs(inertial_momentum(flown, 600.0) - before).max() < 1e-9 * 8.0  # N m s
    assert abs(flown.wheels[2].momentum_n_m_s - 0.7) > 0.3  # while the wheels have worked


def test_an_outer_torque_is_stored_in_the_wheels():
    flown = flying((1.5, -8.0, 0.7))
    solar = (0.0, 0.0, 1.0e-4)  # pitch: its axis does not turn
    before = inertial_momentum(flown, 0.0)
    flown.fly((0, 600 * S), [], STILL, solar, (0.0, 0.0, 0.05e-4))
    gained = inertial_momentum(flown, 600.0) - before
    np.testing.assert_allclose(gained, [0.0, 0.06, 0.0], atol=1e-5)  # N m s; the axis leaves by some 1e-4 rad
    assert flown.wheels[1].momentum_n_m_s - -8.0 == pytest.approx(0.95 * 0.06, rel=0.2)  # 5 % turn the body


def test_energy_is_conserved_when_nothing_drives_the_wheels():
    flown = flying((1.5, -8.0, 0.7), has_fast_loop=False)
    flown.motion = Motion(3e-4, -2e-4, 5e-4, 0.0, 0.0, 0.0)
    energies = []
    for minute in range(20):
        energies.append(0.5 * float(np.sum(INERTIA * np.square(flown.motion.rate_rad_s))))
        flown.fly((minute * 60 * S, (minute + 1) * 60 * S), [], STILL, STILL, STILL)
    assert np.ptp(energies) < 1e-9 * energies[0]
    assert flown.motion.rate_x != pytest.approx(3e-4, rel=0.1)  # gyroscopic torques turn the rate round


def test_without_the_fast_loop_one_newton_metre_second_turns_the_craft_by_a_third_of_a_degree():
    largest = {}
    for has_fast_loop in (False, True):
        flown = flying((0.0, 0.0, 1.0), has_fast_loop=has_fast_loop)
        flown.fly((0, 600 * S), [], STILL, STILL, STILL)
        largest[has_fast_loop] = max(abs(angle) for angle in flown.state.attitude_deg)
    print(f"after 10 min: {largest[False]:.3f} deg without the loop, {largest[True]:.1e} with it")
    assert largest[False] == pytest.approx(0.3, abs=0.03)
    assert largest[True] < 0.003  # bearings that start from rest


def test_a_mode_that_follows_the_orbit_does_not_exchange_roll_and_yaw():
    moved = []
    for is_coupled in (True, False):
        flown = spacecraft_at_rest(
            INERTIA_KG_M2, (0.4, 0.0, 0.0), wheel_set(1, (0.5, -8.0, 0.5)), is_coupled=is_coupled
        )
        flown.fly((0, 600 * S), [], STILL, STILL, STILL)
        moved.append(flown.state.attitude_deg[1])
    assert moved[0] == pytest.approx(0.4 * EARTH_RATE_RAD_S * 600.0, rel=0.02)
    assert abs(moved[1]) < 2e-4


def test_the_inertial_model_drifts_away_with_the_craft():
    flown = flying((0.5, -8.0, 0.5))
    drift = (0.0, 0.0, 1e-5)  # deg/s of pitch
    flown.fly((0, 3600 * S), [], drift, STILL, STILL)
    assert flown.state.attitude_deg[2] == pytest.approx(0.036, rel=0.02)


def test_a_drive_moves_in_whole_quanta_whose_mean_is_what_was_asked_for():
    wheel, wanted = Wheel(-8.0), 3.1e-4
    motors = [wheel.motor_n_m(wanted, 2.0) for _ in range(1000)]
    assert {round(motor / QUANTUM_N_M, 9) % 1.0 for motor in motors} == {0.0}
    assert np.mean(motors) == pytest.approx(-wanted + friction_n_m(-8.0), abs=QUANTUM_N_M / 1000)


def test_a_wheel_at_its_limit_takes_no_more():
    wheel = Wheel(MOMENTUM_LIMIT_N_M_S - 0.001)
    given = [wheel.body_torque_n_m(0.05, 2.0) for _ in range(3)]
    assert wheel.momentum_n_m_s == MOMENTUM_LIMIT_N_M_S
    assert given == pytest.approx([-0.0005, 0.0, 0.0])


def test_friction_slows_a_wheel_down_and_reverses_with_it():
    assert friction_n_m(8.0) == pytest.approx(1.8e-3)
    assert friction_n_m(-8.0) == -friction_n_m(8.0)
    assert friction_n_m(0.0) == 0.0


def test_a_tone_rings_as_an_oscillator_does():
    tone = HubTone(0, 0.6, 0.003, 0.4)
    acceleration = 1e-6
    for _ in range(500):
        tone.push(acceleration, 0.5)
    time_s = 250.0
    damped = 0.6 * math.sqrt(1.0 - 0.003**2)
    decay = math.exp(-0.003 * 0.6 * time_s)
    shape = math.cos(damped * time_s) + 0.003 / math.sqrt(1.0 - 0.003**2) * math.sin(damped * time_s)
    assert tone.angle_rad == pytest.approx(0.4 * acceleration / 0.36 * (1.0 - decay * shape), rel=1e-9)


@pytest.mark.parametrize("text", ["roll", "x:1:0.1:1", "roll:0:0.1:1", "roll:1:1:1", "roll:1:0.1:nan", "roll:a:1:1"])
def test_a_text_that_is_no_tone_is_refused(text):
    with pytest.raises(ValueError, match=r"tone|omega|float"):
        parse_tone(text)
