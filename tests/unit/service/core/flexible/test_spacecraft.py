"""What is not physical is refused, in words that say what, which and what to do."""

import math

import pytest

from service.core.flexible.spacecraft import HubMode, WheelDrive, accelerations, require_drive, require_mode

DRIVE = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)


def test_accelerations_of_the_paper():
    found = accelerations(DRIVE)
    assert found.passive_rad_s2 == pytest.approx(1.05e-6, rel=1e-12)
    assert found.pulse_rad_s2 == pytest.approx(1.9895e-4, rel=1e-12)
    assert found.viscous_rate_1_s == pytest.approx(5e-6, rel=1e-12)


def test_the_sense_of_the_rotor_does_not_change_magnitudes():
    assert accelerations(DRIVE._replace(momentum_n_m_s=-10.0)) == accelerations(DRIVE)


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({"inertia_kg_m2": 0.0}, "inertia_kg_m2 is 0, it must be a finite number above 0"),
        ({"inertia_kg_m2": -5.0}, "inertia_kg_m2 is -5"),
        ({"inertia_kg_m2": math.nan}, "inertia_kg_m2 is nan"),
        ({"motor_torque_n_m": math.inf}, "motor_torque_n_m is inf"),
        ({"dry_friction_n_m": -1e-3}, "dry_friction_n_m is -0.001, it must be a finite number, 0 or above"),
        ({"viscous_loss_n_m": math.nan}, "viscous_loss_n_m is nan"),
        ({"external_torque_n_m": math.inf}, "external_torque_n_m is inf, it must be a finite number"),
        ({"momentum_n_m_s": 21.0}, "momentum_n_m_s is 21, beyond momentum_limit_n_m_s 20; unload the wheel"),
    ],
)
def test_a_drive_that_cannot_exist_is_refused(changes, reported):
    with pytest.raises(ValueError, match=reported):
        require_drive(DRIVE._replace(**changes))


def test_a_motor_weaker_than_its_friction_is_refused():
    with pytest.raises(ValueError, match=r"friction of 0\.2\d* N m is not below the motor torque of 0\.2 N m"):
        accelerations(DRIVE._replace(dry_friction_n_m=0.2))


@pytest.mark.parametrize("xi", [0.0, -0.01, 1.0, 1.5, math.nan])
def test_a_mode_without_damping_or_with_too_much_is_refused(xi):
    with pytest.raises(ValueError, match=r"damping_ratio is .*, it must lie between 0 and 1, both excluded"):
        require_mode(HubMode(0.5, xi, 0.4))


def test_a_question_may_allow_a_mode_without_damping():
    require_mode(HubMode(0.5, 0.0, 0.4), may_be_undamped=True)
    with pytest.raises(ValueError, match="between 0 and 1, 1 excluded"):
        require_mode(HubMode(0.5, -1e-3, 0.4), may_be_undamped=True)


@pytest.mark.parametrize(
    ("mode", "reported"),
    [
        (HubMode(0.0, 0.01, 0.4), "omega_rad_s is 0"),
        (HubMode(0.5, 0.01, -0.4), "coupling is -0.4"),
    ],
)
def test_a_mode_that_cannot_swing_is_refused(mode, reported):
    with pytest.raises(ValueError, match=reported):
        require_mode(mode)
