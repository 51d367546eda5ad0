"""Ingest: which rows of a batch may enter the archive (received rows -> L1).

Pure array work: the caller reads the clock and tells the bounds. A row is refused for its first fault, in the order
``value.count``, ``time.too_old``, ``time.future``, ``value.out_of_range``, ``flag.reserved``; every other row of the
batch goes on. A row of only absent powers is a row.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.records.epoch import DAY_US, EARLIEST_EPOCH_US, LATEST_EPOCH_US, US_PER_S, format_epoch
from service.records.levels.attitude import BoolArray, FloatArray, IntArray
from service.records.levels.measurement import (
    DETAIL_NAMES,
    CarrierDetails,
    MeasurementBatch,
    QualityFlag,
    RowRefusal,
    Sender,
)

#: no carrier power that an analyzer can see lies outside
MIN_POWER_DBM = -250.0
MAX_POWER_DBM = 50.0
#: nothing measured of a simulated spacecraft lies so far past its newest row: one such epoch would end its clock
HORIZON_US = 366 * DAY_US

Powers = Sequence[Sequence[float | None]]
Flags = Sequence[Sequence[int] | None]
#: by name, what each row states beside its powers
Details = Sequence[Mapping[str, Sequence[float | None]]]


class EpochBounds(NamedTuple):
    """Bounds of accepted epochs and of late ones; microseconds UTC."""

    #: smallest accepted epoch
    earliest_us: int
    #: greatest accepted epoch
    latest_us: int
    #: rows below it count as late; None = age makes nothing late
    stale_before_us: int | None


@dataclass(frozen=True, slots=True)
class ReceivedRows:
    """The rows of one request as they came, T of them."""

    spacecraft_id: str
    source: str
    plan_id: int
    received_at_us: int
    first_seq: int | None
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: T rows of dBm, None = absent
    power_dbm: Powers
    #: T rows of bit masks, None where none were sent
    flags: Flags
    #: T mappings of a name of DETAIL_NAMES to N figures, or None when no row states any
    details: Details | None = None
    #: rows measured within a leap second
    leap_positions: Sequence[int] = ()
    sender: Sender | None = None


def system_bounds(
    now_us: int, future_tolerance_s: float, late_after_s: float, retention_s: float | None
) -> EpochBounds:
    """Return the bounds under the system clock.

    Parameters
    ----------
    now_us : int
        Present, microseconds UTC.
    future_tolerance_s : float
        How far ahead of the present an epoch may lie.
    late_after_s : float
        Age from which a row is late.
    retention_s : float or None
        Age from which a row is refused; None = none is.

    Examples
    --------
    >>> system_bounds(2_000_000_000_000_000, 5.0, 300.0, None)
    EpochBounds(earliest_us=946684800000000, latest_us=2000000005000000, stale_before_us=1999999700000000)
    """
    latest_us = min(now_us + _us(future_tolerance_s), LATEST_EPOCH_US)
    return EpochBounds(_earliest_us(now_us, retention_s), latest_us, now_us - _us(late_after_s))


def data_bounds(now_us: int | None, future_tolerance_s: float, retention_s: float | None) -> EpochBounds:
    """Return the bounds under the data clock, under which nothing grows late by age.

    Parameters
    ----------
    now_us : int or None
        Newest accepted epoch; None before the first row, when only the year 2100 bounds the future.
    future_tolerance_s : float
        How far ahead of it an epoch may lie.
    retention_s : float or None
        Age from which a row is refused; None = none is.
    """
    if now_us is None:
        return EpochBounds(EARLIEST_EPOCH_US, LATEST_EPOCH_US, None)
    latest_us = min(now_us + _us(future_tolerance_s), LATEST_EPOCH_US)
    return EpochBounds(_earliest_us(now_us, retention_s), latest_us, None)


def screen(rows: ReceivedRows, width: int, bounds: EpochBounds) -> tuple[MeasurementBatch, tuple[RowRefusal, ...]]:
    """Return the rows that may be stored, and why the others may not.

    Parameters
    ----------
    rows : ReceivedRows
        What was received.
    width : int
        Number of carriers of the plan.
    bounds : EpochBounds
        What the clock says.

    Returns
    -------
    MeasurementBatch
        Accepted rows in the order in which they came.
    tuple of Refusal
        In order of place.
    """
    has_width = _has_width(rows, width)
    power_dbm = _as_array(rows.power_dbm, has_width, width)
    # compared before the rounding to float32, so that nothing overflows; NaN compares false and stays
    is_outside = np.any((power_dbm < MIN_POWER_DBM) | (power_dbm > MAX_POWER_DBM), axis=1)
    is_old = rows.epochs_us < bounds.earliest_us
    bounds = _bounded(bounds, rows.epochs_us[~is_old])
    is_ahead = rows.epochs_us > bounds.latest_us
    is_reserved = np.array([_is_reserved(masks) for masks in rows.flags], dtype=np.bool_)
    index = np.flatnonzero(has_width & ~is_outside & ~is_old & ~is_ahead & ~is_reserved)
    refusals: list[RowRefusal] = []
    if len(index) < len(has_width):
        faults = {
            "value.count": ~has_width,
            "time.too_old": is_old,
            "time.future": is_ahead,
            "value.out_of_range": is_outside,
            "flag.reserved": is_reserved,
        }
        refusals = [
            _refusal(rows, position, faults, width, bounds) for position in np.flatnonzero(_any(faults)).tolist()
        ]
    return _batch(rows, index, power_dbm, bounds), tuple(refusals)


def _is_reserved(masks: Sequence[int] | None) -> bool:
    """Return whether a row states the flag of a leap second, whose epochs may give way to one another."""
    leap = int(QualityFlag.LEAP_SECOND)
    return bool(masks) and max(masks or ()) >= leap and any(mask & leap for mask in masks or ())


def _bounded(bounds: EpochBounds, epochs_us: IntArray) -> EpochBounds:
    """Return the bounds; before the first row of all, which nothing bounds, by the first epoch of the batch."""
    if bounds.latest_us < LATEST_EPOCH_US or not len(epochs_us):
        return bounds
    return bounds._replace(latest_us=min(int(epochs_us.min()) + HORIZON_US, LATEST_EPOCH_US))


def _batch(rows: ReceivedRows, index: IntArray, power_dbm: FloatArray, bounds: EpochBounds) -> MeasurementBatch:
    epochs_us = rows.epochs_us[index]
    stale_before_us = bounds.stale_before_us
    is_stale = np.zeros(len(index), dtype=np.bool_) if stale_before_us is None else epochs_us < stale_before_us
    return MeasurementBatch(
        spacecraft_id=rows.spacecraft_id,
        source=rows.source,
        plan_id=rows.plan_id,
        received_at_us=rows.received_at_us,
        index=index,
        epochs_us=epochs_us,
        power_dbm=power_dbm[index].astype(np.float32),
        flags=tuple(_flags(rows, position, power_dbm.shape[1]) for position in index.tolist()),
        is_stale=is_stale,
        first_seq=rows.first_seq,
        details=None if rows.details is None else _details(rows.details, index, power_dbm.shape[1]),
        sender=rows.sender,
    )


def _has_width(rows: ReceivedRows, width: int) -> BoolArray:
    """Return which rows have one power, and one mask and one figure of each kind where any, for each carrier."""
    has_width = np.array(
        [
            len(powers) == width and (masks is None or len(masks) == width)
            for powers, masks in zip(rows.power_dbm, rows.flags, strict=True)
        ],
        dtype=np.bool_,
    )
    if rows.details is not None:
        has_width &= [all(len(figures) == width for figures in stated.values()) for stated in rows.details]
    return has_width


def _details(details: Details, index: IntArray, width: int) -> CarrierDetails:
    """Return the details beside powers of the rows at some positions, each (T, N)."""
    blank = [None] * width
    kept = [details[position] for position in index.tolist()]
    return CarrierDetails(
        **{
            name: np.array([stated.get(name, blank) for stated in kept], dtype=np.float32).reshape(len(kept), width)
            for name in DETAIL_NAMES
        }
    )


def _as_array(power_dbm: Powers, has_width: BoolArray, width: int) -> FloatArray:
    """Return (T, N) powers, NaN where absent and in rows of another width."""
    if len(has_width) and has_width.all():
        return np.array(power_dbm, dtype=np.float64).reshape(len(has_width), width)
    absent = [None] * width
    kept = [powers if is_kept else absent for powers, is_kept in zip(power_dbm, has_width.tolist(), strict=True)]
    return np.array(kept, dtype=np.float64).reshape(len(kept), width)


def _refusal(
    rows: ReceivedRows, position: int, faults: dict[str, BoolArray], width: int, bounds: EpochBounds
) -> RowRefusal:
    code = next(code for code, is_faulty in faults.items() if is_faulty[position])
    seq = None if rows.first_seq is None else rows.first_seq + position
    return RowRefusal(position, seq, code, _detail(code, rows, position, width, bounds))


def _detail(code: str, rows: ReceivedRows, position: int, width: int, bounds: EpochBounds) -> str:
    if code == "value.count":
        return f"plan {rows.plan_id} has {width} carriers; the row has {_counts(rows, position)}"
    if code == "time.too_old":
        return f"nothing before {format_epoch(bounds.earliest_us)} is kept"
    if code == "time.future":
        return f"the epoch lies after {format_epoch(bounds.latest_us)}; check the clock of source {rows.source!r}"
    if code == "flag.reserved":
        return "the flag LEAP_SECOND is set by the service, by the epoch"
    return f"a power lies outside {MIN_POWER_DBM:g}..{MAX_POWER_DBM:g} dBm; send null for an absent carrier"


def _counts(rows: ReceivedRows, position: int) -> str:
    """Return how many values of each kind a row has."""
    masks = rows.flags[position]
    flags = "no flags" if masks is None else f"{len(masks)} flags"
    stated = {} if rows.details is None else rows.details[position]
    more = "".join(f", {len(figures)} of {name}" for name, figures in stated.items())
    return f"{len(rows.power_dbm[position])} powers and {flags}{more}"


def _any(faults: dict[str, BoolArray]) -> BoolArray:
    has_fault: BoolArray = np.any(np.stack(list(faults.values())), axis=0)
    return has_fault


def _flags(rows: ReceivedRows, position: int, width: int) -> tuple[int, ...] | None:
    """Return the bit masks of a row, those of a leap second marked."""
    masks = rows.flags[position]
    if position not in rows.leap_positions:
        return None if masks is None else tuple(masks)
    return tuple(mask | QualityFlag.LEAP_SECOND for mask in masks or [0] * width)


def _earliest_us(now_us: int, retention_s: float | None) -> int:
    """Return the smallest epoch that is kept."""
    return EARLIEST_EPOCH_US if retention_s is None else max(EARLIEST_EPOCH_US, now_us - _us(retention_s))


def _us(seconds: float) -> int:
    return round(seconds * US_PER_S)
