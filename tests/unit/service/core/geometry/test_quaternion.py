"""Quaternions, pinned by a published message and by rotation matrices written out here."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from service.core.geometry.frames import body_from_nadir
from service.core.geometry.quaternion import (
    attitude_of_quaternion,
    matrix_of_quaternion,
    quaternion_of_attitude,
    quaternion_of_matrix,
    with_continuous_sign,
)


def _frame_rotation(axis: int, angle_deg: float) -> NDArray[np.float64]:
    """Return the matrix that changes vectors into a frame turned about one of its axes."""
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    matrix = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    matrix[j, j] = matrix[k, k] = cosine
    matrix[j, k], matrix[k, j] = sine, -sine
    return matrix


def test_golden_vector_of_a_flown_message() -> None:
    # A message of the Magnetospheric Multiscale mission gives the same attitude as ZXZ angles and as a quaternion.
    matrix = _frame_rotation(2, -144.066452) @ _frame_rotation(0, 25.098268) @ _frame_rotation(2, 5.798977)
    golden = np.array([0.056482, 0.209807, -0.912091, 0.347679])
    assert quaternion_of_matrix(matrix) == pytest.approx(golden, abs=2e-6)
    assert np.abs(matrix_of_quaternion(golden) - matrix).max() < 5e-6
    # the conjugate, which a mistaken sense of rotation gives, is far away
    assert np.abs(quaternion_of_matrix(matrix.T) - golden).max() > 0.1


@given(st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 1e-3))
def test_matrix_and_quaternion_are_inverse(parts: list[float]) -> None:
    quaternion = np.array(parts) / np.linalg.norm(parts)
    matrix = matrix_of_quaternion(quaternion)
    assert np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-14
    again = quaternion_of_matrix(matrix)
    assert min(np.abs(again - quaternion).max(), np.abs(again + quaternion).max()) < 1e-14
    assert again[3] >= 0.0


@given(st.floats(-179.0, 179.0), st.floats(-179.0, 179.0), st.floats(-89.0, 89.0))
def test_attitude_there_and_back(yaw: float, roll: float, pitch: float) -> None:
    attitude_deg = np.array([yaw, roll, pitch])
    quaternion = quaternion_of_attitude(attitude_deg)
    assert np.abs(matrix_of_quaternion(quaternion) - body_from_nadir(attitude_deg)).max() < 1e-14
    assert attitude_of_quaternion(quaternion) == pytest.approx(attitude_deg, abs=1e-11)


@pytest.mark.parametrize(("axis", "position"), [(0, 1), (1, 2), (2, 0)], ids=["roll", "pitch", "yaw"])
def test_small_angles_stand_at_the_place_of_their_axis(axis: int, position: int) -> None:
    attitude_deg = np.zeros(3)
    attitude_deg[position] = 0.4
    quaternion = quaternion_of_attitude(attitude_deg)
    assert quaternion[axis] == pytest.approx(np.sin(np.radians(0.2)), abs=1e-15)
    assert np.delete(quaternion, axis) == pytest.approx([0.0, 0.0, np.cos(np.radians(0.2))], abs=1e-15)


def test_sign_is_continuous_through_a_full_turn() -> None:
    attitude_deg = np.zeros((721, 3))
    attitude_deg[:, 0] = np.linspace(0.0, 720.0, 721)
    plain = quaternion_of_attitude(attitude_deg)
    smooth = with_continuous_sign(plain)
    assert np.abs(np.diff(plain, axis=0)).max() > 1.0
    assert np.abs(np.diff(smooth, axis=0)).max() < 0.01
    assert smooth[360] == pytest.approx(-smooth[0], abs=1e-12)


def test_one_row_has_nothing_to_be_continuous_with() -> None:
    assert with_continuous_sign([[0.0, 0.0, 0.0, -1.0]])[0, 3] == -1.0
