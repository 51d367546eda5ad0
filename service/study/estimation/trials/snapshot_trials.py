"""Trials of the snapshot, the fix of one epoch alone, at attitudes all over the range.

Two worlds of one seed that differ in the attitude only have the same noise, so the difference of their powers is the
true change of the beams, free of noise: the spacecraft of ``octants`` against the spacecraft of ``nominal``. To it are
added the noise of fifteen averaged rows and a level common to all carriers. The calibration comes from ``white`` of
that seed.

* ``over_bound_true``: the coefficients are known; rms over the bound of Cramer and Rao with a common level.
* ``over_bound_fitted``, ``yaw_scale``: the beams are the simulator's, the coefficients those of the calibration.
* ``breakdown``: most carriers out of sixteen that may be rained on while fewer than 1 % of the fixes of roll or pitch
  are off by 0.3 deg; ``false_exclusion_share`` of the sound carriers up to there.
* ``level_day1_db``, ``level_day7_db``: error of the expected level on that day of operation.

Trials of the expected level: how far the daily change that a calibration predicts is off some days later.

Powers of ``white`` less the level that calibration and ballistics expect, less what the true attitude does to them, are
noise and the error of the prediction. Means of two hours leave 0.015 dB of the noise; its variance is known and taken
off.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.geometry_columns import (
    QuadraticResponse,
    exact_response,
    predict_deviation,
    predict_jacobian,
)
from service.core.estimation.observability import crlb_deg
from service.core.estimation.snapshot import CarrierUse, Snapshots, solve_snapshots, subset_orders
from service.pipeline.carrier_model.expected_level import GeometryModel, expected_levels, geometry_model
from service.records.calibration import GeometryFit
from service.records.catalogue import CarrierPlan, Ephemeris
from service.records.levels.attitude import BoolArray, FloatArray
from service.study.estimation.bounds import AXES, Statistics
from service.study.estimation.flight.drive import UndrivenError, calibrate
from service.study.estimation.flight.world import World, simulated_world

#: days of operation that are looked at, counted from 1
DAYS = (1, 7)
#: rows of a minute in one mean, and means of a day
_BLOCK, _BLOCKS = 120, 12


def level_error_db2(world: World, model: GeometryModel, fit: GeometryFit, ephemeris: Ephemeris) -> FloatArray:
    """Return the mean square (D,) in dB^2 of the prediction's error on each of ``DAYS``, over all carriers.

    Parameters
    ----------
    world : World
        White noise only, rows of a minute, as many days of operation as the last of ``DAYS``.
    model, fit : GeometryModel, GeometryFit
        Calibration of its quiet days.
    ephemeris : Ephemeris
        Orbit that the ground predicts.
    """
    first = int(np.searchsorted(world.ground.epochs_us, world.ground.phases["operation"].start_us))
    squares = []
    for day in DAYS:
        begin = first + (day - 1) * _BLOCK * _BLOCKS
        rows = slice(begin, begin + _BLOCK * _BLOCKS)
        expected_dbm = expected_levels(model, fit, ephemeris)(world.ground.epochs_us[rows])
        turned_db = predict_deviation(world.truth.attitude_deg[rows], model.response)
        error_db = world.ground.power_dbm[rows] - expected_dbm - turned_db
        means_db = error_db.reshape(_BLOCKS, _BLOCK, -1).mean(axis=1)
        squares.append(np.mean(means_db**2 - world.truth.white_db**2 / _BLOCK))
    return np.array(squares)


ROWS_AVERAGED = 15
COMMON_DB = 0.3
FAR_DEG, FAR_SHARE = 0.3, 0.01
#: attitudes with known coefficients, and for each number of carriers in the rain
_EXACT_TRIALS, _RAINED_TRIALS = 2500, 150
#: noises drawn for each attitude of the simulator's craft, and rows from one attitude to the next
_DRAWS, _STRIDE = 8, 10
_OPERATION_DAYS = 1.0
_MAX_DEG = 0.3
#: what a quadratic does not describe, of the simulator's beams and of another quadratic, dB
MODEL_ERROR_DB = 0.01
_NO_MODEL_ERROR_DB = 1e-4
#: fades of the rained on, dB
_FADE_DB = (0.5, 6.0)
_MAX_RAINED = 8
_STREAM = 20131


class SnapshotTrials(NamedTuple):
    """Sums of one seed; squares (3,) are means over the fixes, each over the square of its bound."""

    exact_ratio_square: FloatArray
    fitted_ratio_square: FloatArray
    #: of estimate and true yaw, and of true yaw
    yaw_covariance: float
    yaw_variance: float
    #: (K,) for 0..K-1 carriers in the rain: fixes, fixes that are far off, sound carriers, sound carriers excluded
    fixes: FloatArray
    far: FloatArray
    sound: FloatArray
    excluded: FloatArray
    #: (D,) dB^2, error of the expected level on each of ``DAYS``
    level_error_db2: FloatArray


def run_trials(seed: int) -> SnapshotTrials:
    """Return the trials of one seed.

    Raises
    ------
    ExportFailedError, UndrivenError
        No world, or no calibration.
    """
    calm, still, touring = (_world(name, seed) for name in ("white", "nominal", "octants"))
    plan = CarrierPlan(1, "", calm.ground.carriers)
    result = calibrate(calm.ground, plan, calm.ground.ephemeris).result
    if result is None or result.geometry is None:
        message = "the calibration holds no geometry"
        raise UndrivenError(message)
    model = geometry_model(result.geometry)
    response = model.response
    sigma_db = calm.truth.white_db / np.sqrt(ROWS_AVERAGED)
    rng = np.random.default_rng((_STREAM, seed))
    exact = exact_response(response.slope, response.curvature)
    fitted_ratio, covariance, variance = _with_calibration(rng, response, sigma_db, still, touring)
    return SnapshotTrials(
        _with_known_coefficients(rng, exact, sigma_db),
        fitted_ratio,
        covariance,
        variance,
        *_rained(rng, exact, sigma_db),
        level_error_db2(calm, model, result.geometry, calm.ground.ephemeris),
    )


def trial_statistics(seeds: Sequence[SnapshotTrials]) -> Statistics:
    """Return the figures over all seeds."""
    exact = np.sqrt(np.mean([seed.exact_ratio_square for seed in seeds], axis=0))
    fitted = np.sqrt(np.mean([seed.fitted_ratio_square for seed in seeds], axis=0))
    far = np.sum([seed.far for seed in seeds], axis=0) / np.sum([seed.fixes for seed in seeds], axis=0)
    broken = np.flatnonzero(far >= FAR_SHARE)
    breakdown = (int(broken[0]) if len(broken) else len(far)) - 1
    upto = slice(0, max(breakdown, 0) + 1)
    excluded, sound = (np.sum([values[upto] for values in many]) for many in _pairs(seeds))
    by_axis = {"over_bound_true": exact, "over_bound_fitted": fitted}
    # noise taken off may leave less than nothing
    level_db = np.sqrt(np.maximum(np.mean([seed.level_error_db2 for seed in seeds], axis=0), 0.0))
    return {
        **{f"{name}.{axis}": float(values[k]) for name, values in by_axis.items() for k, axis in enumerate(AXES)},
        **{f"level_day{day}_db": float(level_db[k]) for k, day in enumerate(DAYS)},
        "yaw_scale": sum(seed.yaw_covariance for seed in seeds) / sum(seed.yaw_variance for seed in seeds),
        "breakdown": float(breakdown),
        "false_exclusion_share": float(excluded / sound),
    }


def _pairs(seeds: Sequence[SnapshotTrials]) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return excluded and sound carriers of all seeds."""
    return [seed.excluded for seed in seeds], [seed.sound for seed in seeds]


def _world(scenario: str, seed: int) -> World:
    """Return a world that is as long as the trials need it."""
    return simulated_world(scenario, seed, max(DAYS) if scenario == "white" else _OPERATION_DAYS)


def _solve(
    response: QuadraticResponse, deviation_db: FloatArray, sigma_db: FloatArray, model_error_db: float
) -> Snapshots:
    """Return the fixes, piece by piece so that the arrays stay in the processor's cache."""
    orders = subset_orders(len(sigma_db))
    chunks = np.array_split(deviation_db, max(1, len(deviation_db) // 500))
    solved = [solve_snapshots(response, chunk, sigma_db, orders, model_error_db=model_error_db) for chunk in chunks]
    return Snapshots(*(np.concatenate(field) for field in zip(*solved, strict=True)))


def _noise_db(rng: np.random.Generator, rows: int, sigma_db: FloatArray) -> FloatArray:
    """Return the noise of carriers and of all of them together."""
    own = sigma_db * rng.normal(size=(rows, len(sigma_db)))
    return np.asarray(own + COMMON_DB * rng.normal(size=(rows, 1)))


def _bounds_deg(jacobian: FloatArray, sigma_db: FloatArray) -> FloatArray:
    """Return the bound (T, 3) at every attitude."""
    return np.array([crlb_deg(one, sigma_db, with_common=True) for one in jacobian])


def _with_known_coefficients(rng: np.random.Generator, exact: QuadraticResponse, sigma_db: FloatArray) -> FloatArray:
    """Return the mean square of error over bound."""
    attitude = rng.uniform(-_MAX_DEG, _MAX_DEG, (_EXACT_TRIALS, 3))
    values = predict_deviation(attitude, exact) + _noise_db(rng, _EXACT_TRIALS, sigma_db)
    error = _solve(exact, values, sigma_db, _NO_MODEL_ERROR_DB).attitude_deg - attitude
    bound = _bounds_deg(predict_jacobian(attitude, exact), sigma_db)
    return np.asarray(np.mean((error / bound) ** 2, axis=0))


def _with_calibration(
    rng: np.random.Generator, response: QuadraticResponse, sigma_db: FloatArray, still: World, touring: World
) -> tuple[FloatArray, float, float]:
    """Return the mean square of error over bound, and covariance and variance of yaw."""
    start_us = touring.ground.phases["operation"].start_us
    rows = np.flatnonzero(touring.ground.epochs_us >= start_us)[::_STRIDE]
    others = still.truth.attitude_deg[rows]
    change_db = touring.ground.power_dbm[rows] - still.ground.power_dbm[rows] + predict_deviation(others, response)
    attitude = np.tile(touring.truth.attitude_deg[rows], (_DRAWS, 1))
    values = np.tile(change_db, (_DRAWS, 1)) + _noise_db(rng, len(attitude), sigma_db)
    estimate = _solve(response, values, sigma_db, MODEL_ERROR_DB).attitude_deg
    bent = predict_jacobian(touring.truth.attitude_deg[rows], response) - response.slope
    bound = np.tile(_bounds_deg(touring.truth.sensitivity_db_per_deg + bent, sigma_db), (_DRAWS, 1))
    centred = attitude[:, 0] - attitude[:, 0].mean()
    ratio = np.mean(((estimate - attitude) / bound) ** 2, axis=0)
    return np.asarray(ratio), float(np.mean(centred * estimate[:, 0])), float(np.mean(centred**2))


def _rained(
    rng: np.random.Generator, exact: QuadraticResponse, sigma_db: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what becomes of the fixes with more and more carriers in the rain, arrays (K,)."""
    counts = []
    for rained in range(_MAX_RAINED):
        attitude = rng.uniform(-_MAX_DEG, _MAX_DEG, (_RAINED_TRIALS, 3))
        values = predict_deviation(attitude, exact) + _noise_db(rng, _RAINED_TRIALS, sigma_db)
        is_wet: BoolArray = np.asarray(np.argsort(rng.random(values.shape), axis=1) < rained)
        fixes = _solve(
            exact, values - np.where(is_wet, rng.uniform(*_FADE_DB, values.shape), 0.0), sigma_db, _NO_MODEL_ERROR_DB
        )
        # negated, so that a fix that is not a number is far off
        near: BoolArray = np.asarray((np.abs(fixes.attitude_deg - attitude)[:, 1:] <= FAR_DEG).all(axis=1))
        out = fixes.use == CarrierUse.EXCLUDED
        counts.append((len(near), np.count_nonzero(~near), np.count_nonzero(~is_wet), np.count_nonzero(out & ~is_wet)))
    fixes_, far, sound, excluded = np.array(counts, dtype=np.float64).T
    return fixes_, far, sound, excluded
