"""Quality of a calibration by geometry: its figures by name, with their units."""

import numpy as np

from service.pipeline.calibration.geometry_fit import JointFit
from service.pipeline.calibration.geometry_rows import GeometryRows
from service.records.levels.attitude import BoolArray, FloatArray

_AXIS_NAMES = ("yaw", "roll", "pitch")
#: rows that a stretch of the fit averages
_STRETCH_ROWS = 10.0


def slope_shrink(rows: GeometryRows) -> FloatArray:
    """Return by what share (3,) the noise of the sensors makes slopes come out too small; NaN without readings.

    It is the noise's share in the variance of the angles that the fit saw. Noise that was left as it is is averaged by
    a stretch; noise that was smoothed is not, and edges of turns that it hides cost as much again (0.06 deg of noise:
    1 to 2 %, 0.1 deg: 5 to 7 %, on turns of 15 min).
    """
    angles = rows.angles
    is_smoothed = angles.remaining_sigma_deg < angles.sensor_sigma_deg
    left = np.where(is_smoothed, 2.0 * angles.remaining_sigma_deg**2, angles.sensor_sigma_deg**2 / _STRETCH_ROWS)
    known = angles.attitude_deg[np.isfinite(angles.attitude_deg).all(axis=1)]
    variance = known.var(axis=0) if len(known) else np.full(3, np.nan)
    return np.asarray(left / np.maximum(variance, 1e-12))


def quality_metrics(rows: GeometryRows, joint: JointFit, is_used: BoolArray) -> dict[str, float]:
    """Return the figures of the joint fit."""
    fit = joint.fit
    known = np.isfinite(rows.angles.attitude_deg).all(axis=1)
    turns = rows.angles.attitude_deg[known & ~rows.is_quiet]
    sight = rows.rows.motion.sight_deg if rows.rows.motion is not None else np.full((1, 1, 2), np.nan)
    slow_db = np.sqrt(np.square(joint.noise.sigma_db).sum(axis=1))
    sigma = np.sqrt(np.diagonal(fit.covariance, axis1=1, axis2=2))
    slope_sigma = np.sqrt(np.diagonal(joint.response.covariance, axis1=1, axis2=2))[:, :3]
    figures = {
        "carriers_used": float(np.count_nonzero(is_used)),
        "tracked_share": float(rows.is_tracked.mean()),
        "motion_rms_deg": _rms(sight[np.isfinite(sight)]),
        "joint_residual_rms_db": _median(fit.residual_rms_db[is_used]),
        "level_sigma_db": _median(sigma[is_used, 0]),
        "white_noise_db": _median(joint.noise.white_db[is_used]),
        "slow_noise_db": _median(slow_db[is_used]),
        "common_noise_db": float(np.sqrt(np.square(joint.noise.common_db).sum())),
        "reference_walk_db_sqrt_h": _median(joint.drift.walk_db[is_used]),
        "quantisation_db": _median(joint.quantisation_db[is_used]),
        "turn_scatter": _median(joint.turn_scatter.mean[is_used]),
    }
    shrink = slope_shrink(rows)
    for axis, name in enumerate(_AXIS_NAMES):
        figures[f"{name}_turn_reach_deg"] = float(np.abs(turns[:, axis]).max(initial=0.0))
        figures[f"{name}_slope_sigma_db_per_deg"] = _median(slope_sigma[is_used, axis])
        figures[f"{name}_sensor_sigma_deg"] = float(rows.angles.sensor_sigma_deg[axis])
        figures[f"{name}_slope_shrink"] = float(shrink[axis])
    return figures


def _median(values: FloatArray) -> float:
    """Return the median of the figures that are there, NaN when there are none."""
    present = values[np.isfinite(values)]
    return float(np.median(present)) if len(present) else float("nan")


def _rms(values: FloatArray) -> float:
    """Return the root mean square, NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if values.size else float("nan")
