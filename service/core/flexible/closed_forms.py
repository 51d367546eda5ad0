"""Limit cycles in closed form.

With Delta = eps_a tau the gain of speed in a pulse and v the speed at firing, outward, rad/s. The exact forms hold
without viscous loss (c = 0); `limit_cycle` has the exact figures for any.
"""

from typing import NamedTuple

import numpy as np

from service.core.flexible.phi_functions import FloatArray
from service.core.flexible.return_kernels import OneSided
from service.core.flexible.spacecraft import WheelDrive, accelerations


class SinglePulseForms(NamedTuple):
    """Cycle of one pulse, by formula."""

    #: at firing, c = 0
    speed_rad_s: float
    period_s: float
    #: below and above the line
    inner_depth_rad: float
    overshoot_rad: float
    #: -(1 + 2 eps_c / eps_a), c = 0
    multiplier_frictionless: float
    #: with viscous loss to first order
    multiplier: float
    #: of the printed (23), which lacks the displacement theta' tau
    multiplier_truncated: float
    #: loss at the momentum limit above which the cycle is stable, N m
    critical_viscous_loss_n_m: float


def single_pulse_forms(drive: WheelDrive, pulse_s: float) -> SinglePulseForms:
    """Return the closed forms of the cycle of one pulse.

    Examples
    --------
    >>> forms = single_pulse_forms(WheelDrive(1000.0, 0.2, 1e-3, 1e-4, momentum_n_m_s=10.0), 1.0)
    >>> [round(value, 6) for value in (forms.multiplier_frictionless, forms.multiplier, forms.multiplier_truncated)]
    [-1.010555, -1.009917, -0.9895]
    """
    passive, pulse, viscous = accelerations(drive)
    ratio = passive / pulse
    speed = 0.5 * pulse * pulse_s
    steepness = -(1.0 + 2.0 * ratio)
    # the loss that stabilises stands beside dry friction alone
    dry = drive.dry_friction_n_m
    dry_ratio = dry / (drive.motor_torque_n_m - dry)
    return SinglePulseForms(
        speed_rad_s=speed,
        period_s=cycle_period_s(drive, pulse_s, 1),
        inner_depth_rad=0.5 * speed**2 / passive,
        overshoot_rad=0.5 * speed**2 / pulse,
        multiplier_frictionless=steepness,
        multiplier=steepness * (1.0 - 4.0 * viscous * speed / (3.0 * passive)),
        multiplier_truncated=-(1.0 - ratio) / (1.0 + ratio),
        critical_viscous_loss_n_m=3.0 * drive.momentum_limit_n_m_s * dry_ratio**2 / pulse_s,
    )


def cycle_period_s(drive: WheelDrive, pulse_s: float, pulses: int) -> float:
    """Return the period of a cycle, s: N pulses make good what friction takes, equation (25); exact for any loss."""
    passive, _, _ = accelerations(drive)
    return pulses * drive.motor_torque_n_m * pulse_s / (passive * drive.inertia_kg_m2)


def truncated_succession(speeds_rad_s: FloatArray, motion: OneSided) -> FloatArray:
    """Return the succession (S,) that follows from (23) as printed, without the displacement theta' tau in a pulse."""
    gained = motion.pulse_rad_s2 * motion.pulse_s
    passive_part = motion.passive_rad_s2 * motion.pulse_rad_s2 * motion.pulse_s**2
    return np.sqrt((speeds_rad_s - gained) ** 2 + passive_part)
