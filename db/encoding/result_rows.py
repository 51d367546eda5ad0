"""Rows of results as their tables hold them, and the records made of them; results of carriers as bytes."""

import struct
from typing import Any

import numpy as np

from db.encoding.record_codec import RecordCodec
from db.schema.tables import attitude, torque
from service.records.levels.attitude import (
    STEP_DB,
    AttitudeRow,
    CarrierResults,
    FloatArray,
    IntArray,
    TorqueCommand,
)

_ATTITUDE, _TORQUE = RecordCodec(AttitudeRow, attitude), RecordCodec(TorqueCommand, torque)
#: record of a row of ``select(attitude)``, or of ``select(torque)``
attitude_of, torque_of = _ATTITUDE.record, _TORQUE.record


def attitude_values(key: int, version: str, row: AttitudeRow, sequence: int | None) -> dict[str, Any]:
    """Return the columns of an attitude row."""
    return {"spacecraft_key": key, "version": version, "sequence": sequence, **_ATTITUDE.values(row)}


def torque_values(key: int, version: str, command: TorqueCommand, sequence: int | None) -> dict[str, Any]:
    """Return the columns of a torque command."""
    return {"spacecraft_key": key, "version": version, "sequence": sequence, **_TORQUE.values(command)}


_NONE, _MOST = -(1 << 15), (1 << 15) - 1
_PLAN = struct.Struct("<i")
_CARRIER_BYTES = 5
_STATE_BITS = 4


def pack_carriers(results: CarrierResults) -> bytes:
    """Return the results of a row as bytes."""
    words = (results.state | results.hypothesis << _STATE_BITS).astype(np.uint8)
    steps = np.rint(np.concatenate((results.deviation_db, results.residual_db)) / STEP_DB)
    levels = np.where(np.isnan(steps), _NONE, np.minimum(np.maximum(steps, -_MOST), _MOST)).astype("<i2")
    return b"".join((_PLAN.pack(results.plan_id), levels.tobytes(), words.tobytes()))


def unpack_carriers(blob: bytes) -> CarrierResults:
    """Return the results of a row."""
    count = (len(blob) - _PLAN.size) // _CARRIER_BYTES
    levels = np.frombuffer(blob, dtype="<i2", count=2 * count, offset=_PLAN.size).reshape(2, count)
    values: FloatArray = np.where(levels == _NONE, np.nan, levels * STEP_DB)
    words: IntArray = np.frombuffer(blob, dtype=np.uint8, offset=_PLAN.size + 4 * count).astype(np.int64)
    low = (1 << _STATE_BITS) - 1
    return CarrierResults(_PLAN.unpack_from(blob)[0], values[0], values[1], words & low, words >> _STATE_BITS)
