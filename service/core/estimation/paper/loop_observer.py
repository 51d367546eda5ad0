"""Observer of the published loop: fixes of the paper method carried on by the dynamics of the spacecraft.

    x = [yaw roll pitch | 3 drifts | 3 commanded rates | 9 torques | 3 errors of fixes]
                                                            deg, deg/h, deg/h^2 as in `hidden_motion`, deg

A fix is late by half of its mean, its slope is no rate, and it is wrong by the same for a day: levels drift. What moves
the spacecraft is known better: commands, the exchange of roll and yaw, a torque that changes slowly. So the error of
fixes is a state beside the motion, and a fix only corrects. The law of this file: a state is a value.
"""

import math
from typing import NamedTuple

import numpy as np

from service.core.arrays import BoolArray, FloatArray
from service.core.compiled_entry import CompiledEntry
from service.core.estimation.calibration.geometry_columns import displacement_matrix
from service.core.estimation.filtering import filter_model, motion, plant
from service.core.estimation.filtering.filter_model import (
    ATTITUDE,
    RATE,
    RATE_FLOOR_DEG_H,
    FilterSettings,
    KnownMotion,
    no_carriers,
)
from service.core.estimation.filtering.plant import TORQUES, FilterModel, torque_covariance
from service.core.estimation.paper.downlink_fade import SIGMA_OF_MAD, median_of

#: places of torques and of the error of fixes
TORQUE = slice(RATE.stop, RATE.stop + TORQUES)
ERROR = slice(TORQUE.stop, TORQUE.stop + 3)
#: the least that levels have wrong for long, each one by itself, dB, and for how long, h: means of two hours are wrong
#: by 0.12 dB on the plant outside, and 0.08 of it in common
_LASTING_DB = 0.1
_LASTING_H = 24.0
#: variance of what levels have wrong in common over that of each one
_COMMON_VARIANCE = 0.5
#: least squares again, each with the weights that the one before leaves
_REWEIGHTINGS = 3
#: fewest carriers of a fix
_MIN_CARRIERS = 4
#: dB^2/deg^2, an axis of which levels tell less counts as zero within 50 deg/dB: stations in one place tell no yaw
_LEAST_INFORMATION = 50.0**-2
_CALM = np.zeros(3, dtype=np.bool_)
_STEP_MOTION = CompiledEntry(motion.step_motion, (filter_model, plant, motion))


class LoopModel(NamedTuple):
    """Motion of the spacecraft, slopes (N, 3) of its carriers, dB/deg, and which (N,) make fixes.

    What fixes have wrong for long has a covariance (3, 3), deg^2.
    """

    motion: FilterSettings
    #: motion as compiled functions take it, without carriers
    arrays: FilterModel
    slope_db_per_deg: FloatArray
    is_used: BoolArray
    lasting_deg2: FloatArray


class LoopEstimate(NamedTuple):
    """Mean (21,) and covariance (21, 21) at an epoch."""

    epoch_us: int
    mean: FloatArray
    covariance: FloatArray


class LinearFix(NamedTuple):
    """Angles of some levels.

    Parameters
    ----------
    angles_deg : ndarray, shape (3,), deg
        Yaw, roll, pitch.
    unit_covariance : ndarray, shape (3, 3), deg^2/dB^2
        For a noise of 1 dB of each level.
    scatter_db : float, dB
        What the levels differ by from any angles, rms.
    """

    angles_deg: FloatArray
    unit_covariance: FloatArray
    scatter_db: float


def loop_slopes(plus: FloatArray, minus: FloatArray, azimuth_deg: FloatArray, elevation_deg: FloatArray) -> FloatArray:
    """Return the slopes (N, 3) in the middle of both signs, dB/deg, those of yaw by the places of the stations.

    The published system lets each angle choose its sign, which is right at the reach of the turns; in a loop angles are
    small. Yaw moves a station in the frame of the antenna as pitch and roll do, by its direction: so its column follows
    from theirs to 0.04 dB/deg, where the turns tell it to 0.10 (plant outside). A carrier whose station has no
    direction (NaN) has no slope of yaw and takes no part, unless too few others have one.
    """
    slope = 0.5 * (plus + minus)
    moved = displacement_matrix(azimuth_deg, elevation_deg)
    yaw = np.einsum("nj,njk,nk->n", moved[..., 0], np.linalg.inv(np.swapaxes(moved[..., 1:], 1, 2)), slope[:, 1:])
    if np.count_nonzero(np.isfinite(yaw)) >= _MIN_CARRIERS:
        slope[:, 0] = yaw
    return slope


def linear_fix(level_db: FloatArray, slope: FloatArray, is_used: BoolArray) -> LinearFix | None:
    """Return the least squares fix of level changes (N,) by slopes (N, 3); fewer than four carriers make none.

    Levels are wrong by an error of their own and by one that all have in common: the receiving chain, a wet feed. Users
    change their levels for good, so a carrier far from the others counts less, as its square.
    """
    is_used = is_used & np.isfinite(slope).all(axis=1) & np.isfinite(level_db)
    own, count = slope[is_used], int(np.count_nonzero(is_used))
    if count < _MIN_CARRIERS:
        return None
    level_db = level_db[is_used]
    fix, apart_db = _weighted_fix(own, level_db, np.ones(count))
    for _ in range(_REWEIGHTINGS):
        near_db = 2.0 * max(_LASTING_DB, SIGMA_OF_MAD * median_of(apart_db))
        fix, apart_db = _weighted_fix(own, level_db, np.square(near_db / np.maximum(apart_db, near_db)))
    return fix


def _weighted_fix(own: FloatArray, level_db: FloatArray, share: FloatArray) -> tuple[LinearFix, FloatArray]:
    """Return the fix of levels (N,) by slopes (N, 3) under weights (N,), and how far each is from the others, dB."""
    # inverse of diag(1 / share) + common variance
    weight = np.diag(share) - np.multiply.outer(share, share / (1.0 / _COMMON_VARIANCE + float(share.sum())))
    weighted = own.T @ weight
    information, axes = np.linalg.eigh(weighted @ own)
    unit_covariance = np.asarray((axes / np.maximum(information, _LEAST_INFORMATION)) @ axes.T, dtype=np.float64)
    angles_deg = unit_covariance @ (weighted @ level_db)
    residual_db = level_db - own @ angles_deg
    scatter_db = math.sqrt(float(residual_db @ weight @ residual_db) / (len(own) - 3))
    apart_db = np.asarray(np.abs(residual_db - median_of(residual_db)), dtype=np.float64)
    return LinearFix(angles_deg, unit_covariance, scatter_db), apart_db


def loop_model(
    motion: FilterSettings, slope: FloatArray, is_used: BoolArray, coloured_db: float = _LASTING_DB
) -> LoopModel:
    """Return the model for the carriers of a calibration, whose levels had a coloured noise on quiet days.

    Of too few carriers nothing is known of fixes.
    """
    fix = linear_fix(np.zeros(len(slope)), slope, is_used)
    lasting_db = max(_LASTING_DB, coloured_db)
    lasting_deg2 = np.zeros((3, 3)) if fix is None else lasting_db**2 * fix.unit_covariance
    return LoopModel(motion, plant.filter_model(no_carriers(), motion), slope, is_used, lasting_deg2)


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
    step_us, arrays = epoch_us - estimate.epoch_us, model.arrays
    if step_us <= 0:
        return estimate
    step = _STEP_MOTION(
        arrays,
        TORQUES,
        np.array(known.unreported),
        estimate.epoch_us,
        step_us,
        # arrays that may be written are another type to the compiler
        *map(np.array, (known.correction_deg, known.late_correction_deg, known.rate_change_deg_h)),
        1.0,
        math.nan,
        _CALM,
        False,
    )
    hours = step_us / 3.6e9
    transition, noise = np.eye(ERROR.stop), np.zeros((ERROR.stop, ERROR.stop))
    transition[: RATE.stop, : TORQUE.stop] = step.transition[: RATE.stop]
    transition[ERROR, ERROR] *= math.exp(-hours / _LASTING_H)
    noise[: RATE.stop, : RATE.stop] = step.noise + np.diag(step.core_variance[: RATE.stop])
    settled = -math.expm1(-2.0 * hours / model.motion.torque_tau_h)
    noise[TORQUE, TORQUE] = np.diag(settled * arrays.plant[0]["torque_prior_deg_h2"] ** 2)
    noise[ERROR, ERROR] = -math.expm1(-2.0 * hours / _LASTING_H) * model.lasting_deg2
    if arrays.plant[0]["is_fed_forward"]:
        noise[TORQUE, TORQUE] += settled * arrays.plant[0]["scale_covariance"]
    mean = transition @ estimate.mean
    mean[: RATE.stop] += step.push[: RATE.stop]
    return LoopEstimate(epoch_us, mean, transition @ estimate.covariance @ transition.T + noise)


def update_estimate(estimate: LoopEstimate, fix: LinearFix, noise_db: float) -> LoopEstimate:
    """Return the estimate corrected by a fix of its epoch whose levels have a noise of some dB."""
    seen = np.zeros((3, ERROR.stop))
    seen[:, ATTITUDE] = seen[:, ERROR] = np.eye(3)
    noise_deg2 = noise_db**2 * fix.unit_covariance
    columns = estimate.covariance @ seen.T
    gain = np.linalg.solve(seen @ columns + noise_deg2, columns.T).T
    left = np.eye(ERROR.stop) - gain @ seen
    mean = estimate.mean + gain @ (fix.angles_deg - seen @ estimate.mean)
    covariance = left @ estimate.covariance @ left.T + gain @ noise_deg2 @ gain.T
    return LoopEstimate(estimate.epoch_us, mean, 0.5 * (covariance + covariance.T))
