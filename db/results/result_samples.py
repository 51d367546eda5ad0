"""Samples of results, states of live rows over time, and the sealing of both (db.sealing).

Samples and states are read of sealed days as stored, of the others from their rows.

States are runs of status, inhibitions, exclusions and others, and gaps; of each segment they stand beside its bins. A
day counts from them where every measurement of it that was consumed has its row in a segment; the others are read as
rows, the newest first, up to a bound.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, groupby
from typing import Any

import numpy as np
from sqlalchemy import Connection, LargeBinary, func, select, tuple_

from db.columns import Figure
from db.database import Database, within
from db.encoding.column_blob import ColumnBlob, arrow, pack_columns
from db.encoding.segments import DAY_US, RowSeries, SegmentHead, day_of, heads, of_measurements
from db.measurements.closed_days import kept_from_us
from db.results.jobs import check_held
from db.results.stored_rows import (
    HEAD_COLUMNS,
    TABLES,
    attitudes_of,
    carrier_steps,
    plan_of_carriers,
    read_results,
    torques_of,
    unsealed_rows,
)
from db.sealing import Bins, bins_of, bins_within, next_row_us, seal_day, seasons, stored_blobs
from db.tables import attitude, measurement, segment, summary
from service.core.rows import Gap, History, RowState, StateRun, Stretch, StretchSearch, Summaries, joined_stretches
from service.ports.archive import LIVE, Intervals, ListPart, SampledCarriers
from service.records.calibration import Window
from service.records.levels.attitude import STEP_DB, AttitudeRow, FloatArray, IntArray, TorqueCommand
from service.records.storage import SealedResults

#: quantities of the summaries; those of the carriers have a name for each plan
ATTITUDE, IMPULSE = "attitude", "impulse"
_CARRIERS = "carriers "


def figures(rows: Sequence[AttitudeRow | TorqueCommand]) -> tuple[IntArray, FloatArray]:
    """Return what is sampled of the rows that a method computed: `ATTITUDE_FIGURES`, or the impulse.

    Epochs, (T,) microseconds UTC, and values, (T, C), NaN = absent.
    """
    # a row without a calibration says only that nothing was computed
    computed = [row for row in rows if isinstance(row, TorqueCommand) or row.calibration_id is not None]
    epochs_us = np.array([row.epoch_us for row in computed], dtype=np.int64)
    return epochs_us, np.array([_figures(row) for row in computed], dtype=np.float64)


def _figures(row: AttitudeRow | TorqueCommand) -> tuple[float, ...]:
    if isinstance(row, TorqueCommand):
        return row.impulse_n_m_s
    others = (row.residual_rms_db, row.common_db, row.downlink_fade_db, row.carriers_used, row.control_allowed)
    return (*row.attitude_deg, *row.sigma_deg, *row.protection_deg, *others)


def carriers_name(plan_id: int) -> str:
    """Return the quantity of the carriers of a plan."""
    return f"{_CARRIERS}{plan_id}"


def carrier_figures(rows: Iterable[Any]) -> Iterator[tuple[int, IntArray, FloatArray]]:
    """Yield what stored rows of attitude hold of the carriers of each plan, by its number.

    Epochs, (T,) microseconds UTC, and deviations and residuals, (T, 2 N) steps of ``STEP_DB``.
    """
    by_plan: dict[int, list[tuple[int, bytes]]] = {}
    for row in rows:
        if row.carriers is not None:
            by_plan.setdefault(plan_of_carriers(row.carriers), []).append((row.epoch_us, row.carriers))
    for plan_id, found in by_plan.items():
        epochs_us, blobs = zip(*found, strict=True)
        yield plan_id, np.array(epochs_us, dtype=np.int64), carrier_steps(blobs)


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


#: quantity of the summaries
STATES = "states"
#: kinds of rows beside the runs: gaps, with rows missing in the place of rows, and the stretch, with its period there
_GAP, _STRETCH = "gap", "stretch"
_STATE_COLUMNS = ("kind", "name", "carrier", "start_us", "stop_us", "rows")
#: rows of a method that one answer reads where no runs are stored: seven hours of a row a second
MOST_ROWS = 25_000


#: reader of attitude
Read = Callable[[ListPart], Sequence[AttitudeRow]]


def state_history(database: Database, key: int, method: str, read: Read, window: Window) -> History:
    """Return runs and gaps of a window: of sealed days as stored, of others from their newest rows."""
    stretches: list[Stretch] = []
    parts: list[History] = []
    stop_us, left = window.stop_us, MOST_ROWS
    with database.read() as connection:
        known = _parts(connection, RowSeries(key, attitude, LIVE, method), window)
    for part in reversed(known):
        if isinstance(part, Stretch):
            stretches.insert(0, part)
            continue
        rows, start_us = _newest_rows(read, part, left)
        left -= len(rows)
        found = stretch_of([rows])
        stretches[:0] = [] if found is None else [found]
        if start_us > part.start_us:
            parts.insert(0, joined_stretches(stretches, start_us, stop_us))
            parts.insert(0, History([], [], [(part.start_us, start_us)]))
            stretches, stop_us = [], part.start_us
    parts.insert(0, joined_stretches(stretches, window.start_us, stop_us))
    return History(*(list(chain.from_iterable(lists)) for lists in zip(*parts, strict=True)))


def _parts(connection: Connection, of: RowSeries, window: Window) -> list[Stretch | Window]:
    """Return the stored stretches of a window, and the windows beside them, in order."""
    found = heads(connection, of.of_segments(), day_of(window.start_us) * DAY_US, window.stop_us)
    days = {day: list(its) for day, its in groupby(found, lambda head: head.day)}
    whole = _whole_days(connection, of, days)
    blobs = stored_blobs(connection, [head.segment_id for day in whole for head in days[day]], STATES, 0)
    parts: list[Stretch | Window] = []
    rest_us = window.start_us
    for day in whole:
        stretches = _stretches(days[day], blobs)
        if stretches:
            parts += [Window(rest_us, day * DAY_US), *stretches] if rest_us < day * DAY_US else stretches
            rest_us = (day + 1) * DAY_US
    return [*parts, Window(rest_us, window.stop_us)] if rest_us < window.stop_us else parts


def _stretches(found: Sequence[SegmentHead], blobs: dict[int, bytes]) -> list[Stretch]:
    """Return the stretches of the segments of a day; none where one of them is missing or damaged."""
    try:
        return [stretch_from(blobs[head.segment_id]) for head in found]
    except (KeyError, ValueError):
        return []


def _whole_days(connection: Connection, of: RowSeries, days: dict[int, list[SegmentHead]]) -> list[int]:
    """Return the days on which each measurement that feeds has a sealed row of the series."""
    if not days:
        return []
    measured_from_us = kept_from_us(connection, of.key, "measurements")
    span = Window(min(days) * DAY_US, (max(days) + 1) * DAY_US)
    sealed = select(segment.c.day, func.sum(segment.c.feeding_count)).where(
        *of_measurements(of.key), segment.c.day.between(min(days), max(days))
    )
    counts = {row[0]: int(row[1]) for row in connection.execute(sealed.group_by(segment.c.day))}
    unsealed = select(measurement.c.epoch_us).where(
        measurement.c.spacecraft_key == of.key, measurement.c.feeds, within(measurement.c.epoch_us, span)
    )
    for epoch_us in connection.scalars(unsealed):
        counts[day_of(epoch_us)] = counts.get(day_of(epoch_us), 0) + 1
    rows = select(attitude.c.epoch_us).where(*of.of_rows(), within(attitude.c.epoch_us, span))
    mixed = {day_of(epoch_us) for epoch_us in connection.scalars(rows)}
    return [
        day
        for day, its in sorted(days.items())
        if day not in mixed
        and (day * DAY_US < measured_from_us or counts.get(day, 0) == sum(head.row_count for head in its))
    ]


def _newest_rows(read: Read, window: Window, most: int) -> tuple[Sequence[AttitudeRow], int]:
    """Return the newest rows of a window, whole epochs, and the epoch from which on they are all."""
    rows = read(ListPart(window, most + 1, newest_first=True))[::-1]
    if len(rows) <= most:
        return rows, window.start_us
    start_us = rows[0].epoch_us + 1
    return [row for row in rows if row.epoch_us >= start_us], start_us


def stretch_blob(found: Stretch) -> bytes:
    """Return the runs and gaps of a stretch as a blob."""
    whole = (_STRETCH, "", "", found.first_us, found.last_us, found.period_us)
    gaps = ((_GAP, "", "", *gap) for gap in found.gaps)
    columns = zip(whole, *gaps, *((*state, *numbers) for state, *numbers in found.runs), strict=True)
    return pack_columns(dict(zip(_STATE_COLUMNS, map(list, columns), strict=True)))


def stretch_from(blob: bytes) -> Stretch:
    """Return the runs and gaps of a blob; ValueError where it holds none."""
    held = ColumnBlob(blob)
    columns = [held.values(name, slice(None)) for name in _STATE_COLUMNS]
    first, *others = zip(*columns, strict=True)
    if first[0] != _STRETCH:
        message = f"states begin with {first[0]!r}"
        raise ValueError(message)
    gaps = [Gap(*numbers) for kind, _, _, *numbers in others if kind == _GAP]
    runs = [StateRun(RowState(*each[:3]), *each[3:]) for each in others if each[0] != _GAP]
    first_us, last_us, period_us = first[3:]
    return Stretch(first_us, last_us, period_us, runs, gaps)


def stretch_of(found: Iterable[Sequence[AttitudeRow]]) -> Stretch | None:
    """Return runs and gaps of rows that come in pieces; None where there is no row."""
    search = StretchSearch()
    for rows in found:
        search.add([row.epoch_us for row in rows], _states(rows))
    return search.end()


def _states(rows: Sequence[AttitudeRow]) -> Iterator[tuple[RowState, ...]]:
    """Yield the states of rows, one object for neighbours that have the same."""
    before: tuple[Any, ...] = ()
    states: tuple[RowState, ...] = ()
    for row in rows:
        held = (row.status, row.control_allowed, row.inhibitions, row.advice, row.downlink_fade, row.excluded)
        if held != before:
            before, states = held, tuple(dict.fromkeys(_states_of(row)))
        yield states


def _states_of(row: AttitudeRow) -> Iterator[RowState]:
    yield RowState("status", row.status.value)
    if row.control_allowed:
        yield RowState("control", "allowed")
    yield from (RowState("inhibition", name) for name in row.inhibitions)
    yield from (RowState("advice", name) for name in row.advice)
    if row.downlink_fade:
        yield RowState("fade", "downlink")
    yield from (RowState("exclusion", reason, carrier) for carrier, reason in row.excluded)


class ResultRows:
    """Rows of results as they are sealed."""

    def sealed(self, connection: Connection, head: SegmentHead) -> list[Any]:
        """Return the rows of a segment; StorageError ``storage.corrupt``."""
        return read_results(connection, head).rows()

    def columns_and_bins(self, of: RowSeries, rows: Sequence[Any]) -> tuple[dict[str, Any], Bins]:
        """Return rows as the columns of a segment, and what is summarised of them."""
        columns = zip(of.table.c, zip(*rows, strict=True), strict=True)
        arrays = {
            column.name: _array(column.type, values) for column, values in columns if column.name not in HEAD_COLUMNS
        }
        return {name: array for name, array in arrays.items() if array is not None}, _bins(of, rows)


def _bins(of: RowSeries, rows: Sequence[Any]) -> Bins:
    """Return the bins of the figures of rows, of those of their carriers by plan, and the states of live rows."""
    if of.table is not attitude:
        return bins_of(IMPULSE, *figures(torques_of(rows)))
    records = attitudes_of(rows)
    found = bins_of(ATTITUDE, *figures(records))
    for plan_id, epochs_us, steps in carrier_figures(rows):
        found |= bins_of(carriers_name(plan_id), epochs_us, steps)
    if of.version == LIVE and (states := stretch_of([records])) is not None:
        found[STATES, 0] = stretch_blob(states)
    return found


def _array(kind: Any, values: Sequence[Any]) -> Any:
    """Return the values of a column of the table as an array; None where there is none."""
    pa = arrow()
    if isinstance(kind, Figure):
        found = np.array(values, dtype=np.float64)
        return None if np.isnan(found).all() else found
    if isinstance(kind, LargeBinary):
        widths = {len(value) for value in values if value is not None}
        return pa.array(values, pa.binary(*widths) if len(widths) == 1 else pa.binary())
    return pa.array(values)


def seal_results(database: Database, key: int, before_us: int) -> Iterator[SealedResults]:
    """Seal the days that ended by an epoch, a transaction a step."""
    for of in _series(database, key):
        for day in _days(database, of, day_of(before_us) * DAY_US):
            for change in seal_day(database, of, day, ResultRows()):
                moved, sealed_rows = len(change.sealed), change.rows_of_segments
                first_us = change.sealed[0][0]
                yield SealedResults(of.table.name, of.version, of.method or None, first_us, moved, sealed_rows)


def _series(database: Database, key: int) -> Iterator[RowSeries]:
    for table in TABLES.values():
        names = [table.c[name] for name in ("version", "method") if name in table.c]
        query = select(*names).where(table.c.spacecraft_key == key).order_by(*names).limit(1)
        row = database.fetch_one(query)
        while row is not None:
            yield RowSeries(key, table, *row)
            row = database.fetch_one(query.where(tuple_(*names) > tuple(row)))


def _days(database: Database, of: RowSeries, stop_us: int) -> Iterator[int]:
    """Yield the days before an epoch that have rows in the table of rows."""
    start_us = -(1 << 62)
    epoch_us = of.table.c.epoch_us
    while True:
        query = select(func.min(epoch_us)).where(*of.of_rows(), epoch_us >= start_us, epoch_us < stop_us)
        with database.read() as connection:
            first_us = connection.scalar(query)
        if first_us is None:
            return
        yield day_of(first_us)
        start_us = (day_of(first_us) + 1) * DAY_US
