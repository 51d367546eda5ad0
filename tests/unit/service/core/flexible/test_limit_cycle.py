"""The analysis of limit cycles from plain numbers."""

import numpy as np
import pytest

from service.core.flexible.limit_cycle import analyse_limit_cycle, find_limit_cycles
from service.core.flexible.spacecraft import WheelDrive
from service.core.flexible.switching_law import SwitchingLaw

PLAIN = {
    "inertia_kg_m2": 1000.0,
    "motor_torque_n_m": 0.2,
    "dry_friction_n_m": 1e-3,
    "viscous_loss_n_m": 1e-4,
    "momentum_limit_n_m_s": 20.0,
    "momentum_n_m_s": 10.0,
    "alpha_rad": 0.0175,
    "beta_rad": 0.0349,
    "pulse_s": 1.0,
}


def test_everything_that_is_shown():
    found = analyse_limit_cycle(**PLAIN, start_speed_rad_s=1.05e-4, returns=20, map_points=50)
    (cycle,) = found.cycles
    assert cycle.period_s == pytest.approx(190.4761905, rel=1e-9)
    assert found.forms.period_s == pytest.approx(cycle.period_s, rel=1e-9)
    assert (found.passive_rad_s2, found.pulse_rad_s2) == pytest.approx((1.05e-6, 1.9895e-4), rel=1e-12)
    assert found.speeds_rad_s.shape == found.next_speeds_rad_s.shape == (50,)
    assert found.ladder_rad_s.shape == (41, 2)
    assert found.ladder_rad_s[0].tolist() == [1.05e-4, 1.05e-4]


def test_closed_forms_are_near_the_cycle():
    found = analyse_limit_cycle(**PLAIN, map_points=2, returns=1)
    (cycle,) = found.cycles
    assert found.forms.speed_rad_s == pytest.approx(cycle.speed_rad_s, rel=1e-3)
    assert found.forms.inner_depth_rad == pytest.approx(0.0349 - cycle.inner_rad, rel=2e-3)
    assert found.forms.overshoot_rad == pytest.approx(cycle.outer_rad - 0.0349, rel=1e-3)


def test_the_sense_of_the_rotor_mirrors_the_cycle():
    (cycle,) = analyse_limit_cycle(**PLAIN | {"momentum_n_m_s": -10.0}, map_points=2, returns=1).cycles
    low, high = cycle.momentum_n_m_s
    assert -11.0 < low < -10.0 < high < -9.0
    assert cycle.is_momentum_consistent


def test_a_wheel_near_its_limit_is_told():
    drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, 10.05, 10.0)
    (cycle,) = find_limit_cycles(drive, SwitchingLaw(0.0175, 0.0349, 1.0))
    assert cycle.momentum_n_m_s[1] > 10.05
    assert not cycle.is_momentum_consistent


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"inertia_kg_m2": 0.0}, "inertia_kg_m2"),
        ({"pulse_s": -1.0}, "pulse_s is -1"),
        ({"alpha_rad": 0.04}, "alpha_rad 0.04"),
        ({"returns": 0}, "returns is 0"),
        ({"map_points": 1}, "map_points 1"),
        ({"start_speed_rad_s": 0.0}, "start_speed_rad_s is 0"),
        ({"external_torque_n_m": 1e-3}, "external_torque_n_m is 0.001"),
    ],
)
def test_what_is_not_physical_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        analyse_limit_cycle(**PLAIN | changes)


def test_the_function_is_given_where_there_is_one():
    found = analyse_limit_cycle(**PLAIN | {"line_step_rad": 1e-3}, map_points=60, returns=1)
    assert np.isfinite(found.next_speeds_rad_s).all()
    bare = analyse_limit_cycle(**PLAIN, map_points=60, returns=1)
    assert np.isnan(bare.next_speeds_rad_s).any()
