"""Observer of the published loop: fixes of the paper method carried on by the dynamics of the spacecraft.

    x = [yaw roll pitch | 3 drifts | 3 commanded rates | 9 torques | 2 errors of fixes]
                                                            deg, deg/h, deg/h^2 as in `hidden_motion`, deg

A fix is late by half of its mean, its slope is no rate, and it is wrong by the same for a day: levels drift. What moves
the spacecraft is known better: commands, the exchange of roll and yaw, a torque that changes slowly. So the error of
fixes is a state beside the motion, and a fix only corrects. The law of this file: a state is a value.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.estimation.filtering.model.filter_model import (
    ATTITUDE,
    RATE,
    RATE_FLOOR_DEG_H,
    BoolArray,
    CarrierModel,
    FilterSettings,
    FloatArray,
    KnownMotion,
)
from service.core.estimation.filtering.model.step_inputs import step_inputs
from service.core.estimation.filtering.model.torque_prior import TORQUES, torque_covariance

#: places of torques and of the error of fixes
TORQUE = slice(RATE.stop, RATE.stop + TORQUES)
ERROR = slice(TORQUE.stop, TORQUE.stop + 2)
#: what levels have wrong for long, dB, and for how long, h: means of six hours of fixes in the study's worlds are wrong
#: by 0.2 to 0.8 deg in yaw, 0.03 in roll, 0.04 to 0.14 in pitch, which is 0.2 dB by their geometry
_LASTING_DB = 0.2
_LASTING_H = 24.0
#: fewest carriers of a fix
_MIN_CARRIERS = 4
_MAX_CONDITION = 1e6
_CALM = (False, False, False)
_NONE = np.zeros(0)
_NO_CARRIERS = CarrierModel(
    gradient_db_deg=np.zeros((0, 3)),
    hessian_db_deg2=np.zeros((0, 3, 3)),
    rain_share=_NONE,
    transponder=np.zeros(0, dtype=np.int64),
    white_sigma_db=_NONE,
    coloured_sigma_db=np.zeros((0, 1)),
    coloured_tau_s=np.zeros((0, 1)),
    reference_walk_db=_NONE,
    common_sigma_db=_NONE,
    common_tau_s=_NONE,
    coefficient_covariance=np.zeros((0, 9, 9)),
)


class LoopModel(NamedTuple):
    """Motion of the spacecraft, and the covariance (2, 2) of what fixes have wrong for long, deg^2."""

    motion: FilterSettings
    lasting_deg2: FloatArray


class LoopEstimate(NamedTuple):
    """Mean (20,) and covariance (20, 20) at an epoch."""

    epoch_us: int
    mean: FloatArray
    covariance: FloatArray


class LinearFix(NamedTuple):
    """Roll and pitch of some levels, with what yaw does to them.

    Parameters
    ----------
    angles_deg : ndarray, shape (2,), deg
        Roll and pitch, if yaw were zero.
    response : ndarray, shape (2, 3), deg/deg
        Of these numbers to yaw, roll and pitch.
    unit_covariance : ndarray, shape (2, 2), deg^2/dB^2
        For a noise of 1 dB of each level.
    scatter_db : float, dB
        What the levels differ by from any roll and pitch, rms.
    """

    angles_deg: FloatArray
    response: FloatArray
    unit_covariance: FloatArray
    scatter_db: float


def linear_fix(level_db: FloatArray, plus: FloatArray, minus: FloatArray, is_used: BoolArray) -> LinearFix | None:
    """Return the least squares fix of level changes (N,) by the slope in the middle of both signs.

    The published system lets each angle choose its sign, which is right at the reach of the turns; in a loop angles are
    small. Its yaw is left out: what a calibration tells of yaw beside roll and pitch is mostly noise of the turns, so
    that a fix shows an eighth to a quarter of the true yaw (plant outside, seeds 101 and 102). What yaw does to roll
    and pitch it tells well: through a tenth of it the stations seem to move.

    Parameters
    ----------
    level_db : ndarray, shape (N,), dB
        Changes of the levels.
    plus, minus : ndarray, shape (N, 3), dB/deg
        Sensitivities for positive and negative angles.
    is_used : ndarray, shape (N,)
        Which carriers take part; fewer than four make no fix.
    """
    slope = 0.5 * (plus + minus)
    is_used = is_used & np.isfinite(slope).all(axis=1) & np.isfinite(level_db)
    own = slope[is_used, 1:]
    normal = own.T @ own
    if np.count_nonzero(is_used) < _MIN_CARRIERS or np.linalg.cond(normal) > _MAX_CONDITION:
        return None
    unit_covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    solution = unit_covariance @ own.T
    angles_deg = solution @ level_db[is_used]
    residual_db = level_db[is_used] - own @ angles_deg
    scatter_db = math.sqrt(float(residual_db @ residual_db) / (len(residual_db) - 2))
    return LinearFix(angles_deg, solution @ slope[is_used], unit_covariance, scatter_db)


def loop_model(motion: FilterSettings, plus: FloatArray, minus: FloatArray, is_used: BoolArray) -> LoopModel:
    """Return the model for the carriers of a calibration; of too few nothing is known of fixes."""
    fix = linear_fix(np.zeros(len(plus)), plus, minus, is_used)
    return LoopModel(motion, np.zeros((2, 2)) if fix is None else _LASTING_DB**2 * fix.unit_covariance)


def initial_estimate(epoch_us: int, attitude_deg: FloatArray, sigma_deg: FloatArray, model: LoopModel) -> LoopEstimate:
    """Return the estimate at an alignment with attitude (3,) and sigma (3,): levels are right by it."""
    mean, covariance = np.zeros(ERROR.stop), np.zeros((ERROR.stop, ERROR.stop))
    mean[ATTITUDE] = attitude_deg
    variance = np.concatenate([sigma_deg**2, np.square(model.motion.drift_deg_h), np.full(3, RATE_FLOOR_DEG_H**2)])
    covariance[: RATE.stop, : RATE.stop] = np.diag(variance)
    return with_other_torque(LoopEstimate(epoch_us, mean, covariance), model)


def with_other_torque(estimate: LoopEstimate, model: LoopModel) -> LoopEstimate:
    """Return the estimate whose torque begins again by what is stated now."""
    mean, covariance = estimate.mean.copy(), estimate.covariance.copy()
    mean[TORQUE], covariance[TORQUE], covariance[:, TORQUE] = 0.0, 0.0, 0.0
    covariance[TORQUE, TORQUE] = torque_covariance(model.motion)
    return LoopEstimate(estimate.epoch_us, mean, covariance)


def predict_estimate(estimate: LoopEstimate, model: LoopModel, epoch_us: int, known: KnownMotion) -> LoopEstimate:
    """Return the estimate at a later epoch, after what was commanded until then; an earlier epoch changes nothing."""
    step_us, motion = epoch_us - estimate.epoch_us, model.motion
    if step_us <= 0:
        return estimate
    step = step_inputs(
        _NO_CARRIERS, motion, TORQUES, step_us, known, _CALM, is_raining=False, from_us=estimate.epoch_us
    )
    hours = step.seconds / 3600.0
    transition, noise = np.eye(ERROR.stop), np.zeros((ERROR.stop, ERROR.stop))
    transition[: RATE.stop, : TORQUE.stop] = step.transition
    transition[ERROR, ERROR] *= math.exp(-hours / _LASTING_H)
    noise[: RATE.stop, : RATE.stop] = step.noise + np.diag(step.core_variance[: RATE.stop])
    # without carriers the torques are all that is common
    noise[TORQUE, TORQUE] = np.diag(-np.expm1(-2.0 * step.seconds / step.common_tau_s) * step.common_sigma**2)
    noise[ERROR, ERROR] = -math.expm1(-2.0 * hours / _LASTING_H) * model.lasting_deg2
    if len(step.torque_noise):
        noise[TORQUE, TORQUE] += step.torque_noise
    mean = transition @ estimate.mean
    mean[: RATE.stop] += step.push
    return LoopEstimate(epoch_us, mean, transition @ estimate.covariance @ transition.T + noise)


def update_estimate(estimate: LoopEstimate, fix: LinearFix, noise_db: float) -> LoopEstimate:
    """Return the estimate corrected by a fix of its epoch whose levels have a noise of some dB."""
    seen = np.zeros((2, ERROR.stop))
    seen[:, ATTITUDE], seen[:, ERROR] = fix.response, np.eye(2)
    noise_deg2 = noise_db**2 * fix.unit_covariance
    columns = estimate.covariance @ seen.T
    gain = np.linalg.solve(seen @ columns + noise_deg2, columns.T).T
    left = np.eye(ERROR.stop) - gain @ seen
    mean = estimate.mean + gain @ (fix.angles_deg - seen @ estimate.mean)
    covariance = left @ estimate.covariance @ left.T + gain @ noise_deg2 @ gain.T
    return LoopEstimate(estimate.epoch_us, mean, 0.5 * (covariance + covariance.T))
