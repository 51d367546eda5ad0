"""What holds for every wish, carry and drive: impulse is conserved, limits hold, nothing winds up."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from service.core.control.pulses import shape_pulses
from service.core.control.wheels import allocate_to_wheels, body_torque_limit_n_m

WISHES = st.lists(st.floats(-0.2, 0.2), min_size=3, max_size=3).map(np.array)
CARRIES = st.lists(st.floats(-0.5, 0.5), min_size=3, max_size=3).map(np.array)
DRIVES = st.fixed_dictionaries(
    {
        "period_s": st.floats(0.5, 900.0),
        "limit_n_m": st.floats(0.004, 0.2),
        "quantum_n_m": st.floats(1e-4, 0.004),
        "min_pulse_s": st.sampled_from([0.05, 0.1, 1.0]),
        "time_step_s": st.sampled_from([0.001, 0.01]),
    }
)
AXES = (
    st.lists(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), min_size=3, max_size=6)
    .map(np.array)
    # catalogue rule: no direction may need more than twenty times the torque
    .filter(lambda axes: (np.linalg.norm(axes, axis=1) > 0.1).all())
    .filter(lambda a: np.linalg.svd(a / np.linalg.norm(a, axis=1, keepdims=True), compute_uv=False)[-1] > 0.05)
)


@given(WISHES, CARRIES, DRIVES)
def test_impulse_and_carry_are_conserved_or_the_wish_is_saturated_and_dropped(wish, carry, drive):
    pulses = shape_pulses(wish, carry, **drive)
    wanted = wish * drive["period_s"] + carry
    left = np.where(pulses.is_saturated, 0.0, wanted - pulses.impulse_n_m_s)
    # rounding of three products, relative to the size of the impulse
    np.testing.assert_allclose(pulses.carry_n_m_s, left, atol=1e-12 * (1.0 + np.abs(wanted).max()))
    # a pulse goes the way of the wish, and never beyond it but by rounding
    assert (pulses.impulse_n_m_s * wanted >= 0.0).all()
    assert (np.abs(pulses.impulse_n_m_s) <= np.abs(wanted) * (1.0 + 1e-9)).all()


@given(WISHES, CARRIES, DRIVES)
def test_pulses_keep_to_limit_quantum_grid_and_period(wish, carry, drive):
    pulses = shape_pulses(wish, carry, **drive)
    steps = pulses.torque_n_m / drive["quantum_n_m"]
    ticks = pulses.duration_s / drive["time_step_s"]
    # products and quotients of doubles: 1e-9 of a step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(ticks, np.round(ticks), rtol=1e-9)
    assert (np.abs(pulses.torque_n_m) <= drive["limit_n_m"] * (1.0 + 1e-9)).all()
    assert (pulses.duration_s <= drive["period_s"] * (1.0 + 1e-9)).all()
    is_given = pulses.duration_s > 0.0
    assert (pulses.duration_s[is_given] >= drive["min_pulse_s"]).all()
    np.testing.assert_array_equal(is_given, pulses.torque_n_m != 0.0)


@given(WISHES, DRIVES)
def test_the_carry_never_winds_up(wish, drive):
    """Whatever is wanted for however long, the carry stays below what one period at the limit can give."""
    carry = np.zeros(3)
    most = drive["limit_n_m"] * drive["period_s"]
    for _ in range(40):
        carry = shape_pulses(wish, carry, **drive).carry_n_m_s
        assert (np.abs(carry) <= most * (1.0 + 1e-9)).all()


@given(st.floats(-2e-5, 2e-5))
def test_the_mean_torque_of_many_periods_is_the_wanted_one(torque_n_m):
    """First-order sigma-delta: after n periods the error is one carry, below one shortest pulse and one tick."""
    wish, carry, given_n_m_s = np.full(3, torque_n_m), np.zeros(3), np.zeros(3)
    for _ in range(200):
        pulses = shape_pulses(
            wish, carry, period_s=60.0, limit_n_m=0.05, quantum_n_m=0.002, min_pulse_s=0.1, time_step_s=0.001
        )
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
