"""Insertion of rows that may stand already: a batch in one statement of the driver, its values converted by columns.

SQLAlchemy converts the parameters row by row, which costs twice what encoding and storing the row do.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from sqlalchemy import Connection, Table
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.engine import Dialect

from db.schema.row_checksum import checksum_of


class _Insertion(NamedTuple):
    """Statement in a dialect."""

    text: str
    #: columns in the order of their values
    names: tuple[str, ...]
    #: what makes of a value that of the driver, by column; None = it is the value
    converted: tuple[Callable[[Any], Any] | None, ...]


def insert_new(connection: Connection, table: Table, rows: Sequence[Mapping[str, Any]]) -> int:
    """Insert rows of the same columns and return how many were new; those whose primary key exists stay as they are."""
    if not rows:
        return 0
    named = [{**row, "checksum": checksum_of(table, row)} for row in rows] if "checksum" in table.c else rows
    dialect = connection.dialect
    text, names, converted = _insertion(dialect, table, tuple(named[0]))
    columns = (
        [row[name] for row in named] if convert is None else [convert(row[name]) for row in named]
        for name, convert in zip(names, converted, strict=True)
    )
    values: Any = list(zip(*columns, strict=True))
    if not dialect.positional:
        values = [dict(zip(names, each, strict=True)) for each in values]
    return connection.exec_driver_sql(text, values, execution_options={"preserve_rowcount": True}).rowcount


@lru_cache(maxsize=64)
def _insertion(dialect: Dialect, table: Table, columns: tuple[str, ...]) -> _Insertion:
    """Return the statement that gives values to some columns of a table."""
    insert = sqlite.insert if dialect.name == "sqlite" else postgresql.insert
    statement = insert(table).on_conflict_do_nothing().inline()
    compiled: Any = statement.compile(dialect=dialect, column_keys=list(columns))
    names = tuple(compiled.positiontup) if dialect.positional else columns
    kinds = (table.c[name].type.dialect_impl(dialect) for name in names)
    return _Insertion(str(compiled), names, tuple(kind.bind_processor(dialect) for kind in kinds))
