"""Oracle: a linear Kalman filter with the true statistics, references and slopes, which no product can have.

    z = J x + c + sum of n + wave + white       x attitude, c receiving chain, n first-order parts, J true slopes
    x' = exchange of roll and yaw + (1 + s) u + d        u announced corrections, s their scale error, d drift

The reference of a carrier is its true level. Left out are carriers that lose more by rain and wet antennas than their
own noise, that are interfered with, and those whose level stepped within the last hour; then the new level is known.
While it rains over the receiving site what is common to all carriers tells nothing. Motion that the corrections do not
tell widens the attitude by its true size for as long as it lasts. Before operation the attitude is known, as it is to
the sensor, so that slow noise is known as well as alignment and quiet days can tell it. Where wheels, rates or
polarisation are measured their states stand behind those of the noise (`wheels`, `rates`, `polarimeter`).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.study.estimation.flight.baselines import COUPLING_RAD_H
from service.study.estimation.flight.drive import MethodSeries
from service.study.estimation.flight.episodes import stretches
from service.study.estimation.flight.oracle.flown_rows import (
    ANGLES,
    DRIFTS,
    MOTION,
    FlownRows,
    MeasuredStates,
    OracleMeasurement,
    OracleState,
    flown_rows,
)
from service.study.estimation.flight.oracle.polarimeter import PolarimeterStates
from service.study.estimation.flight.oracle.rates import RateStates
from service.study.estimation.flight.oracle.wheels import WheelStates
from service.study.estimation.flight.world import TrueStatistics, World

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
    """Return the states of the noise."""
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
