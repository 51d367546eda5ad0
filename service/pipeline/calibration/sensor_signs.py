"""Verdict on the axes of the attitude sensors: a calibration with a wrong sign, order or scale is refused or warned of.

The law of this file: a mistake is refused only when another reading of the sensors explains the powers better by five
sigma; where the powers cannot tell, the calibration says that the sign is unproven.
"""

from typing import NamedTuple

import numpy as np

from service.core.estimation.calibration.sensor_axes import (
    DECISIVE,
    MAPPINGS,
    AxesVerdict,
    FreeResponse,
    judge_axes,
)
from service.pipeline.calibration.geometry_rows import CalibrationError, CalibrationInput, PlanPositions
from service.pipeline.config import CalibrationConfig
from service.records.calibration import SensorSigns
from service.records.levels.attitude import BoolArray, FloatArray

_AXIS_NAMES = ("yaw", "roll", "pitch")
_SIGMAS = 5.0
#: readings of the sensors that explain the powers this much worse than the best one are named beside it
_SIMILAR = 9.0


class SignReport(NamedTuple):
    """Report of a calibration on the axes of its sensors."""

    signs: SensorSigns
    quality: dict[str, float]
    warnings: tuple[str, ...]


def report_signs(
    data: CalibrationInput,
    config: CalibrationConfig,
    positions: PlanPositions,
    free: FreeResponse,
    is_used: BoolArray,
    yaw_reach_deg: float,
    *,
    doubt: str = "",
) -> SignReport:
    """Return the report on the axes of the sensors.

    Parameters
    ----------
    data : CalibrationInput
        Plan, references and corrections.
    config : CalibrationConfig
        Limits.
    positions : PlanPositions
        Positions of the stations.
    free : FreeResponse
        Slopes of each carrier about each axis of the sensors.
    is_used : ndarray of bool, shape (N,)
        Carriers with a station, slopes and no level control.
    yaw_reach_deg : float
        Largest yaw angle of the turns.
    doubt : str
        Why angles are of another time, unit or sensor, which prove no sign and contradict none; empty = they are not.

    Raises
    ------
    CalibrationError
        The powers contradict the axes of the sensors.
    """
    transponders = [carrier.transponder for carrier in data.plan.carriers]
    beam = np.unique(transponders, return_inverse=True)[1]
    turned = _turned(data, config)
    verdict = judge_axes(free, positions.geometry, beam, is_used, turned)
    unproven = SensorSigns(is_yaw_proven=False, is_common_proven=False)
    if verdict is None:
        return SignReport(unproven, {}, (_unproven("too few carriers have a station"),))
    contradiction = _contradiction(verdict, data.sensors)
    if contradiction and not doubt:
        raise CalibrationError(contradiction)
    if contradiction:
        return SignReport(unproven, {}, (contradiction,))
    is_turned = yaw_reach_deg >= config.min_yaw_proof_deg
    is_yaw_proven = is_turned and verdict.margin(-1.0, 1.0, 1.0) >= DECISIVE
    warnings = _about_scale(verdict, config)
    if not is_yaw_proven:
        why = f"yaw was turned by {yaw_reach_deg:.2f} deg, {config.min_yaw_proof_deg} deg are needed"
        warnings += (_unproven("noise hides the effect of the yaw turns" if is_turned else why),)
    quality = {}
    for name, value, sigma in zip(("pitch", "roll"), verdict.coefficient, verdict.sigma, strict=True):
        quality[f"yaw_on_{name}_slope"] = float(value)
        quality[f"yaw_on_{name}_slope_sigma"] = float(sigma)
    is_common_proven = verdict.margin(-1.0, -1.0, -1.0) >= DECISIVE
    return SignReport(SensorSigns(is_yaw_proven, is_common_proven), quality, warnings)


def _turned(data: CalibrationInput, config: CalibrationConfig) -> tuple[FloatArray, FloatArray]:
    """Return the announced corrections (C, 3) of the turns and the changes that the sensors told."""
    announced = np.array([correction.change_deg for correction in data.corrections]).reshape(-1, 3)
    spans_us = np.array([(one.start_us, one.stop_us) for one in data.corrections], dtype=np.int64).reshape(-1, 2)
    before, after = (data.angles_deg(spans_us[:, k], config) for k in range(2))
    return announced, after - before


def _contradiction(verdict: AxesVerdict, sensors: tuple[str, str, str]) -> str:
    """Return why the powers contradict the axes of the sensors; empty = they do not."""
    best = float(verdict.chi_square.min())
    if verdict.chi_square[0] - best <= DECISIVE:
        return ""
    similar = np.flatnonzero(verdict.chi_square <= best + _SIMILAR)[:2]
    likely = ", or ".join(_mistake(MAPPINGS[k]) for k in similar)
    (pitch, roll), (pitch_sigma, roll_sigma) = verdict.coefficient, verdict.sigma
    return (
        f"the powers contradict the axes of {', '.join(sorted(set(sensors)))} by "
        f"{np.sqrt(verdict.chi_square[0] - best):.0f} sigma; likely {likely} (yaw slopes on pitch slopes "
        f"{pitch:+.2f} +- {pitch_sigma:.2f}, on roll slopes {roll:+.2f} +- {roll_sigma:.2f}, both must be +1). Send "
        "references in which roll > 0 moves stations South, pitch > 0 West and yaw > 0 those in the East to the North"
    )


def _mistake(mapping: FloatArray) -> str:
    """Return the mistake of a sensor that a mapping corrects."""
    source = np.abs(mapping).argmax(axis=1)
    moved = [name for k, name in enumerate(_AXIS_NAMES) if source[k] != k]
    flipped = [name for name, row in zip(_AXIS_NAMES, mapping, strict=True) if row.sum() < 0.0]
    exchanged = [f"exchanged axes ({', '.join(moved)})"] if moved else []
    return " and ".join([*exchanged, *([f"flipped {', '.join(flipped)}"] if flipped else [])])


def _about_scale(verdict: AxesVerdict, config: CalibrationConfig) -> tuple[str, ...]:
    """Return the warning of a scale that differs between the axes."""
    off = np.abs(verdict.coefficient - 1.0)
    is_off = (off > _SIGMAS * verdict.sigma) & (off > config.max_scale_error)
    if not is_off.any():
        return ()
    axis = "yaw" if is_off.all() else ("pitch" if is_off[0] else "roll")
    (pitch, roll), (pitch_sigma, roll_sigma) = verdict.coefficient, verdict.sigma
    text = (
        f"the scale of the {axis} sensor differs from that of the other axes: yaw slopes on pitch slopes {pitch:.2f} "
        f"+- {pitch_sigma:.2f}, on roll slopes {roll:.2f} +- {roll_sigma:.2f}, both should be 1; check its units"
    )
    return (text,)


def _unproven(why: str) -> str:
    """Return the warning of a yaw whose sign is not proven."""
    return f"the sign of yaw is unproven: {why}; the method paper does not control it under this calibration"
