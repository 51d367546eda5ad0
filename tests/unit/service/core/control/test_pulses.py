"""Pulses: edges of the drive; what holds for every input is in the property tests."""

import numpy as np
import pytest

from service.core.control.pulses import shape_pulses

DRIVE = {"period_s": 60.0, "limit_n_m": 0.05, "quantum_n_m": 0.002, "min_pulse_s": 0.1, "time_step_s": 0.001}


def shape(torque, carry=(0.0, 0.0, 0.0), **changes):
    return shape_pulses(np.array(torque), np.array(carry), **{**DRIVE, **changes})


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
