"""Check of the reported wheel momentum by the calibration turns, before the filter uses it.

Sign, order and scale of the axes by their response to the turns; what all axes share, a unit or one sign for all, by
the momentum along pitch that the catalogue states. The law of this file: telemetry is refused only where it is
contradicted; what was not checked is said with its reason.
"""

import math

import numpy as np

from service.core.estimation.calibration.checks.responses import MomentumResponse, momentum_response
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.known_motion import angle_inertia_kg_m2
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import AxesCheck, MotionVerdict
from service.records.catalogue import Spacecraft, WheelMomentum
from service.records.epoch import US_PER_S
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import BoolArray, FloatArray, IntArray

#: sigmas from which telemetry is contradicted: true one stays within 3.0 on 24 seeds, and one axis wrong by 0.2 costs
#: yaw four times the error without it
_SIGMAS = 3.5
#: the spacecraft slews where its angles change by more in two minutes, deg
_SLEW_DEG, _HALF_US = 0.05, 60 * US_PER_S
#: records around the turns that are needed, and momentum along pitch below which turns move nothing, N m s
_LEAST_RECORDS, _LEAST_N_M_S = 20, 1.0
_NEXT = (
    "the filter does not use it under this calibration; correct sign, order of axes, unit or epochs of "
    "wheel_momentum_n_m_s, or onboard.momentum, send the records of the turns again and calibrate again"
)


def momentum_check(data: CalibrationInput, config: CalibrationConfig) -> AxesCheck | None:
    """Return the check; None where the catalogue states nothing of the momentum."""
    spacecraft = data.spacecraft
    stated = None if spacecraft is None else spacecraft.onboard.momentum
    if spacecraft is None or stated is None:
        return None
    axes = np.array(spacecraft.wheels.axes)
    records = _records(data, len(axes))
    if len(records) < _LEAST_RECORDS:
        return _unchecked(f"{len(records)} records of momentum within the turns, {_LEAST_RECORDS} are needed")
    response = _response(data, records, axes, spacecraft, config)
    return _judged(response, stated, config)


def momentum_quality(check: AxesCheck | None) -> dict[str, float]:
    """Return the figures of a check, by name."""
    if check is None:
        return {}
    named = zip(("roll", "pitch", "yaw"), check.response, check.response_sigma, strict=True)
    figures = {f"momentum_response_{axis}": (value, sigma) for axis, value, sigma in named if math.isfinite(sigma)}
    return {
        **{name: value for name, (value, _) in figures.items()},
        **{f"{name}_sigma": sigma for name, (_, sigma) in figures.items()},
    }


def momentum_warnings(check: AxesCheck | None) -> tuple[str, ...]:
    """Return the warnings of a check."""
    if check is None or not check.reason:
        return ()
    if check.verdict is MotionVerdict.CONTRADICTED:
        return (f"the momentum of the wheels in telemetry is refused: {check.reason}; {_NEXT}",)
    if check.verdict is MotionVerdict.UNCHECKED:
        return (f"the momentum of the wheels in telemetry was not checked: {check.reason}",)
    return (f"the momentum of the wheels in telemetry was checked in part: {check.reason}",)


def _records(data: CalibrationInput, wheels: int) -> list[TelemetryRecord]:
    """Return the records of the turns that tell the momentum of every wheel, in order of their epochs."""
    turns = data.request.turns
    reported = [
        one
        for one in data.telemetry
        if turns.start_us <= one.epoch_us < turns.stop_us and len(one.wheel_momentum_n_m_s or ()) == wheels
    ]
    return sorted(reported, key=lambda one: one.epoch_us)


def _response(
    data: CalibrationInput,
    records: list[TelemetryRecord],
    axes: FloatArray,
    spacecraft: Spacecraft,
    config: CalibrationConfig,
) -> MomentumResponse:
    """Return the response of the records to the turns."""
    epochs_us = np.array([one.epoch_us for one in records], dtype=np.int64)
    yaw, roll, pitch = angle_inertia_kg_m2(spacecraft)
    return momentum_response(
        (epochs_us - epochs_us[0]) / US_PER_S,
        np.array([one.wheel_momentum_n_m_s for one in records]) @ axes,
        _angles(data, epochs_us, config),
        _is_slewing(data, epochs_us, config),
        np.array([bool(one.thrusters_active) for one in records], dtype=np.bool_),
        np.array([roll, pitch, yaw]),
    )


def _angles(data: CalibrationInput, epochs_us: IntArray, config: CalibrationConfig) -> FloatArray:
    return angles_at(epochs_us, data.quiet_references + data.references, data.sensors, config)


def _is_slewing(data: CalibrationInput, epochs_us: IntArray, config: CalibrationConfig) -> BoolArray:
    """Return at which epochs (K,) the spacecraft slews; an angle that is not known counts as still."""
    before, after = (_angles(data, epochs_us + shift_us, config) for shift_us in (-_HALF_US, _HALF_US))
    return np.asarray((np.abs(after - before) > _SLEW_DEG).any(axis=1))


def _judged(response: MomentumResponse, stated: WheelMomentum, config: CalibrationConfig) -> AxesCheck:
    """Return what the response says of the telemetry."""
    sigmas = response.deviation(stated.scale_error)
    pitch = float(response.mean_n_m_s[1])
    bias, limit = stated.pitch_bias_n_m_s, config.momentum_bias_share
    if sigmas > _SIGMAS:
        return _check(response, MotionVerdict.CONTRADICTED, _contradiction(response, sigmas))
    if bias is not None and abs(bias) >= _LEAST_N_M_S and abs(pitch - bias) > limit * abs(bias):
        reason = f"{pitch:.3g} N m s along pitch on average, onboard.momentum.pitch_bias_n_m_s states {bias:g}"
        return _check(response, MotionVerdict.CONTRADICTED, reason)
    if not response.is_determined:
        return _check(response, MotionVerdict.UNCHECKED, _why_undetermined(response))
    if bias is None:
        reason = (
            "a unit or a sign that all axes share stays unproven; state onboard.momentum.pitch_bias_n_m_s, the "
            f"momentum along pitch that unloadings restore (reported {pitch:.3g} N m s)"
        )
        return _check(response, MotionVerdict.CONSISTENT, reason)
    return _check(response, MotionVerdict.CONSISTENT, "")


def _why_undetermined(response: MomentumResponse) -> str:
    """Return why the turns do not tell the response."""
    if response.records < _LEAST_RECORDS:
        several = f", between {response.stretches - 1} unloadings or jumps" if response.stretches > 1 else ""
        return (
            f"{response.records} records with the attitude standing still{several}; {_LEAST_RECORDS} without an "
            "unloading between them are needed: unload before the turns"
        )
    pitch = float(response.mean_n_m_s[1])
    if abs(pitch) < _LEAST_N_M_S:
        return f"{pitch:.2f} N m s along pitch are too little for turns to move; such wheels tell next to nothing"
    roll, _, yaw = response.sigma.tolist()
    return f"turns in yaw and roll tell the response to {roll:.2g} and {yaw:.2g} only, 0.2 is needed"


def _contradiction(response: MomentumResponse, sigmas: float) -> str:
    """Return what contradicts the telemetry, with its figures."""
    figures = ", ".join(
        f"{axis} {value:+.2f} +- {sigma:.2f}"
        for axis, value, sigma in zip(("roll", "pitch", "yaw"), response.coefficient, response.sigma, strict=True)
        if math.isfinite(sigma)
    )
    return f"its response to the turns is off by {sigmas:.1f} sigma ({figures}; each must be +1)"


def _check(response: MomentumResponse, verdict: MotionVerdict, reason: str) -> AxesCheck:
    roll, pitch, yaw = response.coefficient.tolist()
    roll_sigma, pitch_sigma, yaw_sigma = response.sigma.tolist()
    return AxesCheck(verdict, reason, (roll, pitch, yaw), (roll_sigma, pitch_sigma, yaw_sigma))


def _unchecked(reason: str) -> AxesCheck:
    return AxesCheck(MotionVerdict.UNCHECKED, reason)
