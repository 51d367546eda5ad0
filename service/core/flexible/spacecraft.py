"""One axis of a spacecraft with a wheel and one flexible mode, and the refusal of numbers that are not physical.

    I thT'' = M_B + M_y,   thU'' + 2 xi w thU' + w^2 thU = kn (M_B + M_y) / I,   theta = thT + thU
    M_y = M_n F - M_T sgn H - M_v H / H_max,   dH/dt = M_y,   |H| <= H_max

theta (rad) is what the sensor sees, thT the turn of the body as a rigid one, thU what the flexible mode adds to it at
the hub; H (N m s) the wheel's momentum, counted so that a torque on the body raises it; F in {-1, 0, +1} the switch;
I in kg m^2, torques in N m, w in rad/s. Equations (1) to (3), (21), (22) of [1]_; the plus before the integral of
friction in the printed (22) cannot hold for H > 0.

References
----------
.. [1] L. V. Severova, S. P. Severov, "On the analysis of the orientation of deformable spacecraft", Bauman MSTU.
"""

import math
from typing import NamedTuple


class WheelDrive(NamedTuple):
    """Inertia of the axis and what turns it."""

    inertia_kg_m2: float
    #: M_n, motor torque while switched on
    motor_torque_n_m: float
    #: M_T, dry friction of the rotor
    dry_friction_n_m: float = 0.0
    #: M_v, viscous and ventilation loss at the momentum limit
    viscous_loss_n_m: float = 0.0
    #: H_max
    momentum_limit_n_m_s: float = 20.0
    #: H0, momentum of the rotor where the body's rate is zero
    momentum_n_m_s: float = 0.0
    #: M_B, external torque on the body
    external_torque_n_m: float = 0.0


class HubMode(NamedTuple):
    """One tone of the panels as the hub feels it; without a mode the body is rigid."""

    omega_rad_s: float
    #: xi
    damping_ratio: float
    #: kn, share of the hub's acceleration that drives the tone
    coupling: float


class Accelerations(NamedTuple):
    """Net accelerations of one-sided motion, magnitudes."""

    #: eps_c, rad/s^2: friction of the rotor, turns the body against the sign of the momentum
    passive_rad_s2: float
    #: eps_a, rad/s^2: a pulse against it
    pulse_rad_s2: float
    #: c, 1/s: viscous loss over momentum limit
    viscous_rate_1_s: float


def accelerations(drive: WheelDrive) -> Accelerations:
    """Return eps_c, eps_a and c; dry friction keeps the sign of the momentum at rest.

    Raises
    ------
    ValueError
        The motor is not stronger than the friction.

    Examples
    --------
    >>> drive = WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0)
    >>> [f"{value:.5g}" for value in accelerations(drive)]
    ['1.05e-06', '0.00019895', '5e-06']
    """
    require_drive(drive)
    viscous_rate_1_s = drive.viscous_loss_n_m / drive.momentum_limit_n_m_s
    friction_n_m = drive.dry_friction_n_m + viscous_rate_1_s * abs(drive.momentum_n_m_s)
    passive_rad_s2 = friction_n_m / drive.inertia_kg_m2
    pulse_rad_s2 = drive.motor_torque_n_m / drive.inertia_kg_m2 - passive_rad_s2
    if pulse_rad_s2 <= 0.0:
        raise ValueError(
            f"friction of {friction_n_m:g} N m is not below the motor torque of {drive.motor_torque_n_m:g} N m: "
            "no pulse can turn the body; raise motor_torque_n_m or lower the friction"
        )
    return Accelerations(passive_rad_s2, pulse_rad_s2, viscous_rate_1_s)


def require_drive(drive: WheelDrive) -> None:
    """Refuse a drive that cannot exist; ValueError says which number and what to do."""
    for name in ("inertia_kg_m2", "motor_torque_n_m", "momentum_limit_n_m_s"):
        require_positive(name, getattr(drive, name))
    for name in ("dry_friction_n_m", "viscous_loss_n_m"):
        require_not_negative(name, getattr(drive, name))
    require_finite("external_torque_n_m", drive.external_torque_n_m)
    require_finite("momentum_n_m_s", drive.momentum_n_m_s)
    if abs(drive.momentum_n_m_s) > drive.momentum_limit_n_m_s:
        raise ValueError(
            f"momentum_n_m_s is {drive.momentum_n_m_s:g}, beyond momentum_limit_n_m_s {drive.momentum_limit_n_m_s:g}; "
            "unload the wheel or correct the limit"
        )


def require_mode(mode: HubMode, *, may_be_undamped: bool = False) -> None:
    """Refuse a mode that cannot exist, one without damping among them unless the question allows it."""
    require_positive("omega_rad_s", mode.omega_rad_s)
    require_not_negative("coupling", mode.coupling)
    if not 0.0 < mode.damping_ratio < 1.0 and not (may_be_undamped and mode.damping_ratio == 0.0):
        raise ValueError(
            f"damping_ratio is {mode.damping_ratio:g}, it must lie between 0 and 1, "
            f"{'1' if may_be_undamped else 'both'} excluded; "
            "every panel damps (0.001 to 0.02 is usual), and an overdamped one does not oscillate"
        )


def require_positive(name: str, value: float) -> None:
    """Refuse what is not a finite number above zero."""
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"{name} is {value:g}, it must be a finite number above 0")


def require_not_negative(name: str, value: float) -> None:
    """Refuse what is not a finite number, zero or above."""
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name} is {value:g}, it must be a finite number, 0 or above")


def require_finite(name: str, value: float) -> None:
    """Refuse NaN and infinity."""
    if not math.isfinite(value):
        raise ValueError(f"{name} is {value:g}, it must be a finite number")
