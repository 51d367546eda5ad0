"""Checksum of a stored row: the CRC-32 of its content, key included, as four bytes in a column of its own.

It is computed here alone, from the values that a query gives back, so that both databases store the same four bytes.
Tables are inserted into through SQLAlchemy, whose column default computes the checksum; measurements, whose statements
take many rows at once, state it. A row whose columns are ever updated has none.
"""

import json
import struct
import zlib
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from typing import Any

from sqlalchemy import Boolean, Column, Float, Integer, LargeBinary, Table, Text, TypeDecorator

CHECKSUM_BYTES = 4
_SHARED, _POSITION = struct.Struct("<7q"), struct.Struct("<4q")
#: for what is absent
_NONE = -1


#: epoch, journal number, sequence number, delay, powers, flags, figures of details, as stored
MeasurementParts = tuple[int, int, int | None, int, bytes, bytes | None, bytes | None]


def measurement_checksums(shared: tuple[int, int, int, bool, bool], rows: Iterable[MeasurementParts]) -> bytes:
    """Checksums of rows of ``measurement``, each together with its row of ``measurement_detail``, one after another.

    Half a microsecond a row.

    Parameters
    ----------
    shared : tuple
        What all rows have in common: key of the spacecraft, of the source, plan, claims to be late and to feed.
    rows : iterable
        The rest; powers and flags of all rows are of one length.
    """
    crc32, pack, start = zlib.crc32, _POSITION.pack, 0
    found: list[int] = []
    for epoch_us, number, seq, delay_us, powers, flags, figures in rows:
        if not found:
            start = crc32(_SHARED.pack(*shared, len(powers), _NONE if flags is None else len(flags)))
        crc = crc32(powers, crc32(pack(epoch_us, number, _NONE if seq is None else seq, delay_us), start))
        if flags:
            crc = crc32(flags, crc)
        found.append(crc if figures is None else crc32(figures, crc))
    return struct.pack(f"<{len(found)}I", *found)


def checksum_column() -> Column[bytes]:
    """Column with the checksum of a table that is only added to."""

    def of_row(context: Any) -> bytes:
        return checksum_of(made.table, context.get_current_parameters())

    made: Column[bytes] = Column("checksum", LargeBinary, default=of_row)
    return made


def checksum_of(table: Any, values: Mapping[str, Any]) -> bytes:
    """Checksum of a row of a table: of the columns that are not null, by name, as JSON.

    The number that a database gives a row does not count.
    """
    # NaN is null in the table
    content = {
        name: plain(value)
        for name, plain in _plain_columns(table)
        if (value := values.get(name)) is not None and value == value
    }
    return _bytes_of(zlib.crc32(json.dumps(content).encode()))


@cache
def _plain_columns(table: Table) -> tuple[tuple[str, Callable[[Any], Any]], ...]:
    """Names of the columns that count, each with what makes its values those of a query."""
    columns = (column for column in table.c if column is not table.autoincrement_column and column.name != "checksum")
    return tuple((column.name, _plain_kind(column.type)) for column in columns)


def _plain_kind(kind: Any) -> Callable[[Any], Any]:
    if isinstance(kind, TypeDecorator):
        kind = kind.impl_instance
    plain: dict[type, Callable[[Any], Any]] = {
        Boolean: bool,
        Integer: int,
        Float: float,
        Text: str,
        LargeBinary: bytes.hex,
    }
    return next(function for known, function in plain.items() if isinstance(kind, known))


def _bytes_of(crc32: int) -> bytes:
    return crc32.to_bytes(CHECKSUM_BYTES, "little")
