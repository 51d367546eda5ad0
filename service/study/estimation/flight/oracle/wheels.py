"""Momentum of the wheels in the oracle: what gathers by a torque, and what a report of it has wrong.

    H' = turn of the orbit + (1 + c) T + q cos 2a + r sin 2a + n     H N m s of the whole spacecraft, orbital frame
    reported = h + e x h + s h + noise,   h = C H - J w              of the wheels, in the body

T is the profile that the ground states, c the share of each axis that it has wrong, most of it common; q, r the wave of
half a day, a phase of the day (constant and wave of a day too where no profile is stated), n a torque of first order; e
misalignment, s scale, C the true turn of the body, w its rate. In operation w follows from corrections and drift;
before it is known. Vectors x roll, y pitch, z yaw. An unloading is known when it happens. Reports count at rows of
powers.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from service.records.catalogue import FedForwardTorque
from service.records.epoch import US_PER_S
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import FloatArray
from service.study.estimation.flight.baselines import COUPLING_RAD_H
from service.study.estimation.flight.motion_statistics import TrueWheels
from service.study.estimation.flight.oracle.flown_rows import (
    ANGLES,
    DRIFTS,
    SCALES,
    FlownRows,
    MeasuredStates,
    OracleMeasurement,
    OracleState,
)
from service.study.estimation.flight.world import Ground

#: positions of x, y, z among yaw, roll, pitch
_BODY = np.array([1, 2, 0])
#: places of momentum, shares, wave of half a day, torque of a profile that is not stated, torque of first order,
#: misalignment and scale among the states
_MOMENTUM, _SHARES, _HALF_DAY, _UNSTATED = slice(0, 3), slice(3, 6), slice(6, 12), slice(12, 21)
_UNKNOWN, _MISALIGNMENT, _SCALE, _STATES = slice(21, 24), slice(24, 27), slice(27, 30), 30
#: torques move the momentum in spans of at most this, h
_PANEL_H = 1.0 / 6.0
_DEGREE = math.radians(1.0)


class WheelStates(MeasuredStates):
    """Momentum and errors of its report: 30 states from a place on."""

    def __init__(self, ground: Ground, flown: FlownRows, statistics: TrueWheels, first: int) -> None:
        stated = ground.spacecraft.onboard.momentum
        self._flown, self._statistics, self._first = flown, statistics, first
        self._profile = None if stated is None else stated.torque
        self._inertia_kg_m2 = np.diag(np.array(ground.spacecraft.inertia_kg_m2))
        self._reports = _reports(ground)
        self._unloading_us = np.array(statistics.unloading_us, dtype=np.int64)
        seconds = flown.epochs_us / US_PER_S
        # rates x, y, z, deg/s: the known one, and that of announced corrections
        self._known_deg_s = np.gradient(flown.inertial_deg, seconds, axis=0)[:, _BODY]
        self._commanded_deg_s = np.gradient(flown.commanded_deg, seconds, axis=0)[:, _BODY]
        self.beginning = self._beginning()
        self.tau_h = np.full(_STATES, np.inf)
        self.tau_h[_UNKNOWN] = statistics.unknown_tau_s / 3600.0

    @property
    def _unloaded(self) -> tuple[FloatArray, FloatArray]:
        """Momentum (3,) that an unloading leaves, and its sigma."""
        left = self._statistics.unloaded_n_m_s
        return np.array([0.0, self._statistics.bias_n_m_s, 0.0]), np.array([left, 0.0, left])

    def _beginning(self) -> OracleState:
        """Return the states at the first row."""
        true, wave = self._statistics, np.tile(np.array(self._statistics.torque_n_m) / math.sqrt(2.0), 2)
        mean, covariance = np.zeros(_STATES), np.zeros((_STATES, _STATES))
        mean[_MOMENTUM], sigma = self._unloaded
        covariance[_MOMENTUM, _MOMENTUM] = np.diag(sigma**2)
        covariance[_SHARES, _SHARES] = true.profile_error**2 + true.axis_profile_error**2 * np.eye(3)
        covariance[_HALF_DAY, _HALF_DAY] = np.diag((true.half_day_share * wave) ** 2)
        if self._profile is None:
            covariance[_UNSTATED, _UNSTATED] = np.diag(np.square([*true.constant_n_m, *wave]))
        covariance[_UNKNOWN, _UNKNOWN] = true.unknown_n_m**2 * np.eye(3)
        covariance[_MISALIGNMENT, _MISALIGNMENT] = (_DEGREE * true.misalignment_deg) ** 2 * np.eye(3)
        covariance[_SCALE, _SCALE] = true.scale_error**2 * np.eye(3)
        return OracleState(mean, covariance)

    def move(self, gaussian: OracleState, last: int, row: int) -> None:
        """Carry the momentum from one row to a later one, in place."""
        mean, covariance = gaussian
        own, momentum = (slice(self._first, self._first + count) for count in (_UNKNOWN.stop, _MOMENTUM.stop))
        epochs_us = self._flown.epochs_us
        if ((self._unloading_us > epochs_us[last]) & (self._unloading_us <= epochs_us[row])).any():
            mean[momentum], sigma = self._unloaded
            covariance[momentum, :] = covariance[:, momentum] = 0.0
            covariance[momentum, momentum] = np.diag(sigma**2)
            return
        step, push, added = self._moved(int(epochs_us[last]), float(self._flown.hours[row] - self._flown.hours[last]))
        mean[momentum] = step @ mean[own] + push
        across = step @ covariance[own, :]
        across[:, momentum] = across[:, own] @ step.T + added * np.eye(3)
        covariance[momentum, :], covariance[:, momentum] = across, across.T

    def _moved(self, from_us: int, hours: float) -> tuple[FloatArray, FloatArray, float]:
        """Return the step (3, 24) of the momentum, the push (3,) of the profile, and the variance added."""
        panels = math.ceil(hours / _PANEL_H)
        span_h, step, push = hours / panels, np.zeros((3, _UNKNOWN.stop)), np.zeros(3)
        step[:, _MOMENTUM] = _turn(hours)
        tau_h = self._statistics.unknown_tau_s / 3600.0
        for panel in range(panels):
            elapsed_h = (panel + 0.5) * span_h
            pushed = _turn(hours - elapsed_h) * span_h * 3600.0
            middle_us = from_us + round(elapsed_h * 3.6e9)
            torque = _profile_n_m(self._profile, middle_us)
            half = 4.0 * math.pi * (middle_us - int(self._flown.epochs_us[0])) / (24.0 * 3.6e9)
            push += pushed @ torque
            step[:, _SHARES] += pushed * torque
            step[:, _HALF_DAY] += np.hstack([math.cos(half) * pushed, math.sin(half) * pushed])
            step[:, _UNSTATED] += np.hstack([pushed, math.cos(0.5 * half) * pushed, math.sin(0.5 * half) * pushed])
            step[:, _UNKNOWN] += math.exp(-elapsed_h / tau_h) * pushed
        ratio = hours / tau_h
        grown = 2.0 * ratio - 3.0 + 4.0 * math.exp(-ratio) - math.exp(-2.0 * ratio)
        return step, push, (self._statistics.unknown_n_m * self._statistics.unknown_tau_s) ** 2 * max(0.0, grown)

    def at(self, row: int, states: int) -> OracleMeasurement | None:
        """Return the report of a row, None without one."""
        is_known = row < self._flown.operation_row
        reported = self._reports.get(int(self._flown.epochs_us[row]))
        if reported is None:
            return None
        attitude = _DEGREE * self._flown.attitude_deg[row]
        turned = Rotation.from_euler("ZYX", attitude[[0, 2, 1]]).as_matrix().T
        rate = (self._known_deg_s if is_known else self._commanded_deg_s)[row]
        inertia, spin = self._inertia_kg_m2 * _DEGREE, np.zeros(3)
        spin[1] = self._inertia_kg_m2[1] * COUPLING_RAD_H / 3600.0
        # first order about the true attitude, with the momentum that was reported
        x, y, z = (reported - spin).tolist()
        by_angle = np.array([[y, 0.0, -z], [-x, z, 0.0], [0.0, -y, x]])
        design = np.zeros((3, states))
        own = design[:, self._first : self._first + _STATES]
        design[:, ANGLES] = _DEGREE * by_angle
        own[:, _MOMENTUM], own[:, _SCALE] = turned, np.diag(reported)
        own[:, _MISALIGNMENT] = -np.cross(reported, np.eye(3)).T
        if not is_known:
            design[:, DRIFTS] = -np.diag(inertia)[:, np.argsort(_BODY)] / 3600.0
            design[:, SCALES] = -np.diag(inertia * rate)[:, np.argsort(_BODY)]
        measured = reported + by_angle @ attitude + inertia * rate - spin
        variance = self._statistics.noise_n_m_s**2 + self._statistics.quantum_n_m_s**2 / 12.0
        return OracleMeasurement(design, measured, variance * np.eye(3))


def _profile_n_m(profile: FedForwardTorque | None, epoch_us: int) -> FloatArray:
    """Return the torque (3,) that the ground states at an epoch, 0 without a profile."""
    if profile is None:
        return np.zeros(3)
    angle = 2.0 * math.pi * (epoch_us - profile.epoch_us) / US_PER_S / profile.period_s
    parts = zip(
        (1.0, math.cos(angle), math.sin(angle)),
        (profile.constant_n_m, profile.cosine_n_m, profile.sine_n_m),
        strict=True,
    )
    return np.asarray(sum(share * np.array([part.roll, part.pitch, part.yaw]) for share, part in parts))


def _turn(hours: float) -> FloatArray:
    """Return the turn (3, 3) of the momentum in the orbital frame over some hours."""
    cosine, sine = math.cos(COUPLING_RAD_H * hours), math.sin(COUPLING_RAD_H * hours)
    return np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])


def _reports(ground: Ground) -> dict[int, FloatArray]:
    """Return the momentum (3,) along the axes of the body by epoch."""
    records = (event.content for event in ground.events if isinstance(event.content, TelemetryRecord))
    axes = np.array(ground.spacecraft.wheels.axes)
    return {
        record.epoch_us: np.array(record.wheel_momentum_n_m_s) @ axes
        for record in records
        if record.wheel_momentum_n_m_s is not None
    }
