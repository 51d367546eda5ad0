"""Torque that gathers in the wheels, learned on the quiet days of a calibration from their telemetry.

The filter begins with it in place of a profile that the catalogue states or does not. The law of this file: telemetry
that the turns contradict tells nothing; where quiet days tell nothing, the calibration says why.
"""

from dataclasses import replace

import numpy as np

from service.core.estimation.calibration import gathered_torque as fit
from service.core.estimation.filtering.model.filter_model import FilterSettings
from service.core.estimation.filtering.model.torque_prior import TORQUES
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.known_motion import learned_units, momentum_model
from service.pipeline.inputs.sensor_angles import angles_at
from service.records.calibration import AxesCheck, GatheredTorque, MotionVerdict
from service.records.catalogue import Spacecraft
from service.records.inputs import TelemetryRecord
from service.records.levels.attitude import FloatArray

#: sigmas from which what gathered is not the torque that the catalogue states
_SIGMAS = 3.0
#: records with known angles that are needed
_LEAST_RECORDS = 50
_NEXT = "yaw begins with what onboard.momentum.torque states, or with an unknown torque"


def gathered_torque(
    data: CalibrationInput, check: AxesCheck | None, sigma_deg: FloatArray, config: CalibrationConfig
) -> GatheredTorque | None:
    """Return what the quiet days tell of the torque; sensors have a noise (3,), deg, order yaw, roll, pitch."""
    spacecraft = data.spacecraft
    if spacecraft is None or check is None or check.verdict is MotionVerdict.CONTRADICTED:
        return None
    onboard = spacecraft.onboard
    unknown = None if onboard.momentum is None else replace(onboard.momentum, torque=None)
    wheels = momentum_model(replace(spacecraft, onboard=replace(onboard, momentum=unknown, fed_forward_torque=None)))
    records = quiet_records(data, spacecraft)
    if wheels is None or len(records) < _LEAST_RECORDS:
        return None
    epochs_us = np.array([one.epoch_us for one in records], dtype=np.int64)
    found = fit.gathered_torque(
        epochs_us,
        np.array([one.wheel_momentum_n_m_s for one in records]) @ np.array(spacecraft.wheels.axes),
        angles_at(epochs_us, data.quiet_references, data.sensors, config),
        np.nan_to_num(sigma_deg),
        np.array([bool(one.thrusters_active) for one in records], dtype=np.bool_),
        FilterSettings(momentum=wheels),
    )
    if found is None or found.records < _LEAST_RECORDS:
        return None
    scale = learned_units(spacecraft)
    covariance = scale[:, None] * found.covariance * scale
    return GatheredTorque(
        tuple((scale * found.mean).tolist()),
        tuple(map(tuple, covariance.tolist())),
        found.records,
        data.request.quiet.stop_us,
    )


def gathered_warnings(
    data: CalibrationInput, check: AxesCheck | None, gathered: GatheredTorque | None
) -> tuple[str, ...]:
    """Return why the torque was not learned, or that it is not the one which the catalogue states."""
    spacecraft, wheels = data.spacecraft, momentum_model(data.spacecraft)
    is_left_out = check is None or check.verdict is MotionVerdict.CONTRADICTED
    if spacecraft is None or wheels is None or is_left_out or spacecraft.onboard.fed_forward_torque is not None:
        return ()
    if gathered is None:
        records = len(quiet_records(data, spacecraft))
        reason = (
            f"{records} records of momentum within the quiet days, {_LEAST_RECORDS} are needed"
            if records < _LEAST_RECORDS
            else "its records on the quiet days contradict one another, or no sensor tells the angles at them"
        )
        return (f"the torque that gathers in the wheels was not learned: {reason}; {_NEXT}",)
    if wheels.profile is None:
        return ()
    stated = learned_units(spacecraft)[:TORQUES] * np.concatenate(wheels.profile[:3])
    sigma = np.sqrt(np.trace(np.array(gathered.covariance)[:TORQUES, :TORQUES]))
    off, size = float(np.linalg.norm(np.array(gathered.mean[:TORQUES]) - stated)), float(np.linalg.norm(stated))
    if off <= _SIGMAS * (wheels.profile.relative_error + wheels.profile.axis_relative_error) * size + _SIGMAS * sigma:
        return ()
    return (
        f"the torque that gathered in the wheels differs from onboard.momentum.torque by {off:.2g} of {size:.2g} N m; "
        "the filter takes what gathered: correct the profile, its sign or its epoch",
    )


def quiet_records(data: CalibrationInput, spacecraft: Spacecraft) -> list[TelemetryRecord]:
    """Return the records of the quiet days that tell the momentum of every wheel, in order of their epochs."""
    quiet, wheels = data.request.quiet, len(spacecraft.wheels.axes)
    within = (one for one in data.telemetry if quiet.start_us <= one.epoch_us < quiet.stop_us)
    return sorted(
        (one for one in within if len(one.wheel_momentum_n_m_s or ()) == wheels), key=lambda one: one.epoch_us
    )


def gathered_quality(gathered: GatheredTorque | None) -> dict[str, float]:
    """Return the figures of the torque, by name."""
    if gathered is None:
        return {}
    parts = np.array(gathered.mean[:TORQUES]).reshape(3, 3)
    sigma = np.sqrt(np.diag(np.array(gathered.covariance)))[:TORQUES].reshape(3, 3)
    figures = {"gathered_torque_records": float(gathered.records)}
    for axis, name in enumerate(("yaw", "roll", "pitch")):
        figures[f"gathered_constant_{name}_n_m"] = float(parts[0, axis])
        figures[f"gathered_daily_{name}_n_m"] = float(np.hypot(parts[1, axis], parts[2, axis]))
        figures[f"gathered_{name}_sigma_n_m"] = float(np.linalg.norm(sigma[:, axis]))
    return figures
