"""Samples of measurements: of sealed days from their bins, of the others from their rows."""

from collections.abc import Callable, Iterator, Sequence

from sqlalchemy import Connection

from db.database import Database
from db.encoding.segments import DAY_US, MeasurementSegment, SegmentCache, SegmentHead, day_of, read_chunk
from db.measurements.measurement_pages import Chosen, MeasurementPages, RowChunk
from db.summaries import bins_within
from service.core.rows import Summaries
from service.ports.archive import Intervals, MeasuredFigure, SampledPowers
from service.records.calibration import Window

#: days that one read transaction looks at
_SLICE_US = 128 * DAY_US


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
    the carriers of a plan.
    """
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
                columns = slice(len(carriers_of(plan_id)))
                for buckets in _sealed(connection, database.segments, of_plan, intervals, figure, columns):
                    yield SampledPowers(plan_id, buckets)
            for chunk in pages.read_unsealed(part):
                yield SampledPowers(chunk.plan_id, _bucket(chunk, figure))
        epoch_us = stop_us


def _sealed(
    connection: Connection,
    cache: SegmentCache,
    heads: Sequence[SegmentHead],
    intervals: Intervals,
    figure: MeasuredFigure,
    columns: slice,
) -> Iterator[Summaries]:
    """Yield columns of the segments of one plan; those of a segment without a sound summary row by row."""
    buckets, rest = bins_within(connection, heads, figure, intervals, columns)
    if buckets is not None:
        yield buckets
    scan = cache.for_scan()
    for head in rest:
        yield _bucket(read_chunk(connection, scan, head), figure)


def _bucket(chunk: RowChunk | MeasurementSegment, figure: MeasuredFigure) -> Summaries:
    """Return the rows of a piece as buckets of their own."""
    values = chunk.power_dbm() if figure == "power_dbm" else chunk.figure(figure)
    return Summaries.of_rows(chunk.epochs_us, values)
