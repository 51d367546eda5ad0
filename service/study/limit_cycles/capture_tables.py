"""T3 to T5: boundary of capture, stable band and surface (26), perpetual capture."""

import math
from typing import NamedTuple

import numpy as np

from service.core.flexible.capture import (
    SwitchOn,
    critical_amplitude_rad,
    least_capturing_amplitude_rad,
    perpetual_amplitude_rad,
    rigid_frequency_rad_s,
    stable_band,
)
from service.core.flexible.limit_cycle import cycle_period_s
from service.core.flexible.motion import follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.spacecraft import HubMode, SwitchingLaw, WheelDrive
from service.study.limit_cycles import reference
from service.study.limit_cycles.reference import CaptureCase, Compared, ComparedTable, PerpetualCase, holds

#: in place of a damping of zero, which the motion refuses; it changes no digit
_HARDLY_DAMPED = 1e-12
_PERIODS, _COUNTED_PERIODS = 150, 50
#: the amplitude of a locked relay is told from the last instant
_LOCKED_FIRINGS = (2.0, 2.2)
_FREE_FIRINGS = 0.3
_LOCKED_AMPLITUDE = 0.06


def switch_of(case: CaptureCase) -> SwitchOn:
    """Return the switching on of a case."""
    lines = (case.rate_rad_s, case.alpha_rad, case.beta_rad, case.pulse_s)
    return SwitchOn(reference.PULSE_RAD_S2, reference.PASSIVE_RAD_S2, *lines)


def mode_of(case: CaptureCase) -> HubMode:
    """Return the mode of a case."""
    return HubMode(case.omega_rad_s, case.damping_ratio, case.coupling)


def is_captured(case: CaptureCase, amplitude_rad: float) -> bool:
    """Return whether a swing turns the relay off within half a period, by following the whole motion."""
    mode = mode_of(case)._replace(damping_ratio=max(case.damping_ratio, _HARDLY_DAMPED))
    inertia = reference.BASE.inertia_kg_m2
    friction_n_m = reference.PASSIVE_RAD_S2 * inertia
    drive = WheelDrive(inertia, reference.BASE.motor_torque_n_m, friction_n_m, momentum_limit_n_m_s=1e6)
    # a rotor that turns the other way: its friction pushes the body outward on the positive side
    deflection = mode.coupling * reference.PASSIVE_RAD_S2 / mode.omega_rad_s**2 + amplitude_rad
    start = BodyState(case.beta_rad - deflection, case.rate_rad_s, deflection, momentum_n_m_s=-1e3)
    half_s = math.pi / (mode.omega_rad_s * math.sqrt(1.0 - mode.damping_ratio**2))
    motion = follow_motion(start, drive, mode, SwitchingLaw(case.alpha_rad, case.beta_rad, math.inf), half_s)
    return len(motion.release_times_s) > 0


def capture_table() -> ComparedTable:
    """Return T3."""
    rows: list[Compared] = []
    for case in reference.CAPTURES:
        switch, mode = switch_of(case), mode_of(case)
        name = _name(case)
        least = least_capturing_amplitude_rad(switch, mode)
        rows.append(Compared(name, "p_cr by (18), rad", case.formula_rad, critical_amplitude_rad(switch, mode), 1e-6))
        rows.append(Compared(name, "p_min by following, rad", case.least_rad, least, 1e-4))
        if math.isinf(case.pulse_s) and least > 0.0:
            rows.append(holds(name, "free at 0.99 p_min", is_true=not is_captured(case, 0.99 * least)))
            rows.append(holds(name, "captured at 1.01 p_min", is_true=is_captured(case, 1.01 * least)))
    return ComparedTable("T3", "Boundary of capture", tuple(rows))


def _name(case: CaptureCase) -> str:
    """Return a case in words."""
    law = "one line" if case.alpha_rad == case.beta_rad else "two lines" if math.isinf(case.pulse_s) else "timed"
    return f"w {case.omega_rad_s:g}, kn {case.coupling:g}, xi {case.damping_ratio:g}, rate {case.rate_rad_s:g}, {law}"


def cycle_switch() -> SwitchOn:
    """Return a switching on of cycle A at one line."""
    rate = 0.5 * reference.PULSE_RAD_S2
    return SwitchOn(reference.PULSE_RAD_S2, reference.PASSIVE_RAD_S2, rate, reference.ALPHA_RAD, reference.ALPHA_RAD)


def band_table() -> ComparedTable:
    """Return T4, and the surface (26)."""
    rows: list[Compared] = []
    for coupling, bands in reference.BANDS.items():
        for swing, band in bands.items():
            found = stable_band(cycle_switch(), coupling, swing)
            case = f"kn {coupling:g}, C {swing:g}"
            if band is None:
                rows.append(holds(case, "no band", is_true=math.isnan(found.low_rad_s)))
                continue
            # seven digits are printed
            rows.append(Compared(case, "w-, rad/s", band[0], found.low_rad_s, 1e-6))
            rows.append(Compared(case, "w+, rad/s", band[1], found.high_rad_s, 1e-6))
    for swing, omega, printed in reference.SURFACE:
        mode = HubMode(omega, 0.01, 0.5)
        found_rad_s = rigid_frequency_rad_s(cycle_switch(), mode, swing)
        rows.append(Compared(f"C {swing:g}, w {omega:g}", "w_T by (26), rad/s", printed, found_rad_s, 1e-6))
    own = 2.0 * math.pi / cycle_period_s(reference.BASE, 1.0, 1)
    rows.append(Compared("A0", "own w_T, rad/s", reference.RIGID_FREQUENCY_RAD_S, own, 1e-6))
    return ComparedTable("T4", "Band without capture, and surface (26)", tuple(rows))


class Lock(NamedTuple):
    """Steady motion of a relay: firings per period and amplitude."""

    firings_per_period: float
    amplitude_rad: float


def perpetual_lock(case: PerpetualCase) -> Lock:
    """Return what 150 periods of a relay on a body without friction come to."""
    mode = HubMode(case.omega_rad_s, case.damping_ratio, case.coupling)
    drive = WheelDrive(1000.0, 0.2, momentum_limit_n_m_s=1e6)
    period_s = 2.0 * math.pi / case.omega_rad_s
    start = BodyState(reference.BETA_RAD - case.amplitude_rad, 1e-4, case.amplitude_rad)
    law = SwitchingLaw(reference.ALPHA_RAD, reference.BETA_RAD, math.inf)
    motion = follow_motion(start, drive, mode, law, _PERIODS * period_s)
    counted = np.count_nonzero(motion.firing_times_s > (_PERIODS - _COUNTED_PERIODS) * period_s)
    amplitude = math.hypot(motion.end.deflection_rad, motion.end.deflection_rate_rad_s / case.omega_rad_s)
    return Lock(float(counted) / _COUNTED_PERIODS, amplitude)


def perpetual_table() -> ComparedTable:
    """Return T5."""
    rows: list[Compared] = []
    for case in reference.PERPETUAL:
        switch = SwitchOn(2e-4, 0.0, 1e-4, reference.ALPHA_RAD, reference.BETA_RAD)
        limit = perpetual_amplitude_rad(switch, HubMode(case.omega_rad_s, case.damping_ratio, case.coupling))
        lock = perpetual_lock(case)
        name = f"w {case.omega_rad_s:g}, kn {case.coupling:g}, xi {case.damping_ratio:g}, p0 {case.amplitude_rad:g}"
        rows.append(Compared(name, "p_inf / beta", case.lock_ratio, limit / reference.BETA_RAD, 6e-3))
        rows.append(Compared(name, "firings a period", case.firings_per_period, lock.firings_per_period, 0.02))
        if case.is_captured:
            rows.append(Compared(name, "amplitude, rad", case.final_amplitude_rad, lock.amplitude_rad, 1e-2))
        rows.append(
            holds(
                name, "locked" if case.is_captured else "not locked", is_true=agrees_with_published(case, lock, limit)
            )
        )
    return ComparedTable("T5", "Perpetual capture", tuple(rows))


def agrees_with_published(case: PerpetualCase, lock: Lock, limit_rad: float) -> bool:
    """Return whether a run locked where it was to, at the amplitude of the energy balance, or stayed free."""
    if not case.is_captured:
        return lock.firings_per_period < _FREE_FIRINGS
    low, high = _LOCKED_FIRINGS
    is_near = abs(lock.amplitude_rad / limit_rad - 1.0) <= _LOCKED_AMPLITUDE
    return low <= lock.firings_per_period <= high and is_near
