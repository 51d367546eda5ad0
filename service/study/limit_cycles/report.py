"""Tables of the study: figures of the reference beside those of the product."""

import math
from functools import cache
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
from service.core.flexible.limit_cycle import (
    LimitCycle,
    critical_viscous_loss_n_m,
    cycle_period_s,
    find_cycles_over_both_lines,
    find_limit_cycles,
    one_sided_motion,
    single_pulse_forms,
    succession,
    truncated_succession,
)
from service.core.flexible.motion import follow_motion
from service.core.flexible.propagation import BodyState
from service.core.flexible.return_kernels import Follow, OneSided, compiled_follow, follow
from service.core.flexible.schedule import FREQUENCY_COUNT, FREQUENCY_REACH, TorquePulse, schedule_response
from service.core.flexible.spacecraft import HubMode, SwitchingLaw, WheelDrive
from service.study.limit_cycles import reference
from service.study.limit_cycles.reference import CaptureCase, PerpetualCase
from service.study.published import Row, row, statement_row

#: relative tolerance of speeds and angles, of periods; absolute one of multipliers
_RELATIVE, _PERIOD, _MULTIPLIER = 1e-6, 1e-8, 1e-4
#: as many returns of a leg-by-leg run must agree with the map
_FOLLOWED_S = 2000.0


def _compared(
    case: str, figure: str, reference: float, found: float, tolerance: float, *, is_relative: bool = True
) -> Row:
    """Return a figure with all its digits; the tolerance is a share of the reference, or a distance."""
    within = tolerance * abs(reference) if is_relative else tolerance
    return row(figure, case, reference, found, "", within=within, digits=10)


def _holds(case: str, claim: str, *, is_true: bool) -> Row:
    """Return a claim as a row: 1 where it holds."""
    return statement_row(claim, case, "holds", float(is_true), "", is_met=is_true)


@cache
def cycle_of(name: str) -> LimitCycle:
    """Return the cycle of a case that uses each of its lines once."""
    case = reference.CYCLES[name]
    (cycle,) = (one for one in find_limit_cycles(case.drive, case.law) if one.pulses == case.law.pulse_count)
    return cycle


def motion_of(name: str) -> OneSided:
    """Return the one-sided motion of a case."""
    case = reference.CYCLES[name]
    return one_sided_motion(case.drive, case.law)


def limit_cycle_table() -> list[Row]:
    """Return T1."""
    rows: list[Row] = []
    for name, case in reference.CYCLES.items():
        cycle = cycle_of(name)
        rows += [
            _compared(name, "w*, rad/s", case.speed_rad_s, cycle.speed_rad_s, _RELATIVE),
            _compared(name, "vmax, rad/s", case.rate_rad_s, cycle.rate_rad_s, _RELATIVE),
            # the reference prints ten digits
            _compared(name, "T, s", case.period_s, cycle.period_s, _PERIOD),
            _compared(name, "inner, rad", case.inner_rad, cycle.inner_rad, _RELATIVE),
            _compared(name, "outer, rad", case.outer_rad, cycle.outer_rad, _RELATIVE),
            _compared(name, "multiplier", case.multiplier, cycle.multiplier, _MULTIPLIER, is_relative=False),
        ]
    return rows + _closed_forms()


def _closed_forms() -> list[Row]:
    """Return what formulas say of cycle A0 and of the loss that makes it stable."""
    forms = single_pulse_forms(reference.BASE, 1.0)
    found = (forms.multiplier, forms.multiplier_frictionless, forms.multiplier_truncated)
    names = ("multiplier by formula", "multiplier by formula, c = 0", "multiplier of truncated (23)")
    rows = [
        _compared("A0", name, printed, value, 1e-6, is_relative=False)
        for name, printed, value in zip(names, reference.CLOSED_MULTIPLIERS, found, strict=True)
    ]
    for dry, (exact, formula) in reference.CRITICAL_LOSSES.items():
        drive = reference.BASE._replace(
            dry_friction_n_m=dry, viscous_loss_n_m=0.0, momentum_n_m_s=reference.CRITICAL_MOMENTUM_N_M_S
        )
        law = reference.law_of()
        case = f"M_T = {dry:g}"
        rows += [
            _compared(case, "M_v,crit, N m", exact, critical_viscous_loss_n_m(drive, law), _RELATIVE),
            _compared(
                case,
                "M_v,crit by formula, N m",
                formula,
                single_pulse_forms(drive, 1.0).critical_viscous_loss_n_m,
                5e-5,
            ),
        ]
    return rows


def both_lines_table() -> list[Row]:
    """Return cycles over both lines beside the balance of momentum: N - N' pulses make good what friction takes."""
    rows: list[Row] = []
    for friction_n_m, pulse_s in ((1e-3, 4.0), (3e-4, 2.0), (1e-4, 1.0)):
        drive = reference.BASE._replace(dry_friction_n_m=friction_n_m)
        (cycle,) = find_cycles_over_both_lines(drive, reference.law_of(pulse_s=pulse_s))
        ahead = cycle.motion.pulses[0] - cycle.motion.pulses[1]
        case, balance_s = f"M_T {friction_n_m:g}, tau {pulse_s:g}", cycle_period_s(drive, pulse_s, ahead)
        rows.append(_compared(case, "T, s", balance_s, cycle.motion.period_s, 1e-8))
        rows.append(_holds(case, "two pulses on one side, one on the other", is_true=cycle.motion.pulses == (2, 1)))
    resting = reference.BASE._replace(dry_friction_n_m=1e-4, momentum_n_m_s=0.0)
    law = reference.law_of(3, 1.5e-3, 4.0)
    found = {cycle.motion.pulses for cycle in find_cycles_over_both_lines(resting, law)}
    rows.append(_holds("rotor at rest, M_T 1e-4, tau 4", "three pulses a side, adjoining", is_true=(3, 3) in found))
    none = find_cycles_over_both_lines(reference.BASE, reference.law_of())
    rows.append(_holds("A0", "no cycle over both lines", is_true=not none))
    return rows


def succession_table() -> list[Row]:
    """Return T2."""
    rows = [
        _compared(name, f"f({speed:g}), rad/s", printed, float(succession(np.array([speed]), motion_of(name))[0]), 1e-6)
        for name, speed, printed in reference.SUCCESSIONS
    ]
    truncated = truncated_succession(np.array([speed for speed, _ in reference.TRUNCATED_SUCCESSIONS]), motion_of("A0"))
    rows += [
        _compared("A0, truncated (23)", f"f({speed:g}), rad/s", printed, float(value), 1e-6)
        for (speed, printed), value in zip(reference.TRUNCATED_SUCCESSIONS, truncated, strict=True)
    ]
    follower = compiled_follow()
    return [*rows, *_followed(), *_approaches(follower), *_basins(follower), _wandering()]


def _followed() -> list[Row]:
    """Return arrivals of C2 by the motion itself, leg by leg."""
    speed, printed = reference.FOLLOWED_ARRIVALS
    found = followed_arrivals("C2", speed)
    return [
        _compared("C2, leg by leg", f"w_{k + 1}, rad/s", one, float(value), 1e-9)
        for k, (one, value) in enumerate(zip(printed, found[1:], strict=False))
    ]


def followed_arrivals(name: str, speed_rad_s: float) -> "np.typing.NDArray[np.float64]":
    """Return the speeds of arrivals at the first line, followed on the rigid sheet by events alone."""
    case = reference.CYCLES[name]
    momentum = case.drive.momentum_n_m_s - case.drive.inertia_kg_m2 * speed_rad_s
    start = BodyState(-case.law.beta_rad, -speed_rad_s, momentum_n_m_s=momentum)
    motion = follow_motion(start, case.drive, None, case.law, _FOLLOWED_S)
    states = motion.states(motion.firing_times_s)
    is_first_line = np.abs(states[:, 0] + case.law.beta_rad) < 1e-12
    return np.asarray(-states[is_first_line, 1])


def _approaches(follower: Follow) -> list[Row]:
    """Return where returns lead."""
    return [
        _compared(
            name,
            f"w after {returns} returns from {start:g}, rad/s",
            printed,
            float(follower(np.array([start]), returns, motion_of(name))[0, -1]),
            1e-6,
        )
        for name, start, returns, printed in reference.APPROACHES
    ]


def basin_count(name: str, follower: Follow = follow) -> int:
    """Return how many of 60 starts come within 1 % of the cycle."""
    starts = np.linspace(5e-6, 6e-4, 60)
    last = follower(starts, reference.BASIN_RETURNS, motion_of(name))[:, -1]
    return int(np.count_nonzero(np.abs(last / reference.CYCLES[name].speed_rad_s - 1.0) < 0.01))


def _basins(follower: Follow) -> list[Row]:
    return [
        _compared(name, "starts of 60 that reach the cycle", count, basin_count(name, follower), 0.0)
        for name, count in reference.BASINS.items()
    ]


def wandering_range() -> tuple[float, float]:
    """Return the least and the greatest arrival of A0 that never settles; NaN once it escapes."""
    step, speed, returns, _ = reference.WANDERING
    case = reference.CYCLES["A0"]
    motion = one_sided_motion(case.drive, case.law._replace(line_step_rad=step))
    speeds = follow(np.array([speed]), returns, motion)[0]
    return float(speeds.min()), float(speeds.max())


def _wandering() -> Row:
    """Return whether A0 stays bounded without settling; its extremes are chaotic, so they are no figures."""
    low, high = wandering_range()
    _, _, _, (printed_low, printed_high) = reference.WANDERING
    is_bounded = 0.5 * printed_low < low and high < 1.01 * printed_high
    return _holds("A0", "3000 returns bounded, never settled", is_true=is_bounded and low < 0.1 * high)


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


def capture_table() -> list[Row]:
    """Return T3."""
    rows: list[Row] = []
    for case in reference.CAPTURES:
        switch, mode = switch_of(case), mode_of(case)
        name = _name(case)
        least = least_capturing_amplitude_rad(switch, mode)
        rows.append(_compared(name, "p_cr by (18), rad", case.formula_rad, critical_amplitude_rad(switch, mode), 1e-6))
        rows.append(_compared(name, "p_min by following, rad", case.least_rad, least, 1e-4))
        if math.isinf(case.pulse_s) and least > 0.0:
            rows.append(_holds(name, "free at 0.99 p_min", is_true=not is_captured(case, 0.99 * least)))
            rows.append(_holds(name, "captured at 1.01 p_min", is_true=is_captured(case, 1.01 * least)))
    return rows


def _name(case: CaptureCase) -> str:
    law = "one line" if case.alpha_rad == case.beta_rad else "two lines" if math.isinf(case.pulse_s) else "timed"
    return f"w {case.omega_rad_s:g}, kn {case.coupling:g}, xi {case.damping_ratio:g}, rate {case.rate_rad_s:g}, {law}"


def cycle_switch() -> SwitchOn:
    """Return a switching on of cycle A at one line."""
    rate = 0.5 * reference.PULSE_RAD_S2
    return SwitchOn(reference.PULSE_RAD_S2, reference.PASSIVE_RAD_S2, rate, reference.ALPHA_RAD, reference.ALPHA_RAD)


def band_table() -> list[Row]:
    """Return T4, and the surface (26)."""
    rows: list[Row] = []
    for coupling, bands in reference.BANDS.items():
        for swing, band in bands.items():
            found = stable_band(cycle_switch(), coupling, swing)
            case = f"kn {coupling:g}, C {swing:g}"
            if band is None:
                rows.append(_holds(case, "no band", is_true=math.isnan(found.low_rad_s)))
                continue
            # seven digits are printed
            rows.append(_compared(case, "w-, rad/s", band[0], found.low_rad_s, 1e-6))
            rows.append(_compared(case, "w+, rad/s", band[1], found.high_rad_s, 1e-6))
    for swing, omega, printed in reference.SURFACE:
        mode = HubMode(omega, 0.01, 0.5)
        found_rad_s = rigid_frequency_rad_s(cycle_switch(), mode, swing)
        rows.append(_compared(f"C {swing:g}, w {omega:g}", "w_T by (26), rad/s", printed, found_rad_s, 1e-6))
    own = 2.0 * math.pi / cycle_period_s(reference.BASE, 1.0, 1)
    rows.append(_compared("A0", "own w_T, rad/s", reference.RIGID_FREQUENCY_RAD_S, own, 1e-6))
    return rows


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


def perpetual_table() -> list[Row]:
    """Return T5."""
    rows: list[Row] = []
    for case in reference.PERPETUAL:
        switch = SwitchOn(2e-4, 0.0, 1e-4, reference.ALPHA_RAD, reference.BETA_RAD)
        limit = perpetual_amplitude_rad(switch, HubMode(case.omega_rad_s, case.damping_ratio, case.coupling))
        lock = perpetual_lock(case)
        name = f"w {case.omega_rad_s:g}, kn {case.coupling:g}, xi {case.damping_ratio:g}, p0 {case.amplitude_rad:g}"
        rows.append(_compared(name, "p_inf / beta", case.lock_ratio, limit / reference.BETA_RAD, 6e-3))
        rows.append(_compared(name, "firings a period", case.firings_per_period, lock.firings_per_period, 0.02))
        if case.is_captured:
            rows.append(_compared(name, "amplitude, rad", case.final_amplitude_rad, lock.amplitude_rad, 1e-2))
        rows.append(
            _holds(
                name, "locked" if case.is_captured else "not locked", is_true=agrees_with_published(case, lock, limit)
            )
        )
    return rows


def agrees_with_published(case: PerpetualCase, lock: Lock, limit_rad: float) -> bool:
    """Return whether a run locked where it was to, at the amplitude of the energy balance, or stayed free."""
    if not case.is_captured:
        return lock.firings_per_period < _FREE_FIRINGS
    low, high = _LOCKED_FIRINGS
    is_near = abs(lock.amplitude_rad / limit_rad - 1.0) <= _LOCKED_AMPLITUDE
    return low <= lock.firings_per_period <= high and is_near


def schedules() -> dict[str, tuple[TorquePulse, ...]]:
    """Return the schedules of T6 by name."""
    _, (omega, xi, _), torque, width = reference.SCHEDULE_AXIS
    period_s = 2.0 * math.pi / omega
    half_s = math.pi / (omega * math.sqrt(1.0 - xi * xi))
    intervals = {"ten a period": period_s, "ten a half period": 0.5 * period_s, "ten every 10 s": 10.0}
    made: dict[str, tuple[TorquePulse, ...]] = {"single": (TorquePulse(0.0, width, torque),)}
    made |= {name: tuple(TorquePulse(k * apart, width, torque) for k in range(10)) for name, apart in intervals.items()}
    made["two halves"] = tuple(TorquePulse(k * half_s, width, 0.5 * torque) for k in range(2))
    return made


def schedule_table() -> list[Row]:
    """Return T6."""
    inertia, mode_numbers, _, _ = reference.SCHEDULE_AXIS
    mode = HubMode(*mode_numbers)
    tried = mode.omega_rad_s * np.linspace(1.0 - FREQUENCY_REACH, 1.0 + FREQUENCY_REACH, FREQUENCY_COUNT)
    rows: list[Row] = []
    for name, pulses in schedules().items():
        nominal = schedule_response(pulses, mode, inertia)
        scanned = schedule_response(pulses, mode, inertia, omega_rad_s=tried)
        found = {
            "peak": nominal.peak_rad[0],
            "residual": nominal.residual_rad[0],
            "scanned peak": scanned.peak_rad.max(),
            "scanned residual": scanned.residual_rad.max(),
        }
        # the residual of two halves is printed with five digits
        rows += [
            _compared(name, f"{figure}, rad", printed, float(found[figure]), 1e-6 if "halves" not in name else 4e-5)
            for figure, printed in reference.SCHEDULES[name].items()
        ]
    return rows


_TABLES = {
    "T1 Limit cycles": limit_cycle_table,
    "T2 Succession function": succession_table,
    "T3 Boundary of capture": capture_table,
    "T4 Band without capture, and surface (26)": band_table,
    "T5 Perpetual capture": perpetual_table,
    "T6 Torque schedules": schedule_table,
    "T7 Cycles over both lines": both_lines_table,
}


def reproduce() -> dict[str, list[Row]]:
    """Return all tables of the study by title."""
    return {title: table() for title, table in _TABLES.items()}
