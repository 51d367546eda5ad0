"""All tables of one archive into another, row by row: between SQLite and PostgreSQL in either direction.

Both sides have the same layout and both are read and written through the same column types, so every value arrives as
it left: doubles and float32 blobs bit for bit, text as text. The reading side stands in one transaction, the writing
side in another: a copy is whole or it is not there.
"""

from collections.abc import Callable, Iterator
from typing import Any

from sqlalchemy import Connection, Integer, Table, func, select

import db.schema.layout  # noqa: F401 - brings every table along
from db.schema.tables import metadata

_ROWS = 2000
#: rows with large blobs are held few at a time
_ROWS_OF_BLOBS = 100
_BLOB_TABLES = frozenset(
    {
        "attitude_summary",
        "carrier_summary",
        "checkpoint",
        "measurement_segment",
        "power_summary",
        "replay_checkpoint",
        "result_segment",
        "state_summary",
        "trace",
    }
)

#: told the share that is done, 0 to 1
Progress = Callable[[float], None]


def copy_tables(source: Connection, target: Connection, progress: Progress) -> None:
    """Copy every row of every table into empty tables."""
    tables = metadata.sorted_tables
    total = sum(source.scalar(select(func.count()).select_from(table)) or 0 for table in tables) or 1
    done = 0
    for table in tables:
        for rows in _pages(source, table):
            target.execute(table.insert(), rows)
            done += len(rows)
            progress(done / total)
        if target.dialect.name == "postgresql":
            _move_sequence(target, table)


def _pages(source: Connection, table: Table) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of a table, some at a time."""
    at_once = _ROWS_OF_BLOBS if table.name in _BLOB_TABLES else _ROWS
    options = {"stream_results": True, "max_row_buffer": at_once}
    result = source.execute(select(table), execution_options=options)
    for rows in result.partitions(at_once):
        yield [dict(row._mapping) for row in rows]  # noqa: SLF001 - SQLAlchemy's public name


def _move_sequence(target: Connection, table: Table) -> None:
    """Let the numbers that PostgreSQL gives go on behind those that were copied."""
    column = table.autoincrement_column
    if column is None or not isinstance(column.type, Integer):
        return
    name = target.scalar(select(func.pg_get_serial_sequence(table.name, column.name)))
    if name is not None:
        newest = target.scalar(select(func.max(column)))
        target.execute(select(func.setval(name, newest or 1, newest is not None)))
