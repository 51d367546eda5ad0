"""Which wheels are planned with: those of the options, else those of the catalogue."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from geometry_flight import FlightPayload

from service.core.estimation.attitude_bound import WheelStatistics
from service.core.estimation.calibration.coloured_rows import ColouredNoise
from service.pipeline.planning.momentum_gain import motion_gain, stated_wheels
from service.records.catalogue import AxisTorques, BodyRateSensor, FedForwardTorque, Polarimeter, WheelMomentum

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


def test_the_bound_knows_what_the_catalogue_states_to_measure_motion() -> None:
    slopes = np.random.default_rng(3).normal(0.0, [0.12, 1.0, 0.8], (8, 3))
    noise = ColouredNoise(np.full(8, 0.1), np.full((8, 1), 0.1), np.full((8, 1), 1200.0))
    candidates: Any = SimpleNamespace(sensitivity_db_per_deg=slopes, noise=noise)
    chosen, wheels, plain = np.arange(8), WheelStatistics(8.0), FlightPayload.make().spacecraft()
    assert motion_gain(candidates, chosen, plain, wheels) is None
    beside = BodyRateSensor(in_loop=False, bias_deg_h=0.01, bias_tau_h=8.0, noise_deg_sqrt_h=0.003)
    in_loop = replace(plain, onboard=replace(plain.onboard, rate_sensor=BodyRateSensor(in_loop=True)))
    assert motion_gain(candidates, chosen, in_loop, wheels) is None
    rated = replace(plain, onboard=replace(plain.onboard, rate_sensor=beside))
    seen = replace(rated, polarimeters=(Polarimeter("p", 10.0, 11e9), Polarimeter("q", 5.0, 11e9, used=False)))
    alone, both = (motion_gain(candidates, chosen, craft, None) for craft in (rated, seen))
    more = motion_gain(candidates, chosen, seen, wheels)
    assert alone is not None
    assert both is not None
    assert more is not None
    assert alone.polarization_deg is None
    assert alone.rates_deg == alone.all_deg == both.rates_deg
    assert both.polarization_deg is not None
    assert both.rates_deg is not None
    assert both.all_deg.yaw < both.polarization_deg.yaw < both.powers_deg.yaw
    assert more.all_deg.yaw < both.all_deg.yaw < both.rates_deg.yaw
