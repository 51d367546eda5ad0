"""Statements of the hot path, compiled to text once, so that running one costs the driver's time and little else.

Only for statements whose values need no conversion by SQLAlchemy: integers, texts, bytes and truth values.
"""

from typing import Any

from sqlalchemy import Connection, CursorResult, Select, Update
from sqlalchemy.engine import Dialect


class CompiledStatement:
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

    def run(self, connection: Connection, *values: Any) -> CursorResult[Any]:
        """Execute with one set of values."""
        text, order = self._compiled(connection.dialect)
        if order is None:
            return connection.exec_driver_sql(text, dict(zip(self._names, values, strict=True)))
        return connection.exec_driver_sql(text, tuple(values[place] for place in order))

    def _compiled(self, dialect: Dialect) -> tuple[str, tuple[int, ...] | None]:
        """Return the text, and the places of the values if the driver takes them by position."""
        known = self._known.get(dialect.name)
        if known is None:
            compiled = self._statement.compile(dialect=dialect)
            order = tuple(self._names.index(name) for name in compiled.positiontup or ())
            known = self._known[dialect.name] = (str(compiled), order if compiled.positional else None)
        return known
