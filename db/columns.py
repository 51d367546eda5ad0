"""Columns: types that SQLAlchemy does not have, columns by the fields of a record, the checksum of a row."""

import math
import struct
import zlib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING
from functools import cache
from typing import Any, NamedTuple

from sqlalchemy import (
    DOUBLE_PRECISION,
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Integer,
    LargeBinary,
    Row,
    Table,
    Text,
    TypeDecorator,
    types,
)
from sqlalchemy.engine import Dialect

from service.errors import StorageError
from service.records.epoch import format_epoch
from service.records.record_fields import FieldKind, RecordField, record_fields


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

    def bind_processor(self, dialect: Dialect) -> Callable[[float | None], float | None]:  # noqa: ARG002 - SQLAlchemy's
        """Return what stores NaN as NULL; as a processor of its own it costs half of `process_bind_param`."""
        return lambda value: None if value is None or value != value else float(value)

    def result_processor(self, dialect: Dialect, coltype: object) -> Callable[[float | None], float]:  # noqa: ARG002
        """Return what reads NULL as NaN."""
        return lambda value: math.nan if value is None else value


def needed(kind: Any, *names: str) -> list[Column[Any]]:
    """Return columns that always hold a value."""
    return [Column(name, kind, nullable=False) for name in names]


def optional(kind: Any, *names: str) -> list[Column[Any]]:
    """Return columns that may be NULL."""
    return [Column(name, kind) for name in names]


def keys(kind: Any, *names: str) -> list[Column[Any]]:
    """Return columns of a primary key that the writer states."""
    return [Column(name, kind, primary_key=True, autoincrement=False) for name in names]


def spacecraft_key(*, is_referencing: bool = True) -> Column[int]:
    """Return the column that says which spacecraft a row belongs to."""
    reference = [ForeignKey("spacecraft.spacecraft_key")] if is_referencing else []
    return Column("spacecraft_key", Integer, *reference, primary_key=True, autoincrement=False)


_TYPES: dict[FieldKind, Any] = {
    FieldKind.EPOCH: BigInteger,
    FieldKind.COUNT: Integer,
    FieldKind.NUMBER: Figure,
    FieldKind.TRUTH: Boolean,
    FieldKind.AXES: Figure,
    FieldKind.AXIS_TRUTHS: Boolean,
}
_PER_AXIS = (FieldKind.AXES, FieldKind.AXIS_TRUTHS)
#: column that says whether a field of axes that may be None is there
HAS_AXES = {"rates_deg_s": "has_rates"}


def column_names(field: RecordField) -> tuple[str, ...]:
    """Return the names of the columns that hold a field."""
    if field.kind not in _PER_AXIS:
        return (field.name,)
    return (HAS_AXES[field.name], *field.axis_names()) if field.is_optional else field.axis_names()


def record_columns(record: type, *, without: Collection[str]) -> list[Column[Any]]:
    """Return the columns of all fields but those that the table declares itself.

    NULL stands for NaN, for None, and for the default of a field.
    """
    chosen = (field for name, field in record_fields(record).items() if name not in without)
    return [_column(field, name) for field in chosen for name in column_names(field)]


def _column(field: RecordField, name: str) -> Column[Any]:
    if name == HAS_AXES.get(field.name):
        return Column(name, Boolean, nullable=False)
    kind = _TYPES.get(field.kind, Text)
    return Column(name, kind, nullable=field.is_optional or field.default is not MISSING or kind is Figure)


CHECKSUM_BYTES = 4
#: year 2255
_EPOCH_END_US = 1 << 53
#: of values that no writer stores
_NO_CHECKSUM = (ArithmeticError, AttributeError, TypeError, ValueError, struct.error)
#: for what is absent, and size of a content
_NONE, _SIZE = -(1 << 63), struct.Struct("<q")


def checksum_column() -> Column[bytes]:
    """Column with the checksum of a table that is only added to."""

    def of_row(context: Any) -> bytes:
        return checksum_of(made.table, context.get_current_parameters())

    made: Column[bytes] = Column("checksum", LargeBinary, default=of_row)
    return made


def checksum_of(table: Any, values: Mapping[str, Any]) -> bytes:
    """Checksum of a row of a table."""
    return checksums_of(table, {name: (value,) for name, value in values.items()})[0]


def checksums_of(table: Any, columns: Mapping[str, Sequence[Any]]) -> list[bytes]:
    """Checksums of rows of a table: CRC-32 of its columns in their order, numbers first, null as NaN is.

    The number that a database gives a row does not count.
    """
    whole, figures, contents, packed = _parts(table)
    nothing = (None,) * len(next(iter(columns.values())))
    numbers = ([_NONE if each is None else each for each in columns.get(name, nothing)] for name in whole)
    reals = (
        [math.nan if each is None or each != each else each for each in columns.get(name, nothing)] for name in figures
    )
    heads = (packed.pack(*row) for row in zip(*numbers, *reals, strict=True))
    parts = [columns.get(name, nothing) for name in contents]
    # most texts are one of a few
    sized = ({each: _with_size(each) for each in set(part)} for part in parts)
    framed = (map(sizes.__getitem__, part) for sizes, part in zip(sized, parts, strict=True))
    return [_bytes_of(zlib.crc32(b"".join(row))) for row in zip(heads, *framed, strict=True)]


def _with_size(content: str | bytes | None) -> bytes:
    part = content.encode() if isinstance(content, str) else content
    return _SIZE.pack(_NONE) if part is None else _SIZE.pack(len(part)) + part


def agrees(table: Table, row: Row[Any]) -> bool:
    """Return whether a row, all columns of its table, has its checksum; values that no writer stores have none."""
    try:
        return bool(row.checksum == checksum_of(table, row._asdict()))
    except _NO_CHECKSUM:
        return False


def soundness(table: Table, rows: Sequence[Row[Any]]) -> list[bool]:
    """Return which rows agree with their checksums, or have none: written by hand, which the doctor reports."""
    if not rows:
        return []
    columns = dict(zip(rows[0]._fields, zip(*rows, strict=True), strict=True))
    try:
        computed = checksums_of(table, columns)
    except _NO_CHECKSUM:
        return [row.checksum is None or agrees(table, row) for row in rows]
    pairs = zip(columns["checksum"], computed, strict=True)
    return [stored is None or stored == checksum for stored, checksum in pairs]


def row_name(table: Table, row: Row[Any]) -> str:
    """Return the key of a row in words."""
    parts = ((column.name, row._mapping[column]) for column in table.primary_key.columns)  # noqa: SLF001
    return " ".join(
        # a damaged epoch can lie beyond every calendar
        f"epoch {format_epoch(value)}" if name == "epoch_us" and 0 <= value < _EPOCH_END_US else f"{name} {value}"
        for name, value in parts
    )


def sound_rows(table: Table, rows: Iterable[Row[Any]]) -> list[Row[Any]]:
    """Return the rows of a table; StorageError ``storage.corrupt`` names one that is not sound."""
    found = list(rows)
    damaged = next((row for row, is_sound in zip(found, soundness(table, found), strict=True) if not is_sound), None)
    if damaged is not None:
        detail = f"The {table.name} row of {row_name(table, damaged)} differs from its checksum."
        raise StorageError("storage.corrupt", detail)
    return found


class _Parts(NamedTuple):
    """Columns that count in a checksum, by what they hold."""

    whole: tuple[str, ...]
    figures: tuple[str, ...]
    contents: tuple[str, ...]
    packed: struct.Struct


@cache
def _parts(table: Table) -> _Parts:
    names: dict[type, list[str]] = {Integer: [], Float: [], Text: []}
    for column in table.c:
        kind = column.type.impl_instance if isinstance(column.type, TypeDecorator) else column.type
        if column is not table.autoincrement_column and column.name != "checksum":
            holds = Integer if isinstance(kind, Integer | Boolean) else Float if isinstance(kind, Float) else Text
            names[holds].append(column.name)
    whole, figures, contents = map(tuple, names.values())
    return _Parts(whole, figures, contents, struct.Struct(f"<{len(whole)}q{len(figures)}d"))


def _bytes_of(crc32: int) -> bytes:
    return crc32.to_bytes(CHECKSUM_BYTES, "little")
