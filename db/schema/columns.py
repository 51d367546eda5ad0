"""Columns of tables, several of one type at once."""

from typing import Any

from sqlalchemy import Column, ForeignKey, Integer


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
