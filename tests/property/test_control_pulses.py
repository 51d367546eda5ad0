"""Pulses, slews and flown craft."""

import json
import math
from contextlib import suppress

import numpy as np
from example_counts import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from analyzer_sim.epochs import rfc3339
from analyzer_sim.plant.plant import ScheduleError, parse_schedule
from analyzer_sim.world.spacecraft.body import INERTIA_KG_M2, QUANTUM_N_M, TorqueElement, spacecraft_at_rest
from analyzer_sim.world.spacecraft.body import wheel_set as simulated_wheels
from service.core.control.slew_schedule import Drive, plan_slew, predicted_effect, shape_pulses
from service.core.control.wheel_allocation import allocate, allocate_to_wheels, body_torque_limit_n_m, wheel_set

WISHES = st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3).map(np.array)
CARRIES = st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3).map(np.array)
PERIODS = st.floats(0.5, 900.0)
DRIVES = st.builds(
    Drive,
    st.floats(0.004, 0.2),
    st.floats(1e-4, 0.004),
    st.sampled_from([0.05, 0.1, 1.0]),
    st.sampled_from([0.001, 0.01]),
)


def wheel_axes(least):
    """Return axes of wheels; catalogue rule: no direction may need more than twenty times the torque."""

    def is_spread(axes):
        length = np.linalg.norm(axes, axis=1, keepdims=True)
        return (length > 0.1).all() and np.linalg.svd(axes / length, compute_uv=False)[-1] > least

    axis = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3)
    return st.lists(axis, min_size=3, max_size=6).map(np.array).filter(is_spread)


AXES = wheel_axes(0.05)


@given(WISHES, CARRIES, PERIODS, DRIVES)
def test_impulse_and_carry_are_conserved_or_the_wish_is_saturated_and_dropped(wish, carry, period_s, drive):
    pulses = shape_pulses(wish, carry, period_s, drive)
    wanted = wish * period_s + carry
    left = np.where(pulses.is_saturated, 0.0, wanted - pulses.impulse_n_m_s)
    # rounding of three products, relative to the size of the impulse
    np.testing.assert_allclose(pulses.carry_n_m_s, left, atol=1e-12 * (1.0 + np.abs(wanted).max()))
    # a pulse goes the way of the wish, and never beyond it but by rounding
    assert (pulses.impulse_n_m_s * wanted >= 0.0).all()
    assert (np.abs(pulses.impulse_n_m_s) <= np.abs(wanted) * (1.0 + 1e-9)).all()


@given(WISHES, CARRIES, PERIODS, DRIVES)
def test_pulses_keep_to_limit_quantum_grid_and_period(wish, carry, period_s, drive):
    pulses = shape_pulses(wish, carry, period_s, drive)
    steps = pulses.torque_n_m / drive.quantum_n_m
    ticks = pulses.duration_s / drive.time_step_s
    # products and quotients of doubles: 1e-9 of a step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(ticks, np.round(ticks), rtol=1e-9)
    assert (np.abs(pulses.torque_n_m) <= drive.limit_n_m * (1.0 + 1e-9)).all()
    assert (pulses.duration_s <= period_s * (1.0 + 1e-9)).all()
    is_given = pulses.duration_s > 0.0
    assert (pulses.duration_s[is_given] >= drive.min_pulse_s).all()
    np.testing.assert_array_equal(is_given, pulses.torque_n_m != 0.0)


@given(WISHES, PERIODS, DRIVES)
def test_the_carry_never_winds_up(wish, period_s, drive):
    """Whatever is wanted for however long, the carry stays below what one period at the limit can give."""
    carry = np.zeros(3)
    most = drive.limit_n_m * period_s
    for _ in range(40):
        carry = shape_pulses(wish, carry, period_s, drive).carry_n_m_s
        assert (np.abs(carry) <= most * (1.0 + 1e-9)).all()


@given(st.floats(-2e-5, 2e-5))
def test_the_mean_torque_of_many_periods_is_the_wanted_one(torque_n_m):
    """First-order sigma-delta: after n periods the error is one carry, below one shortest pulse and one tick."""
    wish, carry, given_n_m_s = np.full(3, torque_n_m), np.zeros(3), np.zeros(3)
    for _ in range(200):
        pulses = shape_pulses(wish, carry, 60.0, Drive(0.05, 0.002, 0.1, 0.001))
        carry, given_n_m_s = pulses.carry_n_m_s, given_n_m_s + pulses.impulse_n_m_s
    np.testing.assert_allclose(given_n_m_s, 200 * 60.0 * torque_n_m, atol=0.002 * 0.1 + 1e-9)


@given(AXES, WISHES)
def test_allocation_reproduces_the_body_torque(axes, torque):
    unit = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    wheels = allocate_to_wheels(axes, torque)
    # condition number of the axes is at most 50 by the filter
    np.testing.assert_allclose(-wheels @ unit, torque, atol=1e-12)
    # least norm: no part along what turns nothing
    null = np.linalg.svd(unit.T)[2][3:]
    np.testing.assert_allclose(null @ wheels, 0.0, atol=1e-12)


@given(AXES, st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array))
def test_within_the_body_limit_no_wheel_exceeds_its_own(axes, share):
    torque = share * body_torque_limit_n_m(axes, 0.05)
    # rounding of the pseudo-inverse
    assert np.abs(allocate_to_wheels(axes, torque)).max() <= 0.05 * (1.0 + 1e-9)


ANGLES = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)
RATES = st.lists(st.floats(-5e-5, 5e-5), min_size=3, max_size=3)
SLEW_DRIVES = st.builds(Drive, st.floats(0.02, 0.2), st.floats(5e-4, 4e-3), st.sampled_from([0.1, 0.5]), st.just(0.001))
#: with products of inertia; always a body's: diagonal plus a small symmetric part
TENSORS = st.lists(st.floats(-60.0, 60.0), min_size=3, max_size=3).map(
    lambda p: np.diag([2600.0, 2500.0, 1400.0]) + np.array([[0.0, p[0], p[1]], [p[0], 0.0, p[2]], [p[1], p[2], 0.0]])
)


@settings(max_examples=examples(60))
@given(ANGLES, RATES, SLEW_DRIVES, TENSORS, st.floats(600.0, 3600.0))
def test_a_slew_leaves_no_rate_and_keeps_to_drive_and_horizon(angles, rates, drive, tensor, horizon_s):
    pulses = plan_slew(angles, rates, tensor, horizon_s, drive)
    effect = predicted_effect(pulses, tensor, np.eye(3), horizon_s)
    for pulse in pulses:
        steps, ticks = pulse.torque_n_m / drive.quantum_n_m, pulse.duration_s / drive.time_step_s
        assert abs(steps - round(steps)) < 1e-9
        assert abs(ticks - round(ticks)) < 1e-6
        assert abs(pulse.torque_n_m) <= drive.limit_n_m * (1.0 + 1e-9)
        assert pulse.duration_s >= drive.min_pulse_s * (1.0 - 1e-9)
        assert pulse.stop_s <= horizon_s * (1.0 + 1e-9)
    left = tensor @ np.radians(np.add(rates, effect.rate_change_deg_s))
    # half of the shortest pulse is left out, otherwise a tick of the strongest pulse
    strongest = max((abs(pulse.torque_n_m) for pulse in pulses), default=0.0)
    assert np.abs(left).max() <= drive.quantum_n_m * drive.min_pulse_s + strongest * drive.time_step_s


@settings(max_examples=examples(60))
@given(ANGLES, SLEW_DRIVES, st.floats(600.0, 3600.0))
def test_from_rest_the_angle_is_met_or_too_small_for_a_pulse(angles, drive, horizon_s):
    tensor = np.diag([2600.0, 2600.0, 1400.0])
    pulses = plan_slew(angles, [0.0] * 3, tensor, horizon_s, drive)
    effect = predicted_effect(pulses, tensor, np.eye(3), horizon_s)
    for axis, wanted in enumerate(angles):
        if any(pulse.axis == axis for pulse in pulses):
            # both pulses are the same, so the time between them settles the angle to rounding
            assert abs(effect.angle_change_deg[axis] - wanted) < 1e-9
            assert effect.rate_change_deg_s[axis] == 0.0
        else:
            least = 0.5 * drive.quantum_n_m * drive.min_pulse_s / tensor[axis, axis] * horizon_s
            assert abs(np.radians(wanted)) <= least * 1.1


@settings(max_examples=examples(25))
@given(ANGLES, RATES, TENSORS)
def test_the_predicted_effect_is_what_a_craft_flies(angles, rates, tensor):
    """Flown step by step, a tenth of a second each."""
    drive, horizon_s, step_s = Drive(0.05, 0.002, 0.1, 0.1), 300.0, 0.1
    try:
        pulses = plan_slew(angles, rates, tensor, horizon_s, drive)
    except ValueError:
        assume(False)
    # on the grid of the flight
    pulses = tuple(pulse._replace(start_s=round(pulse.start_s, 1)) for pulse in pulses)
    effect = predicted_effect(pulses, tensor, np.eye(3), horizon_s + step_s)
    times = np.arange(0, round((horizon_s + step_s) / step_s)) * step_s
    torque = np.zeros((len(times), 3))
    for pulse in pulses:
        torque[(times >= pulse.start_s - 1e-6) & (times < pulse.stop_s - 1e-6), pulse.axis] += pulse.torque_n_m
    acceleration = np.linalg.solve(tensor, torque.T).T
    rate = np.vstack([np.zeros(3), np.cumsum(acceleration * step_s, axis=0)])
    angle = np.vstack([np.zeros(3), np.cumsum((rate[:-1] + 0.5 * acceleration * step_s) * step_s, axis=0)])
    np.testing.assert_allclose(effect.angle_change_deg, np.degrees(angle[-1]), atol=1e-9)
    np.testing.assert_allclose(effect.rate_change_deg_s, np.degrees(rate[-1]), atol=1e-12)
    # the flight sees the top of a parabola within a step
    np.testing.assert_allclose(np.abs(effect.peak_angle_deg), np.degrees(np.abs(angle).max(axis=0)), atol=1e-4)
    np.testing.assert_allclose(np.abs(effect.peak_rate_deg_s), np.degrees(np.abs(rate).max(axis=0)), atol=1e-9)


@settings(max_examples=examples(150))
@given(wheel_axes(0.06), st.data(), st.floats(1.0, 300.0), st.sampled_from([0.0, 0.5, 2.0]))
def test_allocation_keeps_direction_and_every_limit(axes, data, duration_s, least):
    wheels = wheel_set(axes, 0.05, 20.0, least)
    torque = np.array(data.draw(st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)))
    momentum = np.array(data.draw(st.lists(st.floats(-22.0, 22.0), min_size=len(axes), max_size=len(axes))))
    found = allocate(wheels, torque, momentum, duration_s)
    assert 0.0 <= found.share <= 1.0
    # null motion turns nothing; condition of the axes is below 20
    np.testing.assert_allclose(-found.wheels_n_m @ wheels.axes, found.share * torque, atol=1e-12)
    assert np.abs(found.wheels_n_m).max() <= 0.05 * (1.0 + 1e-9)
    # a wheel ends within its limit, or no further out than it began
    ending = momentum + found.wheels_n_m * duration_s
    assert (np.abs(ending) <= np.maximum(20.0, np.abs(momentum)) + 1e-9).all()
    # null motion never makes the slowest wheel slower than it would be
    plain = momentum + (found.wheels_n_m - found.null_n_m) * duration_s
    if found.null_n_m.any() and np.abs(ending).min() < least - 1e-9:
        assert np.abs(plain).min() < least


S = 1_000_000
STILL = (0.0, 0.0, 0.0)
MOMENTUM = (1.2, -8.0, 0.6)

torques = st.tuples(*[st.integers(-4, 4).map(lambda steps: steps * QUANTUM_N_M)] * 3)
pulses = st.builds(
    lambda start, duration, torque: TorqueElement(start * S, (start + duration) * S, torque),
    st.integers(0, 200),
    st.integers(1, 8),
    torques,
)


def flown(schedule):
    """Return the attitude after five minutes, deg."""
    subject = spacecraft_at_rest(INERTIA_KG_M2, STILL, simulated_wheels(1, MOMENTUM))
    subject.fly((0, 300 * S), schedule, STILL, STILL, STILL)
    return np.array(subject.state.attitude_deg)


@settings(max_examples=examples(20), deadline=None)
@given(st.lists(pulses, max_size=3))
def test_mirrored_commands_mirror_the_motion(schedule):
    mirrored = [
        TorqueElement(e.start_us, e.stop_us, (-e.torque_n_m[0], -e.torque_n_m[1], -e.torque_n_m[2])) for e in schedule
    ]
    still = flown([])
    there, back = flown(schedule) - still, flown(mirrored) - still
    # beside the ripple of the drives, some 1e-4 deg, and products of the angles
    size = float(np.abs(there).max())
    np.testing.assert_allclose(there, -back, atol=1e-3 + 0.02 * size**2 + 1e-3 * size)


@settings(max_examples=examples(20), deadline=None)
@given(st.lists(pulses, max_size=3))
def test_a_command_is_stored_in_the_wheels(schedule):
    subject = spacecraft_at_rest(INERTIA_KG_M2, STILL, simulated_wheels(1, STILL))
    subject.orbital_rate_rad_s = 0.0
    subject.motion = subject.motion._replace(rate_y=0.0)
    subject.fly((0, 300 * S), schedule, STILL, STILL, STILL)
    stored = np.array([wheel.momentum_n_m_s for wheel in subject.wheels])
    body = np.array(INERTIA_KG_M2) * subject.motion.rate_rad_s
    # from rest without a torque from outside the whole is zero, to the product of momentum and angle
    size = float(np.abs(stored).max())
    np.testing.assert_allclose(body + stored, 0.0, atol=1e-9 + 0.02 * size)


NOW_US = 1_793_491_200_000_000

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8)
documents = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4)
)
starts = st.integers(NOW_US - 10**7, NOW_US + 10**9).map(rfc3339) | scalars
elements = st.fixed_dictionaries(
    {
        "start": starts,
        "duration_s": st.floats(-1.0, 1e5) | scalars,
        **{f"{axis}_n_m": st.floats(-0.06, 0.06) | scalars for axis in ("roll", "pitch", "yaw")},
    }
)
schedules = st.fixed_dictionaries({"schedule": st.lists(elements | documents, max_size=4)})


@given(st.text() | documents.map(json.dumps) | schedules.map(json.dumps))
def test_a_line_is_a_schedule_or_is_refused(text):
    flown = ()
    with suppress(ScheduleError):
        flown = parse_schedule(text, NOW_US).elements
    for element in flown:
        assert NOW_US <= element.start_us < element.stop_us
        assert all(math.isfinite(torque) and abs(torque) <= 0.05 for torque in element.torque_n_m)
