"""Mapping between rows of the tables and records; arrays inside records are read-only."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Row

from db.encoding.json_documents import decode, decode_all, encode, encode_all
from db.encoding.measurement_details import details_of
from db.encoding.power_codec import unpack_flags, unpack_parts, unpack_powers
from db.schema.tables import measurement, measurement_detail, source
from service.records.catalogue import Method
from service.records.levels.attitude import NO_ANGLES, AttitudeRow, Axes, Exclusion, FloatArray, IntArray, Status
from service.records.levels.command import Pulse, ScheduleVerdict, TorqueCommand
from service.records.levels.measurement import Measurement

#: when a row was received; the table holds how long after its epoch that was, which takes half the bytes
RECEIVED_AT_US: ColumnElement[int] = (measurement.c.epoch_us + measurement.c.delay_us).label("received_at_us")
#: what ``measurement_of`` reads, in this order
MEASUREMENT_COLUMNS: tuple[ColumnElement[Any], ...] = (
    measurement.c.epoch_us,
    RECEIVED_AT_US,
    measurement.c.number,
    source.c.name,
    measurement.c.plan_id,
    measurement.c.powers,
    measurement.c.flags,
    measurement.c.is_late,
    measurement.c.feeds,
    measurement.c.seq,
    measurement_detail.c.figures,
    measurement.c.source_key,
)


def powers_of(blob: bytes) -> FloatArray:
    """Return stored powers widened to float64, shape (N,), read-only."""
    return _read_only(unpack_powers([blob])[0].astype(np.float64))


def measurement_of(row: Row[Any], power_dbm: FloatArray | None = None) -> Measurement:
    """Return the record of a row of ``MEASUREMENT_COLUMNS``, with its powers where they were read already."""
    epoch_us, received_at_us, number, name, plan_id, powers, flags, is_late, feeds, seq, figures, *_ = tuple(row)
    values = powers_of(powers) if power_dbm is None else power_dbm
    masks: IntArray | None = None
    if flags is not None:
        masks = unpack_flags(flags, len(values))
        masks.setflags(write=False)
    details = None if figures is None else details_of(figures, len(values))
    return Measurement(epoch_us, received_at_us, number, name, plan_id, values, masks, is_late, feeds, seq, details)


def measurements_of(rows: Sequence[Row[Any]]) -> list[Measurement]:
    """Return the records of many rows of ``MEASUREMENT_COLUMNS``; powers of one form are read in one go."""
    power_dbm: dict[int, FloatArray] = {}
    for places, part in unpack_parts([row.powers for row in rows]):
        power_dbm.update(zip(places, _read_only(part.astype(np.float64)), strict=True))
    return [measurement_of(row, power_dbm[place]) for place, row in enumerate(rows)]


def attitude_values(key: int, version: str, row: AttitudeRow, sequence: int | None) -> dict[str, Any]:
    """Return the columns of an attitude row."""
    yaw_allowed, roll_allowed, pitch_allowed = row.control_allowed_axes
    return {
        "spacecraft_key": key,
        "version": version,
        "method": row.method.value,
        "epoch_us": row.epoch_us,
        "number": row.number,
        "sequence": sequence,
        "received_at_us": row.received_at_us,
        **_axes_values("{}_deg", row.attitude_deg),
        **_axes_values("{}_sigma_deg", row.sigma_deg),
        "has_rates": row.rates_deg_s is not None,
        **_axes_values("{}_rate_deg_s", NO_ANGLES if row.rates_deg_s is None else row.rates_deg_s),
        "status": row.status.value,
        "control_allowed": row.control_allowed,
        "yaw_control_allowed": yaw_allowed,
        "roll_control_allowed": roll_allowed,
        "pitch_control_allowed": pitch_allowed,
        "inhibitions": json.dumps(row.inhibitions),
        "carriers_used": row.carriers_used,
        "excluded": json.dumps(row.excluded),
        "downlink_fade": row.downlink_fade,
        "downlink_fade_db": row.downlink_fade_db,
        "common_db": row.common_db,
        "residual_rms_db": row.residual_rms_db,
        "calibration_id": row.calibration_id,
        "alignment_id": row.alignment_id,
        "advice": json.dumps(row.advice) if row.advice else None,
    }


def attitude_of(row: Row[Any]) -> AttitudeRow:
    """Return the record of a row that has every column of ``attitude``."""
    return AttitudeRow(
        epoch_us=row.epoch_us,
        received_at_us=row.received_at_us,
        number=row.number,
        method=Method(row.method),
        attitude_deg=Axes(row.yaw_deg, row.roll_deg, row.pitch_deg),
        sigma_deg=Axes(row.yaw_sigma_deg, row.roll_sigma_deg, row.pitch_sigma_deg),
        rates_deg_s=Axes(row.yaw_rate_deg_s, row.roll_rate_deg_s, row.pitch_rate_deg_s) if row.has_rates else None,
        status=Status(row.status),
        control_allowed=row.control_allowed,
        control_allowed_axes=(row.yaw_control_allowed, row.roll_control_allowed, row.pitch_control_allowed),
        inhibitions=tuple(json.loads(row.inhibitions)),
        carriers_used=row.carriers_used,
        excluded=tuple(Exclusion(*pair) for pair in json.loads(row.excluded)),
        downlink_fade=row.downlink_fade,
        downlink_fade_db=row.downlink_fade_db,
        common_db=row.common_db,
        residual_rms_db=row.residual_rms_db,
        calibration_id=row.calibration_id,
        alignment_id=row.alignment_id,
        advice=tuple(json.loads(row.advice)) if row.advice is not None else (),
    )


def torque_values(key: int, version: str, command: TorqueCommand, sequence: int | None) -> dict[str, Any]:
    """Return the columns of a torque command."""
    return {
        "spacecraft_key": key,
        "version": version,
        "epoch_us": command.epoch_us,
        "number": command.number,
        "sequence": sequence,
        "attitude_epoch_us": command.attitude_epoch_us,
        "mode": command.mode,
        **_axes_values("{}_n_m", command.torque_n_m),
        "wheels_n_m": encode_all(float, command.wheels_n_m),
        "saturated": command.saturated,
        "command_period_s": command.command_period_s,
        "valid_until_us": command.valid_until_us,
        "schedule": encode_all(Pulse, command.schedule),
        **_axes_values("{}_impulse_n_m_s", command.impulse_n_m_s),
        **_axes_values("predicted_{}_change_deg", command.predicted_angle_change_deg),
        **_axes_values("predicted_{}_rate_change_deg_s", command.predicted_rate_change_deg_s),
        "predicted_wheel_momentum_n_m_s": encode_all(float, command.predicted_wheel_momentum_n_m_s),
        "control_allowed": command.control_allowed,
        "inhibitions": json.dumps(command.inhibitions),
        "schedule_check": None if command.schedule_check is None else encode(command.schedule_check),
    }


def torque_of(row: Row[Any]) -> TorqueCommand:
    """Return the record of a row of ``torque``."""
    return TorqueCommand(
        epoch_us=row.epoch_us,
        number=row.number,
        attitude_epoch_us=row.attitude_epoch_us,
        mode=row.mode,
        torque_n_m=_axes_of(row, "{}_n_m"),
        wheels_n_m=decode_all(float, row.wheels_n_m),
        saturated=row.saturated,
        command_period_s=row.command_period_s,
        valid_until_us=row.valid_until_us,
        schedule=decode_all(Pulse, row.schedule),
        impulse_n_m_s=_axes_of(row, "{}_impulse_n_m_s"),
        predicted_angle_change_deg=_axes_of(row, "predicted_{}_change_deg"),
        predicted_rate_change_deg_s=_axes_of(row, "predicted_{}_rate_change_deg_s"),
        predicted_wheel_momentum_n_m_s=decode_all(float, row.predicted_wheel_momentum_n_m_s),
        control_allowed=row.control_allowed,
        inhibitions=tuple(json.loads(row.inhibitions)),
        schedule_check=None if row.schedule_check is None else decode(ScheduleVerdict, row.schedule_check),
    )


def _axes_values(pattern: str, axes: Axes) -> dict[str, float]:
    return {pattern.format(axis): value for axis, value in zip(Axes._fields, axes, strict=True)}


def _axes_of(row: Row[Any], pattern: str) -> Axes:
    yaw, roll, pitch = (getattr(row, pattern.format(axis)) for axis in Axes._fields)
    return Axes(yaw, roll, pitch)


def _read_only(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values
