"""Column types that SQLAlchemy does not have."""

import math
from typing import Any

from sqlalchemy import DOUBLE_PRECISION, TypeDecorator, types
from sqlalchemy.engine import Dialect


class UntypedDouble(types.UserDefinedType[float]):
    """A double in a SQLite column without affinity, where -0.0 keeps its sign; a REAL column would store 0."""

    cache_ok = True

    def get_col_spec(self, **_: Any) -> str:
        """Return the name of the type; the part BLOB is what SQLite looks at."""
        return "DOUBLE_BLOB"


class Figure(TypeDecorator[float]):
    """A float that comes back bit for bit; NaN is NULL in the table."""

    impl = DOUBLE_PRECISION
    cache_ok = True

    def load_dialect_impl(self, dialect: Dialect) -> types.TypeEngine[Any]:
        """Return the type of the column in a dialect."""
        return dialect.type_descriptor(UntypedDouble() if dialect.name == "sqlite" else DOUBLE_PRECISION())

    def process_bind_param(self, value: float | None, dialect: Dialect) -> float | None:  # noqa: ARG002 - SQLAlchemy's signature
        """Store NaN as NULL."""
        return None if value is None or math.isnan(value) else float(value)

    def process_result_value(self, value: float | None, dialect: Dialect) -> float:  # noqa: ARG002 - SQLAlchemy's signature
        """Read NULL as NaN."""
        return math.nan if value is None else value
