"""What holds for every slew, drive and set of wheels: effects as flown, limits kept, no rate left."""

import numpy as np
from example_counts import examples
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from service.core.control.slew_schedule import Drive, plan_slew, predicted_effect
from service.core.control.wheel_allocation import allocate, wheel_set

ANGLES = st.lists(st.floats(-0.3, 0.3), min_size=3, max_size=3)
RATES = st.lists(st.floats(-5e-5, 5e-5), min_size=3, max_size=3)
DRIVES = st.builds(Drive, st.floats(0.02, 0.2), st.floats(5e-4, 4e-3), st.sampled_from([0.1, 0.5]), st.just(0.001))
#: with products of inertia; always a body's: diagonal plus a small symmetric part
TENSORS = st.lists(st.floats(-60.0, 60.0), min_size=3, max_size=3).map(
    lambda p: np.diag([2600.0, 2500.0, 1400.0]) + np.array([[0.0, p[0], p[1]], [p[0], 0.0, p[2]], [p[1], p[2], 0.0]])
)


@settings(max_examples=examples(60))
@given(ANGLES, RATES, DRIVES, TENSORS, st.floats(600.0, 3600.0))
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
@given(ANGLES, DRIVES, st.floats(600.0, 3600.0))
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


AXES = (
    st.lists(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), min_size=3, max_size=6)
    .map(np.array)
    .filter(lambda axes: (np.linalg.norm(axes, axis=1) > 0.1).all())
    .filter(lambda a: np.linalg.svd(a / np.linalg.norm(a, axis=1, keepdims=True), compute_uv=False)[-1] > 0.06)
)


@settings(max_examples=examples(150))
@given(AXES, st.data(), st.floats(1.0, 300.0), st.sampled_from([0.0, 0.5, 2.0]))
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
    assert (np.abs(found.momentum_n_m_s) <= np.maximum(20.0, np.abs(momentum)) + 1e-9).all()
    # null motion never makes the slowest wheel slower than it would be
    plain = momentum + (found.wheels_n_m - found.null_n_m) * duration_s
    if found.null_n_m.any() and np.abs(found.momentum_n_m_s).min() < least - 1e-9:
        assert np.abs(plain).min() < least
