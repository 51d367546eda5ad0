"""Attitude of the spacecraft in truth, and the operator who corrects it."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from analyzer_sim.epochs import US_PER_S
from analyzer_sim.streams import FloatArray, first_order, stream
from analyzer_sim.world.orbit import EARTH_RATE_RAD_S, EpochArray
from analyzer_sim.world.scenario.events import chunk_edges, holds_of, planned_deg, unexecuted_deg
from analyzer_sim.world.scenario.story import SLEW_MIN, TIMETABLE, TURNS_H, KeepingErrors, Scenario

#: exchange of roll and yaw, 1/h
ORBITAL_RATE_PER_H = EARTH_RATE_RAD_S * 3600.0


def coupling_step(hours: float, *, is_coupled: bool) -> tuple[FloatArray, FloatArray]:
    """Return (phi, gamma): attitude after `hours` = phi @ attitude + gamma @ constant rate in deg/h."""
    rate = ORBITAL_RATE_PER_H if is_coupled else 0.0
    angle = rate * hours
    cosine, sine = np.cos(angle), np.sin(angle)
    phi = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    along = hours * np.sinc(angle / np.pi)
    across = 0.5 * hours * angle * np.sinc(0.5 * angle / np.pi) ** 2
    gamma = np.array([[along, -across, 0.0], [across, along, 0.0], [0.0, 0.0, hours]])
    return phi, gamma


#: a carrier is believed to deviate by no more, dB
CUT_DB = 0.5
#: noise of a carrier in a mean of half an hour: 0.1 dB that last for hours count as white noise of three times the size
_SLOW_DB = 0.3
#: knowledge of the angles at the start, deg
_START_DEG = 0.02
#: rows of so many hours are averaged into one measurement
MEAN_H = 0.5


def sensed_error_deg(
    sensitivity_db_per_deg: FloatArray, noise_db: FloatArray, is_aligned: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return what noise (T, N) looks like as attitude (T, 3), deg, and its covariance (3, 3) for a slow noise.

    The level of each carrier in the rows `is_aligned` (T,) is its reference.
    """
    design = np.column_stack([sensitivity_db_per_deg, np.ones(len(sensitivity_db_per_deg))])
    solve = np.linalg.pinv(design)[:3]
    cut_db = np.clip(noise_db - noise_db[is_aligned].mean(axis=0), -CUT_DB, CUT_DB)
    return np.asarray(cut_db @ solve.T), np.asarray(_SLOW_DB**2 * solve @ solve.T)


class Operator:
    """Kalman filter of angles and drift, deg and deg/h, order yaw, roll, pitch."""

    def __init__(self, start_deg: FloatArray, sensed_deg2: FloatArray, keeping: KeepingErrors) -> None:
        self._keeping, self._sensed_deg2 = keeping, sensed_deg2
        self._drift_deg_h = np.array(keeping.drift_deg_h)
        self._state = np.concatenate([start_deg, np.zeros(3)])
        self._covariance = np.diag(np.concatenate([np.full(3, _START_DEG**2), self._drift_deg_h**2]))

    def sense(self, sensed_deg: FloatArray) -> FloatArray:
        """Take in what the powers look like as attitude (3,), and return the estimate (3,)."""
        gain = np.linalg.solve(self._covariance[:3, :3] + self._sensed_deg2, self._covariance[:3]).T
        self._state = self._state + gain @ (sensed_deg - self._state[:3])
        self._covariance = self._covariance - gain @ self._covariance[:3]
        return np.asarray(self._state[:3].copy())

    def predict(self, hours: float, commanded_deg_h: FloatArray) -> None:
        """Carry the estimate on under a commanded rate (3,)."""
        phi, gamma = coupling_step(hours, is_coupled=self._keeping.is_coupling_announced)
        keep = float(np.exp(-hours * 3600.0 / self._keeping.drift_tau_s))
        transition = np.block([[phi, gamma], [np.zeros((3, 3)), keep * np.eye(3)]])
        self._state = transition @ self._state
        self._state[:3] += gamma @ commanded_deg_h
        self._covariance = transition @ self._covariance @ transition.T
        self._covariance[3:, 3:] += np.diag(self._drift_deg_h**2 * (1.0 - keep**2))


#: the limit cycle under the star tracker never leaves this, deg
TRACKER_LIMIT_DEG = 0.095
AXES = ("yaw", "roll", "pitch")
#: a slew to the attitude of the alignment begins so long before it
ALIGNMENT_SLEW_MIN = 5.0


@dataclass(frozen=True, slots=True)
class Correction:
    """A change of attitude commanded by the ground, spread evenly over [start, stop)."""

    start_us: int
    stop_us: int
    #: yaw, roll, pitch, total over the interval
    attitude_deg: tuple[float, float, float]
    #: epoch at which the ground is told: the start, or some time after the end
    reported_us: int

    @property
    def is_late(self) -> bool:
        """Return whether the ground hears of it only afterwards."""
        return self.reported_us > self.start_us


@dataclass(frozen=True, slots=True)
class AttitudeHistory:
    """True attitude of every row and the corrections that the ground knows."""

    #: (T, 3) deg, order yaw, roll, pitch
    attitude_deg: FloatArray
    corrections: tuple[Correction, ...]


class Sensing(NamedTuple):
    """Attitude error of an operator who commands from the powers, and its covariance as he assumes it."""

    #: (T, 3) error of the attitude by noise and weather, deg
    error_deg: FloatArray
    #: (3, 3) assumed covariance, deg^2
    covariance_deg2: FloatArray


def attitude_history(
    scenario: Scenario, seed: int, epochs_us: EpochArray, sensing: Sensing | None = None
) -> AttitudeHistory:
    """Return the attitude at every epoch of a scenario and the corrections that were announced.

    Corrections come from an operator who commands from the powers where his `sensing` is given, else from one who knows
    the truth but for an error of his own.
    """
    tracked = _tracked_deg(scenario, seed, epochs_us)
    first = int(np.searchsorted(epochs_us, scenario.operation_start_us))
    if first >= len(epochs_us):
        return AttitudeHistory(tracked, ())
    of_operation = None if sensing is None else sensing._replace(error_deg=sensing.error_deg[first:])
    free, corrections = _free_flight(scenario, seed, epochs_us[first:], tracked[first], of_operation)
    return AttitudeHistory(np.concatenate([tracked[:first], free]), corrections)


def _tracked_deg(scenario: Scenario, seed: int, epochs_us: EpochArray) -> FloatArray:
    """Return the attitude under the star tracker: the timetable and a bounded limit cycle."""
    figures = scenario.keeping
    cycle = np.stack(
        [
            first_order(
                stream(seed, "limit cycle", axis), len(epochs_us), scenario.row_period_s, sigma, figures.tracker_tau_s
            )
            for axis, sigma in zip(AXES, figures.tracker_deg, strict=True)
        ],
        axis=1,
    )
    bounded = TRACKER_LIMIT_DEG * np.tanh(cycle / TRACKER_LIMIT_DEG)
    minutes = (epochs_us - scenario.phase("turns").start_us) / (60.0 * US_PER_S)
    knots_min, knots_deg = [-1e9], [(0.0, 0.0, 0.0)]
    for turn in TIMETABLE:
        knots_min += [turn.start_min, turn.start_min + SLEW_MIN]
        knots_deg += [knots_deg[-1], turn.attitude_deg]
    if any(figures.alignment_deg):
        signs = stream(seed, "alignment attitude").choice([-1.0, 1.0], size=3)
        yaw, roll, pitch = (signs * np.array(figures.alignment_deg)).tolist()
        slew_min = 60.0 * TURNS_H - ALIGNMENT_SLEW_MIN
        knots_min += [slew_min, slew_min + SLEW_MIN]
        knots_deg += [knots_deg[-1], (yaw, roll, pitch)]
    table = np.array(knots_deg)
    turned = np.stack([np.interp(minutes, knots_min, table[:, axis]) for axis in range(3)], axis=1)
    return np.asarray(bounded + turned)


def _noise_series(
    seed: int, name: str, count: int, step_s: float, sigmas: tuple[float, ...], tau_s: float
) -> FloatArray:
    series = [
        first_order(stream(seed, name, axis), count, step_s, sigma, tau_s)
        for axis, sigma in zip(AXES, sigmas, strict=True)
    ]
    return np.stack(series, axis=1)


def _free_flight(
    scenario: Scenario, seed: int, epochs_us: EpochArray, start_deg: FloatArray, sensing: Sensing | None
) -> tuple[FloatArray, tuple[Correction, ...]]:
    """Fly the operation phase: the ground commands piece by piece, the spacecraft drifts in between."""
    figures, count, step_s = scenario.keeping, len(epochs_us), scenario.row_period_s
    holds = holds_of(scenario.manoeuvres, seed, scenario.operation_h)
    hours = np.asarray(np.arange(count + 1) * step_s / 3600.0, dtype=np.float64)
    announced = planned_deg([hold for hold in holds if hold.is_announced], hours)
    secret = planned_deg([hold for hold in holds if not hold.is_announced], hours)
    balanced = planned_deg([hold for hold in holds if hold.is_balance_announced and not hold.is_announced], hours)
    lead = unexecuted_deg(scenario.manoeuvres, seed, hours)
    drift = _noise_series(seed, "drift", count, step_s, figures.drift_deg_h, figures.drift_tau_s)
    ignorance = _noise_series(seed, "knowledge", count, step_s, figures.knowledge_deg, figures.knowledge_tau_s)
    effect = 1.0 + stream(seed, "correction scale").normal(0.0, figures.scale_error, 3)
    phi, gamma = coupling_step(step_s / 3600.0, is_coupled=figures.is_coupled)
    attitude = np.empty((count + 1, 3))
    attitude[0] = start_deg
    operator = None if sensing is None else Operator(start_deg, sensing.covariance_deg2, figures)
    corrections = []
    for first, last in pairwise(chunk_edges(holds, count, step_s).tolist()):
        span_h = (last - first) * step_s / 3600.0
        if operator is None or sensing is None:
            known = attitude[first] + ignorance[first]
        else:
            since = max(0, first - round(3600.0 * MEAN_H / step_s))
            known = operator.sense(attitude[first] + sensing.error_deg[since : first + 1].mean(axis=0))
        feedback = _feedback(known - announced[first] - secret[first], span_h, figures)
        balance = _balance(balanced[first], balanced[last], figures)
        reported = _feed_forward(announced[first], announced[last], span_h, figures) + feedback + balance
        if operator is not None:
            operator.predict(span_h, reported)
        untold = _feed_forward(secret[first], secret[last], span_h, figures) - balance
        rates = effect * reported + untold + drift[first:last]
        attitude[first + 1 : last + 1] = _propagate(attitude[first], rates @ gamma.T, phi)
        start_us, stop_us = (int(epochs_us[0]) + row * scenario.row_period_us for row in (first, last))
        total = np.round(reported * span_h + (lead[last] - lead[first]), 7).tolist()
        reported_us = _reported_us(start_us, stop_us, figures)
        corrections.append(Correction(start_us, stop_us, (total[0], total[1], total[2]), reported_us))
    return attitude[:count], tuple(corrections)


def _reported_us(start_us: int, stop_us: int, figures: KeepingErrors) -> int:
    late_min = figures.corrections_late_min
    return start_us if late_min is None else stop_us + round(60.0 * late_min) * US_PER_S


def _feed_forward(begin: FloatArray, end: FloatArray, span_h: float, figures: KeepingErrors) -> FloatArray:
    """Return the rate that leads from one planned attitude to the next against the coupling."""
    return np.asarray((end - begin) / span_h + _balance(begin, end, figures))


def _balance(begin: FloatArray, end: FloatArray, figures: KeepingErrors) -> FloatArray:
    """Return the rate against the coupling, as far as those who plan believe in it."""
    rate = ORBITAL_RATE_PER_H if figures.is_coupling_announced else 0.0
    middle = 0.5 * (begin + end)
    return -rate * np.array([-middle[1], middle[0], 0.0])


def _feedback(deviation_deg: FloatArray, span_h: float, figures: KeepingErrors) -> FloatArray:
    """Return the rate that removes the known deviation within the feedback time."""
    share = -np.expm1(-span_h * 3600.0 / figures.feedback_tau_s)
    return np.asarray(-share * deviation_deg / span_h)


def _propagate(start_deg: FloatArray, increments_deg: FloatArray, phi: FloatArray) -> FloatArray:
    """Return the attitude (n, 3) after each of n steps."""
    cosine, sine = float(phi[0, 0]), float(phi[1, 0])
    yaw, roll, pitch = start_deg.tolist()
    states = []
    for yaw_step, roll_step, pitch_step in increments_deg.tolist():
        yaw, roll, pitch = (
            cosine * yaw - sine * roll + yaw_step,
            sine * yaw + cosine * roll + roll_step,
            pitch + pitch_step,
        )
        states.append((yaw, roll, pitch))
    return np.array(states)
