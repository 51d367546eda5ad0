"""Comparison of stored rows with their checksums."""

from collections.abc import Iterable, Sequence
from functools import partial
from itertools import groupby
from operator import itemgetter
from typing import Any, NamedTuple

from sqlalchemy import Connection, Row, Select, Table, and_, select
from sqlalchemy.exc import SQLAlchemyError

from db.documents import damaged_documents
from db.schema.columns import agrees, checksum_of, measurement_checksums, row_name
from db.schema.tables import measurement, measurement_detail, metadata, segment
from service.errors import StorageError
from service.records.epoch import format_epoch

_FETCH = 10_000
#: rows of the table with the largest blobs that are held at once
_FETCH_SEGMENTS = 8
#: rows that a report names at most
_NAMED = 5


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


def document_damage(name: str) -> str:
    """Return in words that a document is damaged."""
    return f"{name} differs from its digest"


def damage_of(connection: Connection) -> list[str]:
    """Return in words which rows and documents are damaged, also where the database refuses to read them."""
    try:
        rows = [table.damage() for table in checked_tables(connection) if table.differing]
        return [*rows, *map(document_damage, damaged_documents(connection))]
    except SQLAlchemyError as fault:
        return [f"rows cannot be read: {getattr(fault, 'orig', fault)}"]


def require_sound(key: int, rows: Iterable[Row[Any]]) -> None:
    """Compare rows of ``measurement`` of a spacecraft, with figures of details, with their checksums.

    StorageError ``storage.corrupt`` names the first that differs. A row without a checksum was written by hand, which
    the doctor reports.
    """
    found = [row for row in rows if row.checksum is not None]
    if not found:
        return
    # an attribute of a row costs a microsecond, a place in a tuple a twentieth of it
    kind = itemgetter(*map(found[0]._fields.index, ("source_key", "plan_id", "is_late", "feeds", "powers", "flags")))

    def alike(row: Row[Any]) -> tuple[Any, ...]:
        *of_row, powers, flags = kind(row)
        return *of_row, len(powers), None if flags is None else len(flags)

    for _, run in groupby(found, alike):
        some = list(run)
        if agrees(b"".join(row.checksum for row in some), partial(checksums_of_rows, key, some)):
            continue
        for row in some:
            if not agrees(row.checksum, partial(checksums_of_rows, key, [row])):
                name = f"{format_epoch(row.epoch_us)} (number {row.number})"
                raise StorageError("storage.corrupt", f"The measurement of {name} differs from its checksum.")


def checksums_of_rows(key: int, rows: Sequence[Row[Any]]) -> bytes:
    """Return the checksums of rows of one kind of a spacecraft, one after another."""
    first = rows[0]
    names = ("epoch_us", "number", "seq", "received_at_us", "powers", "flags", "figures")
    places = itemgetter(*map(first._fields.index, names))
    parts = (
        (epoch_us, number, seq, received_at_us - epoch_us, *stored)
        for epoch_us, number, seq, received_at_us, *stored in map(places, rows)
    )
    return measurement_checksums((key, first.source_key, first.plan_id, first.is_late, first.feeds), parts)


def _checked(connection: Connection, table: Table) -> CheckedTable:
    agreeing = lacking = differing = 0
    named = []
    at_once = _FETCH_SEGMENTS if table is segment else _FETCH
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
                    named.append(row_name(table, row))
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
