"""Allocation within limits: direction kept, momentum honoured, no wheel near zero speed, singular sets refused."""

import numpy as np
import pytest

from service.core.control.wheel_allocation import allocate, wheel_set

PYRAMID = np.array([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]])


def test_within_the_limits_the_body_gets_what_was_wanted():
    found = allocate(wheel_set(PYRAMID, 0.05, 20.0), [0.01, -0.02, 0.015], np.zeros(4), 60.0)
    assert (found.share, found.limited_by) == (1.0, None)
    assert not found.null_n_m.any()
    np.testing.assert_allclose(found.torque_n_m, [0.01, -0.02, 0.015])


def test_a_torque_limit_scales_all_wheels_alike():
    found = allocate(wheel_set(np.eye(3), 0.05, 20.0), [0.1, 0.02, 0.0], np.zeros(3), 10.0)
    assert found.share == 0.5
    assert found.limited_by == (0, "torque")
    np.testing.assert_allclose(found.torque_n_m, [0.05, 0.01, 0.0])


def test_a_full_wheel_takes_no_more_but_gives_back():
    wheels = wheel_set(np.eye(3), 0.05, 20.0)
    # torque about yaw turns its wheel the other way
    full = allocate(wheels, [-0.01, 0.01, 0.0], np.array([20.0, 0.0, 0.0]), 60.0)
    assert (full.share, full.limited_by) == (0.0, (0, "momentum"))
    beyond = allocate(wheels, [0.01, 0.01, 0.0], np.array([21.0, 0.0, 0.0]), 60.0)
    assert beyond.share == 1.0
    assert beyond.momentum_n_m_s[0] == pytest.approx(20.4)


def test_null_motion_turns_nothing_and_leaves_no_wheel_near_zero_speed():
    wheels = wheel_set(PYRAMID, 0.05, 20.0, least_momentum_n_m_s=1.0)
    momentum = np.array([0.2, 4.0, 3.0, 5.0])
    found = allocate(wheels, [0.001, 0.0, 0.0], momentum, 100.0)
    np.testing.assert_allclose(-found.wheels_n_m @ wheels.axes, [0.001, 0.0, 0.0], atol=1e-15)
    assert np.abs(found.momentum_n_m_s).min() >= 1.0 - 1e-9
    # where no wheel is slow there is none
    assert not allocate(wheels, [0.001, 0.0, 0.0], np.full(4, 5.0), 100.0).null_n_m.any()


def test_null_motion_gets_only_the_room_that_is_left():
    wheels = wheel_set(PYRAMID, 0.05, 20.0, least_momentum_n_m_s=1.0)
    found = allocate(wheels, [0.0, 0.0, 0.13], np.array([0.2, 4.0, 3.0, 5.0]), 10.0)
    assert np.abs(found.wheels_n_m).max() <= 0.05 * (1.0 + 1e-12)
    np.testing.assert_allclose(-found.wheels_n_m @ wheels.axes, [0.0, 0.0, 0.13], atol=1e-15)


@pytest.mark.parametrize(
    ("axes", "message"),
    [
        ([[1, 0, 0], [0, 1, 0], [1, 1, 0]], "singular: about the direction.*pitch [+-]1.00"),
        ([[1, 0, 0], [0, 1, 0], [0, 1, 0.04]], "singular"),
        ([[1, 0, 0], [0, 1, 0]], "three wheels"),
        ([[1, 0, 0], [0, 0, 0], [0, 0, 1]], "wheel 2 has no direction"),
        ([[1, 0, float("nan")], [0, 1, 0], [0, 0, 1]], "finite"),
    ],
)
def test_sets_that_cannot_control_are_refused(axes, message):
    with pytest.raises(ValueError, match=message):
        wheel_set(axes, 0.05, 20.0)


@pytest.mark.parametrize(
    "limits", [(0.0, 20.0, 0.0), (0.05, float("inf"), 0.0), (0.05, 20.0, 20.0), (0.05, 20.0, -1.0)]
)
def test_limits_that_contradict_are_refused(limits):
    with pytest.raises(ValueError, match=r"limit|momentum"):
        wheel_set(np.eye(3), *limits)


@pytest.mark.parametrize(
    ("torque", "momentum", "duration_s", "message"),
    [
        ([0.0, float("nan"), 0.0], [0.0] * 3, 1.0, "finite"),
        ([0.0] * 3, [0.0] * 4, 1.0, "3 momenta"),
        ([0.0] * 3, [0.0] * 3, 0.0, "positive"),
    ],
)
def test_numbers_that_make_no_sense_are_refused(torque, momentum, duration_s, message):
    with pytest.raises(ValueError, match=message):
        allocate(wheel_set(np.eye(3), 0.05, 20.0), torque, momentum, duration_s)
