"""Check of polarimeters by the calibration turns, before the filter uses them.

The law of this file: an instrument is refused only where the turns contradict it; what was not checked is said with
its reason.
"""

import math

import numpy as np

from service.core.estimation.calibration.checks.angle_response import AngleResponse, angle_response
from service.pipeline.calibration.windows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.polarization import line_of_sight, measured_angle_deg, orbit_turn_deg, used_polarimeters
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import MotionVerdict, PolarimeterCheck
from service.records.catalogue import Polarimeter, Spacecraft
from service.records.levels.attitude import FloatArray, IntArray

#: sigmas from which an instrument is contradicted
_SIGMAS = 3.5
_LEAST_RECORDS = 20
_US_PER_H = 3.6e9
_NEXT = (
    "the filter does not use it under this calibration; correct the sign of feed_offset_deg, the feed or the ratio, "
    "send the records of the turns again and calibrate again"
)


def polarimeter_checks(data: CalibrationInput, config: CalibrationConfig) -> tuple[PolarimeterCheck, ...]:
    """Return the check of each polarimeter that the catalogue uses."""
    if data.spacecraft is None:
        return ()
    return tuple(_check(data, config, data.spacecraft, each) for each in used_polarimeters(data.spacecraft))


def polarimeter_quality(checks: tuple[PolarimeterCheck, ...]) -> dict[str, float]:
    """Return the figures of the check that is farthest from a true instrument, by name."""
    known = [check for check in checks if math.isfinite(check.response_sigma)]
    if not known:
        return {}
    worst = max(known, key=lambda check: abs(check.response - 1.0) / check.response_sigma)
    return {"polarimeter_response": worst.response, "polarimeter_response_sigma": worst.response_sigma}


def polarimeter_warnings(checks: tuple[PolarimeterCheck, ...]) -> tuple[str, ...]:
    """Return the warnings of the checks."""
    return tuple(
        f"polarimeter {check.source} is refused: {check.reason}; {_NEXT}"
        if check.verdict is MotionVerdict.CONTRADICTED
        else f"polarimeter {check.source} was not checked: {check.reason}"
        for check in checks
        if check.reason
    )


def _check(
    data: CalibrationInput, config: CalibrationConfig, spacecraft: Spacecraft, polarimeter: Polarimeter
) -> PolarimeterCheck:
    """Return the check of one polarimeter."""
    source, turns = polarimeter.source, data.request.turns
    records = sorted(
        (one for one in data.polarization if one.source == source and turns.start_us <= one.epoch_us < turns.stop_us),
        key=lambda one: one.epoch_us,
    )
    if len(records) < _LEAST_RECORDS:
        reason = f"{len(records)} records within the turns, {_LEAST_RECORDS} are needed"
        return PolarimeterCheck(source, MotionVerdict.UNCHECKED, reason)
    epochs_us = np.array([one.epoch_us for one in records], dtype=np.int64)
    measured = np.array([measured_angle_deg(one, polarimeter) for one in records])
    expected = _expected_deg(data, config, spacecraft, polarimeter, epochs_us)
    return _judged(source, angle_response((epochs_us - epochs_us[0]) / _US_PER_H, measured, expected))


def _expected_deg(
    data: CalibrationInput,
    config: CalibrationConfig,
    spacecraft: Spacecraft,
    polarimeter: Polarimeter,
    epochs_us: IntArray,
) -> FloatArray:
    """Return the angle (K,) about the line of sight by the sensors and the orbit, deg."""
    sight = line_of_sight(spacecraft, polarimeter)
    angles = angles_at(epochs_us, data.quiet_references + data.references, data.sensors, config)
    return np.asarray(angles @ np.array(sight) + orbit_turn_deg(data.ephemeris, spacecraft, sight, epochs_us))


def _judged(source: str, response: AngleResponse) -> PolarimeterCheck:
    """Return what the response says of a polarimeter."""
    figures, sigmas = (response.coefficient, response.sigma), response.deviation()
    if sigmas > _SIGMAS:
        reason = (
            f"its angle follows the turns by {response.coefficient:+.2f} +- {response.sigma:.2f}, which must be +1 "
            f"({sigmas:.1f} sigma)"
        )
        return PolarimeterCheck(source, MotionVerdict.CONTRADICTED, reason, *figures)
    if not response.is_determined:
        reason = "too few turns in yaw: the response is known worse than to 0.2"
        return PolarimeterCheck(source, MotionVerdict.UNCHECKED, reason, *figures)
    return PolarimeterCheck(source, MotionVerdict.CONSISTENT, "", *figures)
