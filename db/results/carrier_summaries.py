"""Summaries of what a method made of each carrier: deviation and residual, by day and plan, with those of its rows.

They are made, stored and deleted together with the summary of the attitude of their day; rows are not kept in them, so
an interval that ends between two buckets has the rows of its day read.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from sqlalchemy import Connection, select

from db.database import Database
from db.encoding.measurement_runs import unpack_carriers
from db.encoding.segments import DAY_US
from db.encoding.summary_codec import CARRIERS, MINUTE_US, READ_AT_ONCE, Stored, SummaryBlobs, is_dense, pack_buckets
from db.newest_rows import RowPages
from db.results.stored_rows import ResultSeries, pages, stored_rows
from db.schema.tables import attitude_summary, carrier_summary
from service.core.rows import Summaries, joined
from service.ports.archive import Intervals, SampledCarriers
from service.records.calibration import Window
from service.records.levels.attitude import STEP_DB, CarrierResults, FloatArray, IntArray


class CarrierRow(NamedTuple):
    """Results of the carriers at one row; None where none are stored."""

    epoch_us: int
    number: int
    results: CarrierResults | None


class _Day(NamedTuple):
    """Summarised day: the ids of its summaries by plan."""

    start_us: int
    ids: dict[int, int]


def carrier_rows(
    connection: Connection,
    of: ResultSeries,
    window: Window,
    limit: int | None = None,
    after: tuple[int, int] | None = None,
) -> list[CarrierRow]:
    """Return what a method made of the carriers at the stored rows beyond a cursor, in order of (epoch, number)."""
    return [
        CarrierRow(row.epoch_us, row.number, None if row.carriers is None else unpack_carriers(row.carriers))
        for row in stored_rows(connection, of, window, limit, after)
    ]


def blobs_by_plan(read: RowPages[CarrierRow], start_us: int) -> dict[int, SummaryBlobs]:
    """Return the summaries of a day by plan."""
    epochs_us: dict[int, list[IntArray]] = {}
    minutes: dict[int, list[Summaries]] = {}
    for rows in pages(read, Window(start_us, start_us + DAY_US)):
        for plan_id, some_us, values in _by_plan(rows):
            found = Summaries.of_rows(some_us, values).gathered(some_us // MINUTE_US)
            epochs_us.setdefault(plan_id, []).append(some_us)
            minutes.setdefault(plan_id, []).append(found)
    blobs = {}
    for plan_id, parts in minutes.items():
        buckets = joined(parts)
        # pages may end within a minute
        buckets = buckets.gathered(buckets.first_us // MINUTE_US)
        blobs[plan_id] = pack_buckets(buckets, STEP_DB, has_minutes=is_dense(np.concatenate(epochs_us[plan_id])))
    return blobs


def store_carriers(connection: Connection, summary_id: int, by_plan: Mapping[int, SummaryBlobs]) -> None:
    """Store the summaries that go with one of attitude."""
    for plan_id, blobs in by_plan.items():
        values = {"summary_id": summary_id, "plan_id": plan_id, "day": blobs.day, "hours": blobs.hours}
        connection.execute(carrier_summary.insert().values(**values, minute_frames=blobs.minute_frames))


def sampled(
    database: Database, key: int, name: str, read: RowPages[CarrierRow], window: Window, intervals: Intervals
) -> Iterator[SampledCarriers]:
    """Yield deviations and residuals of a window by plan, in buckets that lie within one interval each."""
    days, rest_us = _days(database, key, name, window), window.start_us
    for start in range(0, len(days), READ_AT_ONCE):
        some = days[start : start + READ_AT_ONCE]
        with database.read() as connection:
            found = [
                (plan_id, *_read(connection, plan_id, some, intervals))
                for plan_id in sorted({plan_id for day in some for plan_id in day.ids})
            ]
        yield from (SampledCarriers(plan_id, buckets) for plan_id, buckets, _ in found if buckets is not None)
        sound = set().union(*(ids for _, _, ids in found))
        for day in some:
            yield from _as_rows(read, Window(rest_us, day.start_us))
            stop_us = day.start_us + DAY_US
            lacking = {plan_id for plan_id, summary_id in day.ids.items() if summary_id not in sound}
            if lacking:
                part = Window(max(day.start_us, window.start_us), min(stop_us, window.stop_us))
                yield from (each for each in _as_rows(read, part) if each.plan_id in lacking)
            rest_us = max(rest_us, stop_us)
    yield from _as_rows(read, Window(rest_us, window.stop_us))


def _days(database: Database, key: int, name: str, window: Window) -> list[_Day]:
    """Return the summarised days that reach into a window."""
    day, of = attitude_summary.c, carrier_summary.c
    query = (
        select(day.start_us, of.plan_id, of.carrier_summary_id)
        .outerjoin(carrier_summary)
        .where(day.spacecraft_key == key, day.method == name, day.day.is_not(None))
        .where(day.start_us > window.start_us - DAY_US, day.start_us < window.stop_us)
        .order_by(day.start_us)
    )
    found: dict[int, dict[int, int]] = {}
    for row in database.fetch(query):
        ids = found.setdefault(row.start_us, {})
        if row.plan_id is not None:
            ids[row.plan_id] = row.carrier_summary_id
    return [_Day(start_us, ids) for start_us, ids in found.items()]


def _read(
    connection: Connection, plan_id: int, days: Sequence[_Day], intervals: Intervals
) -> tuple[Summaries | None, set[int]]:
    """Return the buckets of a plan, and the summaries that were read."""
    wanted = [Stored(day.ids[plan_id], day.start_us, day.start_us + DAY_US - 1) for day in days if plan_id in day.ids]
    return CARRIERS.read(connection, wanted, intervals, has_rows=False)


def _as_rows(read: RowPages[CarrierRow], window: Window) -> Iterator[SampledCarriers]:
    """Yield the rows of a window."""
    if window.start_us < window.stop_us:
        for rows in pages(read, window):
            for plan_id, epochs_us, values in _by_plan(rows):
                yield SampledCarriers(plan_id, Summaries.of_rows(epochs_us, values))


def _by_plan(rows: Sequence[CarrierRow]) -> Iterator[tuple[int, IntArray, FloatArray]]:
    """Yield epochs, (T,), and deviations and residuals, (T, 2 N), of the rows of each plan."""
    by_plan: dict[int, list[tuple[int, CarrierResults]]] = {}
    for row in rows:
        if row.results is not None:
            by_plan.setdefault(row.results.plan_id, []).append((row.epoch_us, row.results))
    for plan_id, held in by_plan.items():
        values = np.array([np.concatenate((results.deviation_db, results.residual_db)) for _, results in held])
        yield plan_id, np.array([epoch_us for epoch_us, _ in held], dtype=np.int64), values
