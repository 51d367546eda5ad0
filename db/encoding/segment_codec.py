"""Sealed measurements as bytes: arrays in, compressed columns out, and back without a bit lost.

Codec 1. Each column of integers is delta-coded and laid out byte plane by byte plane (all lowest bytes first), because
steady steps leave most planes constant; powers are laid out carrier by carrier, so that neighbours resemble each other.
Everything is then compressed by zstd at level 3. What few rows have (flags, details) stands in a blob of its own, which
holds only the rows that have it.
"""

from typing import NamedTuple

import numpy as np
import zstandard
from numpy.typing import NDArray

from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import DETAIL_NAMES, Float32Array

#: the layout that is written; readers know which one a segment has
CODEC = 1
_LEVEL = 3
_INTEGERS = 4
_LATE, _FEEDS, _HAS_SEQ, _HAS_FLAGS, _HAS_DETAILS = (1 << position for position in range(5))


class SealedRows(NamedTuple):
    """Rows of one source under one plan, in order of epoch."""

    #: (T,) microseconds UTC, ascending
    epochs_us: IntArray
    #: (T,) journal numbers
    numbers: IntArray
    #: (T,) microseconds UTC
    received_at_us: IntArray
    #: (T,) sequence numbers, 0 where there is none
    seqs: IntArray
    #: (T,) each
    has_seq: BoolArray
    is_late: BoolArray
    feeds: BoolArray
    has_flags: BoolArray
    has_details: BoolArray
    #: (T, N) dBm
    power_dbm: Float32Array
    #: (T, N) bit masks, 0 where a row has none
    flags: NDArray[np.int32]
    #: (T, K, N), K = len(DETAIL_NAMES), NaN = not stated
    details: Float32Array


class Blobs(NamedTuple):
    """A segment as it is stored."""

    columns: bytes
    powers: bytes
    #: None when no row has flags or details
    extras: bytes | None


class SegmentColumns(NamedTuple):
    """Columns of a segment other than powers, flags and details; all (T,)."""

    epochs_us: IntArray
    numbers: IntArray
    received_at_us: IntArray
    seqs: IntArray
    has_seq: BoolArray
    is_late: BoolArray
    feeds: BoolArray
    has_flags: BoolArray
    has_details: BoolArray


class Extras(NamedTuple):
    """Flags and details of those rows that have them, in order."""

    #: (F, N)
    flags: NDArray[np.int32]
    #: (D, K, N)
    details: Float32Array


def pack(rows: SealedRows) -> Blobs:
    """Return rows as blobs."""
    integers = np.stack((rows.epochs_us, rows.numbers, rows.received_at_us, rows.seqs)).astype("<i8")
    claims = (rows.is_late, rows.feeds, rows.has_seq, rows.has_flags, rows.has_details)
    bits = np.zeros(len(rows.epochs_us), dtype=np.uint8)
    for position, claim in enumerate(claims):
        bits |= claim.astype(np.uint8) << position
    powers = np.ascontiguousarray(rows.power_dbm.T.astype("<f4"))
    return Blobs(_packed(_planes(integers) + bits.tobytes()), _packed(powers.tobytes()), _pack_extras(rows))


def unpack_columns(blob: bytes, count: int) -> SegmentColumns:
    """Return the columns of a segment of ``count`` rows."""
    raw = _unpacked(blob, count * (8 * _INTEGERS + 1))
    epochs_us, numbers, received_at_us, seqs = _integers(raw[: 8 * _INTEGERS * count], count)
    bits = np.frombuffer(raw, dtype=np.uint8, offset=8 * _INTEGERS * count)
    claims = ((bits & mask) != 0 for mask in (_HAS_SEQ, _LATE, _FEEDS, _HAS_FLAGS, _HAS_DETAILS))
    return SegmentColumns(epochs_us, numbers, received_at_us, seqs, *claims)


def unpack_powers(blob: bytes, count: int) -> Float32Array:
    """Return the powers of a segment, (T, N) dBm, carrier by carrier in memory, read-only."""
    powers: Float32Array = np.frombuffer(_unpacked(blob, None), dtype="<f4").reshape(-1, count).T
    powers.setflags(write=False)
    return powers


def unpack_extras(blob: bytes, columns: SegmentColumns, carriers: int) -> Extras:
    """Return flags and details of a segment."""
    raw = _unpacked(blob, None)
    flagged, detailed = int(columns.has_flags.sum()), int(columns.has_details.sum())
    kinds = [position for position in range(len(DETAIL_NAMES)) if raw[0] >> position & 1]
    flags = np.frombuffer(raw, dtype="<i4", count=flagged * carriers, offset=1).reshape(carriers, flagged).T
    stated = np.frombuffer(raw, dtype="<f4", offset=1 + 4 * flagged * carriers).reshape(len(kinds), carriers, detailed)
    details = np.full((detailed, len(DETAIL_NAMES), carriers), np.nan, dtype=np.float32)
    details[:, kinds] = stated.transpose(2, 0, 1)
    return Extras(flags, details)


def _pack_extras(rows: SealedRows) -> bytes | None:
    if not rows.has_flags.any() and not rows.has_details.any():
        return None
    details = rows.details[rows.has_details]
    kinds = np.flatnonzero((~np.isnan(details)).any(axis=(0, 2)))
    mask = bytes([int(np.bitwise_or.reduce(1 << kinds, initial=0))])
    flags = np.ascontiguousarray(rows.flags[rows.has_flags].T.astype("<i4"))
    stated = np.ascontiguousarray(details[:, kinds].transpose(1, 2, 0).astype("<f4"))
    return _packed(mask + flags.tobytes() + stated.tobytes())


def _planes(integers: IntArray) -> bytes:
    """Return (C, T) integers as differences along T, byte plane by byte plane."""
    steps = np.diff(integers, axis=1, prepend=0)
    return np.ascontiguousarray(steps.view(np.uint8).reshape(*integers.shape, 8).transpose(0, 2, 1)).tobytes()


def _integers(raw: bytes, count: int) -> IntArray:
    """Return the (C, T) integers that ``_planes`` made bytes of; sums of differences wrap as the differences did."""
    planes = np.frombuffer(raw, dtype=np.uint8).reshape(_INTEGERS, 8, count)
    steps = np.ascontiguousarray(planes.transpose(0, 2, 1)).view("<i8")[:, :, 0]
    integers: IntArray = np.cumsum(steps, axis=1, dtype=np.int64)
    integers.setflags(write=False)
    return integers


def _packed(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(level=_LEVEL).compress(raw)


def _unpacked(blob: bytes, size: int | None) -> bytes:
    """Return the bytes of a blob; ValueError when they cannot be had or are not ``size``."""
    try:
        raw = zstandard.ZstdDecompressor().decompress(blob)
    except zstandard.ZstdError as fault:
        raise ValueError(str(fault)) from fault
    if size is not None and len(raw) != size:
        message = f"{len(raw)} bytes where {size} belong"
        raise ValueError(message)
    return raw
