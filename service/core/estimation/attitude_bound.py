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
#: offset of a polarimeter before the first angle, deg
_FREE_OFFSET_DEG = 3.0


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
    # compiled scipy is imported where it is used
    from scipy.linalg import block_diag

    drift = drift or DriftStatistics()
    carriers, parts = noise.sigma_db.shape
    first = _FIRST + carriers * (1 + parts)
    blocks = [_of_powers(noise, drift), *(_of_wheels(each) for each in (wheels,) if each is not None)]
    blocks += [_of_polarimeter(each) for each in polarimeters]
    transition, added, covariance = (block_diag(*each) for each in zip(*blocks, strict=True))
    every = 0 if wheels is None else max(1, round(wheels.period_s / 3600.0 / _STEP_H))
    rows = np.zeros((carriers, len(covariance)))
    rows[:, _ANGLES], rows[:, _CHAIN] = sensitivity, 1.0
    rows[:, _FIRST:first] = np.hstack([np.eye(carriers), np.repeat(np.eye(carriers), parts, axis=1)])
    power_db2 = np.square(noise.white_db) * _ROW_H / _STEP_H
    white_deg2 = np.array([one.white_deg**2 for one in polarimeters]) * _ROW_H / _STEP_H
    variances = []
    for step in range(1, round(_SPAN_H / _STEP_H) + 1):
        covariance = transition @ covariance @ transition.T + added
        phase = 2.0 * math.pi * step * _STEP_H / _DAY_H
        if wheels is not None:
            push = _push(len(covariance), first, phase)
            covariance = push @ covariance @ push.T
        covariance = _updated(covariance, rows, power_db2)
        if wheels is not None and step % every == 0:
            momentum = _momentum_rows(len(covariance), first, wheels)
            covariance = _updated(covariance, momentum, np.full(2, wheels.sigma_n_m_s**2))
        if polarimeters:
            covariance = _updated(covariance, _angle_rows(len(covariance), polarimeters, phase), white_deg2)
        variances.append(np.diagonal(covariance)[_ANGLES].copy())
    return np.asarray(np.sqrt(np.mean(variances[-round(_JUDGED_H / _STEP_H) :], axis=0)))


class _States(NamedTuple):
    """Some states: transition and process noise of a step, and covariance at the alignment, (D, D) each."""

    transition: FloatArray
    added: FloatArray
    covariance: FloatArray


def _of_powers(noise: ColouredNoise, drift: DriftStatistics) -> _States:
    """Return angles, drift, chain, references and coloured parts."""
    tau_h, power_db2 = noise.tau_s / 3600.0, np.square(noise.sigma_db)
    mean_db2 = np.square(noise.white_db) * _ROW_H / _QUIET_H
    mean_db2 = mean_db2 + (power_db2 * np.minimum(1.0, 2.0 * tau_h / _QUIET_H)).sum(axis=1)
    keep = np.exp(-_STEP_H * 3600.0 / np.where(noise.tau_s > 0.0, noise.tau_s, 1.0)).ravel()
    drift_keep, drift_deg2 = math.exp(-_STEP_H / drift.tau_h), np.square(drift.sigma_deg_h)
    transition = np.diag(np.concatenate([np.ones(3), np.full(3, drift_keep), np.ones(1 + len(mean_db2)), keep]))
    transition[:2, :2] = _turn(1.0)
    transition[_ANGLES, _DRIFT] = _STEP_H * np.eye(3)
    added = [
        [drift.walk_deg_sqrt_h**2 * _STEP_H] * 3,
        drift_deg2 * (1.0 - drift_keep**2),
        [_CHAIN_WALK_DB**2 * _STEP_H],
    ]
    aligned = [[_ALIGNED_DEG**2] * 3, drift_deg2, [_CHAIN_DB**2], mean_db2, power_db2.ravel()]
    return _States(
        transition,
        np.diag(np.concatenate([*added, np.zeros(len(mean_db2)), power_db2.ravel() * (1.0 - keep**2)])),
        np.diag(np.concatenate(aligned)),
    )


def _of_wheels(wheels: WheelStatistics) -> _States:
    """Return momentum, misalignment and torque."""
    torque = [(wheels.torque_error_n_m * 3600.0) ** 2] * 6
    walk = [_WALK_N_M_S**2 * _STEP_H * 3600.0] * 2
    transition = np.eye(_MOMENTUM)
    transition[:2, :2] = _turn(-1.0)
    return _States(
        transition,
        np.diag(walk + [0.0] * (_MOMENTUM - 2)),
        np.diag([_FREE_N_M_S**2] * 2 + [wheels.misalignment_deg**2] * 2 + torque),
    )


def _of_polarimeter(one: PolarimeterModel) -> _States:
    """Return offset, daily wave and wander."""
    keep = math.exp(-_STEP_H / one.wander_h)
    unknown = [_FREE_OFFSET_DEG**2, one.daily_deg**2, one.daily_deg**2]
    known = unknown if one.learned is None else np.diag(np.array(one.learned.covariance)).tolist()
    return _States(
        np.diag([1.0, 1.0, 1.0, keep]),
        np.diag([one.offset_walk_deg_sqrt_h**2 * _STEP_H, 0.0, 0.0, one.wander_deg**2 * (1.0 - keep**2)]),
        np.diag([*known, one.wander_deg**2]),
    )


def _turn(sign: float) -> FloatArray:
    """Return what the orbit's turn makes of two components in a step."""
    angle = sign * _ORBITAL_RATE_PER_H * _STEP_H
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])


def _momentum_rows(states: int, first: int, wheels: WheelStatistics) -> FloatArray:
    """Return the rows (2, D) of hx and hz; the states of wheels begin at a place."""
    by_angle = math.radians(wheels.pitch_bias_n_m_s)
    rows = np.zeros((2, states))
    rows[0, [0, first, first + 2]] = by_angle, 1.0, by_angle
    rows[1, [1, first + 1, first + 3]] = -by_angle, 1.0, -by_angle
    return rows


def _angle_rows(states: int, polarimeters: tuple[PolarimeterModel, ...], phase: float) -> FloatArray:
    """Return the rows (P, D) of angles; the states of polarimeters are the last ones."""
    own = np.kron(np.eye(len(polarimeters)), [1.0, math.cos(phase), math.sin(phase), 1.0])
    rows = np.zeros((len(polarimeters), states))
    rows[:, _ANGLES] = [one.sight for one in polarimeters]
    rows[:, states - own.shape[1] :] = own
    return rows


def _push(states: int, first: int, phase: float) -> FloatArray:
    """Return what the torque of a step, in N m s an hour, does to the momentum, whose states begin at a place."""
    push = np.eye(states)
    for axis in range(2):
        at = first + 4 + 3 * axis
        push[first + axis, at : at + 3] = np.array([1.0, math.cos(phase), math.sin(phase)]) * _STEP_H
    return push


def _updated(covariance: FloatArray, rows: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the covariance after measurements of rows (M, D) with variances (M,)."""
    cross = rows @ covariance
    factor = np.linalg.cholesky(cross @ rows.T + np.diag(variance))
    whitened = np.linalg.solve(factor, cross)
    return np.asarray(covariance - whitened.T @ whitened)
