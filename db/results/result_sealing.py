"""Sealing closed days of results: attitude and torque rows, live and of replays (db.sealing)."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from sqlalchemy import Connection, LargeBinary, func, select, tuple_

from db.database import Database
from db.encoding.column_blob import arrow
from db.encoding.segments import DAY_US, RowSeries, SegmentHead, day_of
from db.results.result_samples import ATTITUDE, IMPULSE, carrier_figures, carriers_name, figures
from db.results.state_history import STATES, stretch_blob, stretch_of
from db.results.stored_rows import HEAD_COLUMNS, TABLES, attitudes_of, read_results, torques_of
from db.schema.columns import Figure
from db.schema.tables import attitude
from db.sealing import Position, seal_day, sound_and_damaged
from db.summaries import Bins, bins_of
from service.ports.archive import LIVE
from service.records.storage import SealedResults


class ResultRows:
    """Rows of results as they are sealed."""

    def read(
        self, connection: Connection, of: RowSeries, start_us: int, stop_us: int, limit: int
    ) -> tuple[list[Any], list[Position]]:
        """Return the first rows of a span of the table, whole epochs, and the places of those that are damaged."""
        table = of.table
        is_its = (*of.of_rows(), table.c.epoch_us >= start_us, table.c.epoch_us < stop_us)
        query = select(table).where(*is_its).order_by(table.c.epoch_us, table.c.number).limit(limit)
        rows: list[Any] = list(connection.execute(query))
        if len(rows) == limit:
            is_rest = (table.c.epoch_us == rows[-1].epoch_us, table.c.number > rows[-1].number)
            rows += connection.execute(query.limit(None).where(*is_rest))
        return sound_and_damaged(table, rows)

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


ROWS = ResultRows()


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


def seal(database: Database, key: int, before_us: int) -> Iterator[SealedResults]:
    """Seal the days that ended by an epoch, a transaction a step."""
    for of in _series(database, key):
        for day in _days(database, of, day_of(before_us) * DAY_US):
            for change in seal_day(database, of, day, ROWS):
                moved, sealed_rows = len(change.sealed), change.rows_of_segments
                first_us = change.sealed[0][0]
                yield SealedResults(of.table.name, of.version, of.method or None, first_us, moved, sealed_rows)


def _series(database: Database, key: int) -> Iterator[RowSeries]:
    """Yield what has rows in a table of rows."""
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
