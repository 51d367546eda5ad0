"""Comparison of some summaries of each spacecraft with the rows that they stand for."""

from collections.abc import Iterator, Sequence
from functools import partial
from typing import TypeVar

import numpy as np
from sqlalchemy import Connection, select

from db.encoding.segments import DAY_US, HEAD_COLUMNS, SegmentCache, SegmentHead, read_chunk
from db.encoding.summary_codec import SummaryBlobs, unpack_level
from db.measurements.power_summaries import summary_of
from db.measurements.retention import kept_from_us
from db.results.attitude_reader import AttitudeReader
from db.results.attitude_summaries import NO_ROWS, TORQUE, day_blobs
from db.results.carrier_summaries import blobs_by_plan, carrier_rows
from db.results.state_summaries import stored_states, stretch_of
from db.results.stored_rows import ResultSeries
from db.schema.tables import attitude, attitude_summary, carrier_summary, measurement_segment, power_summary
from service.errors import StorageError
from service.ports import LIVE
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.storage.diagnosis import Diagnosis

_Item = TypeVar("_Item")
#: summaries of powers, and of attitude, that are compared with their rows
_COMPARED = 10
_ADVICE = "Charts and timelines of these days are wrong, exports are not. Restore a backup that is known to be sound."


def compare_summaries(connection: Connection, key: int, name: str) -> Iterator[Diagnosis]:
    """Yield whether evenly chosen summaries of a spacecraft agree with their rows, where those can be read."""
    compared, wrong = 0, []
    for start_us, is_right in [*_of_powers(connection, key), *_of_attitude(connection, key)]:
        compared += 1
        if not is_right:
            wrong.append(format_epoch(start_us)[:10])
    if wrong:
        detail = f"{name}: {len(wrong)} of {compared} summaries differ from their rows: {', '.join(sorted(set(wrong)))}"
        yield Diagnosis("summaries", "fault", detail, _ADVICE)
    else:
        yield Diagnosis("summaries", "ok", f"{name}: {compared} summaries compared with their rows")


def _of_powers(connection: Connection, key: int) -> Iterator[tuple[int, bool]]:
    """Yield the first epoch of some segments and whether their hours are those made again."""
    ids = list(
        connection.scalars(
            select(power_summary.c.segment_id)
            .join(measurement_segment)
            .where(measurement_segment.c.spacecraft_key == key)
            .order_by(power_summary.c.segment_id)
        )
    )
    for segment_id in _evenly(ids):
        is_it = measurement_segment.c.segment_id == segment_id
        head = SegmentHead(*connection.execute(select(*HEAD_COLUMNS).where(is_it)).one())
        hours = connection.scalar(select(power_summary.c.hours).where(power_summary.c.segment_id == segment_id))
        try:
            rows = read_chunk(connection, None, head).rows()
        except StorageError:
            continue
        yield head.first_epoch_us, _agree(hours or b"", summary_of(rows))


def _of_attitude(connection: Connection, key: int) -> Iterator[tuple[int, bool]]:
    """Yield some days of attitude and whether their hours, those of their carriers and their states are right."""
    table, cache = attitude_summary, SegmentCache()
    measured_from_us = kept_from_us(connection, key, "measurements")
    is_its = (table.c.spacecraft_key == key, table.c.day.is_not(None), table.c.method != TORQUE)
    query = select(table.c.start_us, table.c.method, table.c.summary_id).where(*is_its).order_by(table.c.start_us)
    for start_us, method, summary_id in map(tuple, _evenly(connection.execute(query).all())):
        hours = connection.scalar(select(table.c.hours).where(table.c.summary_id == summary_id))
        is_its_plan = carrier_summary.c.summary_id == summary_id
        of_plans = select(carrier_summary.c.plan_id, carrier_summary.c.hours).where(is_its_plan)
        stored = {row.plan_id: row.hours for row in connection.execute(of_plans)}
        read_carriers = partial(carrier_rows, connection, ResultSeries(key, attitude, LIVE, method))
        read = AttitudeReader(connection, cache, key, Method(method)).rows
        try:
            made = day_blobs(read, start_us, method)
            by_plan = blobs_by_plan(read_carriers, start_us)
            states = stretch_of(read, Window(start_us, start_us + DAY_US))
        except StorageError:
            continue
        yield start_us, _agree(hours or b"", made)
        for plan_id in stored.keys() | by_plan.keys():
            yield start_us, _agree(stored.get(plan_id, b""), by_plan.get(plan_id, NO_ROWS))
        # rows for which nothing was computed are made of measurements, which may have been deleted since
        if start_us >= measured_from_us and (known := stored_states(connection, summary_id)) is not None:
            yield start_us, known == states


def _evenly(found: Sequence[_Item]) -> Sequence[_Item]:
    """Return about ``_COMPARED`` of some items, the first among them."""
    return found[:: max(1, len(found) // _COMPARED)]


def _agree(stored: bytes, made: SummaryBlobs) -> bool:
    """Return whether hours are those made again; sums to rounding."""
    if not stored or not made.hours:
        return stored == made.hours
    try:
        one, other = unpack_level(stored).buckets, unpack_level(made.hours).buckets
    except ValueError:
        return False
    if one.counts.shape != other.counts.shape:
        return False
    arrays = (each._replace(sums=each.minima) for each in (one, other))
    is_equal = all(np.array_equal(a, b) for a, b in zip(*arrays, strict=True))
    return is_equal and bool(np.allclose(one.sums, other.sums, rtol=1e-9, atol=1e-9))
