"""Samples of results: of sealed days from their bins, of the others from their rows."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from sqlalchemy import Connection, select

from db.database import Database
from db.encoding.segments import RowSeries, SegmentHead, heads
from db.measurements.retention import kept_from_us
from db.results.replays import check_held
from db.results.stored_rows import (
    attitudes_of,
    carrier_steps,
    plan_of_carriers,
    read_results,
    torques_of,
    unsealed_rows,
)
from db.schema.tables import attitude, summary
from db.summaries import bins_within, next_row_us, seasons
from service.core.rows import Summaries
from service.ports.archive import LIVE, Intervals, SampledCarriers
from service.records.calibration import Window
from service.records.levels.attitude import STEP_DB, AttitudeRow, FloatArray, IntArray, TorqueCommand

#: quantities of the summaries; those of the carriers have a name for each plan
ATTITUDE, IMPULSE = "attitude", "impulse"
_CARRIERS = "carriers "


class Figures(NamedTuple):
    """Figures of rows: (T,) microseconds UTC and (T, C) values, NaN = absent."""

    epochs_us: IntArray
    values: FloatArray


class CarrierFigures(NamedTuple):
    """Deviations and residuals of the rows of a plan: (T,) microseconds UTC and (T, 2 N) steps of ``STEP_DB``."""

    plan_id: int
    epochs_us: IntArray
    steps: FloatArray


def figures(rows: Sequence[AttitudeRow | TorqueCommand]) -> Figures:
    """Return what is sampled of the rows that a method computed: `ATTITUDE_FIGURES`, or the impulse."""
    # a row without a calibration says only that nothing was computed
    computed = [row for row in rows if isinstance(row, TorqueCommand) or row.calibration_id is not None]
    epochs_us = np.array([row.epoch_us for row in computed], dtype=np.int64)
    return Figures(epochs_us, np.array([_figures(row) for row in computed], dtype=np.float64))


def _figures(row: AttitudeRow | TorqueCommand) -> tuple[float, ...]:
    if isinstance(row, TorqueCommand):
        return row.impulse_n_m_s
    others = (row.residual_rms_db, row.common_db, row.downlink_fade_db, row.carriers_used, row.control_allowed)
    return (*row.attitude_deg, *row.sigma_deg, *row.protection_deg, *others)


def carriers_name(plan_id: int) -> str:
    """Return the quantity of the carriers of a plan."""
    return f"{_CARRIERS}{plan_id}"


def carrier_figures(rows: Iterable[Any]) -> Iterator[CarrierFigures]:
    """Yield what stored rows of attitude hold of the carriers of each plan."""
    by_plan: dict[int, list[tuple[int, bytes]]] = {}
    for row in rows:
        if row.carriers is not None:
            by_plan.setdefault(plan_of_carriers(row.carriers), []).append((row.epoch_us, row.carriers))
    for plan_id, found in by_plan.items():
        epochs_us, blobs = zip(*found, strict=True)
        yield CarrierFigures(plan_id, np.array(epochs_us, dtype=np.int64), carrier_steps(blobs))


def sampled_figures(
    database: Database, of: RowSeries, window: Window, intervals: Intervals, columns: int
) -> Iterator[Summaries]:
    """Yield the first figures of the computed rows of a window in buckets that lie within one interval each."""
    records, quantity = (attitudes_of, ATTITUDE) if of.table is attitude else (torques_of, IMPULSE)

    def of_rows(rows: Sequence[Any]) -> Iterator[Summaries]:
        epochs_us, values = figures(records(rows))
        if len(epochs_us):
            yield Summaries.of_rows(epochs_us, values[:, :columns])

    for connection, part in _seasons(database, of, window):
        found = list(heads(connection, of.of_segments(), part.start_us, part.stop_us))
        buckets, rest = bins_within(connection, found, quantity, intervals, slice(columns))
        if buckets is not None:
            yield buckets
        for rows in _rows_of(connection, of, rest, part):
            yield from of_rows(rows)


def sampled_carriers(
    database: Database, of: RowSeries, window: Window, intervals: Intervals
) -> Iterator[SampledCarriers]:
    """Yield deviations and residuals of a window by plan, in buckets that lie within one interval each."""
    for connection, part in _seasons(database, of, window):
        found = list(heads(connection, of.of_segments(), part.start_us, part.stop_us))
        plans = _plans_of(connection, [head.segment_id for head in found])
        for plan_id in sorted({plan_id for ids in plans.values() for plan_id in ids}):
            its = [head for head in found if plan_id in plans.get(head.segment_id, ())]
            buckets, rest = bins_within(connection, its, carriers_name(plan_id), intervals, slice(None))
            if buckets is not None:
                yield SampledCarriers(plan_id, in_decibels(buckets))
            opened = (row for head in rest for row in read_results(connection, head).rows())
            yield from (each for each in _of_carriers(opened) if each.plan_id == plan_id)
        bare = [head for head in found if head.segment_id not in plans]
        for rows in _rows_of(connection, of, bare, part):
            yield from _of_carriers(rows)


def in_decibels(buckets: Summaries) -> Summaries:
    """Return buckets of steps as buckets of decibels."""
    return buckets._replace(
        sums=buckets.sums * STEP_DB, minima=buckets.minima * STEP_DB, maxima=buckets.maxima * STEP_DB
    )


def _of_carriers(rows: Iterable[Any]) -> Iterator[SampledCarriers]:
    for plan_id, epochs_us, steps in carrier_figures(rows):
        yield SampledCarriers(plan_id, Summaries.of_rows(epochs_us, steps * STEP_DB))


def _seasons(database: Database, of: RowSeries, window: Window) -> Iterator[tuple[Connection, Window]]:
    """Yield parts of a window that hold rows of a version."""

    def next_us(connection: Connection, epoch_us: int) -> int | None:
        check_held(connection, of.key, of.version)
        if of.version == LIVE and of.table is attitude:
            # rows below the mark are on their way out
            epoch_us = max(epoch_us, kept_from_us(connection, of.key, "attitude"))
        return next_row_us(connection, of.table.c.epoch_us, of.of_rows(), of.of_segments(), epoch_us)

    return seasons(database, window, next_us)


def _rows_of(
    connection: Connection, of: RowSeries, found: Iterable[SegmentHead], window: Window
) -> Iterator[list[Any]]:
    """Yield the rows of some segments, and those of a window that are not sealed, some at a time."""
    for head in found:
        yield read_results(connection, head).rows()
    yield from unsealed_rows(connection, of, window)


def _plans_of(connection: Connection, ids: Sequence[int]) -> dict[int, set[int]]:
    """Return the plans that the carriers of segments have bins for, by id; segments without any bins are left out."""
    plans: dict[int, set[int]] = {}
    query = select(summary.c.segment_id, summary.c.quantity).where(summary.c.segment_id.in_(ids))
    for segment_id, quantity in connection.execute(query):
        held = plans.setdefault(segment_id, set())
        if quantity.startswith(_CARRIERS):
            held.add(int(quantity.removeprefix(_CARRIERS)))
    return plans
