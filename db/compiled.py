"""Statements of the hot path, compiled to text once, so that running one costs the driver's time and little else.

Only for statements whose values need no conversion by SQLAlchemy: integers, texts, bytes and truth values.
"""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Connection, CursorResult, Insert, Select, Update
from sqlalchemy.engine import Dialect

#: values in the order of the statement's parameters
Values = tuple[Any, ...]


class CompiledStatement:
    """A statement and its text in the dialect that runs it.

    Parameters
    ----------
    statement : Select, Insert or Update
        Parameters are named by ``bindparam`` or, in a plain insert, by the columns.
    names : str
        Names of the parameters, in the order of the values that ``run`` takes.
    """

    def __init__(self, statement: Select[Any] | Insert | Update, *names: str) -> None:
        self._statement = statement
        self._names = names
        self._known: dict[str, tuple[str, tuple[int, ...] | None]] = {}

    def run(self, connection: Connection, *values: Any) -> CursorResult[Any]:
        """Execute with one set of values."""
        text, order = self._compiled(connection.dialect)
        return connection.exec_driver_sql(text, self._arranged([values], order)[0])

    def run_many(self, connection: Connection, rows: Sequence[Values]) -> None:
        """Execute once for every set of values."""
        text, order = self._compiled(connection.dialect)
        connection.exec_driver_sql(text, self._arranged(rows, order))

    def _compiled(self, dialect: Dialect) -> tuple[str, tuple[int, ...] | None]:
        """Return the text, and the places of the values if the driver takes them by position."""
        known = self._known.get(dialect.name)
        if known is None:
            compiled = self._statement.compile(dialect=dialect)
            order = tuple(self._names.index(name) for name in compiled.positiontup or ())
            known = self._known[dialect.name] = (str(compiled), order if compiled.positional else None)
        return known

    def _arranged(self, rows: Sequence[Values], order: tuple[int, ...] | None) -> list[Any]:
        """Return the values as the driver takes them: by position or by name."""
        if order is None:
            return [dict(zip(self._names, row, strict=True)) for row in rows]
        if order == tuple(range(len(order))):
            return list(rows)
        return [tuple(row[place] for place in order) for row in rows]
