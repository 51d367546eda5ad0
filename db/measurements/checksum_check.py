"""Comparing stored rows with their checksums, and giving one to rows of versions before checksums."""

import struct
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, Select, Table, and_, bindparam, delete, select, tuple_, update
from sqlalchemy.exc import SQLAlchemyError

from db.database import Database
from db.schema.row_checksum import checksum_of, measurement_checksums
from db.schema.tables import checksum_backlog, measurement, measurement_detail, metadata, result_segment
from service.records.epoch import format_epoch

_FETCH = 10_000
#: rows of the table with the largest blobs that are held at once
_FETCH_SEGMENTS = 8
#: rows that one transaction gives a checksum
_AT_ONCE = 500
#: rows that a report names at most
_NAMED = 5
#: year 2255
_EPOCH_END_US = 1 << 53


class CheckedTable(NamedTuple):
    """Comparison of the rows of one table."""

    name: str
    #: rows that agree with their checksum, rows that have none
    agreeing: int
    lacking: int
    differing: int
    #: the first of the rows that differ
    named: tuple[str, ...]
    #: rows that have none are to get one
    is_backlog: bool

    def damage(self) -> str:
        """Return in words which rows differ."""
        more = f" and {self.differing - len(self.named)} more" if self.differing > len(self.named) else ""
        return f"{self.differing} rows of {self.name} differ from their checksum: {'; '.join(self.named)}{more}"


def checked_tables(connection: Connection) -> list[CheckedTable]:
    """Compare every row of every table that has checksums; memory is that of some thousand rows."""
    backlog = set(connection.scalars(select(checksum_backlog.c.table_name)))
    tables = [table for table in metadata.sorted_tables if "checksum" in table.c]
    return [_checked(connection, table, is_backlog=table.name in backlog) for table in tables]


def damage_of(connection: Connection) -> list[str]:
    """Return in words which rows differ from their checksums, also where the database refuses to read them."""
    try:
        return [table.damage() for table in checked_tables(connection) if table.differing]
    except SQLAlchemyError as fault:
        return [f"rows cannot be read: {getattr(fault, 'orig', fault)}"]


def agrees(stored: bytes, computed: Callable[[], bytes]) -> bool:
    """Return whether a row has the checksum that is stored; values that no writer stores have none."""
    try:
        return stored == computed()
    except (ArithmeticError, AttributeError, TypeError, ValueError, struct.error):
        return False


def complete(database: Database) -> Iterator[int]:
    """Give rows of older versions their checksum, some a transaction, and yield how many."""
    with database.read() as connection:
        names = list(connection.scalars(select(checksum_backlog.c.table_name)))
    for table in (metadata.tables[name] for name in names):
        key = tuple(table.primary_key.columns)
        query = _rows(table).where(table.c.checksum.is_(None)).order_by(*key).limit(_AT_ONCE)
        rows = database.fetch(query)
        while rows:
            yield database.write(partial(_complete_rows, table=table, rows=rows))
            last = tuple(rows[-1]._mapping[column] for column in key)  # noqa: SLF001 - SQLAlchemy's public name
            rows = database.fetch(query.where(tuple_(*key) > last))
        database.write(partial(_end_backlog, name=table.name))


def _complete_rows(connection: Connection, table: Table, rows: Sequence[Row[Any]]) -> int:
    """Store the checksums of rows; one that was moved or dropped meanwhile is left out."""
    key = tuple(table.primary_key.columns)
    is_it = and_(*(column == bindparam(f"of_{column.name}") for column in key), table.c.checksum.is_(None))
    values = [
        {**{f"of_{column.name}": row._mapping[column] for column in key}, "made": _checksum_of_row(table, row)}  # noqa: SLF001
        for row in rows
    ]
    connection.execute(update(table).where(is_it).values(checksum=bindparam("made")), values)
    return len(values)


def _end_backlog(connection: Connection, name: str) -> None:
    connection.execute(delete(checksum_backlog).where(checksum_backlog.c.table_name == name))


def _checked(connection: Connection, table: Table, *, is_backlog: bool) -> CheckedTable:
    agreeing = lacking = differing = 0
    named = []
    at_once = _FETCH_SEGMENTS if table is result_segment else _FETCH
    options = {"stream_results": True, "max_row_buffer": at_once}
    for rows in connection.execute(_rows(table), execution_options=options).partitions(at_once):
        for row in rows:
            if row.checksum is None:
                lacking += 1
            elif agrees(row.checksum, partial(_checksum_of_row, table, row)):
                agreeing += 1
            else:
                differing += 1
                if differing <= _NAMED:
                    named.append(_named(table, row))
    return CheckedTable(table.name, agreeing, lacking, differing, tuple(named), is_backlog)


def _rows(table: Table) -> Select[Any]:
    """Return the query for the rows of a table, measurements with their details."""
    if table is not measurement:
        return select(table)
    is_its_detail = and_(
        *(measurement_detail.c[name] == measurement.c[name] for name in ("spacecraft_key", "epoch_us", "source_key"))
    )
    return select(measurement, measurement_detail.c.figures).outerjoin_from(
        measurement, measurement_detail, is_its_detail
    )


def _checksum_of_row(table: Table, row: Row[Any]) -> bytes:
    if table is measurement:
        key, epoch_us, source_key, number, plan_id, seq, delay_us, *claims, powers, flags, _, figures = tuple(row)
        parts = (epoch_us, number, seq, delay_us, powers, flags, figures)
        return measurement_checksums((key, source_key, plan_id, *claims), [parts])
    return checksum_of(table, dict(zip(row._fields, row, strict=True)))


def _named(table: Table, row: Row[Any]) -> str:
    """Return the key of a row in words."""
    parts = ((column.name, row._mapping[column]) for column in table.primary_key.columns)  # noqa: SLF001
    return " ".join(
        # a damaged epoch can lie beyond every calendar
        f"epoch {format_epoch(value)}" if name == "epoch_us" and 0 <= value < _EPOCH_END_US else f"{name} {value}"
        for name, value in parts
    )
