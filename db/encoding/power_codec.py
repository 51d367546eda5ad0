"""Powers and flags of a row as bytes: whole steps above the smallest one of the row, in as many bits as they need.

An analyzer gives levels in hundredths or thousandths of a decibel, a front end five decimals. As float32 they lie on a
grid, of a power of ten or, with a full mantissa, of the power of two that is the last place of the smallest one::

    power_dbm = float32((base + code) / scale)       scale = 10**2 .. 10**5 or 2**0 .. 2**40

A row is one byte for the scale, one for the bits of a code and for how many more codes its bytes could hold, the
base (int32 LE), and the codes, most significant bit first; the code of ones alone is NaN. All rows of a batch share
scale and bits, so that one statement can cut them apart. Rows that would not come back bit for bit, or gain nothing,
are stored as float32 LE. That form has a multiple of four bytes and the packed one never has (a byte is added where it
would), so both are told apart by their length. Flags are packed the same way with scale 1; rows without any set take
no byte.
"""

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Float32Array

_DECIMAL_SCALES = np.array([1e2, 1e3, 1e4, 1e5])
#: code of the scale 2**0; above it one for each power of two
_BINARY = 8
_MAX_EXPONENT = 40
_HEAD_BYTES = 6
#: values that a grid must hold before all are tried
_PROBED = 8
_MANTISSA_BITS = 24
_MAX_STEPS = 1 << 31
_SPARE_SHIFT = 5
_MAX_BITS = (1 << _SPARE_SHIFT) - 1
#: carriers up to which one row is packed value by value
_FEW_CARRIERS = 64
#: bytes that hold any code with the bits before it
_WORD_BYTES = 5


_ONE = struct.Struct("<f")
#: scale, bits and spare codes, base
_HEAD = struct.Struct("<BBi")


class StoredRows(NamedTuple):
    """Rows as bytes, one after another."""

    #: bytes of one row
    width: int
    rows: bytes

    def part(self, start: int, stop: int) -> "StoredRows":
        """Return the rows at some places."""
        return StoredRows(self.width, self.rows[start * self.width : stop * self.width])

    def each(self, count: int) -> list[bytes]:
        """Return the rows one by one; a row of no bytes does not tell how many there are."""
        width, rows = self.width, self.rows
        return [rows[position * width : (position + 1) * width] for position in range(count)]


#: where no flag is set
NO_FLAGS = StoredRows(0, b"")


class _Steps(NamedTuple):
    """Whole steps of a grid."""

    scale_code: int
    #: (T, N), integers below 2**31 in amount; NaN = NaN
    steps: NDArray[np.float64]


def canonical_powers(power_dbm: Float32Array) -> Float32Array:
    """Return powers as float32 little endian in a block of their own, every NaN the same NaN."""
    canonical: Float32Array = np.array(power_dbm, dtype="<f4", order="C")
    canonical[np.isnan(canonical)] = np.nan
    return canonical


def pack_powers(power_dbm: Float32Array) -> StoredRows:
    """Return (T, N) powers as bytes in the smallest form that gives them back bit for bit, every NaN the same NaN."""
    canonical = canonical_powers(power_dbm)
    if len(canonical) == 1 and canonical.shape[1] <= _FEW_CARRIERS and (row := _one_row(canonical)) is not None:
        return row
    return _many_rows(canonical)


def _many_rows(canonical: Float32Array) -> StoredRows:
    """Return (T, N) powers as bytes, whatever they are."""
    is_known = ~np.isnan(canonical)
    found = _on_grid(canonical, canonical.ravel() if is_known.all() else canonical[is_known])
    packed = None if found is None else _packed(found, 4 * canonical.shape[1])
    return StoredRows(4 * canonical.shape[1], canonical.tobytes()) if packed is None else packed


def _one_row(canonical: Float32Array) -> StoredRows | None:
    """Return one row as ``_many_rows`` does, in half its time; None unless all is known and on a decimal grid."""
    powers = canonical[0].tolist()
    raw = canonical.tobytes()
    if not powers or any(power - power != 0.0 for power in powers):
        # NaN or infinite
        return None
    layout = struct.Struct(f"<{len(powers)}f")
    for scale_code, scale in enumerate(_DECIMAL_SCALES.tolist()):
        if _ONE.pack(round(powers[0] * scale) / scale) == raw[: _ONE.size]:
            steps = [round(power * scale) for power in powers]
            if layout.pack(*[step / scale for step in steps]) == raw:
                return _packed_row(scale_code, steps)
    return None


def _packed_row(scale_code: int, steps: list[int]) -> StoredRows | None:
    """Return one row of steps as bytes, None when float32 are no longer."""
    base, count = min(steps), len(steps)
    bits = max(2, (max(steps) - base + 1).bit_length())
    filled = _HEAD_BYTES + (count * bits + 7) // 8
    width = filled + (filled % 4 == 0)
    if width >= 4 * count or bits > _MAX_BITS or max(abs(base), abs(max(steps))) >= _MAX_STEPS:
        return None
    codes = 0
    for step in steps:
        codes = codes << bits | step - base
    spare = (width - _HEAD_BYTES) * 8 // bits - count
    head = _HEAD.pack(scale_code, bits | spare << _SPARE_SHIFT, base)
    return StoredRows(
        width, head + (codes << 8 * (width - _HEAD_BYTES) - count * bits).to_bytes(width - _HEAD_BYTES, "big")
    )


def unpack_powers(blobs: Sequence[bytes]) -> Float32Array:
    """Return the powers of rows of one carrier plan, (T, N) dBm, bit for bit what was packed."""
    parts = unpack_parts(blobs)
    if len(parts) == 1:
        return parts[0][1]
    powers = np.empty((len(blobs), parts[0][1].shape[1]), dtype="<f4")
    for positions, part in parts:
        powers[positions] = part
    return powers


def unpack_parts(blobs: Sequence[bytes]) -> list[tuple[list[int], Float32Array]]:
    """Return the powers of rows of any plans: those of one form together, (T, N) dBm, with their places."""
    positions: dict[tuple[int, bytes], list[int]] = {}
    for position, blob in enumerate(blobs):
        positions.setdefault((len(blob), blob[:2] if len(blob) % 4 else b""), []).append(position)
    return [(found, _of_one_form([blobs[position] for position in found])) for found in positions.values()]


def pack_flags(masks: NDArray[np.int32]) -> StoredRows:
    """Return (T, N) bit masks as bytes; no bytes where none is set."""
    if not masks.any():
        return NO_FLAGS
    width = 4 * masks.shape[1]
    packed = _packed(_Steps(_BINARY, masks.astype(np.float64)), width)
    return StoredRows(width, masks.astype("<i4").tobytes()) if packed is None else packed


def unpack_flags(blob: bytes, carriers: int) -> IntArray:
    """Return the bit masks of one row, (N,)."""
    if not blob:
        return np.zeros(carriers, dtype=np.int64)
    if len(blob) % 4 == 0:
        return np.frombuffer(blob, dtype="<i4").astype(np.int64)
    codes, base, _ = _codes([blob])
    masks: IntArray = (codes[0].astype(np.int64) + base[0]).astype(np.int64)
    return masks


def _on_grid(power_dbm: Float32Array, known: Float32Array) -> _Steps | None:
    """Return powers as steps of the coarsest grid that holds every known one, None when there is no grid."""
    if not len(power_dbm):
        return None
    if not len(known):
        return _Steps(0, power_dbm.astype(np.float64))
    wide = known.astype(np.float64)
    probe = wide[:_PROBED]
    steps = np.rint(probe * _DECIMAL_SCALES[:, None]) / _DECIMAL_SCALES[:, None]
    is_likely = (steps.astype("<f4") == known[:_PROBED]).all(axis=1)
    codes = [*np.flatnonzero(is_likely).tolist(), *_binary_code(wide)]
    for code in codes:
        scale = _scale_of(code)
        if _is_exact(known, np.rint(wide * scale), scale):
            return _Steps(code, np.rint(power_dbm.astype(np.float64) * scale))
    return None


def _binary_code(wide: NDArray[np.float64]) -> list[int]:
    """Return the code of the power of two that is the last place of the smallest value, if it has one."""
    amounts = np.abs(wide)
    smallest = float(amounts.min()) or float(amounts.min(where=amounts > 0, initial=np.inf))
    exponent = _MANTISSA_BITS - int(np.frexp(smallest)[1])
    return [_BINARY + exponent] if 0 <= exponent <= _MAX_EXPONENT else []


def _is_exact(known: Float32Array, steps: NDArray[np.float64], scale: float) -> bool:
    """Return whether steps are few enough and give every value back, the sign of zero too."""
    if not np.abs(steps).max() < _MAX_STEPS:
        return False
    return np.array_equal((steps.astype(np.int64) / scale).astype("<f4").view("<u4"), known.view("<u4"))


def _scale_of(code: int) -> float:
    return float(_DECIMAL_SCALES[code]) if code < _BINARY else 2.0 ** (code - _BINARY)


def _packed(found: _Steps, raw_width: int) -> StoredRows | None:
    """Return steps as bytes, None when float32 are no longer."""
    steps = found.steps
    is_missing = np.isnan(steps)
    has_missing = bool(is_missing.any())
    base = np.where(is_missing, np.inf, steps).min(axis=1) if has_missing else steps.min(axis=1)
    base[~np.isfinite(base)] = 0.0
    above = steps - base[:, None]
    if has_missing:
        above[is_missing] = 0.0
    # at least two, so that no more than seven codes are to spare
    bits = max(2, (int(above.max()) + 1).bit_length())
    if bits > _MAX_BITS:
        return None
    codes = above.astype(">u4")
    if has_missing:
        codes[is_missing] = (1 << bits) - 1
    return _laid_out(found.scale_code, bits, base, codes, raw_width)


def _laid_out(
    scale_code: int, bits: int, base: NDArray[np.float64], codes: NDArray[np.uint32], raw_width: int
) -> StoredRows | None:
    """Return rows of heads and codes."""
    count, carriers = codes.shape
    filled = _HEAD_BYTES + (carriers * bits + 7) // 8
    width = filled + (filled % 4 == 0)
    if width >= raw_width:
        return None
    rows = np.zeros((count, width), dtype=np.uint8)
    spare = (width - _HEAD_BYTES) * 8 // bits - carriers
    rows[:, 0], rows[:, 1] = scale_code, bits | spare << _SPARE_SHIFT
    rows[:, 2:_HEAD_BYTES] = base.astype("<i4").view(np.uint8).reshape(count, 4)
    unpacked = np.unpackbits(codes.view(np.uint8).reshape(count, carriers, 4), axis=2)[:, :, 32 - bits :]
    rows[:, _HEAD_BYTES:filled] = np.packbits(unpacked.reshape(count, -1), axis=1)
    return StoredRows(width, rows.tobytes())


def _of_one_form(blobs: Sequence[bytes]) -> Float32Array:
    """Return the powers of rows of one length, scale and number of bits."""
    if len(blobs[0]) % 4 == 0:
        return np.frombuffer(b"".join(blobs), dtype="<f4").reshape(len(blobs), -1)
    codes, base, bits = _codes(blobs)
    powers: Float32Array = ((codes.astype(np.int64) + base[:, None]) / _scale_of(blobs[0][0])).astype("<f4")
    powers[codes == (1 << bits) - 1] = np.nan
    return powers


def _codes(blobs: Sequence[bytes]) -> tuple[NDArray[np.uint64], IntArray, int]:
    """Return codes (T, N), bases (T,) and the number of bits of a code."""
    rows = np.frombuffer(b"".join(blobs), dtype=np.uint8).reshape(len(blobs), -1)
    width = rows.shape[1]
    bits, spare = blobs[0][1] & _MAX_BITS, blobs[0][1] >> _SPARE_SHIFT
    carriers = (width - _HEAD_BYTES) * 8 // bits - spare
    starts = np.arange(carriers) * bits
    first = _HEAD_BYTES + (starts >> 3)
    words = np.zeros((len(rows), carriers), dtype=np.uint64)
    for offset in range(_WORD_BYTES):
        # behind the last byte anything will do: it is shifted out
        words = words << np.uint64(8) | rows[:, np.minimum(first + offset, width - 1)]
    behind = (8 * _WORD_BYTES - bits - (starts & 7)).astype(np.uint64)
    codes: NDArray[np.uint64] = words >> behind & np.uint64((1 << bits) - 1)
    base: IntArray = rows[:, 2:_HEAD_BYTES].copy().view("<i4")[:, 0].astype(np.int64)
    return codes, base, bits
