"""Mapping between rows of the tables and records; arrays inside records are read-only."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Row

from db.encoding.measurement_runs import details_of
from db.encoding.power_codec import unpack_flags, unpack_parts, unpack_powers
from db.encoding.record_codec import RecordCodec
from db.schema.tables import attitude, measurement, measurement_detail, source, torque
from service.records.levels.attitude import AttitudeRow, FloatArray, IntArray, TorqueCommand
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

_ATTITUDE, _TORQUE = RecordCodec(AttitudeRow, attitude), RecordCodec(TorqueCommand, torque)
#: record of a row of ``select(attitude)``, or of ``select(torque)``
attitude_of, torque_of = _ATTITUDE.record, _TORQUE.record


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
    for positions, part in unpack_parts([row.powers for row in rows]):
        power_dbm.update(zip(positions, _read_only(part.astype(np.float64)), strict=True))
    return [measurement_of(row, power_dbm[position]) for position, row in enumerate(rows)]


def attitude_values(key: int, version: str, row: AttitudeRow, sequence: int | None) -> dict[str, Any]:
    """Return the columns of an attitude row."""
    return {"spacecraft_key": key, "version": version, "sequence": sequence, **_ATTITUDE.values(row)}


def torque_values(key: int, version: str, command: TorqueCommand, sequence: int | None) -> dict[str, Any]:
    """Return the columns of a torque command."""
    return {"spacecraft_key": key, "version": version, "sequence": sequence, **_TORQUE.values(command)}


def _read_only(values: FloatArray) -> FloatArray:
    values.setflags(write=False)
    return values
