"""Comparison of stored rows with their checksums."""

from typing import NamedTuple

from sqlalchemy import Connection, Table, select
from sqlalchemy.exc import SQLAlchemyError

from db.documents import damaged_documents
from db.schema.columns import row_name, soundness
from db.schema.tables import metadata, segment

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


def _checked(connection: Connection, table: Table) -> CheckedTable:
    agreeing = lacking = differing = 0
    named: list[str] = []
    at_once = _FETCH_SEGMENTS if table is segment else _FETCH
    options = {"stream_results": True, "max_row_buffer": at_once}
    for rows in connection.execute(select(table), execution_options=options).partitions(at_once):
        wrong = [row for row, is_sound in zip(rows, soundness(table, rows), strict=True) if not is_sound]
        without = sum(row.checksum is None for row in rows)
        lacking += without
        differing += len(wrong)
        agreeing += len(rows) - without - len(wrong)
        named += [row_name(table, row) for row in wrong[: _NAMED - len(named)]]
    return CheckedTable(table.name, agreeing, lacking, differing, tuple(named))
