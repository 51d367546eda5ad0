"""Geometry of the simulated world: properties for any attitude."""

import numpy as np
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from analyzer_sim.world.orbit.geometry import antenna_angles_deg, body_from_orbital

angle = st.floats(-30.0, 30.0, allow_nan=False)
small = st.floats(-0.5, 0.5, allow_nan=False)
position = st.floats(-8.5, 8.5, allow_nan=False)


@settings(max_examples=examples(100), derandomize=True)
@given(yaw=angle, roll=angle, pitch=angle)
def test_every_attitude_is_a_rotation(yaw: float, roll: float, pitch: float) -> None:
    turn = body_from_orbital(np.array([[yaw, roll, pitch]]))[0]
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-14)  # rounding
    assert abs(np.linalg.det(turn) - 1.0) < 1e-14


@settings(max_examples=examples(100), derandomize=True)
@given(yaw=small, roll=small, pitch=small, az=position, el=position)
def test_signs_hold_everywhere_on_the_disc(yaw: float, roll: float, pitch: float, az: float, el: float) -> None:
    direction = np.array([np.tan(np.radians(az)), -np.tan(np.radians(el)), 1.0])
    turned = body_from_orbital(np.array([[yaw, roll, pitch]]))[0] @ direction
    az_new, el_new = antenna_angles_deg(turned)
    first_az = -pitch - yaw * np.radians(el)
    first_el = -roll + yaw * np.radians(az)
    # terms left out: angle times 0.15^2 (2.2 %) and products of two turns of 0.5 deg (0.009 deg)
    slack = 0.025 * (abs(yaw) + abs(roll) + abs(pitch)) + 0.009
    assert abs(az_new - az - first_az) < slack
    assert abs(el_new - el - first_el) < slack
