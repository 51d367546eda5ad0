"""Results of the carriers of a row as bytes: five bytes a carrier, decibels in steps of 0.004 dB.

The number of the plan (int32), then column by column deviations and residuals (int16 steps; the smallest is NaN, what
lies beyond 131 dB becomes 131 dB) and a byte with the state (low four bits) and the hypothesis. Sealed, a carrier
takes about two bytes.
"""

import struct

import numpy as np

from service.records.levels.attitude import FloatArray, IntArray
from service.records.levels.carrier_results import STEP_DB, CarrierResults

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
