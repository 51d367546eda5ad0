"""Comparison of stored rows with their checksums."""

import struct
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, Select, Table, and_, select
from sqlalchemy.exc import SQLAlchemyError

from db.schema.columns import checksum_of, measurement_checksums
from db.schema.tables import measurement, measurement_detail, metadata, result_segment
from service.records.epoch import format_epoch

_FETCH = 10_000
#: rows of the table with the largest blobs that are held at once
_FETCH_SEGMENTS = 8
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

    def damage(self) -> str:
        """Return in words which rows differ."""
        more = f" and {self.differing - len(self.named)} more" if self.differing > len(self.named) else ""
        return f"{self.differing} rows of {self.name} differ from their checksum: {'; '.join(self.named)}{more}"


def checked_tables(connection: Connection) -> list[CheckedTable]:
    """Compare every row of every table that has checksums; memory is that of some thousand rows."""
    return [_checked(connection, table) for table in metadata.sorted_tables if "checksum" in table.c]


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


def _checked(connection: Connection, table: Table) -> CheckedTable:
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
    return CheckedTable(table.name, agreeing, lacking, differing, tuple(named))


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
