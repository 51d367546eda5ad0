"""Torque schedules judged against a flexible mode."""

import cmath
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray
from service.core.flexible.spacecraft import (
    HubMode,
    require_finite,
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


class ScheduleLimits(NamedTuple):
    """Limits of a schedule on one axis."""

    inertia_kg_m2: float
    modes: tuple[HubMode, ...]
    #: hub angle that panels may add
    peak_allowed_rad: float


class ScheduleMetrics(NamedTuple):
    """Metrics of a schedule, worst case over frequencies, sum over modes."""

    peak_rad: float
    #: amplitude of the oscillation after the last edge
    residual_rad: float
    #: greatest swing after any edge: a schedule may undo at its end what it did before
    swing_rad: float
    worst_mode: int
    worst_omega_rad_s: float
    #: per mode, at its own frequency
    nominal: tuple[ModeResponse, ...]


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
    return ScheduleMetrics(
        peak_rad=sum(peaks),
        residual_rad=sum(residuals),
        swing_rad=sum(swings),
        worst_mode=worst_mode,
        worst_omega_rad_s=omegas[worst_mode],
        nominal=tuple(nominal),
    )


def require_limits(limits: ScheduleLimits) -> None:
    """Refuse limits that are not physical; ValueError says which number and what to do."""
    require_positive("inertia_kg_m2", limits.inertia_kg_m2)
    require_positive("peak_allowed_rad", limits.peak_allowed_rad)
    if not limits.modes:
        raise ValueError("no flexible mode is given: there is nothing to excite; give omega, damping and coupling")
    for mode in limits.modes:
        require_mode(mode)


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
    """Verdict on a schedule, its metrics with what was carried, and what would help."""

    #: accept; reject: the peak is above what is allowed
    verdict: str
    metrics: ScheduleMetrics
    #: best first
    suggestions: tuple[Suggestion, ...]


def check_schedule(
    pulses: tuple[TorquePulse, ...], limits: ScheduleLimits, carried_rad: tuple[complex, ...]
) -> ScheduleCheck:
    """Return the verdict on a schedule.

    Parameters
    ----------
    pulses : tuple of TorquePulse
        In any order.
    limits : ScheduleLimits
        Inertia and modes of the axis, and the hub angle that they may add.
    carried_rad : tuple of complex, rad
        Z of each mode at time zero (`carry_phasor`); 0: at rest.

    Raises
    ------
    ValueError
        Something is not physical, or pulses overlap; the message says what and what to do.

    Examples
    --------
    >>> check = check_schedule(
    ...     (TorquePulse(0.0, 1.0, 0.2),), ScheduleLimits(5000.0, (HubMode(0.6, 0.003, 0.4),), 1e-4), (0j,)
    ... )
    >>> check.verdict, f"{check.metrics.peak_rad:.4e}"
    ('accept', '3.0888e-05')
    """
    require_limits(limits)
    if len(carried_rad) != len(limits.modes) or not all(cmath.isfinite(one) for one in carried_rad):
        raise ValueError(f"carried_rad must hold one finite number for each of {len(limits.modes)} modes")
    ordered = ordered_schedule(pulses)
    metrics = schedule_metrics(ordered, limits, carried_rad)
    verdict = _verdict(metrics, limits)
    suggestions = () if verdict == "accept" else _suggestions(ordered, limits, carried_rad, metrics)
    return ScheduleCheck(verdict, metrics, suggestions)


def _verdict(metrics: ScheduleMetrics, limits: ScheduleLimits) -> str:
    return "reject" if metrics.peak_rad > limits.peak_allowed_rad else "accept"


def _suggestions(
    pulses: tuple[TorquePulse, ...],
    limits: ScheduleLimits,
    carried_rad: tuple[complex, ...],
    metrics: ScheduleMetrics,
) -> tuple[Suggestion, ...]:
    """Return changes that help, judged like the schedule itself, best first."""
    mode = limits.modes[metrics.worst_mode]
    made = []
    for kind, value_s, changed in (*_splits(pulses, mode), *_widths(pulses, mode), *_intervals(pulses, mode)):
        tried = schedule_metrics(changed, limits, carried_rad)
        if tried.peak_rad < _WORTH * metrics.peak_rad or tried.swing_rad < _WORTH * metrics.swing_rad:
            made.append(Suggestion(kind, value_s, _verdict(tried, limits), tried.peak_rad, tried.residual_rad))
    made += _waits(pulses, limits, carried_rad)
    return tuple(sorted(made, key=lambda one: (one.verdict != "accept", one.peak_rad, one.residual_rad)))


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
    pulses: tuple[TorquePulse, ...], limits: ScheduleLimits, carried_rad: tuple[complex, ...]
) -> list[Suggestion]:
    """Return the time after which what was carried has decayed enough, where that is what stands in the way."""
    own = schedule_metrics(pulses, limits, (0j,) * len(carried_rad))
    carried = sum(abs(one) for one in carried_rad)
    # a hair below the level itself
    left_rad = 0.999 * (limits.peak_allowed_rad - own.peak_rad)
    if not 0.0 < left_rad < carried:
        return []
    slowest_1_s = min(mode.damping_ratio * mode.omega_rad_s for mode in limits.modes)
    wait_s = math.log(carried / left_rad) / slowest_1_s
    decayed = tuple(one * left_rad / carried for one in carried_rad)
    tried = schedule_metrics(pulses, limits, decayed)
    return [Suggestion("wait", wait_s, _verdict(tried, limits), tried.peak_rad, tried.residual_rad)]


def _is_apart(pulses: list[TorquePulse]) -> bool:
    """Return whether no pulse begins before another one has ended."""
    return all(latter.start_s >= former.stop_s for former, latter in pairwise(sorted(pulses)))
