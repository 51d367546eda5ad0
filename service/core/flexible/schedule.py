"""Torque schedules judged against a flexible mode."""

import cmath
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.flexible.capture import SwitchOn, critical_amplitude_rad, perpetual_amplitude_rad
from service.core.flexible.spacecraft import (
    HubMode,
    SwitchingLaw,
    require_finite,
    require_law,
    require_mode,
    require_not_negative,
    require_positive,
)

ComplexArray = NDArray[np.complex128]


class TorquePulse(NamedTuple):
    """One pulse of a schedule, on the body, in the clock of the schedule."""

    start_s: float
    duration_s: float
    torque_n_m: float

    @property
    def stop_s(self) -> float:
        """Return its end."""
        return self.start_s + self.duration_s


class ModeResponse(NamedTuple):
    """Response of one mode to a schedule, at one or more frequencies; all hub angles."""

    #: (F,) rad/s
    omega_rad_s: FloatArray
    #: (F,) rad, greatest deflection from time zero on, also after the last edge
    peak_rad: FloatArray
    #: (F,) rad, amplitude of the oscillation after the last edge
    residual_rad: FloatArray
    #: (F,) rad, greatest amplitude about the mode's centre, carried and after every edge
    swing_rad: FloatArray
    #: (F,) rad, Z at the last edge
    phasor_rad: ComplexArray
    #: s, the last edge, 0 without pulses
    end_s: float


def ordered_schedule(pulses: tuple[TorquePulse, ...]) -> tuple[TorquePulse, ...]:
    """Return the pulses by start.

    Raises
    ------
    ValueError
        A pulse without length, before time zero, not finite, or over another one.
    """
    for number, pulse in enumerate(pulses):
        require_not_negative(f"pulses[{number}].start_s", pulse.start_s)
        require_positive(f"pulses[{number}].duration_s", pulse.duration_s)
        require_finite(f"pulses[{number}].torque_n_m", pulse.torque_n_m)
    ordered = tuple(sorted(pulses))
    for former, latter in pairwise(ordered):
        # ends are sums of two decimals: a hair of overlap is rounding
        if latter.start_s < former.stop_s - 1e-9 * max(1.0, former.stop_s):
            raise ValueError(
                f"the pulse at {latter.start_s:g} s begins before the one at {former.start_s:g} s has ended "
                f"({former.stop_s:g} s): the wheel gives one torque at a time; move it or send their sum"
            )
    return ordered


def schedule_response(
    pulses: tuple[TorquePulse, ...],
    mode: HubMode,
    inertia_kg_m2: float,
    *,
    carried_rad: complex = 0j,
    omega_rad_s: FloatArray | None = None,
) -> ModeResponse:
    """Return the response of a mode to a schedule.

    Parameters
    ----------
    pulses : tuple of TorquePulse
        In order and apart (`ordered_schedule`).
    mode : HubMode
        w, xi, kn.
    inertia_kg_m2 : float, kg m^2
        Inertia of the axis.
    carried_rad : complex, rad
        Z at time zero, left by earlier schedules.
    omega_rad_s : ndarray, shape (F,), rad/s, or None
        Frequencies to try in place of the mode's own.

    Notes
    -----
    A single pulse of tau leaves ``2 x |sin(w tau / 2)|`` without damping; N of them every T leave
    ``|1 - q^N| / |1 - q|`` times that of one, ``q = exp((-xi w + i w nu) T)``.

    Examples
    --------
    >>> response = schedule_response((TorquePulse(0.0, 1.0, 0.2),), HubMode(0.6, 0.003, 0.4), 5000.0)
    >>> f"{response.peak_rad[0]:.6e}"
    '2.614520e-05'
    """
    omega = np.array([mode.omega_rad_s]) if omega_rad_s is None else omega_rad_s
    exponent: ComplexArray = np.asarray(omega * complex(-mode.damping_ratio, _nu(mode)), dtype=np.complex128)
    step = mode.coupling / (inertia_kg_m2 * omega**2)
    kick = step * complex(1.0, -mode.damping_ratio / _nu(mode))
    phasor = np.full(len(omega), carried_rad, dtype=np.complex128)
    edges_s, changes_n_m = np.array([(0.0, 0.0), *_edges(pulses)]).T
    stretches_s = np.append(np.diff(edges_s), math.inf)[:, None]
    begun, ended = [phasor], list[ComplexArray]()
    for turn, change_n_m in zip(np.exp(exponent * stretches_s[:-1]), changes_n_m[1:], strict=True):
        ended.append(begun[-1] * turn)
        begun.append(ended[-1] - kick * change_n_m)
    # all stretches at once: one after another, 500 pulses on 16 modes take four times as long
    centres, phasors = np.cumsum(changes_n_m)[:, None] * step, np.array(begun)
    # what is left of the centre after equal steps up and down is rounding
    centres[-1] = 0.0
    peak = _turning_peaks(centres, phasors, exponent, stretches_s).max(axis=0)
    if ended:
        peak = np.maximum(peak, np.abs(centres[:-1] + np.array(ended).real).max(axis=0))
    swings = np.abs(phasors)
    return ModeResponse(omega, peak, swings[-1], swings.max(axis=0), phasors[-1], float(edges_s[-1]))


def carry_phasor(phasor_rad: complex, mode: HubMode, elapsed_s: float) -> complex:
    """Return Z after a free time: from the last edge of one schedule to time zero of the next."""
    turned = np.exp(mode.omega_rad_s * complex(-mode.damping_ratio, _nu(mode)) * elapsed_s)
    return complex(phasor_rad * turned)


def _nu(mode: HubMode) -> float:
    """Return sqrt(1 - xi^2)."""
    return math.sqrt(1.0 - mode.damping_ratio**2)


def _edges(pulses: tuple[TorquePulse, ...]) -> list[tuple[float, float]]:
    """Return times and steps of torque, in order of time."""
    edges = [(pulse.start_s, pulse.torque_n_m) for pulse in pulses]
    edges += [(pulse.stop_s, -pulse.torque_n_m) for pulse in pulses]
    return sorted(edges)


def _turning_peaks(
    centre: FloatArray, phasor: ComplexArray, exponent: ComplexArray, duration_s: FloatArray
) -> FloatArray:
    """Return the greatest deflections (K, F) of K stretches without edges at their begin and their first two turns."""
    frequency = exponent.imag
    first_s = np.mod(0.5 * np.pi - np.angle(exponent * phasor), np.pi) / frequency
    peak = np.abs(centre + phasor.real)
    for turn_s in (first_s, first_s + np.pi / frequency):
        reached = centre + (phasor * np.exp(exponent * np.minimum(turn_s, duration_s))).real
        peak = np.maximum(peak, np.abs(reached))
    return peak


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
