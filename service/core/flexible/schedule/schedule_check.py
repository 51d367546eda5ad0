"""Verdict on a torque schedule of one axis, with what to change where it is not accepted."""

import cmath
import math
from itertools import pairwise
from typing import NamedTuple

from service.core.flexible.schedule.schedule_metrics import (
    WARNED_SHARE,
    OnboardRegulator,
    ScheduleLimits,
    ScheduleMetrics,
    reasons_of,
    regulator_boundary_rad,
    require_limits,
    schedule_metrics,
)
from service.core.flexible.schedule.schedule_response import TorquePulse, ordered_schedule
from service.core.flexible.spacecraft import HubMode
from service.core.flexible.switching_law import SwitchingLaw

#: a swing or peak must become less than this share of what it was to be worth a suggestion
_WORTH = 0.95
#: intervals that differ by less are one interval
_SAME_INTERVAL = 1e-6


class Suggestion(NamedTuple):
    """One change of a schedule and its effect."""

    #: "split": each pulse in two halves that far apart; "width": pulses of that length, impulse kept; "interval":
    #: pulses that far apart; "wait": send it that much later
    kind: str
    value_s: float
    verdict: str
    peak_rad: float
    residual_rad: float


class ScheduleCheck(NamedTuple):
    """Verdict on a schedule."""

    #: accept, warn or reject
    verdict: str
    #: why, in words of one: peak, always_captured, captured, momentum; near_capture, perpetual_capture
    reasons: tuple[str, ...]
    #: worst case over +-15 % of each frequency, sum over modes, what was carried included
    peak_rad: float
    residual_rad: float
    #: greatest swing after any edge, which the regulator may meet
    swing_rad: float
    #: least p_cr; infinite without a regulator
    p_cr_rad: float
    #: p_cr less the greatest swing
    margin_rad: float
    #: greatest p_inf of a relay, 0 without
    p_inf_rad: float
    #: place of the mode with the greatest peak, and the frequency at which it is greatest
    worst_mode: int
    worst_omega_rad_s: float
    #: least and greatest momentum of the wheel
    momentum_n_m_s: tuple[float, float]
    #: best first
    suggestions: tuple[Suggestion, ...]
    #: at each mode's own frequency: peak and Z at `end_s`, to be carried to the next uplink
    nominal_peak_rad: tuple[float, ...]
    phasor_rad: tuple[complex, ...]
    end_s: float


_RANK = {"accept": 0, "warn": 1, "reject": 2}


def analyse_schedule(
    *,
    pulses: tuple[tuple[float, float, float], ...],
    inertia_kg_m2: float,
    modes: tuple[tuple[float, float, float], ...],
    peak_allowed_rad: float,
    alpha_rad: float | None = None,
    beta_rad: float | None = None,
    pulse_s: float = math.inf,
    motor_torque_n_m: float | None = None,
    friction_torque_n_m: float = 0.0,
    rate_rad_s: float = 0.0,
    momentum_n_m_s: float = 0.0,
    momentum_limit_n_m_s: float = math.inf,
    carried_rad: tuple[complex, ...] | None = None,
) -> ScheduleCheck:
    """Return the verdict on a torque schedule from plain numbers.

    Parameters
    ----------
    pulses : tuple of (start_s, duration_s, torque_n_m)
        Torque on the body; start counts from the schedule's time zero.
    inertia_kg_m2 : float, kg m^2
        Inertia of the axis.
    modes : tuple of (omega_rad_s, damping_ratio, coupling)
        Flexible modes that this axis feels.
    peak_allowed_rad : float
        Hub angle that they may add.
    alpha_rad, beta_rad, pulse_s, motor_torque_n_m, friction_torque_n_m, rate_rad_s
        Regulator on board; all of alpha, beta and motor torque absent: there is none.
    momentum_n_m_s, momentum_limit_n_m_s : float, N m s
        Wheel of the axis.
    carried_rad : tuple of complex or None, rad
        Z of each mode at time zero (`schedule_response.carry_phasor`); default: at rest.

    Raises
    ------
    ValueError
        Something is not physical, or pulses overlap; the message says what and what to do.

    Examples
    --------
    >>> check = analyse_schedule(
    ...     pulses=((0.0, 1.0, 0.2),), inertia_kg_m2=5000.0, modes=((0.6, 0.003, 0.4),), peak_allowed_rad=1e-4
    ... )
    >>> check.verdict, f"{check.peak_rad:.4e}"
    ('accept', '3.0888e-05')
    """
    regulator = None
    if alpha_rad is not None and beta_rad is not None and motor_torque_n_m is not None:
        law = SwitchingLaw(alpha_rad, beta_rad, pulse_s)
        regulator = OnboardRegulator(law, motor_torque_n_m, friction_torque_n_m, rate_rad_s)
    elif (alpha_rad, beta_rad, motor_torque_n_m) != (None, None, None):
        raise ValueError("a regulator needs all of alpha_rad, beta_rad and motor_torque_n_m; give the missing, or none")
    limits = ScheduleLimits(
        inertia_kg_m2,
        tuple(HubMode(*mode) for mode in modes),
        peak_allowed_rad,
        regulator,
        momentum_n_m_s,
        momentum_limit_n_m_s,
    )
    carried = (0j,) * len(modes) if carried_rad is None else carried_rad
    return check_schedule(tuple(TorquePulse(*pulse) for pulse in pulses), limits, carried)


def check_schedule(
    pulses: tuple[TorquePulse, ...], limits: ScheduleLimits, carried_rad: tuple[complex, ...]
) -> ScheduleCheck:
    """Return the verdict on a schedule."""
    require_limits(limits)
    if len(carried_rad) != len(limits.modes) or not all(cmath.isfinite(one) for one in carried_rad):
        raise ValueError(f"carried_rad must hold one finite number for each of {len(limits.modes)} modes")
    ordered = ordered_schedule(pulses)
    boundary_rad = regulator_boundary_rad(limits)
    figures = schedule_metrics(ordered, limits, carried_rad)
    verdict, reasons = _judge(figures, limits, boundary_rad)
    suggestions = () if verdict == "accept" else _suggestions(ordered, limits, carried_rad, figures, boundary_rad)
    return ScheduleCheck(
        verdict=verdict,
        reasons=reasons,
        peak_rad=figures.peak_rad,
        residual_rad=figures.residual_rad,
        swing_rad=figures.swing_rad,
        p_cr_rad=boundary_rad[0],
        margin_rad=boundary_rad[0] - figures.swing_rad,
        p_inf_rad=boundary_rad[1],
        worst_mode=figures.worst_mode,
        worst_omega_rad_s=figures.worst_omega_rad_s,
        momentum_n_m_s=figures.momentum_n_m_s,
        suggestions=suggestions,
        nominal_peak_rad=tuple(float(one.peak_rad[0]) for one in figures.nominal),
        phasor_rad=tuple(complex(one.phasor_rad[0]) for one in figures.nominal),
        end_s=figures.nominal[0].end_s,
    )


def _judge(
    figures: ScheduleMetrics, limits: ScheduleLimits, boundary_rad: tuple[float, float]
) -> tuple[str, tuple[str, ...]]:
    """Return verdict and reasons."""
    rejected, warned = reasons_of(figures, limits, boundary_rad)
    return ("reject" if rejected else "warn" if warned else "accept"), (*rejected, *warned)


def _suggestions(
    pulses: tuple[TorquePulse, ...],
    limits: ScheduleLimits,
    carried_rad: tuple[complex, ...],
    figures: ScheduleMetrics,
    boundary_rad: tuple[float, float],
) -> tuple[Suggestion, ...]:
    """Return changes that help, judged like the schedule itself, best first."""
    mode = limits.modes[figures.worst_mode]
    made = []
    for kind, value_s, changed in (*_splits(pulses, mode), *_widths(pulses, mode), *_intervals(pulses, mode)):
        tried = schedule_metrics(changed, limits, carried_rad)
        verdict, _ = _judge(tried, limits, boundary_rad)
        if tried.peak_rad < _WORTH * figures.peak_rad or tried.swing_rad < _WORTH * figures.swing_rad:
            made.append(Suggestion(kind, value_s, verdict, tried.peak_rad, tried.residual_rad))
    made += _waits(pulses, limits, carried_rad, boundary_rad)
    return tuple(sorted(made, key=lambda one: (_RANK[one.verdict], one.peak_rad, one.residual_rad)))


_Change = tuple[str, float, tuple[TorquePulse, ...]]


def _splits(pulses: tuple[TorquePulse, ...], mode: HubMode) -> list[_Change]:
    """Return each pulse in two halves, half a damped period apart, where they fit."""
    apart_s = math.pi / (mode.omega_rad_s * math.sqrt(1.0 - mode.damping_ratio**2))
    halves = []
    for pulse in pulses:
        half = pulse._replace(torque_n_m=0.5 * pulse.torque_n_m)
        halves += [half, half._replace(start_s=pulse.start_s + apart_s)]
    return [("split", apart_s, tuple(sorted(halves)))] if _is_apart(halves) else []


def _widths(pulses: tuple[TorquePulse, ...], mode: HubMode) -> list[_Change]:
    """Return pulses that last whole periods, impulse kept and never stronger, where they fit."""
    period_s = 2.0 * math.pi / mode.omega_rad_s
    longest_s = max((pulse.duration_s for pulse in pulses), default=0.0)
    width_s = max(1, math.ceil(longest_s / period_s - 1e-9)) * period_s
    wide = [TorquePulse(pulse.start_s, width_s, pulse.torque_n_m * pulse.duration_s / width_s) for pulse in pulses]
    return [("width", width_s, tuple(wide))] if _is_apart(wide) else []


def _intervals(pulses: tuple[TorquePulse, ...], mode: HubMode) -> list[_Change]:
    """Return equally spaced pulses half a period further from the mode's own rhythm."""
    intervals = [latter.start_s - former.start_s for former, latter in pairwise(pulses)]
    if not intervals or max(intervals) - min(intervals) > _SAME_INTERVAL * max(intervals):
        return []
    period_s = 2.0 * math.pi / mode.omega_rad_s
    interval_s = (math.floor(intervals[0] / period_s) + 0.5) * period_s
    if interval_s < intervals[0]:
        interval_s += period_s
    spaced = [pulse._replace(start_s=pulses[0].start_s + k * interval_s) for k, pulse in enumerate(pulses)]
    return [("interval", interval_s, tuple(spaced))]


def _waits(
    pulses: tuple[TorquePulse, ...],
    limits: ScheduleLimits,
    carried_rad: tuple[complex, ...],
    boundary_rad: tuple[float, float],
) -> list[Suggestion]:
    """Return the time after which what was carried has decayed enough, where that is what stands in the way."""
    own = schedule_metrics(pulses, limits, (0j,) * len(carried_rad))
    carried = sum(abs(one) for one in carried_rad)
    left_rad = min(WARNED_SHARE * boundary_rad[0] - own.swing_rad, limits.peak_allowed_rad - own.peak_rad)
    # a hair below the level itself
    left_rad *= 0.999
    if not 0.0 < left_rad < carried:
        return []
    slowest_1_s = min(mode.damping_ratio * mode.omega_rad_s for mode in limits.modes)
    wait_s = math.log(carried / left_rad) / slowest_1_s
    faded = tuple(one * left_rad / carried for one in carried_rad)
    tried = schedule_metrics(pulses, limits, faded)
    verdict, _ = _judge(tried, limits, boundary_rad)
    return [Suggestion("wait", wait_s, verdict, tried.peak_rad, tried.residual_rad)]


def _is_apart(pulses: list[TorquePulse]) -> bool:
    """Return whether no pulse begins before another one has ended."""
    return all(latter.start_s >= former.stop_s for former, latter in pairwise(sorted(pulses)))
