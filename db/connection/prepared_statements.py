"""Statements of the hot path, compiled to text once, so that running one costs the driver's time and little else.

Only for statements whose values need no conversion by SQLAlchemy: integers, texts, bytes and truth values (which SQLite
gives back as 0 and 1). On SQLite they go to the driver itself, inside the transaction that SQLAlchemy has opened:
its execution costs ten times what a statement of one row does.
"""

import sqlite3
from typing import Any, Protocol

from sqlalchemy import Connection, Select, Update
from sqlalchemy.engine import Dialect
from sqlalchemy.exc import OperationalError


class StatementResult(Protocol):
    """Result of a prepared statement, to be read at once."""

    def fetchone(self) -> Any:
        """Return the next row, None after the last."""

    def fetchall(self) -> Any:
        """Return all rows."""


def run_bare(connection: Connection, text: str, values: tuple[Any, ...]) -> sqlite3.Cursor:
    """Run a statement on SQLite's driver; its faults come as those of SQLAlchemy."""
    driver: Any = connection.connection.driver_connection
    try:
        cursor: sqlite3.Cursor = driver.execute(text, values)
    except sqlite3.Error as fault:
        # the values stay out of it: they are blobs of whole batches
        raise OperationalError(text, None, fault) from fault
    return cursor


class PreparedStatement:
    """A statement and its text in the dialect that runs it.

    Parameters
    ----------
    statement : Select or Update
        Its parameters are named by ``bindparam``.
    names : str
        Names of the parameters, in the order of the values that ``run`` takes.
    """

    def __init__(self, statement: Select[Any] | Update, *names: str) -> None:
        self._statement = statement
        self._names = names
        self._known: dict[str, tuple[str, tuple[int, ...] | None]] = {}

    def run(self, connection: Connection, *values: Any) -> StatementResult:
        """Execute with one set of values."""
        text, order = self._compiled(connection.dialect)
        if order is None:
            return connection.exec_driver_sql(text, dict(zip(self._names, values, strict=True)))
        placed = tuple(values[position] for position in order)
        if connection.dialect.name == "sqlite":
            return run_bare(connection, text, placed)
        return connection.exec_driver_sql(text, placed)

    def _compiled(self, dialect: Dialect) -> tuple[str, tuple[int, ...] | None]:
        """Return the text, and the places of the values if the driver takes them by position."""
        known = self._known.get(dialect.name)
        if known is None:
            compiled = self._statement.compile(dialect=dialect)
            order = tuple(self._names.index(name) for name in compiled.positiontup or ())
            known = self._known[dialect.name] = (str(compiled), order if compiled.positional else None)
        return known
