"""Plans of commands: at rest when the horizon ends, the known torque balanced, every step inside the envelope."""

import numpy as np
import pytest

from service.core.control.command_plan import Forecast, PlannedPulses, Situation, plan_command
from service.core.control.envelope import Envelope, envelope_excesses
from service.core.control.quaternion_law import loop_gains
from service.core.control.slew_schedule import Drive, predicted_effect

INERTIA = np.diag([2600.0, 2600.0, 1400.0])
GAINS = loop_gains(
    np.diag([2600.0, 1400.0, 2600.0]),
    period_s=2400.0,
    damping=0.9,
    torque_limit_n_m=0.05,
    command_period_s=None,
    # the exchange of roll and yaw turns the spacecraft as well; it is the slew's own test that looks at it
    orbital_rate_rad_s=0.0,
)
DRIVE = Drive(0.05, 0.002, 0.1, 0.001)
EVERY = np.array([True, True, True])
NOTHING = np.zeros(3)
SLEW_S, SLICE_S = 450.0, 450.0
#: what quantum and shortest pulse leave, deg and deg/s: half of the shortest pulse of 2e-4 N m s about pitch
ANGLE_LEFT_DEG, RATE_LEFT_DEG_S = 0.01, 1.2e-5


def forecast(torque_n_m=(0.0, 0.0, 0.0), slices=7) -> Forecast:
    return Forecast(SLEW_S, SLICE_S, np.tile(np.array(torque_n_m), (1 + slices, 1)))


def flown(plan: PlannedPulses, rates_deg_s=NOTHING, torque_n_m=NOTHING, until_s=None) -> tuple[np.ndarray, np.ndarray]:
    """Return what the spacecraft has turned and its rate, deg and deg/s, by steps of 10 ms and without exchange."""
    stop_s = plan.horizon_s if until_s is None else until_s
    step_s = 0.01
    rate, angle = np.radians(rates_deg_s), np.zeros(3)
    edges = np.arange(0.0, stop_s, step_s)
    torque = np.tile(np.array(torque_n_m, dtype=np.float64), (len(edges), 1))
    for pulse in plan.pulses:
        acting = np.clip((pulse.start_s + pulse.duration_s - edges) / step_s, 0.0, 1.0)
        acting -= np.clip((pulse.start_s - edges) / step_s, 0.0, 1.0)
        torque[:, pulse.axis] += pulse.torque_n_m * acting
    rates = rate + np.cumsum(torque, axis=0) / INERTIA.diagonal() * step_s
    return np.degrees(angle + rates.sum(axis=0) * step_s), np.degrees(rates[-1])


def test_a_slew_goes_the_law_s_way_and_ends_at_rest():
    plan = plan_command(GAINS, DRIVE, Situation(np.array([0.0, 0.1, -0.1]), NOTHING, EVERY), forecast(), Envelope())
    turned, rate = flown(plan)
    # the share of the law's oscillator in its slow motion
    share = 1.0 - np.exp(-np.pi / 2400.0 / 0.9 * SLEW_S)
    np.testing.assert_allclose(turned, [0.0, -0.1 * share, 0.1 * share], atol=ANGLE_LEFT_DEG)
    np.testing.assert_allclose(rate, 0.0, atol=RATE_LEFT_DEG_S)
    assert not plan.is_shortened
    assert plan.horizon_s == SLEW_S + 7 * SLICE_S


def test_a_known_torque_is_balanced_until_the_horizon_and_a_rate_is_taken():
    torque, rates = np.array([-3e-7, 4e-7, 2e-7]), np.array([0.0, 1.2e-5, -8e-6])
    plan = plan_command(GAINS, DRIVE, Situation(NOTHING, rates, EVERY), forecast(torque), Envelope())
    assert plan.horizon_s > 1500.0
    for until_s in (SLEW_S, plan.horizon_s):
        turned, rate = flown(plan, rates, torque, until_s)
        np.testing.assert_allclose(turned, 0.0, atol=ANGLE_LEFT_DEG)
        np.testing.assert_allclose(rate, 0.0, atol=RATE_LEFT_DEG_S)
    idle, _ = flown(PlannedPulses((), plan.horizon_s, False), rates, torque)
    assert np.abs(idle).max() > 4.0 * ANGLE_LEFT_DEG


def test_an_axis_that_is_withheld_has_no_pulse():
    only = np.array([False, True, True])
    plan = plan_command(GAINS, DRIVE, Situation(np.full(3, 0.2), NOTHING, only), forecast((1e-7,) * 3), Envelope())
    assert {pulse.axis for pulse in plan.pulses} == {1, 2}


@pytest.mark.parametrize("seed", range(40))
def test_whatever_is_asked_for_the_step_lies_inside_the_envelope(seed):
    rng = np.random.default_rng(seed)
    situation = Situation(rng.uniform(-0.6, 0.6, 3), rng.uniform(-1e-4, 1e-4, 3), EVERY)
    torque = rng.uniform(-8e-7, 8e-7, 3)
    limits = Envelope(*(0.95 * limit for limit in Envelope()))
    plan = plan_command(GAINS, DRIVE, situation, forecast(torque), limits)
    effect = predicted_effect(plan.pulses, INERTIA, np.eye(3), plan.horizon_s)
    print(f"seed {seed}: {plan.horizon_s:g} s, {effect.angle_change_deg}, {effect.gross_impulse_n_m_s}")
    assert envelope_excesses(effect, (0.0, 0.0, 0.0), Envelope()) == ()


def test_a_large_angle_is_led_back_in_steps_and_the_horizon_becomes_shorter():
    far = Situation(np.array([0.0, 0.5, 0.0]), NOTHING, EVERY)
    plan = plan_command(GAINS, DRIVE, far, forecast((0.0, 6e-7, 0.0)), Envelope())
    assert plan.is_shortened
    turned, _ = flown(plan, torque_n_m=np.array([0.0, 6e-7, 0.0]))
    assert -0.11 < turned[1] < -0.07
    near = plan_command(GAINS, DRIVE, far._replace(attitude_deg=NOTHING), forecast((0.0, 6e-7, 0.0)), Envelope())
    assert near.horizon_s > plan.horizon_s


def test_a_yaw_that_is_not_far_off_does_not_shorten_what_roll_and_pitch_are_held_for():
    calm = plan_command(GAINS, DRIVE, Situation(NOTHING, NOTHING, EVERY), forecast((1e-7,) * 3), Envelope())
    turned = Situation(np.array([0.29, 0.0, 0.0]), np.array([5e-5, 0.0, 0.0]), EVERY)
    plan = plan_command(GAINS, DRIVE, turned, forecast((1e-7,) * 3), Envelope())
    assert plan.horizon_s == calm.horizon_s
    assert plan.is_shortened


def test_a_yaw_far_off_is_led_back_although_a_torque_fills_the_envelope_of_an_hour():
    """Before: balancing 2e-6 N m for an hour left nothing to the slew, and the spacecraft went on to turn away."""
    yaw_deg, rate_deg_s, torque_n_m = 0.8, 1e-4, 2e-6
    turned = Situation(np.array([yaw_deg, 0.0, 0.0]), np.array([rate_deg_s, 0.0, 0.0]), EVERY)
    expected = forecast((torque_n_m, 1e-7, 1e-7))
    plan = plan_command(GAINS, DRIVE, turned, expected, Envelope())
    slew = [pulse for pulse in plan.pulses if pulse.axis == 0 and pulse.start_s < expected.slew_s]
    gained_deg_s = np.degrees(sum(pulse.impulse_n_m_s for pulse in slew) / INERTIA[0, 0])
    pushed_deg_s = np.degrees(torque_n_m / INERTIA[0, 0]) * expected.slew_s
    # at least the rate that the torque gives within the slew and half of what was there are taken away
    assert gained_deg_s < -(pushed_deg_s + 0.5 * rate_deg_s)


def test_a_drive_without_steps_gives_long_weak_pulses_that_do_not_overlap():
    fine = DRIVE._replace(quantum_n_m=5e-8)
    situation = Situation(np.array([0.1, 0.1, -0.1]), NOTHING, EVERY)
    plan = plan_command(GAINS, fine, situation, forecast((2e-7, -4e-7, 3e-7)), Envelope())
    predicted_effect(plan.pulses, INERTIA, np.eye(3), plan.horizon_s)
    assert max(abs(pulse.torque_n_m) for pulse in plan.pulses) <= 0.05


@pytest.mark.parametrize("torque", [np.nan, np.inf])
def test_a_torque_that_is_not_finite_is_refused(torque):
    situation = Situation(np.array([0.0, 0.1, -0.1]), NOTHING, EVERY)
    expected = forecast((0.0, 6e-7, 0.0))
    expected.torque_n_m[-1, 1] = torque
    with pytest.raises(ValueError, match="must be finite"):
        plan_command(GAINS, DRIVE, situation, expected, Envelope())
