"""Effect of a torque schedule on panels, regulator and wheel, and the uplink limits that it exceeds.

The ground knows the frequency of a panel poorly: every response is tried over +-15 % of it, since a zero at the nominal
frequency proves nothing. Phases of several modes are unknown: their peaks are added. Measured angles cannot answer the
question, they come far more seldom than the modes swing; the history of schedules does, carried from uplink to uplink.

Levels of the warning (half of p_cr, p_inf above beta) are margins of this service, not of the paper.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.flexible.capture.capture import SwitchOn, critical_amplitude_rad, perpetual_amplitude_rad
from service.core.flexible.schedule.schedule_response import (
    ModeResponse,
    TorquePulse,
    schedule_response,
)
from service.core.flexible.spacecraft import (
    HubMode,
    require_mode,
    require_not_negative,
    require_positive,
)
from service.core.flexible.switching_law import SwitchingLaw, require_law

#: half the band of frequencies tried around the known one, and how many
FREQUENCY_REACH = 0.15
FREQUENCY_COUNT = 61
#: a swing above this share of p_cr is warned of
WARNED_SHARE = 0.5


class OnboardRegulator(NamedTuple):
    """The regulator on board as the verdict needs it."""

    law: SwitchingLaw
    motor_torque_n_m: float
    #: friction of the rotor
    friction_torque_n_m: float = 0.0
    #: worst outward rate at a switching; 0 is safe
    rate_rad_s: float = 0.0


class ScheduleLimits(NamedTuple):
    """Limits of a schedule on one axis."""

    inertia_kg_m2: float
    modes: tuple[HubMode, ...]
    #: hub angle that panels may add
    peak_allowed_rad: float
    #: None: nothing on board switches on the angle
    regulator: OnboardRegulator | None = None
    #: H0 and H_max of the wheel that serves the axis
    momentum_n_m_s: float = 0.0
    momentum_limit_n_m_s: float = math.inf


class ScheduleMetrics(NamedTuple):
    """Metrics of a schedule, worst case over frequencies, sum over modes."""

    peak_rad: float
    #: amplitude of the oscillation after the last edge
    residual_rad: float
    #: the greatest swing that the regulator meets, after any edge: a schedule may undo at its end what it did before
    swing_rad: float
    worst_mode: int
    worst_omega_rad_s: float
    #: per mode, at its own frequency
    nominal: tuple[ModeResponse, ...]
    #: least and greatest momentum of the wheel
    momentum_n_m_s: tuple[float, float]


def schedule_metrics(
    pulses: tuple[TorquePulse, ...], limits: ScheduleLimits, carried_rad: tuple[complex, ...]
) -> ScheduleMetrics:
    """Return the metrics of a schedule; ``carried_rad`` holds Z of each mode at time zero."""
    spread = np.linspace(1.0 - FREQUENCY_REACH, 1.0 + FREQUENCY_REACH, FREQUENCY_COUNT)
    peaks, residuals, swings, omegas, nominal = [], [], [], [], []
    for mode, carried in zip(limits.modes, carried_rad, strict=True):
        nominal.append(schedule_response(pulses, mode, limits.inertia_kg_m2, carried_rad=carried))
        tried = schedule_response(pulses, mode, limits.inertia_kg_m2, omega_rad_s=mode.omega_rad_s * spread)
        worst = int(np.argmax(tried.peak_rad))
        # the phase of what was carried is as unknown as the frequency; its decay is left out
        peaks.append(float(tried.peak_rad[worst]) + abs(carried))
        residuals.append(float(tried.residual_rad.max()) + abs(carried))
        swings.append(float(tried.swing_rad.max()) + abs(carried))
        omegas.append(float(tried.omega_rad_s[worst]))
    worst_mode = int(np.argmax(peaks))
    momentum = limits.momentum_n_m_s + np.cumsum([0.0, *(pulse.torque_n_m * pulse.duration_s for pulse in pulses)])
    return ScheduleMetrics(
        peak_rad=sum(peaks),
        residual_rad=sum(residuals),
        swing_rad=sum(swings),
        worst_mode=worst_mode,
        worst_omega_rad_s=omegas[worst_mode],
        nominal=tuple(nominal),
        momentum_n_m_s=(float(momentum.min()), float(momentum.max())),
    )


def regulator_boundary_rad(limits: ScheduleLimits) -> tuple[float, float]:
    """Return (p_cr, p_inf), the least and the greatest over modes and frequencies tried; infinite and 0 without law."""
    if limits.regulator is None:
        return math.inf, 0.0
    critical, perpetual = math.inf, 0.0
    spread = np.linspace(1.0 - FREQUENCY_REACH, 1.0 + FREQUENCY_REACH, FREQUENCY_COUNT)
    tried = [mode._replace(omega_rad_s=mode.omega_rad_s * float(one)) for mode in limits.modes for one in spread]
    for switch in switch_ons_of(limits.regulator, limits.inertia_kg_m2):
        critical = min(critical, *(critical_amplitude_rad(switch, mode, is_refined=True) for mode in tried))
        if limits.regulator.law.is_relay:
            perpetual = max(perpetual, *(perpetual_amplitude_rad(switch, mode) for mode in tried))
    return critical, perpetual


def switch_ons_of(regulator: OnboardRegulator, inertia_kg_m2: float) -> tuple[SwitchOn, SwitchOn]:
    """Return a switching on with the friction either way: the sense of the rotor on board is not asked for."""
    law, friction_rad_s2 = regulator.law, regulator.friction_torque_n_m / inertia_kg_m2
    motor_rad_s2 = regulator.motor_torque_n_m / inertia_kg_m2
    lines = (regulator.rate_rad_s, law.alpha_rad, law.beta_rad, law.pulse_s)
    toward = SwitchOn(motor_rad_s2 - friction_rad_s2, friction_rad_s2, *lines)
    return toward, SwitchOn(motor_rad_s2 + friction_rad_s2, -friction_rad_s2, *lines)


def reasons_of(
    figures: ScheduleMetrics, limits: ScheduleLimits, boundary_rad: tuple[float, float]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return why a schedule is rejected and what is warned of, each in words of one."""
    critical, perpetual = boundary_rad
    beta = limits.regulator.law.beta_rad if limits.regulator is not None else math.inf
    rejected = {
        "peak": figures.peak_rad > limits.peak_allowed_rad,
        "always_captured": critical <= 0.0,
        "captured": 0.0 < critical <= figures.swing_rad,
        "momentum": max(-figures.momentum_n_m_s[0], figures.momentum_n_m_s[1]) > limits.momentum_limit_n_m_s,
    }
    warned = {
        "near_capture": WARNED_SHARE * critical < figures.swing_rad < critical,
        "perpetual_capture": perpetual > beta,
    }
    return tuple(name for name, holds in rejected.items() if holds), tuple(
        name for name, holds in warned.items() if holds
    )


def require_limits(limits: ScheduleLimits) -> None:
    """Refuse limits that are not physical; ValueError says which number and what to do."""
    require_positive("inertia_kg_m2", limits.inertia_kg_m2)
    require_positive("peak_allowed_rad", limits.peak_allowed_rad)
    if not limits.modes:
        raise ValueError("no flexible mode is given: there is nothing to excite; give omega, damping and coupling")
    for mode in limits.modes:
        require_mode(mode)
    if not limits.momentum_limit_n_m_s > 0.0:
        raise ValueError(f"momentum_limit_n_m_s is {limits.momentum_limit_n_m_s:g}, it must be above 0")
    if not abs(limits.momentum_n_m_s) <= limits.momentum_limit_n_m_s:
        raise ValueError(
            f"momentum_n_m_s is {limits.momentum_n_m_s:g}, beyond momentum_limit_n_m_s "
            f"{limits.momentum_limit_n_m_s:g}; unload the wheel first"
        )
    if limits.regulator is not None:
        _require_regulator(limits.regulator)


def _require_regulator(regulator: OnboardRegulator) -> None:
    """Refuse a regulator that cannot switch."""
    require_law(regulator.law)
    require_positive("motor_torque_n_m", regulator.motor_torque_n_m)
    require_not_negative("friction_torque_n_m", regulator.friction_torque_n_m)
    require_not_negative("rate_rad_s", regulator.rate_rad_s)
    if regulator.friction_torque_n_m >= regulator.motor_torque_n_m:
        raise ValueError(
            f"friction_torque_n_m {regulator.friction_torque_n_m:g} is not below motor_torque_n_m "
            f"{regulator.motor_torque_n_m:g}: the motor cannot turn the body back; raise one or lower the other"
        )
