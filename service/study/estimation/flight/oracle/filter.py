"""Oracle: a linear Kalman filter with the true statistics, references and slopes, which no product can have.

    z = J x + c + sum of n + wave + white       x attitude, c receiving chain, n first-order parts, J true slopes
    x' = exchange of roll and yaw + (1 + s) u + d        u announced corrections, s their scale error, d drift

The reference of a carrier is its true level. Left out are carriers that lose more by rain and wet antennas than their
own noise, that are interfered with, and those whose level stepped within the last hour; then the new level is known.
While it rains over the receiving site what is common to all carriers tells nothing. Motion that the corrections do not
tell widens the attitude by its true size for as long as it lasts. Before operation the attitude is known, as it is to
the sensor, so that slow noise is known as well as alignment and quiet days can tell it. Where wheels, rates or
polarisation are measured their states stand behind those of the noise.

Rate sensor in the oracle: mean rates of a step tell corrections, drift and the bias of the sensor together.

    reported = (1 + s) u + d + b + noise       u commanded, s scale error, d drift, b bias of first order; deg/h

as above, without the turn of the orbit. Before operation the motion is known, and what is reported is the bias.

Momentum of the wheels in the oracle: what gathers by a torque, and what a report of it has wrong.

    H' = turn of the orbit + (1 + c) T + q cos 2a + r sin 2a + n     H N m s of the whole spacecraft, orbital frame
    reported = h + e x h + s h + noise,   h = C H - J w              of the wheels, in the body

T is the profile that the ground states, c the share of each axis that it has wrong, most of it common; q, r the wave of
half a day, a phase of the day (constant and wave of a day too where no profile is stated), n a torque of first order; e
misalignment, s scale, C the true turn of the body, w its rate. In operation w follows from corrections and drift;
before it is known. Vectors x roll, y pitch, z yaw. An unloading is known when it happens. Reports count at rows of
powers.

Polarimeter in the oracle: its angle follows the turn of the body about the line of sight.

    z = atan(10^(D/20)) - d0 = p + b + w + f (1 - m) + r fade + l t + white,   D dB ratio of two ports of a feed at d0

p is the true turn, b offset with the wave of a day, w a wander of hours, f the Faraday rotation by the reported
electron content and m its relative error, r the turn by rain over the site, l a drift. Rain is known, and so are a
storm of the ionosphere and the moment in which the feed turns.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from service.records.catalogue import FedForwardTorque
from service.records.epoch import US_PER_S
from service.records.inputs import PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.study.estimation.flight.baselines import COUPLING_RAD_H
from service.study.estimation.flight.drive import MethodSeries
from service.study.estimation.flight.episodes import stretches
from service.study.estimation.flight.motion_statistics import TruePolarimeter, TrueRates, TrueWheels
from service.study.estimation.flight.oracle.flown_rows import (
    ANGLES,
    DRIFTS,
    MOTION,
    SCALES,
    FlownRows,
    MeasuredStates,
    OracleMeasurement,
    OracleState,
    flown_rows,
)
from service.study.estimation.flight.world import Ground, TrueStatistics, Truth, World

#: offset, daily cosine and sine, wander, error of the electron content, turn by rain, drift
_FEED_STATES = 7
#: Faraday rotation of 1 TECU at 1 Hz in 1 T, deg
_FARADAY_DEG = math.degrees(2.36e4 * 1e16)


class PolarimeterStates(MeasuredStates):
    """Errors of a polarimeter: seven states from a place on."""

    def __init__(
        self,
        ground: Ground,
        truth: Truth,
        flown: FlownRows,
        statistics: TruePolarimeter,
        turn_deg: FloatArray,
        first: int,
    ) -> None:
        self._flown, self._statistics, self._first = flown, statistics, first
        self._fade_db = truth.downlink_fade_db
        self._operation_h = (ground.phases["operation"].start_us - int(flown.epochs_us[0])) / 3.6e9
        # what is left of an angle without the true turn; slopes are those at the true attitude
        self._other_deg = flown.attitude_deg @ np.array(statistics.sight) - turn_deg
        self._records = _records(ground)
        stated = ground.spacecraft.polarimeters[0]
        self._faraday_deg_tecu = _FARADAY_DEG * stated.field_t / stated.frequency_hz**2
        # a leakage turns the angle by as much as the feed is turned
        leak = math.cos(math.radians(statistics.feed_offset_deg)) ** 2
        daily = leak * statistics.daily_deg / math.sqrt(2.0)
        offset, wander = leak * statistics.leakage_deg / math.sqrt(2.0), leak * statistics.wander_deg
        drift = leak * statistics.leak_drift_deg_h
        sigma = [offset, daily, daily, wander, statistics.map_error, statistics.rain_deg_db, drift]
        self.beginning = OracleState(np.zeros(_FEED_STATES), np.diag(np.square(sigma)))
        self.tau_h = np.full(_FEED_STATES, np.inf)
        self.tau_h[3] = statistics.wander_tau_s / 3600.0

    def move(self, gaussian: OracleState, last: int, row: int) -> None:
        """Free the offset where the feed turns, in place."""
        from_us, to_us = self._flown.epochs_us[last], self._flown.epochs_us[row]
        if from_us < self._statistics.feed_turn_from_us <= to_us:
            gaussian.covariance[self._first, self._first] += self._statistics.feed_turn_deg**2

    def at(self, row: int, states: int) -> OracleMeasurement | None:
        """Return the angle of a row, None without one."""
        epoch_us = int(self._flown.epochs_us[row])
        record = self._records.get(epoch_us)
        if record is None or record.ratio_db is None:
            return None
        true, hours = self._statistics, float(self._flown.hours[row])
        storm = true.storm_factor if epoch_us >= true.storm_from_us else 1.0
        rotation_deg = storm * self._faraday_deg_tecu * (record.tec_tecu or 0.0)
        phase = 2.0 * math.pi * hours / _DAY_H
        design = np.zeros((1, states))
        design[0, ANGLES] = true.sight
        design[0, self._first : self._first + _FEED_STATES] = (
            1.0,
            math.cos(phase),
            math.sin(phase),
            1.0,
            -rotation_deg,
            self._fade_db[row],
            max(0.0, hours - self._operation_h),
        )
        angle_deg = math.degrees(math.atan(10.0 ** (record.ratio_db / 20.0))) - true.feed_offset_deg
        measured = np.array([angle_deg - rotation_deg + self._other_deg[row]])
        return OracleMeasurement(design, measured, np.array([[true.white_deg**2]]))


def _records(ground: Ground) -> dict[int, PolarizationRecord]:
    found = (event.content for event in ground.events if isinstance(event.content, PolarizationRecord))
    return {record.epoch_us: record for record in found}


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


#: turn of the orbit, deg/h, about pitch
_ORBIT_DEG_H = np.array([0.0, 0.0, 15.0410686])
#: known motion that is faster than this, deg/h, or a longer step, h, tells nothing: rates are about turned axes
_FASTEST_DEG_H, _LONGEST_H = 1.0, 1.0


class RateStates(MeasuredStates):
    """Bias of the sensor: three states from a place on."""

    def __init__(self, ground: Ground, flown: FlownRows, statistics: TrueRates, first: int) -> None:
        self._flown, self._statistics, self._own = flown, statistics, slice(first, first + 3)
        self._known_deg, self._reported_deg = flown.inertial_deg, _reported_deg(ground, flown)
        sigma = statistics.bias_factor * statistics.bias_deg_h
        self.beginning = OracleState(np.zeros(3), sigma**2 * np.eye(3))
        self.tau_h = np.full(3, statistics.bias_tau_h)

    def during(self, last: int, row: int, states: int) -> OracleMeasurement | None:
        """Return the mean rate of a step, None where it tells nothing."""
        is_known = last < self._flown.operation_row
        hours = self._flown.hours[row] - self._flown.hours[last]
        reported = (self._reported_deg[row] - self._reported_deg[last]) / hours
        moved = self._known_deg if is_known else self._flown.commanded_deg
        known = (moved[row] - moved[last]) / hours
        is_unfit = is_known and (hours > _LONGEST_H or np.abs(known).max() > _FASTEST_DEG_H)
        if is_unfit or not np.isfinite(reported).all():
            return None
        design = np.zeros((3, states))
        design[:, self._own] = np.eye(3)
        if not is_known:
            design[:, DRIFTS], design[:, SCALES] = np.eye(3), np.diag(known)
        return OracleMeasurement(design, reported - known, self._statistics.noise_deg_sqrt_h**2 / hours * np.eye(3))


def _reported_deg(ground: Ground, flown: FlownRows) -> FloatArray:
    """Return the turn (T, 3) that the rates add up to, NaN from the first row without one."""
    records = (event.content for event in ground.events if isinstance(event.content, TelemetryRecord))
    rates = {record.epoch_us: record.body_rate_deg_s for record in records if record.body_rate_deg_s is not None}
    nothing = (np.nan,) * 3
    reported = 3600.0 * np.array([rates.get(epoch_us, nothing) for epoch_us in flown.epochs_us[1:].tolist()])
    gained = (reported + _ORBIT_DEG_H) * np.diff(flown.hours)[:, np.newaxis]
    return np.vstack([np.zeros(3), np.cumsum(gained, axis=0)])


#: name of the answer
ORACLE = "oracle"
#: before operation the attitude is known to this, deg, and each of so many rows is taken
_KNOWN_DEG, _STRIDE = 0.01, 5
#: a changed level is left out for so long, h, if it moved by more, dB
_STEPPED_H, _STEPPED_DB = 1.0, 0.05
#: common noise while it rains over the receiving site, dB
_RAIN_DB = 10.0
#: motion that corrections do not tell passes this many sigmas of the drift
_UNTOLD_SIGMAS = 6.0
_DAY_H = 24.0


class _States(NamedTuple):
    """States behind the motion: chain parts and wave, then parts and wave of each carrier."""

    #: (M,) stationary variances, dB^2, and correlation times, h
    variance_db2: FloatArray
    tau_h: FloatArray
    #: (N, M) place of each state in a carrier's power, and whether it goes with cosine or sine of the day
    share: FloatArray
    is_cosine: BoolArray
    is_sine: BoolArray


def oracle_series(world: World, rows: IntArray) -> MethodSeries:
    """Return what the oracle says of some rows (T,) of operation.

    Raises
    ------
    ValueError
        The world does not state its true statistics.
    """
    if world.truth.statistics is None:
        message = f"world of {world.scenario}, seed {world.seed} without true statistics"
        raise ValueError(message)
    before = np.flatnonzero(world.ground.is_measured[: rows[0]])[::_STRIDE]
    flight = _Flight(world, world.truth.statistics, np.concatenate([before, rows]))
    answers = [flight.step(number, is_known=number < len(before)) for number in range(len(flight.rows))]
    estimate, sigma = (np.array(part)[len(before) :] for part in zip(*answers, strict=True))
    everywhere, nowhere = np.ones(len(rows), dtype=np.bool_), np.zeros(len(rows), dtype=np.bool_)
    return MethodSeries(
        estimate_deg=estimate,
        sigma_deg=sigma,
        is_axis_allowed=np.ones((len(rows), 3), dtype=np.bool_),
        is_control_allowed=everywhere,
        is_fade=nowhere,
        is_alarm=nowhere,
        is_excluded=flight.is_left_out[rows],
        is_carrier_used=np.ones(len(world.ground.carrier_ids), dtype=np.bool_),
    )


class _Flight:
    """The filter over the rows of one world."""

    def __init__(self, world: World, statistics: TrueStatistics, rows: IntArray) -> None:
        truth, ground = world.truth, world.ground
        self.rows, self._statistics, self._attitude_deg = rows, statistics, truth.attitude_deg
        operation_row = int(np.searchsorted(ground.epochs_us, ground.phases["operation"].start_us))
        flown = flown_rows(ground, truth.attitude_deg, operation_row, is_coupled=statistics.is_coupled)
        self._hours, self._commanded_deg = flown.hours, flown.commanded_deg
        self._residual_db = ground.power_dbm - statistics.noise_free_dbm
        self._rain_db = np.where(truth.downlink_fade_db > 0.0, _RAIN_DB, 0.0)
        self.is_left_out = _left_out(world, statistics)
        self._untold_deg = self._untold(flown)
        self._states = _states(statistics)
        drift, scale = statistics.drift_sigma_deg_h**2, np.full(3, statistics.correction_scale_sigma**2)
        variance = np.concatenate([np.ones(3), drift, scale, self._states.variance_db2])
        self._measured = _measured_motion(world, statistics, flown, len(variance))
        blocks = [one.beginning.covariance for one in self._measured]
        self._state = np.concatenate([np.zeros(len(variance)), *(one.beginning.mean for one in self._measured)])
        self._covariance = block_diag(np.diag(variance), *blocks)
        # stationary variances and correlation times of what decays on its own
        self._variance = np.concatenate([self._states.variance_db2, *map(np.diagonal, blocks)])
        self._tau_h = np.concatenate([self._states.tau_h, *(one.tau_h for one in self._measured)])

    def step(self, number: int, *, is_known: bool) -> tuple[FloatArray, FloatArray]:
        """Carry the filter to a row, correct it there, and return angles and sigma (3,)."""
        row = int(self.rows[number])
        if number:
            last = int(self.rows[number - 1])
            self._measure_step(last, row)
            self._predict(last, row)
        if is_known:
            self._know(row)
        self._correct(row)
        for one in self._measured:
            self._update(one.at(row, len(self._state)))
        return self._state[ANGLES].copy(), np.sqrt(np.diag(self._covariance)[ANGLES])

    def _measure_step(self, last: int, row: int) -> None:
        """Correct the filter by what is measured of the motion from a row to a later one, and carry it along."""
        for one in self._measured:
            self._update(one.during(last, row, len(self._state)))
            one.move(OracleState(self._state, self._covariance), last, row)

    def _know(self, row: int) -> None:
        """Take the true attitude for what the sensor tells."""
        self._covariance[ANGLES, :] = self._covariance[:, ANGLES] = 0.0
        self._covariance[ANGLES, ANGLES] = _KNOWN_DEG**2 * np.eye(3)
        self._state[ANGLES] = self._attitude_deg[row]

    def _predict(self, last: int, row: int) -> None:
        """Carry state and covariance from one row to a later one."""
        hours = float(self._hours[row] - self._hours[last])
        change_deg = self._commanded_deg[row] - self._commanded_deg[last]
        phi, gamma = _motion(hours, is_coupled=self._statistics.is_coupled)
        keep = np.exp(-hours / np.concatenate([np.full(3, self._statistics.drift_tau_s / 3600.0), self._tau_h]))
        scale = np.concatenate([np.ones(3), keep[:3], np.ones(3), keep[3:]])
        noise = np.zeros(len(self._state))
        noise[ANGLES] = np.max(self._untold_deg[last + 1 : row + 1] ** 2, axis=0)
        noise[DRIFTS] = self._statistics.drift_sigma_deg_h**2 * (1.0 - keep[:3] ** 2)
        noise[9:] = self._variance * (1.0 - keep[3:] ** 2)
        # rows of the attitude mix angles, drift and scale errors; every other state decays on its own
        mixing = np.hstack([phi, gamma, gamma @ np.diag(change_deg / hours)])
        attitude = mixing @ self._state[MOTION] + gamma @ (change_deg / hours)
        self._state *= scale
        self._state[ANGLES] = attitude
        across = mixing @ self._covariance[MOTION, :]
        corner = across[:, MOTION] @ mixing.T
        self._covariance *= scale[:, np.newaxis] * scale
        self._covariance[ANGLES, :] = across * scale
        self._covariance[:, ANGLES] = (across * scale).T
        self._covariance[ANGLES, ANGLES] = corner
        self._covariance[np.diag_indices_from(self._covariance)] += noise

    def _correct(self, row: int) -> None:
        """Correct the filter by the powers of a row."""
        used = np.flatnonzero(np.isfinite(self._residual_db[row]) & ~self.is_left_out[row])
        if len(used) == 0:
            return
        slopes = self._statistics.row_sensitivity_db_per_deg[row, used]
        angle = 2.0 * np.pi * self._hours[row] / _DAY_H
        wave = np.where(self._states.is_cosine, np.cos(angle), np.where(self._states.is_sine, np.sin(angle), 1.0))
        others = np.zeros((len(used), len(self._state) - 9 - len(wave)))
        design = np.hstack([slopes, np.zeros((len(used), 6)), self._states.share[used] * wave, others])
        white = np.diag(self._statistics.white_db[used] ** 2) + self._rain_db[row] ** 2
        # slopes are those at the true attitude, so that powers are linear in the error of the angles
        measured = self._residual_db[row, used] + slopes @ self._attitude_deg[row]
        self._update(OracleMeasurement(design, measured, white))

    def _update(self, reading: OracleMeasurement | None) -> None:
        """Correct the filter by measurements, if there are any."""
        if reading is None:
            return
        design, measured, noise = reading
        across = self._covariance @ design.T
        gain = np.linalg.solve(design @ across + noise, across.T).T
        self._state += gain @ (measured - design @ self._state)
        self._covariance -= gain @ across.T
        self._covariance = 0.5 * (self._covariance + self._covariance.T)

    def _untold(self, flown: FlownRows) -> FloatArray:
        """Return the size (T, 3) of the motion that corrections do not tell, in every row in which it goes on."""
        hours = np.diff(self._hours)
        untold = np.zeros_like(self._attitude_deg)
        change_deg = np.diff(self._commanded_deg, axis=0)
        missing = np.diff(self._attitude_deg, axis=0) - change_deg - flown.exchanged_deg
        limit = _UNTOLD_SIGMAS * self._statistics.drift_sigma_deg_h * hours[:, np.newaxis]
        for axis in range(3):
            for first, last in stretches(np.abs(missing[:, axis]) > limit[:, axis]):
                untold[first + 1 : last + 1, axis] = missing[first:last, axis].sum()
        return untold


def _motion(hours: float, *, is_coupled: bool) -> tuple[FloatArray, FloatArray]:
    """Return (phi, gamma): attitude after some hours = phi @ attitude + gamma @ constant rate in deg/h."""
    angle = COUPLING_RAD_H * hours * is_coupled
    cosine, sine = np.cos(angle), np.sin(angle)
    phi = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    along, across = hours * np.sinc(angle / np.pi), 0.5 * hours * angle * np.sinc(0.5 * angle / np.pi) ** 2
    gamma = np.array([[along, -across, 0.0], [across, along, 0.0], [0.0, 0.0, hours]])
    return phi, gamma


def _states(statistics: TrueStatistics) -> _States:
    carriers = len(statistics.white_db)
    all_of_them, infinite = np.ones(carriers), np.inf
    made: list[tuple[float, float, FloatArray, str]] = []
    for sigma, tau_s in zip(statistics.chain_part_sigma_db, statistics.chain_part_tau_s, strict=True):
        made.append((sigma, tau_s / 3600.0, all_of_them, ""))
    made += [(statistics.chain_daily_db / np.sqrt(2.0), infinite, all_of_them, kind) for kind in ("cosine", "sine")]
    for k, own in enumerate(np.eye(carriers)):
        parts = zip(statistics.part_sigma_db[k], statistics.part_tau_s[k], strict=True)
        made += [(sigma, tau_s / 3600.0, own, "") for sigma, tau_s in parts]
        made += [(statistics.daily_db[k] / np.sqrt(2.0), infinite, own, kind) for kind in ("cosine", "sine")]
    made = [one for one in made if one[0] > 0.0]
    return _States(
        np.array([sigma**2 for sigma, *_ in made]),
        np.array([tau_h for _, tau_h, *_ in made]),
        np.column_stack([share for *_, share, _ in made]) if made else np.zeros((carriers, 0)),
        np.array([kind == "cosine" for *_, kind in made], dtype=np.bool_),
        np.array([kind == "sine" for *_, kind in made], dtype=np.bool_),
    )


def _measured_motion(world: World, statistics: TrueStatistics, flown: FlownRows, first: int) -> list[MeasuredStates]:
    """Return the states of what is measured beside powers, in order from a place on."""
    ground, motion, found = world.ground, statistics.motion, list[MeasuredStates]()
    if motion.wheels is not None:
        found.append(WheelStates(ground, flown, motion.wheels, first))
    if motion.rates is not None:
        found.append(RateStates(ground, flown, motion.rates, first + sum(len(one.tau_h) for one in found)))
    if motion.polarimeter is not None:
        first += sum(len(one.tau_h) for one in found)
        turn_deg = motion.polarimeter_turn_deg
        found.append(PolarimeterStates(ground, world.truth, flown, motion.polarimeter, turn_deg, first))
    return found


def _left_out(world: World, statistics: TrueStatistics) -> BoolArray:
    """Return where (T, N) a carrier is left out."""
    truth = world.truth
    noise_db = np.sqrt(statistics.white_db**2 + np.sum(statistics.part_sigma_db**2, axis=1))
    is_out: BoolArray = np.asarray(truth.station_loss_db > noise_db) | truth.has_flag("interference", "off")
    level_db = truth.level_db + truth.station_loss_db
    reach = max(1, round(_STEPPED_H * 3600.0 / world.row_period_s))
    for row, carrier in np.argwhere(np.abs(np.diff(level_db, axis=0)) > _STEPPED_DB).tolist():
        is_out[row + 1 : row + 1 + reach, carrier] = True
    return is_out
