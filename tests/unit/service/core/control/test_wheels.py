"""Wheel allocation: signs, least norm, and the limit that keeps every wheel within its own."""

from itertools import product

import numpy as np
import pytest

from service.core.control.wheels import allocate_to_wheels, body_torque_limit_n_m

PYRAMID = np.array([[1.0, 0, 1], [-1, 0, 1], [0, 1, 1], [0, -1, 1]])
SKEWED = np.array([[1.0, 0, 0], [1, 1, 0], [0, 1, 2]])


def test_a_wheel_turns_the_body_the_other_way():
    np.testing.assert_array_equal(allocate_to_wheels(np.eye(3), np.array([0.01, 0.0, 0.0])), [-0.01, 0.0, 0.0])


def test_zero_is_plain_zero():
    assert not np.signbit(allocate_to_wheels(np.eye(3), np.zeros(3))).any()


def test_four_wheels_share_with_the_least_norm():
    wheels = allocate_to_wheels(PYRAMID, np.array([0.0, 0.0, 0.04]))
    # by symmetry all four alike: 4 w cos 45 deg = 0.04
    np.testing.assert_allclose(wheels, -0.01 * np.sqrt(2.0), rtol=1e-12)


def test_the_length_of_an_axis_does_not_matter():
    torque = np.array([[0.01, -0.02, 0.03], [0.0, 0.01, 0.0]])
    found = allocate_to_wheels(7.0 * PYRAMID, torque)
    assert found.shape == (2, 4)
    np.testing.assert_allclose(found, allocate_to_wheels(PYRAMID, torque), rtol=1e-12)  # rounding of the norm


@pytest.mark.parametrize("axes", [np.eye(3), PYRAMID, SKEWED], ids=["orthogonal", "pyramid", "skewed"])
def test_at_the_body_limit_the_hardest_worked_wheel_is_at_its_own(axes):
    limit = body_torque_limit_n_m(axes, 0.05)
    signs = limit * np.array(list(product((-1.0, 1.0), repeat=3)))
    # rounding of the pseudo-inverse
    assert np.abs(allocate_to_wheels(axes, signs)).max() == pytest.approx(0.05, rel=1e-12)
