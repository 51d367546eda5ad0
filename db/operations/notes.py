"""The shift log; implements ``service.ports.Notes``."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, delete, or_, select, true

from db.database import Repository, page_of, within
from db.encoding.json_documents import decode, encode
from db.measurements.retention import LOGS_AT_ONCE
from db.schema.alarm_tables import note as note_table
from service.errors import NotFoundError
from service.ports import ARCHIVE
from service.records.calibration import Window
from service.records.operations.note import Note


class SqlNotes(Repository):
    """Notes in a relational database."""

    def add(self, note: Note) -> Note:
        """Store a note (its id is ignored) and return it with its id; NotFoundError ``note.unknown``."""

        def store(connection: Connection) -> Note:
            if note.corrects is not None:
                _check(connection, note.corrects)
            values = {"spacecraft_id": note.spacecraft_id, "epoch_us": note.epoch_us, "document": encode(note)}
            insert = note_table.insert().values(values).returning(note_table.c.note_id)
            return replace(note, id=int(connection.execute(insert).scalar_one()))

        return self._database.write(store)

    def note(self, note_id: int) -> Note:
        """Return one note; NotFoundError ``note.unknown``."""
        row = self._database.fetch_one(select(note_table).where(note_table.c.note_id == note_id))
        if row is None:
            raise _no_note(note_id)
        return _note_of(row)

    def notes(
        self,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        spacecraft_id: str | None = None,
        *,
        newest_first: bool = False,
    ) -> list[Note]:
        """Return notes about instants of a window in order of (epoch, id), also those about no spacecraft."""
        column = note_table.c
        query = select(note_table).where(within(column.epoch_us, window), _about(spacecraft_id))
        page = page_of(query, column.epoch_us, column.note_id, limit, after, newest_first=newest_first)
        return _notes_of(self._database.fetch(page))

    def drop_before(self, spacecraft_id: str | None, before_us: int) -> Iterator[int]:
        """Drop notes about instants before one, a transaction a step."""
        is_old = (note_table.c.spacecraft_id == spacecraft_id, note_table.c.epoch_us < before_us)

        def drop(connection: Connection) -> int:
            query = select(note_table.c.note_id).where(*is_old).order_by(note_table.c.epoch_us)
            ids = list(connection.scalars(query.limit(LOGS_AT_ONCE)))
            connection.execute(delete(note_table).where(note_table.c.note_id.in_(ids)))
            return len(ids)

        led = self._database.leases.under(drop, spacecraft_id or ARCHIVE)
        while (rows := self._database.write(led)) > 0:
            yield rows

    def newest(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes with the greatest epochs, newest first."""
        query = select(note_table).where(_about(spacecraft_id))
        ordered = query.order_by(note_table.c.epoch_us.desc(), note_table.c.note_id.desc()).limit(limit)
        return _notes_of(self._database.fetch(ordered))

    def last_written(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes that were stored last, newest first, whatever instant they are about."""
        query = select(note_table).where(_about(spacecraft_id))
        return _notes_of(self._database.fetch(query.order_by(note_table.c.note_id.desc()).limit(limit)))


def _check(connection: Connection, note_id: int) -> None:
    """Raise NotFoundError unless a note exists."""
    if connection.scalar(select(note_table.c.note_id).where(note_table.c.note_id == note_id)) is None:
        raise _no_note(note_id)


def _about(spacecraft_id: str | None) -> ColumnElement[bool]:
    if spacecraft_id is None:
        return true()
    return or_(note_table.c.spacecraft_id == spacecraft_id, note_table.c.spacecraft_id.is_(None))


def _notes_of(rows: Sequence[Row[Any]]) -> list[Note]:
    return [_note_of(row) for row in rows]


def _note_of(row: Row[Any]) -> Note:
    return replace(decode(Note, row.document), id=int(row.note_id))


def _no_note(note_id: int) -> NotFoundError:
    return NotFoundError("note.unknown", f"There is no note {note_id}.")
