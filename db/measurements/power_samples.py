"""Samples of measurements: of sealed days from their bins, of the others from their rows."""

from collections.abc import Callable, Iterator, Sequence

from sqlalchemy import Connection

from db.database import Database
from db.encoding.segments import MeasurementSegment, of_measurements, read_chunk
from db.measurements.measurement_pages import Chosen, MeasurementPages, RowChunk
from db.schema.tables import measurement
from db.summaries import bins_within, next_row_us, seasons
from service.core.rows import Summaries
from service.ports.archive import Intervals, MeasuredFigure, SampledPowers


def sampled(
    database: Database,
    key: int,
    chosen: Chosen,
    intervals: Intervals,
    carriers_of: Callable[[int], Sequence[str]],
    figure: MeasuredFigure = "power_dbm",
) -> Iterator[SampledPowers]:
    """Yield rows in buckets that lie within one interval each, a read transaction a season.

    ``carriers_of`` gives the carriers of a plan.
    """

    def next_us(connection: Connection, epoch_us: int) -> int | None:
        row = measurement.c
        return next_row_us(connection, row.epoch_us, [row.spacecraft_key == key], of_measurements(key), epoch_us)

    for connection, window in seasons(database, chosen.window, next_us):
        pages, part = MeasurementPages(connection, database.segments, key), chosen._replace(window=window)
        heads = pages.segments(part)
        for plan_id in sorted({head.plan_id for head in heads}):
            of_plan = [head for head in heads if head.plan_id == plan_id]
            columns = slice(len(carriers_of(plan_id)))
            buckets, rest = bins_within(connection, of_plan, figure, intervals, columns)
            if buckets is not None:
                yield SampledPowers(plan_id, buckets)
            for head in rest:
                yield SampledPowers(plan_id, _bucket(read_chunk(connection, None, head), figure))
        for chunk in pages.read_unsealed(part):
            yield SampledPowers(chunk.plan_id, _bucket(chunk, figure))


def _bucket(chunk: RowChunk | MeasurementSegment, figure: MeasuredFigure) -> Summaries:
    """Return the rows of a piece as buckets of their own."""
    values = chunk.power_dbm() if figure == "power_dbm" else chunk.figure(figure)
    return Summaries.of_rows(chunk.epochs_us, values)
