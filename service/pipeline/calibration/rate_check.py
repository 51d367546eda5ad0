"""Check of the reported rates of the body by the calibration turns, before the filter uses them.

The law of this file: telemetry is refused only where it is contradicted; what was not checked is said with its reason.
"""

import math

import numpy as np

from service.core.estimation.calibration.checks.responses import RateResponse, rate_response
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.known_motion import is_rate_in_loop, rate_sensor_model
from service.pipeline.inputs.sensor_angles import angles_at, inertial_deg_h
from service.records.calibration import AxesCheck, MotionVerdict

#: sigmas from which telemetry is contradicted
_SIGMAS = 3.5
_LEAST_RECORDS = 20
_US_PER_H = 3.6e9
#: of yaw, roll, pitch among roll, pitch, yaw
_NAMED = (1, 2, 0)
_NEXT = (
    "the filter does not use them under this calibration; correct sign, order of axes, unit or epochs of "
    "body_rate_deg_s, or onboard.rate_sensor, send the records of the turns again and calibrate again"
)
IN_LOOP = (
    "onboard.rate_sensor is in the loop on board: its rates tell nothing new and the filter does not use them; state a "
    "sensor beside the loop to have yaw known better"
)


def rate_check(data: CalibrationInput, config: CalibrationConfig) -> AxesCheck | None:
    """Return the check; None where the catalogue has no rate sensor beside the loop."""
    sensor = rate_sensor_model(data.spacecraft)
    if sensor is None:
        return None
    turns = data.request.turns
    within = (one for one in data.telemetry if turns.start_us <= one.epoch_us < turns.stop_us)
    records = {one.epoch_us: one.body_rate_deg_s for one in within if one.body_rate_deg_s is not None}
    if len(records) < _LEAST_RECORDS:
        return AxesCheck(
            MotionVerdict.UNCHECKED, f"{len(records)} records of rates within the turns, {_LEAST_RECORDS} are needed"
        )
    epochs_us = np.array(sorted(records), dtype=np.int64)
    response = rate_response(
        (epochs_us - epochs_us[0]) / _US_PER_H,
        inertial_deg_h([records[epoch_us] for epoch_us in epochs_us.tolist()]),
        angles_at(epochs_us, data.quiet_references + data.references, data.sensors, config),
    )
    return _judged(response, sensor.bias_deg_h)


def rate_quality(check: AxesCheck | None) -> dict[str, float]:
    """Return the figures of a check, by name."""
    if check is None:
        return {}
    named = list(zip(("roll", "pitch", "yaw"), check.response, check.response_sigma, strict=True))
    known = [each for each in named if math.isfinite(each[2])]
    return {
        **{f"rate_response_{axis}": value for axis, value, _ in known},
        **{f"rate_response_{axis}_sigma": sigma for axis, _, sigma in known},
    }


def rate_warnings(data: CalibrationInput, check: AxesCheck | None) -> tuple[str, ...]:
    """Return the warnings of a check."""
    if is_rate_in_loop(data.spacecraft):
        return (IN_LOOP,)
    if check is None or not check.reason:
        return ()
    if check.verdict is MotionVerdict.CONTRADICTED:
        return (f"the rates of the body in telemetry are refused: {check.reason}; {_NEXT}",)
    return (f"the rates of the body in telemetry were not checked: {check.reason}",)


def _judged(response: RateResponse, bias_deg_h: float) -> AxesCheck:
    """Return what the response says of the telemetry."""
    sigmas = response.deviation(bias_deg_h)
    values, sigma = (part.diagonal()[list(_NAMED)].tolist() for part in (response.coefficient, response.sigma))
    figures = (values[0], values[1], values[2]), (sigma[0], sigma[1], sigma[2])
    if sigmas > _SIGMAS:
        return AxesCheck(MotionVerdict.CONTRADICTED, _contradiction(response, sigmas), *figures)
    if not response.is_determined:
        reason = "rates that stand still, or too few turns: the response of an axis is known worse than to 0.2"
        return AxesCheck(MotionVerdict.UNCHECKED, reason, *figures)
    return AxesCheck(MotionVerdict.CONSISTENT, "", *figures)


def _contradiction(response: RateResponse, sigmas: float) -> str:
    """Return what contradicts the telemetry, with its figures."""
    axes = ("yaw", "roll", "pitch")
    rows = (
        f"turns about {axis} by " + ", ".join(f"{name} {value:+.2f}" for name, value in zip(axes, row, strict=True))
        for axis, row in zip(axes, response.coefficient.tolist(), strict=True)
    )
    rest = ", ".join(f"{axis} {value:+.2f}" for axis, value in zip(axes, response.rest_deg_h.tolist(), strict=True))
    return (
        f"off by {sigmas:.1f} sigma ({'; '.join(rows)}: each must be +1 by its own rate and 0 by the others; at rest "
        f"{rest} deg/h beside the turn of the orbit, which must be 0)"
    )
