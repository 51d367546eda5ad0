"""Alarms, their changes, limits and memory; notes of the shift log."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib import import_module
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, delete, func, or_, select, true, update

from db.columns import sound_rows
from db.database import Repository, page_of
from db.encoding.record_codec import decode, encode
from db.measurements.closed_days import LOGS_AT_ONCE
from db.tables import alarm as alarm_table
from db.tables import alarm_change, alarm_limits, alarm_memory
from db.tables import note as note_table
from service.errors import NotFoundError
from service.ports.archive import ListPart
from service.ports.storage import ARCHIVE
from service.records.operations.alarms import Alarm, AlarmChange, AlarmLimits, EngineMemory, Note

#: states that stand for several
_GROUPS: dict[str, tuple[str, ...]] = {
    "open": ("unacknowledged", "acknowledged", "returned", "latched"),
    "closed": ("normal",),
}
_Instance = tuple[str | None, str, str, int]


class SqlAlarms(Repository):
    """Alarms in a relational database."""

    def save(self, changes: Sequence[AlarmChange]) -> tuple[AlarmChange, ...]:
        """Store changes in one transaction and return them with their numbers, alarms that are new with their ids."""

        def store(connection: Connection) -> tuple[AlarmChange, ...]:
            fresh: dict[_Instance, int] = {}
            return tuple(_store(connection, change, fresh) for change in changes)

        # of one spacecraft, or of the service
        about = changes[0].alarm.spacecraft_id if changes else None
        return self._database.write(self._database.leases.under(store, about or ARCHIVE))

    def alarm(self, alarm_id: int) -> Alarm:
        """Return one alarm; NotFoundError ``alarm.unknown``."""
        row = self._database.fetch_one(select(alarm_table).where(alarm_table.c.alarm_id == alarm_id))
        if row is None:
            raise NotFoundError("alarm.unknown", f"There is no alarm {alarm_id}.")
        return _with_id(decode(Alarm, row.document), row.alarm_id)

    def open_alarms(self, spacecraft_id: str | None) -> tuple[Alarm, ...]:
        """Return the alarms of a spacecraft, or of the service, that stand, those under a cover too."""
        query = select(alarm_table).where(alarm_table.c.is_open, alarm_table.c.spacecraft_id == spacecraft_id)
        rows = self._database.fetch(query.order_by(alarm_table.c.alarm_id))
        return tuple(_with_id(decode(Alarm, row.document), row.alarm_id) for row in rows)

    def alarms(self, spacecraft_id: str, states: Sequence[str], part: ListPart) -> list[Alarm]:
        """Return alarms of a spacecraft and of the service raised in a window, in order of (raised, id)."""
        raised = alarm_table.c.raised_at_us
        query = select(alarm_table).where(_concerns(alarm_table.c.spacecraft_id, spacecraft_id))
        if states:
            wanted = [name for state in states for name in _GROUPS.get(state, (state,))]
            query = query.where(alarm_table.c.state.in_(wanted))
        page = page_of(query, raised, alarm_table.c.alarm_id, part)
        rows = self._database.fetch(page)
        return [_with_id(decode(Alarm, row.document), row.alarm_id) for row in rows]

    def changes(self, alarm_id: int) -> list[AlarmChange]:
        """Return the changes of one alarm, in order."""
        query = select(alarm_change).where(alarm_change.c.alarm_id == alarm_id)
        rows = self._database.fetch(query.order_by(alarm_change.c.sequence))
        return _changes_of(sound_rows(alarm_change, rows))

    def changes_after(self, spacecraft_id: str, sequence: int, limit: int) -> list[AlarmChange]:
        """Return the changes of alarms of a spacecraft and of the service after a number, in order."""
        query = select(alarm_change).where(
            _concerns(alarm_change.c.spacecraft_id, spacecraft_id), alarm_change.c.sequence > sequence
        )
        return _changes_of(self._database.fetch(query.order_by(alarm_change.c.sequence).limit(limit)))

    def newest_sequence(self) -> int:
        """Return the number of the newest change, 0 before the first."""
        row = self._database.fetch_one(select(func.max(alarm_change.c.sequence)))
        return 0 if row is None or row[0] is None else int(row[0])

    def memory(self, spacecraft_id: str | None) -> EngineMemory:
        """Return the memory of the alarms of a spacecraft, or of the service."""
        query = select(alarm_memory.c.document).where(alarm_memory.c.spacecraft_id == (spacecraft_id or ""))
        row = self._database.fetch_one(query)
        return EngineMemory() if row is None else decode(EngineMemory, row.document)

    def save_memory(self, spacecraft_id: str | None, memory: EngineMemory) -> None:
        """Store what they remember in place of what they did."""
        store = partial(_put_memory, spacecraft_id=spacecraft_id or "", document=encode(memory))
        self._database.write(self._database.leases.under(store, spacecraft_id or ARCHIVE))

    def count_refused(self, spacecraft_id: str, is_refused: Sequence[bool]) -> None:
        """Count records of telemetry that were refused one after another, whichever process refused them."""
        if not any(is_refused) and spacecraft_id not in self.refused():
            return

        def store(connection: Connection, _key: int) -> None:
            count = connection.scalar(_refused(spacecraft_id)) or 0
            for is_bad in is_refused:
                count = count + 1 if is_bad else 0
            _put_memory(connection, spacecraft_id=spacecraft_id, refused=count)

        self._change(spacecraft_id, store)

    def refused(self) -> dict[str, int]:
        """Return how many records of telemetry were refused since one was accepted, by spacecraft; none: not named."""
        memory = alarm_memory.c
        rows = self._database.fetch(select(memory.spacecraft_id, memory.refused).where(memory.refused > 0))
        return dict(map(tuple, rows))

    def limits(self, spacecraft_id: str, version: int | None = None) -> AlarmLimits:
        """Return a version of the limits, or the newest; version 0 are the defaults."""
        if version == 0:
            return AlarmLimits()
        query = select(alarm_limits).where(alarm_limits.c.spacecraft_id == spacecraft_id)
        if version is not None:
            query = query.where(alarm_limits.c.version == version)
        row = self._database.fetch_one(query.order_by(alarm_limits.c.version.desc()).limit(1))
        if row is not None:
            return decode(AlarmLimits, row.document)
        if version is not None:
            raise NotFoundError("alarm_limits.unknown", f"There is no version {version} of the limits.")
        return AlarmLimits()

    def drop_before(self, spacecraft_id: str | None, before_us: int) -> Iterator[int]:
        """Drop closed alarms raised before an instant with their changes, a transaction a step."""
        is_old = (
            alarm_table.c.spacecraft_id == spacecraft_id,
            alarm_table.c.raised_at_us < before_us,
            alarm_table.c.is_open.is_(False),
        )

        def drop(connection: Connection) -> int:
            query = select(alarm_table.c.alarm_id).where(*is_old).order_by(alarm_table.c.raised_at_us)
            ids = list(connection.scalars(query.limit(LOGS_AT_ONCE)))
            for table in (alarm_change, alarm_table):
                connection.execute(delete(table).where(table.c.alarm_id.in_(ids)))
            return len(ids)

        led = self._database.leases.under(drop, spacecraft_id or ARCHIVE)
        while (rows := self._database.write(led)) > 0:
            yield rows

    def put_limits(self, spacecraft_id: str, limits: AlarmLimits) -> AlarmLimits:
        """Store limits as the next version and return it; the version that they state is ignored."""

        def store(connection: Connection, _key: int) -> AlarmLimits:
            query = select(func.max(alarm_limits.c.version)).where(alarm_limits.c.spacecraft_id == spacecraft_id)
            stored = replace(limits, version=1 + (connection.scalar(query) or 0))
            values = {"spacecraft_id": spacecraft_id, "version": stored.version, "document": encode(stored)}
            connection.execute(alarm_limits.insert().values(values))
            return stored

        return self._change(spacecraft_id, store)


def _refused(spacecraft_id: str) -> Select[Any]:
    return select(alarm_memory.c.refused).where(alarm_memory.c.spacecraft_id == spacecraft_id)


def _put_memory(connection: Connection, **values: Any) -> None:
    """Store columns of the memory of a spacecraft, beside those that it has."""
    # that of PostgreSQL takes 20 ms of a start, which a file does not need
    insert = import_module(f"sqlalchemy.dialects.{connection.dialect.name}").insert
    statement = insert(alarm_memory).values({"document": encode(EngineMemory()), **values})
    statement = statement.on_conflict_do_update(index_elements=["spacecraft_id"], set_=values)
    connection.execute(statement)


def _changes_of(rows: Sequence[Row[Any]]) -> list[AlarmChange]:
    return [replace(decode(AlarmChange, row.document), sequence=row.sequence) for row in rows]


def _store(connection: Connection, change: AlarmChange, fresh: dict[_Instance, int]) -> AlarmChange:
    """Store one change; the later changes of an alarm that is new with it get its id."""
    reported = change.alarm
    instance = (reported.spacecraft_id, *reported.key, reported.raised_at_us)
    values = {
        "spacecraft_id": reported.spacecraft_id,
        "state": reported.state,
        "is_open": reported.is_open,
        "raised_at_us": reported.raised_at_us,
        "document": encode(reported),
    }
    alarm_id = reported.id or fresh.get(instance, 0)
    if alarm_id:
        connection.execute(update(alarm_table).where(alarm_table.c.alarm_id == alarm_id).values(values))
    else:
        raised = alarm_table.insert().values(values).returning(alarm_table.c.alarm_id)
        alarm_id = fresh[instance] = int(connection.execute(raised).scalar_one())
    numbered = replace(change, alarm=_with_id(reported, alarm_id))
    values = {"alarm_id": alarm_id, "spacecraft_id": reported.spacecraft_id, "document": encode(numbered)}
    added = alarm_change.insert().values(values).returning(alarm_change.c.sequence)
    sequence = connection.execute(added).scalar_one()
    return replace(numbered, sequence=int(sequence))


def _with_id(reported: Alarm, alarm_id: int) -> Alarm:
    return replace(reported, id=int(alarm_id))


def _concerns(column: ColumnElement[str | None], spacecraft_id: str) -> ColumnElement[bool]:
    """Return the condition that a row is about a spacecraft or about the service as a whole."""
    return or_(column == spacecraft_id, column.is_(None))


class SqlNotes(Repository):
    """Notes in a relational database."""

    def add(self, note: Note) -> Note:
        """Store a note (its id is ignored) and return it with its id; NotFoundError ``note.unknown``."""

        def store(connection: Connection) -> Note:
            corrected = select(note_table.c.note_id).where(note_table.c.note_id == note.corrects)
            if note.corrects is not None and connection.scalar(corrected) is None:
                raise _no_note(note.corrects)
            values = {"spacecraft_id": note.spacecraft_id, "epoch_us": note.epoch_us, "document": encode(note)}
            insert = note_table.insert().values(values).returning(note_table.c.note_id)
            return replace(note, id=int(connection.execute(insert).scalar_one()))

        return self._database.write(store)

    def note(self, note_id: int) -> Note:
        """Return one note; NotFoundError ``note.unknown``."""
        notes = _notes_of(self._database.fetch(select(note_table).where(note_table.c.note_id == note_id)))
        if not notes:
            raise _no_note(note_id)
        return notes[0]

    def notes(self, part: ListPart, spacecraft_id: str | None = None) -> list[Note]:
        """Return notes about instants of a window in order of (epoch, id), also those about no spacecraft."""
        column = note_table.c
        query = select(note_table).where(_about(spacecraft_id))
        page = page_of(query, column.epoch_us, column.note_id, part)
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

    def last_written(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes that were stored last, newest first, whatever instant they are about."""
        query = select(note_table).where(_about(spacecraft_id))
        return _notes_of(self._database.fetch(query.order_by(note_table.c.note_id.desc()).limit(limit)))


def _about(spacecraft_id: str | None) -> ColumnElement[bool]:
    if spacecraft_id is None:
        return true()
    return or_(note_table.c.spacecraft_id == spacecraft_id, note_table.c.spacecraft_id.is_(None))


def _notes_of(rows: Sequence[Row[Any]]) -> list[Note]:
    return [replace(decode(Note, row.document), id=int(row.note_id)) for row in sound_rows(note_table, rows)]


def _no_note(note_id: int) -> NotFoundError:
    return NotFoundError("note.unknown", f"There is no note {note_id}.")
