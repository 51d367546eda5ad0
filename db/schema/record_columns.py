"""Columns of a table derived from the fields of the record that its rows hold."""

from collections.abc import Collection
from dataclasses import MISSING
from typing import Any

from sqlalchemy import BigInteger, Boolean, Column, Integer, Text

from db.schema.column_types import Figure
from service.records.record_fields import FieldKind, RecordField, record_fields

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
