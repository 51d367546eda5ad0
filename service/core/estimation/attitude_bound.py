"""Bound of the attitude by powers and by measured motion: covariance of a filter with true statistics.

    yaw' = -w roll + d,  roll' = w yaw + d,  pitch' = d         w = orbital rate, d drift of first order
    P_i = s_i (yaw, roll, pitch) + c + r_i + n_i + white        c chain (walk), r reference (constant), n correlated
    Hx' = w Hz + Tx,  Hz' = -w Hx + Tz                          T = error of the stated torque, constant and daily wave
    hx = Hx + Hy (yaw + bx),  hz = Hz - Hy (roll + bz)          b misalignment
    p = sight (yaw, roll, pitch) + b + c cos t + s sin t + a    a polarimeter: offset (walk), daily wave, wander

A rate sensor outside of the loop on board has its bias in the place of the drift, and its noise moves the angles.

Riccati's equation over two days in steps of five minutes from an alignment; means over the second day. The law of this
file: covariances alone, no measurement; what carriers do not determine stays as wide as it grows.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import FloatArray
from service.core.estimation.calibration.whitened_fit import ColouredNoise
from service.core.estimation.filtering.filter_model import PolarimeterModel

_ORBITAL_RATE_PER_H = 0.2625162
_STEP_H, _SPAN_H, _JUDGED_H, _DAY_H = 1.0 / 12.0, 48.0, 24.0, 24.0
#: at the alignment: angles, deg, chain, dB, and momentum, N m s; quiet days behind the references, h
_ALIGNED_DEG, _CHAIN_DB, _FREE_N_M_S, _QUIET_H = 0.01, 0.1, 1.0, 72.0
#: random walk of the receiving chain, dB/sqrt(h), and of the momentum, N m s/sqrt(s)
_CHAIN_WALK_DB, _WALK_N_M_S = 0.03, 2e-8
#: time between rows of powers, h
_ROW_H = 1.0 / 60.0
_ANGLES, _DRIFT, _CHAIN, _FIRST = slice(0, 3), slice(3, 6), 6, 7
#: Hx, Hz, bx, bz, and constant, cosine and sine of Tx and Tz
_MOMENTUM = 10
#: offset, daily cosine and sine, wander; the offset before the first angle, deg
_POLARIMETER, _FREE_OFFSET_DEG = 4, 3.0


class DriftStatistics(NamedTuple):
    """Drift of the inertial model, or bias of the sensor that measures the rate in its place."""

    #: sigma of yaw, roll, pitch, deg/h, and correlation time, h
    sigma_deg_h: tuple[float, float, float] = (0.04, 0.025, 0.025)
    tau_h: float = 8.0
    #: random walk of each angle, deg/sqrt(h)
    walk_deg_sqrt_h: float = 0.0


class WheelStatistics(NamedTuple):
    """Wheels as telemetry reports them."""

    #: momentum along pitch and noise of a record, N m s
    pitch_bias_n_m_s: float
    sigma_n_m_s: float = 0.01
    #: time between records, s; rounded to five minutes
    period_s: float = 300.0
    misalignment_deg: float = 0.05
    #: one sigma of the constant part of the torque that the profile does not state, and of each part of its wave, N m
    torque_error_n_m: float = 5e-7


def attitude_bound_deg(
    sensitivity: FloatArray,
    noise: ColouredNoise,
    wheels: WheelStatistics | None = None,
    drift: DriftStatistics | None = None,
    polarimeters: tuple[PolarimeterModel, ...] = (),
) -> FloatArray:
    """Return the smallest sigma (3,) of yaw, roll, pitch that a filter can have over a day, deg.

    Parameters
    ----------
    sensitivity : ndarray, shape (N, 3), dB/deg
        Columns yaw, roll, pitch; finite.
    noise : ColouredNoise
        Of the N carriers.
    wheels : WheelStatistics, optional
        Momentum of the wheels as a measurement; None: powers alone.
    drift : DriftStatistics, optional
        Of the inertial model, or of the rate sensor in its place.
    polarimeters : tuple of PolarimeterModel
        Angles of the polarisation as measurements, one each five minutes.
    """
    drift = drift or DriftStatistics()
    first, states = _size(noise, wheels), _POLARIMETER * len(polarimeters)
    rows = _power_rows(sensitivity, noise, wheels)
    momentum = None if wheels is None else _momentum_rows(rows.shape[1], wheels)
    power_db2 = np.square(noise.white_db) * _ROW_H / _STEP_H
    every = 0 if wheels is None else max(1, round(wheels.period_s / 3600.0 / _STEP_H))
    rows = np.hstack([rows, np.zeros((len(rows), states))])
    momentum = None if momentum is None else np.hstack([momentum, np.zeros((2, states))])
    kept, grown, angles_deg2 = _wander(polarimeters)
    covariance = _as_blocks(_aligned(noise, wheels, drift), np.diag(angles_deg2))
    steps, variances = round(_SPAN_H / _STEP_H), []
    transition, added = _transition(noise, wheels, drift)
    transition, added = _as_blocks(transition, np.diag(kept)), _as_blocks(added, np.diag(grown))
    white_deg2 = np.array([one.white_deg**2 for one in polarimeters]) * _ROW_H / _STEP_H
    for step in range(1, steps + 1):
        covariance = transition @ covariance @ transition.T + added
        if wheels is not None:
            covariance = _pushed(covariance, first, step * _STEP_H)
        covariance = _updated(covariance, rows, power_db2)
        if wheels is not None and momentum is not None and step % every == 0:
            covariance = _updated(covariance, momentum, np.full(2, wheels.sigma_n_m_s**2))
        if polarimeters:
            covariance = _updated(covariance, _angle_rows(first, polarimeters, step * _STEP_H), white_deg2)
        variances.append(np.diagonal(covariance)[_ANGLES].copy())
    return np.asarray(np.sqrt(np.mean(variances[-round(_JUDGED_H / _STEP_H) :], axis=0)))


def _size(noise: ColouredNoise, wheels: WheelStatistics | None) -> int:
    return _FIRST + len(noise.white_db) + noise.sigma_db.size + (0 if wheels is None else _MOMENTUM)


def _power_rows(sensitivity: FloatArray, noise: ColouredNoise, wheels: WheelStatistics | None) -> FloatArray:
    """Return the rows (N, D) of the powers."""
    carriers, parts = noise.sigma_db.shape
    rows = np.zeros((carriers, _size(noise, wheels)))
    rows[:, _ANGLES], rows[:, _CHAIN] = sensitivity, 1.0
    rows[:, _FIRST : _FIRST + carriers] = np.eye(carriers)
    first = _FIRST + carriers
    rows[:, first : first + carriers * parts] = np.repeat(np.eye(carriers), parts, axis=1)
    return rows


def _momentum_rows(size: int, wheels: WheelStatistics) -> FloatArray:
    """Return the rows (2, D) of hx and hz."""
    first, by_angle = size - _MOMENTUM, math.radians(wheels.pitch_bias_n_m_s)
    rows = np.zeros((2, size))
    rows[0, [0, first, first + 2]] = by_angle, 1.0, by_angle
    rows[1, [1, first + 1, first + 3]] = -by_angle, 1.0, -by_angle
    return rows


def _aligned(noise: ColouredNoise, wheels: WheelStatistics | None, drift: DriftStatistics) -> FloatArray:
    """Return the covariance at the alignment."""
    tau_h = noise.tau_s / 3600.0
    mean_db2 = np.square(noise.white_db) * _ROW_H / _QUIET_H
    mean_db2 = mean_db2 + (np.square(noise.sigma_db) * np.minimum(1.0, 2.0 * tau_h / _QUIET_H)).sum(axis=1)
    parts = [[_ALIGNED_DEG**2] * 3, np.square(drift.sigma_deg_h), [_CHAIN_DB**2], mean_db2, np.square(noise.sigma_db)]
    if wheels is not None:
        torque = [(wheels.torque_error_n_m * 3600.0) ** 2] * 6
        parts += [[_FREE_N_M_S**2] * 2, [wheels.misalignment_deg**2] * 2, torque]
    return np.diag(np.concatenate([np.ravel(part) for part in parts]))


def _transition(
    noise: ColouredNoise, wheels: WheelStatistics | None, drift: DriftStatistics
) -> tuple[FloatArray, FloatArray]:
    """Return transition and process noise (D, D) of a step, without the torque on the momentum."""
    size, carriers = _size(noise, wheels), len(noise.white_db)
    transition, added = np.eye(size), np.zeros(size)
    angle = _ORBITAL_RATE_PER_H * _STEP_H
    cos, sin = math.cos(angle), math.sin(angle)
    transition[:2, :2] = [[cos, -sin], [sin, cos]]
    transition[_ANGLES, _DRIFT] = _STEP_H * np.eye(3)
    keep = math.exp(-_STEP_H / drift.tau_h)
    transition[_DRIFT, _DRIFT] = keep * np.eye(3)
    added[_ANGLES] = drift.walk_deg_sqrt_h**2 * _STEP_H
    added[_DRIFT] = np.square(drift.sigma_deg_h) * (1.0 - keep**2)
    added[_CHAIN] = _CHAIN_WALK_DB**2 * _STEP_H
    coloured = slice(_FIRST + carriers, _FIRST + carriers + noise.sigma_db.size)
    kept = np.exp(-_STEP_H * 3600.0 / np.where(noise.tau_s > 0.0, noise.tau_s, 1.0)).ravel()
    transition[coloured, coloured] = np.diag(kept)
    added[coloured] = np.square(noise.sigma_db).ravel() * (1.0 - kept**2)
    if wheels is not None:
        own = slice(size - _MOMENTUM, size - _MOMENTUM + 2)
        transition[own, own] = [[cos, sin], [-sin, cos]]
        added[own] = _WALK_N_M_S**2 * _STEP_H * 3600.0
    return transition, np.diag(added)


def _as_blocks(matrix: FloatArray, other: FloatArray) -> FloatArray:
    """Return two square matrices (D, D) and (E, E) as blocks of one."""
    size = len(matrix)
    both = np.zeros((size + len(other), size + len(other)))
    both[:size, :size], both[size:, size:] = matrix, other
    return both


def _wander(polarimeters: tuple[PolarimeterModel, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what a step keeps of the states of polarimeters and adds, and their variance before it, (4 P,) each."""
    kept, grown = [], []
    variance: list[float] = []
    for one in polarimeters:
        keep = math.exp(-_STEP_H / one.wander_h)
        kept += [1.0, 1.0, 1.0, keep]
        grown += [one.offset_walk_deg_sqrt_h**2 * _STEP_H, 0.0, 0.0, one.wander_deg**2 * (1.0 - keep**2)]
        unknown = [_FREE_OFFSET_DEG**2, one.daily_deg**2, one.daily_deg**2]
        variance += unknown if one.learned is None else np.diag(np.array(one.learned.covariance)).tolist()
        variance.append(one.wander_deg**2)
    return np.array(kept), np.array(grown), np.array(variance)


def _angle_rows(first: int, polarimeters: tuple[PolarimeterModel, ...], hours: float) -> FloatArray:
    """Return the rows (P, D) of angles; the states of polarimeters are the last ones, from a place on."""
    phase = 2.0 * math.pi * hours / _DAY_H
    rows = np.zeros((len(polarimeters), first + _POLARIMETER * len(polarimeters)))
    for number, one in enumerate(polarimeters):
        own = first + _POLARIMETER * number
        rows[number, _ANGLES] = one.sight
        rows[number, own : own + _POLARIMETER] = 1.0, math.cos(phase), math.sin(phase), 1.0
    return rows


def _pushed(covariance: FloatArray, states: int, hours: float) -> FloatArray:
    """Return the covariance after the torque of a step has acted on the momentum, the last of some states.

    Torques in N m s an hour.
    """
    first = states - _MOMENTUM
    phase = 2.0 * math.pi * hours / _DAY_H
    push = np.eye(len(covariance))
    for axis in range(2):
        at = first + 4 + 3 * axis
        push[first + axis, at : at + 3] = np.array([1.0, math.cos(phase), math.sin(phase)]) * _STEP_H
    return np.asarray(push @ covariance @ push.T)


def _updated(covariance: FloatArray, rows: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the covariance after measurements of rows (M, D) with variances (M,)."""
    cross = rows @ covariance
    factor = np.linalg.cholesky(cross @ rows.T + np.diag(variance))
    whitened = np.linalg.solve(factor, cross)
    return np.asarray(covariance - whitened.T @ whitened)
