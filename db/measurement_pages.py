"""Reading measurements in order: one page of rows at a time, each in one consistent state of the database.

A page begins behind a cursor (epoch, number), which stays true whatever happens to the rows between two pages. Rows of
one source under one plan form a piece; a page is the pieces' rows in order of (epoch, number), told as runs of rows
that follow each other within one piece.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, and_, select

from db.database import beyond, within
from db.mapping import MEASUREMENT_COLUMNS, measurement_of, powers_of
from db.tables import measurement, measurement_detail, source
from service.records.attitude import IntArray
from service.records.calibration import Window
from service.records.measurement import Float32Array, Measurement

#: place of a row in the order of epochs: its epoch and its journal number
Cursor = tuple[int, int]


class Chosen(NamedTuple):
    """Which measurements of a spacecraft are meant."""

    window: Window
    #: of this source only
    source: str | None = None
    #: only those that feed the estimator
    feeds_only: bool = False
    #: only those with a smaller journal number
    before_number: int | None = None


class Piece(Protocol):
    """Rows of one source under one plan."""

    source: str
    plan_id: int
    #: (T,) microseconds UTC
    epochs_us: IntArray
    #: (T,) journal numbers
    numbers: IntArray

    def power_dbm(self) -> Float32Array:
        """Return the powers as stored, (T, N) dBm."""
        ...

    def record(self, place: int) -> Measurement:
        """Return the row at a place."""
        ...


class Run(NamedTuple):
    """Rows of one piece that follow each other in the order of epochs."""

    piece: Piece
    #: (n,) places within the piece
    places: IntArray

    @property
    def end(self) -> Cursor:
        """Return the cursor behind the last row."""
        return int(self.piece.epochs_us[self.places[-1]]), int(self.piece.numbers[self.places[-1]])

    def power_dbm(self) -> Float32Array:
        """Return the powers of the rows, (n, N) dBm, read-only."""
        first, last = int(self.places[0]), int(self.places[-1])
        held = self.piece.power_dbm()
        # nearly always the rows lie side by side: nothing is copied
        powers = held[first : last + 1] if last - first + 1 == len(self.places) else held[self.places]
        powers.setflags(write=False)
        return powers

    def epochs_us(self) -> IntArray:
        """Return the epochs of the rows, (n,) microseconds UTC, read-only."""
        epochs_us = self.piece.epochs_us[self.places]
        epochs_us.setflags(write=False)
        return epochs_us


class RowPiece:
    """Rows as the table of rows gives them, in columns of ``MEASUREMENT_COLUMNS``."""

    def __init__(self, rows: Sequence[Row[Any]]) -> None:
        self._rows = rows
        self.source, self.plan_id = rows[0].name, rows[0].plan_id
        places = np.array([(row.epoch_us, row.number) for row in rows], dtype=np.int64)
        self.epochs_us, self.numbers = places[:, 0], places[:, 1]

    def power_dbm(self) -> Float32Array:
        """Return the powers as stored, (T, N) dBm."""
        return np.frombuffer(b"".join(row.powers for row in self._rows), dtype="<f4").reshape(len(self._rows), -1)

    def record(self, place: int) -> Measurement:
        """Return the row at a place."""
        return measurement_of(self._rows[place], powers_of(self._rows[place].powers))


def read_page(connection: Connection, key: int, chosen: Chosen, limit: int, after: Cursor | None) -> list[Run]:
    """Return the next rows behind a cursor as runs; fewer than ``limit`` only when there are no more."""
    query = (
        chosen_rows(key, chosen)
        .where(beyond(measurement.c.epoch_us, measurement.c.number, after))
        .order_by(measurement.c.epoch_us, measurement.c.number)
        .limit(limit)
    )
    return _merged(_pieces(connection.execute(query).all()), limit)


def chosen_rows(key: int, chosen: Chosen) -> Select[Any]:
    """Return the query for the chosen rows of the table of rows."""
    is_its_source = and_(
        source.c.spacecraft_key == measurement.c.spacecraft_key, source.c.source_key == measurement.c.source_key
    )
    is_its_detail = and_(
        measurement_detail.c.spacecraft_key == measurement.c.spacecraft_key,
        measurement_detail.c.epoch_us == measurement.c.epoch_us,
        measurement_detail.c.source_key == measurement.c.source_key,
    )
    return (
        select(*MEASUREMENT_COLUMNS)
        .select_from(measurement)
        .join(source, is_its_source)
        .outerjoin(measurement_detail, is_its_detail)
        .where(measurement.c.spacecraft_key == key, *_conditions(chosen))
    )


def _conditions(chosen: Chosen) -> list[ColumnElement[bool]]:
    conditions = [within(measurement.c.epoch_us, chosen.window)]
    if chosen.source is not None:
        conditions.append(source.c.name == chosen.source)
    if chosen.feeds_only:
        conditions.append(measurement.c.feeds)
    if chosen.before_number is not None:
        conditions.append(measurement.c.number < chosen.before_number)
    return conditions


def _pieces(rows: Sequence[Row[Any]]) -> list[Piece]:
    """Return rows piece by piece."""
    found: dict[tuple[str, int], list[Row[Any]]] = {}
    for row in rows:
        found.setdefault((row.name, row.plan_id), []).append(row)
    return [RowPiece(held) for held in found.values()]


def _merged(pieces: Sequence[Piece], limit: int) -> list[Run]:
    """Return the rows of pieces in order of (epoch, number), at most ``limit``, as runs."""
    if not pieces:
        return []
    counts = [len(piece.epochs_us) for piece in pieces]
    epochs_us = np.concatenate([piece.epochs_us for piece in pieces])
    numbers = np.concatenate([piece.numbers for piece in pieces])
    order = np.lexsort((numbers, epochs_us))[:limit]
    owners = np.repeat(np.arange(len(pieces)), counts)[order]
    places = np.concatenate([np.arange(count) for count in counts])[order]
    breaks = np.flatnonzero(np.diff(owners)) + 1
    return [
        Run(pieces[owner[0]], part)
        for owner, part in zip(np.split(owners, breaks), np.split(places, breaks), strict=True)
    ]
