"""Levels in dBm -> what a unit shows, and traces -> the bytes of an answer. 50 ohm throughout."""

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np

from analyzer_sim.streams import FloatArray

IMPEDANCE_OHM = 50.0
_INT32_RANGE = -(2**31), 2**31 - 1
#: 1 mW in 50 ohm above 1 uV, dB
_DBUV_ABOVE_DBM = 90.0 + 10.0 * math.log10(IMPEDANCE_OHM)
#: 1 mW in 50 ohm above 1 uA, dB
_DBUA_ABOVE_DBM = 90.0 - 10.0 * math.log10(IMPEDANCE_OHM)


def _watts(level_dbm: FloatArray) -> FloatArray:
    return np.asarray(1e-3 * 10.0 ** (0.1 * level_dbm))


#: unit -> conversion of a trace; there is no dBW, as on the real instruments
UNITS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "DBM": np.asarray,
    "DBPW": lambda level: level + 90.0,
    "DBUV": lambda level: level + _DBUV_ABOVE_DBM,
    "DBMV": lambda level: level + (_DBUV_ABOVE_DBM - 60.0),
    "DBV": lambda level: level + (_DBUV_ABOVE_DBM - 120.0),
    "DBUA": lambda level: level + _DBUA_ABOVE_DBM,
    "DBMA": lambda level: level + (_DBUA_ABOVE_DBM - 60.0),
    "W": _watts,
    "V": lambda level: np.sqrt(_watts(level) * IMPEDANCE_OHM),
    "A": lambda level: np.sqrt(_watts(level) / IMPEDANCE_OHM),
}


def ascii_list(values: FloatArray) -> str:
    """Return numbers as NR3, comma separated, no blanks.

    Examples
    --------
    >>> ascii_list(np.array([-42.5, 1e-9]))
    '-4.250000E+01,1.000000E-09'
    """
    return ",".join(["%.6E"] * len(values)) % tuple(values.tolist())


def definite_block(payload: bytes) -> bytes:
    """Return an IEEE 488.2 definite length block.

    Examples
    --------
    >>> definite_block(b"abc")
    b'#13abc'
    """
    length = str(len(payload))
    return f"#{len(length)}{length}".encode() + payload


def real32_block(values: FloatArray, *, is_big_endian: bool) -> bytes:
    """Return numbers as a block of 32 bit floats."""
    return definite_block(values.astype(">f4" if is_big_endian else "<f4").tobytes())


def real64_block(values: FloatArray, *, is_big_endian: bool) -> bytes:
    """Return numbers as a block of 64 bit floats."""
    return definite_block(values.astype(">f8" if is_big_endian else "<f8").tobytes())


def int32_block(values: FloatArray, *, is_big_endian: bool) -> bytes:
    """Return numbers as a block of 32 bit integers, in thousandths: milli-dBm for levels in dBm."""
    thousandths = np.nan_to_num(np.clip(np.rint(1e3 * values), *_INT32_RANGE), nan=_INT32_RANGE[0])
    return definite_block(thousandths.astype(">i4" if is_big_endian else "<i4").tobytes())


class Encoder(Protocol):
    """Turns numbers into a block."""

    def __call__(self, values: FloatArray, *, is_big_endian: bool) -> bytes:
        """Return the block."""


#: binary format -> how numbers become a block
ENCODERS: dict[str, Encoder] = {"REAL,32": real32_block, "REAL,64": real64_block, "INT,32": int32_block}
