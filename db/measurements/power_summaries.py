"""Summaries of sealed powers: stored with their segment, read by samples."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from sqlalchemy import Connection

from db.database import Database
from db.encoding.measurement_runs import ChunkRun
from db.encoding.segments import DAY_US, SealedRows, SegmentCache, SegmentHead, day_of, read_chunk
from db.encoding.summary_codec import POWERS, READ_AT_ONCE, Stored, SummaryBlobs, pack_day
from db.measurements.measurement_pages import FULL, Chosen, MeasurementPages
from db.measurements.measurement_pages import POWERS as POWER_COLUMNS
from db.schema.tables import power_summary
from service.core.rows import Summaries
from service.ports.archive import Intervals, MeasuredFigure, SampledPowers
from service.records.calibration import Window
from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import DETAIL_NAMES

#: days that one read transaction looks at
_SLICE_US = 128 * DAY_US
_C_N0 = DETAIL_NAMES.index("c_n0_db_hz")


def summary_of(rows: SealedRows) -> SummaryBlobs:
    """Return the summary of a segment: powers in the order of the plan, and C/N0 where any is stated."""
    carriers, c_n0_db_hz = rows.power_dbm.shape[1], rows.details[:, _C_N0]
    values = rows.power_dbm if np.isnan(c_n0_db_hz).all() else np.hstack((rows.power_dbm, c_n0_db_hz))
    return pack_day(rows.epochs_us, values, carriers)


def store_summary(connection: Connection, segment_id: int, summary: SummaryBlobs) -> None:
    """Store the summary of a segment in the transaction that writes it."""
    connection.execute(power_summary.insert().values(segment_id=segment_id, **summary._asdict()))


def sampled(
    database: Database,
    key: int,
    chosen: Chosen,
    intervals: Intervals,
    carriers_of: Callable[[int], Sequence[str]],
    figure: MeasuredFigure = "power_dbm",
) -> Iterator[SampledPowers]:
    """Yield rows in buckets that lie within one interval each, a read transaction a season.

    A row is sealed or not within one transaction, and never leaves its day: each is counted once. ``carriers_of`` gives
    the carriers of a plan. Frames of rows hold powers alone: where an interval ends within the narrowest
    bucket, the rows of the segment are opened for C/N0.
    """
    has_rows = figure == "power_dbm"
    epoch_us: int | None = chosen.window.start_us
    while epoch_us is not None and epoch_us < chosen.window.stop_us:
        with database.read() as connection:
            pages = MeasurementPages(connection, database.segments, key)
            epoch_us = pages.next_us(epoch_us)
            if epoch_us is None or epoch_us >= chosen.window.stop_us:
                return
            stop_us = min(chosen.window.stop_us, day_of(epoch_us) * DAY_US + _SLICE_US)
            part = chosen._replace(window=Window(epoch_us, stop_us))
            heads = pages.segments(part)
            for plan_id in sorted({head.plan_id for head in heads}):
                of_plan = [head for head in heads if head.plan_id == plan_id]
                carriers = len(carriers_of(plan_id))
                columns = slice(carriers) if has_rows else slice(carriers, 2 * carriers)
                for buckets in _sealed(connection, database.segments, of_plan, intervals, columns):
                    yield SampledPowers(plan_id, buckets)
            for run in pages.read_unsealed(part, POWER_COLUMNS if has_rows else FULL):
                epochs_us = run.chunk.epochs_us[run.positions]
                values = run.power_dbm() if has_rows else _c_n0_db_hz(run)
                yield SampledPowers(run.chunk.plan_id, Summaries.of_rows(epochs_us, values))
        epoch_us = stop_us


def _sealed(
    connection: Connection, cache: SegmentCache, heads: Sequence[SegmentHead], intervals: Intervals, columns: slice
) -> Iterator[Summaries]:
    """Yield columns of the segments of one plan; those of a segment without a sound summary row by row."""
    is_power = columns.start is None
    for start in range(0, len(heads), READ_AT_ONCE):
        some = heads[start : start + READ_AT_ONCE]
        wanted = [Stored(head.segment_id, head.first_epoch_us, head.last_epoch_us) for head in some]
        buckets, read = POWERS.read(connection, wanted, intervals, columns, has_rows=is_power)
        if buckets is not None:
            yield buckets
        for head in some:
            if head.segment_id not in read:
                chunk = read_chunk(connection, cache.for_scan(), head)
                values = chunk.power_dbm() if is_power else chunk.rows().details[:, _C_N0]
                yield Summaries.of_rows(chunk.epochs_us, values)


def _c_n0_db_hz(run: ChunkRun) -> FloatArray:
    """Return the C/N0 of rows of the table of rows, (n, N); NaN = not stated."""
    none = np.full(run.power_dbm().shape[1], np.nan)
    details = [row.details for row in run.records()]
    return np.array([none if each is None else each.c_n0_db_hz for each in details], dtype=np.float64)
