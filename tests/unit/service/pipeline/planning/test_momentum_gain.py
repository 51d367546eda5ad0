"""Which wheels are planned with: those of the options, else those of the catalogue."""

import math

import pytest

from service.pipeline.planning.momentum_gain import stated_wheels
from service.records.catalogue import AxisTorques, FedForwardTorque, WheelMomentum

STATED = WheelMomentum(sigma_n_m_s=0.02, misalignment_deg=0.1, pitch_bias_n_m_s=-9.0)


def test_without_a_stated_momentum_there_is_nothing_to_plan_with() -> None:
    assert stated_wheels(None, None, 0.01, 300.0) is None
    assert stated_wheels(WheelMomentum(), None, None, 300.0) is None


def test_options_prevail_over_the_catalogue() -> None:
    wheels = stated_wheels(STATED, None, None, 3600.0)
    assert wheels is not None
    assert wheels[:4] == (-9.0, 0.02, 3600.0, 0.1)
    wheels = stated_wheels(STATED, 8.0, 0.05, 300.0)
    assert wheels is not None
    assert wheels[:3] == (8.0, 0.05, 300.0)


def test_the_error_of_a_stated_profile_is_its_share() -> None:
    torque = AxisTorques(yaw=1e-5, roll=1e-5)
    profile = FedForwardTorque(0, 86_400.0, torque, torque, torque, relative_error=0.03, axis_relative_error=0.04)
    wheels = stated_wheels(WheelMomentum(pitch_bias_n_m_s=8.0, torque=profile), None, None, 300.0)
    assert wheels is not None
    assert wheels.torque_error_n_m == pytest.approx(math.hypot(0.03, 0.04) * 1e-5)
