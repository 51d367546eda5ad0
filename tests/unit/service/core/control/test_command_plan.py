"""From wheels to pulses: allocation, plan of a command and the slew that it follows."""

from itertools import product

import numpy as np
import pytest

from service.core.control.command_plan import (
    Horizon,
    KnownTorque,
    Situation,
    compiled_plan,
    plan_allocated,
    plan_command,
)
from service.core.control.quaternion_law import (
    GEOSTATIONARY_RATE_RAD_S,
    inertia_about_angles,
    loop_gains,
    tracking_request,
)
from service.core.control.slew_schedule import (
    AxisPulse,
    Drive,
    Envelope,
    axis_pulses,
    envelope_excesses,
    plan_slew,
    predicted_angles,
    predicted_effect,
    shape_pulses,
)
from service.core.control.wheel_allocation import allocate, allocate_to_wheels, body_torque_limit_n_m, wheel_set

PYRAMID = np.array([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]])
SKEWED = np.array([[1.0, 0, 0], [1, 1, 0], [0, 1, 2]])


def test_a_wheel_turns_the_body_the_other_way():
    np.testing.assert_array_equal(allocate_to_wheels(np.eye(3), np.array([0.01, 0.0, 0.0])), [-0.01, 0.0, 0.0])


def test_zero_is_plain_zero():
    assert not np.signbit(allocate_to_wheels(np.eye(3), np.zeros(3))).any()


def test_the_length_of_an_axis_does_not_matter():
    torque = np.array([[0.01, -0.02, 0.03], [0.0, 0.01, 0.0]])
    found = allocate_to_wheels(7.0 * PYRAMID, torque)
    assert found.shape == (2, 4)
    # rounding of the norm, and of what is zero
    np.testing.assert_allclose(found, allocate_to_wheels(PYRAMID, torque), rtol=1e-12, atol=1e-17)


@pytest.mark.parametrize("axes", [np.eye(3), PYRAMID, SKEWED], ids=["orthogonal", "pyramid", "skewed"])
def test_at_the_body_limit_the_hardest_worked_wheel_is_at_its_own(axes):
    limit = body_torque_limit_n_m(axes, 0.05)
    signs = limit * np.array(list(product((-1.0, 1.0), repeat=3)))
    # rounding of the pseudo-inverse
    assert np.abs(allocate_to_wheels(axes, signs)).max() == pytest.approx(0.05, rel=1e-12)


def test_within_the_limits_the_body_gets_what_was_wanted():
    wheels, wanted = wheel_set(PYRAMID, 0.05, 20.0), np.array([0.01, -0.02, 0.015])
    found = allocate(wheels, wanted, np.zeros(4), 60.0)
    assert found.share == 1.0
    assert not found.null_n_m.any()
    np.testing.assert_allclose(-found.wheels_n_m @ wheels.axes, wanted)


def test_a_torque_limit_scales_all_wheels_alike():
    found = allocate(wheel_set(np.eye(3), 0.05, 20.0), np.array([0.1, 0.02, 0.0]), np.zeros(3), 10.0)
    assert found.share == 0.5
    np.testing.assert_allclose(found.wheels_n_m, [-0.05, -0.01, 0.0])


def test_a_full_wheel_takes_no_more_but_gives_back():
    wheels = wheel_set(np.eye(3), 0.05, 20.0)
    # torque about yaw turns its wheel the other way
    full = allocate(wheels, np.array([-0.01, 0.01, 0.0]), np.array([20.0, 0.0, 0.0]), 60.0)
    assert full.share == 0.0
    beyond = allocate(wheels, np.array([0.01, 0.01, 0.0]), np.array([21.0, 0.0, 0.0]), 60.0)
    assert beyond.share == 1.0
    assert beyond.wheels_n_m[0] == pytest.approx(-0.01)


def test_null_motion_turns_nothing_and_leaves_no_wheel_near_zero_speed():
    wheels = wheel_set(PYRAMID, 0.05, 20.0, least_momentum_n_m_s=1.0)
    momentum = np.array([0.2, 4.0, 3.0, 5.0])
    wanted = np.array([0.001, 0.0, 0.0])
    found = allocate(wheels, wanted, momentum, 100.0)
    np.testing.assert_allclose(-found.wheels_n_m @ wheels.axes, wanted, atol=1e-15)
    assert np.abs(momentum + 100.0 * found.wheels_n_m).min() >= 1.0 - 1e-9
    # where no wheel is slow there is none
    assert not allocate(wheels, wanted, np.full(4, 5.0), 100.0).null_n_m.any()


def test_null_motion_gets_only_the_room_that_is_left():
    wheels = wheel_set(PYRAMID, 0.05, 20.0, least_momentum_n_m_s=1.0)
    found = allocate(wheels, np.array([0.0, 0.0, 0.13]), np.array([0.2, 4.0, 3.0, 5.0]), 10.0)
    assert np.abs(found.wheels_n_m).max() <= 0.05 * (1.0 + 1e-12)
    np.testing.assert_allclose(-found.wheels_n_m @ wheels.axes, [0.0, 0.0, 0.13], atol=1e-15)


@pytest.mark.parametrize(
    ("axes", "limits", "message"),
    [
        ([[1, 0, 0], [0, 1, 0], [1, 1, 0]], (0.05, 20.0), "singular: about the direction.*pitch [+-]1.00"),
        ([[1, 0, 0], [0, 1, 0], [0, 1, 0.04]], (0.05, 20.0), "singular"),
        ([[1, 0, 0], [0, 1, 0]], (0.05, 20.0), "three wheels"),
        ([[1, 0, 0], [0, 0, 0], [0, 0, 1]], (0.05, 20.0), "wheel 2 has no direction"),
        ([[1, 0, float("nan")], [0, 1, 0], [0, 0, 1]], (0.05, 20.0), "finite"),
        (np.eye(3), (0.0, 20.0, 0.0), r"limit|momentum"),
        (np.eye(3), (0.05, float("inf"), 0.0), r"limit|momentum"),
        (np.eye(3), (0.05, 20.0, 20.0), r"limit|momentum"),
        (np.eye(3), (0.05, 20.0, -1.0), r"limit|momentum"),
    ],
)
def test_sets_that_cannot_control_are_refused(axes, limits, message):
    with pytest.raises(ValueError, match=message):
        wheel_set(axes, *limits)


CRAFT_DRIVE = Drive(0.05, 0.002, 0.1, 0.001)


def shape(torque, carry=(0.0, 0.0, 0.0), period_s=60.0, **changes):
    return shape_pulses(np.array(torque), np.array(carry), period_s, CRAFT_DRIVE._replace(**changes))


def test_a_wish_below_the_shortest_pulse_is_carried():
    pulses = shape([1e-6, -1e-6, 0.0])
    assert not pulses.impulse_n_m_s.any()
    assert not pulses.is_saturated.any()
    # 1e-6 N m over 60 s, exact products
    np.testing.assert_allclose(pulses.carry_n_m_s, [6e-5, -6e-5, 0.0], rtol=1e-12)


def test_a_small_wish_becomes_one_quantum_for_a_short_time():
    pulses = shape([1e-5, -1e-5, 0.0])
    np.testing.assert_allclose(pulses.torque_n_m, [0.002, -0.002, 0.0])
    # 6e-4 N m s over 0.002 N m
    np.testing.assert_allclose(pulses.duration_s, [0.3, 0.3, 0.0], rtol=1e-9)


def test_a_large_wish_takes_as_few_quanta_as_the_period_allows():
    pulses = shape([0.0071, 0.0, 0.0])
    # 0.0071 N m over the whole period lies between three and four quanta
    assert pulses.torque_n_m[0] == pytest.approx(0.008)
    assert pulses.duration_s[0] == pytest.approx(60.0 * 0.0071 / 0.008, abs=1e-3)  # grid of durations


@pytest.mark.parametrize("wanted_n_m", [0.0501, -0.06, 3.0])
def test_beyond_the_limit_the_whole_period_is_used_and_nothing_is_saved_up(wanted_n_m):
    pulses = shape([wanted_n_m, 0.0, 0.0])
    assert pulses.is_saturated.tolist() == [True, False, False]
    assert pulses.torque_n_m[0] == pytest.approx(np.sign(wanted_n_m) * 0.05)
    assert pulses.duration_s[0] == pytest.approx(60.0)
    assert pulses.carry_n_m_s[0] == 0.0


def test_exactly_at_the_limit_is_not_saturated():
    assert not shape([0.05, -0.05, 0.05]).is_saturated.any()


def test_a_limit_below_the_quantum_allows_no_pulse():
    pulses = shape([0.0015, 0.0, -0.0015], limit_n_m=0.001)
    assert not pulses.torque_n_m.any()
    assert not pulses.impulse_n_m_s.any()
    assert not pulses.carry_n_m_s.any()
    assert pulses.is_saturated.tolist() == [True, False, True]


def test_a_limit_between_quanta_is_rounded_down():
    assert shape([1.0, 0.0, 0.0], limit_n_m=0.0059).torque_n_m[0] == pytest.approx(0.004)


@pytest.mark.parametrize("period_s", [0.0, 0.0005, 0.05])
def test_a_period_without_room_for_a_pulse_gives_none_and_keeps_the_wish(period_s):
    pulses = shape([0.01, 0.0, -0.01], carry=(1e-5, 0.0, 0.0), period_s=period_s)
    assert not pulses.impulse_n_m_s.any()
    # exact: nothing was given
    np.testing.assert_array_equal(pulses.carry_n_m_s, [0.01 * period_s + 1e-5, 0.0, -0.01 * period_s])


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
EVERY = np.array([True, True, True])
NOTHING = np.zeros(3)
SLEW_S, SLICE_S = 450.0, 450.0
#: what quantum and shortest pulse leave, deg and deg/s: half of the shortest pulse of 2e-4 N m s about pitch
ANGLE_LEFT_DEG, RATE_LEFT_DEG_S = 0.01, 1.2e-5


def planned(attitude_deg, rates_deg_s=NOTHING, torque_n_m=NOTHING, share=1.0, allowed=EVERY, drive=CRAFT_DRIVE):
    situation = Situation(np.array(attitude_deg), np.array(rates_deg_s), allowed)
    torque = KnownTorque(np.array([torque_n_m, NOTHING, NOTHING]), 86_400.0, 0.0)
    return plan_command(GAINS, drive, situation, torque, Horizon(SLEW_S, SLICE_S, 7), Envelope(), share)


def flown(pulses, stop_s, rates_deg_s=NOTHING, torque_n_m=NOTHING):
    """Return what the spacecraft has turned and its rate, deg and deg/s, by steps of 10 ms and without exchange."""
    step_s = 0.01
    rate, angle = np.radians(rates_deg_s), np.zeros(3)
    edges = np.arange(0.0, stop_s, step_s)
    torque = np.tile(np.array(torque_n_m, dtype=np.float64), (len(edges), 1))
    for pulse in pulses:
        acting = np.clip((pulse.start_s + pulse.duration_s - edges) / step_s, 0.0, 1.0)
        acting -= np.clip((pulse.start_s - edges) / step_s, 0.0, 1.0)
        torque[:, pulse.axis] += pulse.torque_n_m * acting
    rates = rate + np.cumsum(torque, axis=0) / INERTIA.diagonal() * step_s
    return np.degrees(angle + rates.sum(axis=0) * step_s), np.degrees(rates[-1])


def test_a_slew_goes_the_law_s_way_and_ends_at_rest():
    plan = planned([0.0, 0.1, -0.1])
    turned, rate = flown(axis_pulses(plan.pulses), plan.horizon_s)
    # the share of the law's oscillator in its slow motion
    share = 1.0 - np.exp(-np.pi / 2400.0 / 0.9 * SLEW_S)
    np.testing.assert_allclose(turned, [0.0, -0.1 * share, 0.1 * share], atol=ANGLE_LEFT_DEG)
    np.testing.assert_allclose(rate, 0.0, atol=RATE_LEFT_DEG_S)
    assert not plan.is_shortened
    assert plan.horizon_s == SLEW_S + 7 * SLICE_S


def test_a_known_torque_is_balanced_until_the_horizon_and_a_rate_is_taken():
    torque, rates = np.array([-3e-7, 4e-7, 2e-7]), np.array([0.0, 1.2e-5, -8e-6])
    plan = planned(NOTHING, rates, torque)
    assert plan.horizon_s > 1500.0
    for until_s in (SLEW_S, plan.horizon_s):
        turned, rate = flown(axis_pulses(plan.pulses), until_s, rates, torque)
        np.testing.assert_allclose(turned, 0.0, atol=ANGLE_LEFT_DEG)
        np.testing.assert_allclose(rate, 0.0, atol=RATE_LEFT_DEG_S)
    idle, _ = flown((), plan.horizon_s, rates, torque)
    assert np.abs(idle).max() > 4.0 * ANGLE_LEFT_DEG


@pytest.mark.parametrize("seed", range(10))
def test_compiled_it_is_the_same_plan(seed):
    rng = np.random.default_rng(seed)
    situation = Situation(rng.uniform(-0.6, 0.6, 3), rng.uniform(-1e-4, 1e-4, 3), EVERY, 60.0)
    torque = KnownTorque(rng.uniform(-8e-7, 8e-7, (3, 3)), 86_400.0, 7_000.0)
    given = situation, torque, Horizon(SLEW_S, SLICE_S, 7), Envelope(), 0.95, rng.normal(0.0, 5.0, 3), 3600.0
    (plain, period_s), (compiled, compiled_s) = (
        run(GAINS, CRAFT_DRIVE, wheel_set(np.eye(3), 0.05, 20.0), *given) for run in (plan_allocated, compiled_plan)
    )
    for one, other in zip(plain[:3], compiled[:3], strict=True):
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-9)
    assert (compiled.is_cut, compiled_s) == (plain.is_cut, period_s)


def test_a_command_begins_where_the_spacecraft_will_be():
    later = Situation(np.array([0.0, 0.1, 0.0]), np.array([0.0, 1e-5, 0.0]), EVERY, 300.0)
    still = KnownTorque(np.zeros((3, 3)), 86_400.0, 0.0)
    plan = plan_command(GAINS, CRAFT_DRIVE, later, still, Horizon(SLEW_S, SLICE_S, 0), Envelope(), 1.0)
    there = planned([0.0, 0.103, 0.0], [0.0, 1e-5, 0.0])
    # a tick of the drive
    np.testing.assert_allclose(plan.pulses[:, 1:], there.pulses[: len(plan.pulses), 1:], atol=1e-3)


def test_an_axis_that_is_withheld_has_no_pulse():
    plan = planned([0.2] * 3, torque_n_m=(1e-7,) * 3, allowed=np.array([False, True, True]))
    assert set(plan.pulses[:, 0]) == {1, 2}


@pytest.mark.parametrize("seed", range(40))
def test_whatever_is_asked_for_the_step_lies_inside_the_envelope(seed):
    rng = np.random.default_rng(seed)
    attitude, rates, torque = rng.uniform(-0.6, 0.6, 3), rng.uniform(-1e-4, 1e-4, 3), rng.uniform(-8e-7, 8e-7, 3)
    plan = planned(attitude, rates, torque, 0.95)
    effect = predicted_effect(axis_pulses(plan.pulses), INERTIA, np.eye(3), plan.horizon_s)
    assert envelope_excesses(effect, (0.0, 0.0, 0.0), Envelope()) == ()


def test_a_large_angle_is_led_back_in_steps_and_the_horizon_becomes_shorter():
    torque = np.array([0.0, 6e-7, 0.0])
    plan = planned([0.0, 0.5, 0.0], torque_n_m=torque, share=0.95)
    assert plan.is_shortened
    turned, _ = flown(axis_pulses(plan.pulses), plan.horizon_s, torque_n_m=torque)
    assert -0.11 < turned[1] < -0.07
    assert planned(NOTHING, torque_n_m=torque, share=0.95).horizon_s > plan.horizon_s


def test_a_yaw_that_is_not_far_off_does_not_shorten_what_roll_and_pitch_are_held_for():
    calm = planned(NOTHING, torque_n_m=(1e-7,) * 3)
    plan = planned([0.29, 0.0, 0.0], [5e-5, 0.0, 0.0], (1e-7,) * 3)
    assert plan.horizon_s == calm.horizon_s
    assert plan.is_shortened


def test_a_yaw_far_off_is_led_back_although_a_torque_fills_the_envelope_of_an_hour():
    """Before: balancing 2e-6 N m for an hour left nothing to the slew, and the spacecraft went on to turn away."""
    yaw_deg, rate_deg_s, torque_n_m = 0.8, 1e-4, 2e-6
    plan = planned([yaw_deg, 0.0, 0.0], [rate_deg_s, 0.0, 0.0], (torque_n_m, 1e-7, 1e-7), 0.95)
    slew = [pulse for pulse in axis_pulses(plan.pulses) if pulse.axis == 0 and pulse.start_s < SLEW_S]
    gained_deg_s = np.degrees(sum(pulse.impulse_n_m_s for pulse in slew) / INERTIA[0, 0])
    pushed_deg_s = np.degrees(torque_n_m / INERTIA[0, 0]) * SLEW_S
    # at least the rate that the torque gives within the slew and half of what was there are taken away
    assert gained_deg_s < -(pushed_deg_s + 0.5 * rate_deg_s)


def test_a_drive_without_steps_gives_long_weak_pulses_that_do_not_overlap():
    fine = CRAFT_DRIVE._replace(quantum_n_m=5e-8)
    plan = planned([0.1, 0.1, -0.1], torque_n_m=(2e-7, -4e-7, 3e-7), drive=fine)
    predicted_effect(axis_pulses(plan.pulses), INERTIA, np.eye(3), plan.horizon_s)
    assert np.abs(plan.pulses[:, 3]).max() <= 0.05


@pytest.mark.parametrize("torque", [np.nan, np.inf])
def test_a_torque_that_is_not_finite_is_refused(torque):
    with np.errstate(invalid="ignore"):
        assert np.isnan(planned([0.0, 0.1, -0.1], torque_n_m=(0.0, torque, 0.0)).horizon_s)


@pytest.mark.parametrize("angles", [[np.nan, 0.1, 0.0], [0.0, 0.1, np.nan]])
def test_angles_that_are_none_are_refused(angles):
    assert np.isnan(planned(angles).horizon_s)


REST = (0.0, 0.0, 0.0)


def effect_of(pulses, horizon_s=900.0):
    return predicted_effect(pulses, INERTIA, np.eye(3), horizon_s)


def test_each_slew_carries_the_pulse_that_nulls_its_rate():
    pulses = plan_slew([0.0, 0.08, 0.0], REST, INERTIA, 900.0, CRAFT_DRIVE)
    first, second = pulses
    assert first.torque_n_m == -second.torque_n_m == 0.002
    assert first.duration_s == second.duration_s
    found = effect_of(pulses)
    assert found.angle_change_deg[1] == pytest.approx(0.08, rel=1e-12)
    assert found.rate_change_deg_s == REST
    assert found.impulse_n_m_s == REST
    assert found.gross_impulse_n_m_s[1] == pytest.approx(2.0 * 0.002 * first.duration_s)


def test_a_rate_alone_is_taken_by_one_pulse_at_once():
    pulses = plan_slew(REST, [0.0, 2e-5, 0.0], INERTIA, 900.0, CRAFT_DRIVE)
    assert [(pulse.axis, pulse.start_s) for pulse in pulses] == [(1, 0.0)]
    # one tick of one quantum: 2e-6 N m s of 2600 kg m^2
    assert effect_of(pulses).rate_change_deg_s[1] == pytest.approx(-2e-5, abs=5e-8)


def test_a_wish_below_the_shortest_pulse_is_left_out():
    assert plan_slew([0.0, 1e-4, 0.0], REST, INERTIA, 900.0, CRAFT_DRIVE) == ()


@pytest.mark.parametrize(
    ("wanted", "drive", "horizon_s", "message"),
    [
        ([0.0, 5.0, 0.0], CRAFT_DRIVE, 60.0, "allow the slew more time"),
        ([0.0, 0.1, 0.0], Drive(0.001, 0.002, 0.1, 0.001), 900.0, "quantum"),
        ([0.0, 0.1, 0.0], Drive(0.05, 0.002, 0.1, 0.0), 900.0, "positive"),
        ([0.0, 0.1, 0.0], CRAFT_DRIVE, 0.2, "no room"),
        ([0.0, 0.1, 0.0], CRAFT_DRIVE, float("nan"), "finite"),
        ([0.0, float("nan"), 0.0], CRAFT_DRIVE, 900.0, "three finite"),
        ([0.1, 0.1], CRAFT_DRIVE, 900.0, "three finite"),
    ],
)
def test_a_slew_that_cannot_be_is_refused(wanted, drive, horizon_s, message):
    with pytest.raises(ValueError, match=message):
        plan_slew(wanted, REST, INERTIA, horizon_s, drive)


def test_the_way_counts_as_well_as_the_end():
    """Out and back: no angle is left, but it was there."""
    turns = ((0.0, 0.012), (400.0, -0.024), (800.0, 0.012))
    pulses = tuple(AxisPulse(1, start_s, 2.0, torque) for start_s, torque in turns)
    found = effect_of(pulses)
    assert found.angle_change_deg[1] == pytest.approx(0.0, abs=1e-12)
    # 0.024 N m s of 2600 kg m^2 for 400 s, less a quarter of the pulse in whose middle the spacecraft turns back
    assert found.peak_angle_deg[1] == pytest.approx(np.degrees(0.024 / 2600.0 * 399.5), rel=1e-9)
    quantities = [each.quantity for each in envelope_excesses(found, REST, Envelope())]
    assert quantities == ["angle_change_deg", "rate_change_deg_s", "impulse_n_m_s"]


def test_an_angle_that_turns_back_inside_a_pulse_is_found():
    found = predicted_effect((AxisPulse(1, 0.0, 10.0, 0.01), AxisPulse(1, 10.0, 30.0, -0.01)), INERTIA, np.eye(3), 40.0)
    # v^2/a with v = a * 10 s: half of it on the way up, half until it stands
    assert found.peak_angle_deg[1] == pytest.approx(-np.degrees(0.01 / 2600.0 * 100.0), rel=1e-12)
    assert found.angle_change_deg[1] == pytest.approx(-np.degrees(0.01 / 2600.0 * 100.0), rel=1e-12)


def test_predicted_angles_are_those_of_a_rigid_body_under_constant_pulses():
    pulses = (AxisPulse(1, 60.0, 100.0, 0.02), AxisPulse(2, 200.0, 50.0, -0.01), AxisPulse(1, 500.0, 100.0, -0.02))
    coupled = INERTIA + 40.0 * np.eye(3)[[1, 0, 2]]
    at_s, angles_deg = predicted_angles(pulses, coupled, 900.0, 61)
    assert at_s.tolist() == pytest.approx([15.0 * k for k in range(61)])
    acceleration = np.linalg.inv(coupled)
    expected = np.zeros((61, 3))
    for pulse in pulses:
        # at²/2 while a pulse lasts, then its rate from its middle on
        pushed_s = np.clip(at_s - pulse.start_s, 0.0, pulse.duration_s)
        sailed_s = np.maximum(at_s - pulse.stop_s, 0.0)
        twice_s2 = pushed_s**2 + 2.0 * pulse.duration_s * sailed_s
        expected += 0.5 * pulse.torque_n_m * twice_s2[:, None] * acceleration[:, pulse.axis]
    np.testing.assert_allclose(angles_deg, np.degrees(expected), rtol=1e-9, atol=1e-15)
    assert angles_deg[:5].tolist() == [[0.0] * 3] * 5
    assert predicted_effect(pulses, coupled, np.eye(3), 900.0).angle_change_deg == pytest.approx(tuple(angles_deg[-1]))


@pytest.mark.parametrize(
    ("pulses", "message"),
    [
        ((AxisPulse(0, 0.0, 5.0, 0.01), AxisPulse(0, 4.0, 1.0, 0.01)), "about yaw overlap"),
        ((AxisPulse(0, 899.0, 5.0, 0.01),), "after the horizon"),
        ((AxisPulse(0, -1.0, 5.0, 0.01),), "before the schedule"),
        ((AxisPulse(0, 0.0, float("nan"), 0.01),), "finite"),
    ],
)
def test_schedules_that_make_no_sense_are_refused(pulses, message):
    with pytest.raises(ValueError, match=message):
        effect_of(pulses)


def test_what_was_sent_within_the_hour_counts():
    found = effect_of(plan_slew([0.0, 0.08, 0.0], REST, INERTIA, 900.0, CRAFT_DRIVE))
    assert envelope_excesses(found, (0.0, 0.085, 0.0), Envelope()) == ()
    (excess,) = envelope_excesses(found, (0.0, 0.095, 0.0), Envelope())
    assert str(excess).startswith("roll impulse_an_hour_n_m_s 0.1")


def test_what_is_no_number_is_beyond_every_limit():
    found = effect_of(plan_slew([0.0, 0.02, 0.0], REST, INERTIA, 900.0, CRAFT_DRIVE))
    broken = found._replace(peak_angle_deg=(0.0, float("nan"), 0.0))
    assert [each.quantity for each in envelope_excesses(broken, REST, Envelope())] == ["angle_change_deg"]


def test_an_envelope_is_compared_limit_by_limit():
    assert Envelope(angle_change_deg=0.05).is_within(Envelope())
    assert not Envelope(angle_change_deg=0.3).is_within(Envelope())
    assert not Envelope(impulse_n_m_s=0.0).is_within(Envelope())
    assert not Envelope(impulse_n_m_s=float("nan")).is_within(Envelope())


BODY_INERTIA = np.diag([2600.0, 1400.0, 2600.0])
SLOW_GAINS = loop_gains(BODY_INERTIA, period_s=7200.0, damping=0.9, torque_limit_n_m=0.05, command_period_s=600.0)
COUPLING = GEOSTATIONARY_RATE_RAD_S * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
#: what a feed-forward of 95 % leaves of the pressure of the Sun, N m, about yaw, roll, pitch
LEFT_N_M = np.array([3e-7, -5e-7, 4e-7])


def fly(start_deg, horizon_s, periods, sigma_deg, disturbance_n_m=LEFT_N_M):
    """Return angles (K, 3), deg, at the beginning of each command period, and what was sent, N m s."""
    rng = np.random.default_rng(20261122)
    tensor = inertia_about_angles(BODY_INERTIA)
    angle, inertial = np.radians(start_deg), -COUPLING @ np.radians(start_deg)
    track, sent = [], []
    for _ in range(periods):
        track.append(np.degrees(angle))
        seen_deg = np.degrees(angle) + rng.normal(size=3) * sigma_deg
        rate_deg_s = np.degrees(COUPLING @ angle + inertial)
        request = tracking_request(SLOW_GAINS, seen_deg, rate_deg_s, horizon_s)
        change_deg, rate_deg_s = np.degrees(request)
        pulses = plan_slew(change_deg, rate_deg_s, tensor, horizon_s, CRAFT_DRIVE)
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
