"""Access keys and the audit log."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields, replace
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, delete, or_, select, update

from db.database import Repository, append_entry, lock_audit_head
from db.tables import access_key, archive_layout, audit_entry, audit_head, browser_session
from service.errors import ConflictError, NotFoundError
from service.records.operations.access import (
    GENESIS,
    AccessKey,
    AuditEntry,
    AuditEvent,
    AuditFilter,
    AuditHead,
    BrowserSession,
    Role,
    StoredKey,
    name_key,
)

#: entries held at once while a chain is walked
_WALK = 2000
#: sessions of one key at once; the one that would end first makes room
SESSIONS_PER_KEY = 100
#: columns of words by commas
_LISTS = ("spacecraft", "kinds")
_EVENT_FIELDS = tuple(field.name for field in fields(AuditEvent))


class SqlAudit(Repository):
    """The audit log in a relational database."""

    def append(self, audit_event: AuditEvent) -> AuditEntry:
        """Add a deed and wait for its commit."""
        return self._database.submit(lambda connection: append_entry(connection, audit_event)).result()

    def entries(
        self, wanted: AuditFilter, limit: int, after: int | None, *, newest_first: bool = False
    ) -> list[AuditEntry]:
        """Return entries with numbers above ``after``, in order, or those below it in the reverse order."""
        number = audit_entry.c.number
        query = select(audit_entry).where(*_conditions(wanted)).limit(limit)
        query = query.order_by(number.desc() if newest_first else number)
        if after is not None:
            query = query.where(number < after if newest_first else number > after)
        return [_entry_of(row) for row in self._database.fetch(query)]

    def head(self) -> AuditHead:
        """Return the newest entry's number and hash as they stand beside the entries."""
        row = self._database.fetch_one(select(audit_head))
        return AuditHead(0, GENESIS) if row is None else AuditHead(row.number, row.hash)

    def chain(self) -> Iterator[AuditEntry]:
        """Yield every entry in order of number."""
        after = -(2**62)
        while True:
            query = select(audit_entry).where(audit_entry.c.number > after).order_by(audit_entry.c.number).limit(_WALK)
            rows = self._database.fetch(query)
            yield from map(_entry_of, rows)
            if len(rows) < _WALK:
                return
            after = rows[-1].number


def _conditions(wanted: AuditFilter) -> list[ColumnElement[bool]]:
    column = audit_entry.c
    found = [column.at_us >= wanted.start_us, column.at_us < wanted.stop_us]
    found += [
        column[name] == getattr(wanted, name)
        for name in ("who", "role", "action", "outcome")
        if getattr(wanted, name) is not None
    ]
    if wanted.target_prefix is not None:
        found.append(column.target.startswith(wanted.target_prefix, autoescape=True))
    return found


def _entry_of(row: Row[Any]) -> AuditEntry:
    audit_event = AuditEvent(**{name: getattr(row, name) for name in _EVENT_FIELDS})
    return AuditEntry(row.number, audit_event, row.previous_hash, row.hash)


class SqlKeys(Repository):
    """Access keys in a relational database."""

    def add(self, stored: StoredKey) -> AccessKey:
        """Store a new key."""

        def write(connection: Connection) -> AccessKey:
            # of two that are made at once the second one waits here
            lock_audit_head(connection)
            wanted = name_key(stored.key.name)
            for row in connection.execute(select(access_key)):
                key = _stored_of(row).key
                if name_key(key.name) == wanted and key.is_valid(stored.key.created_at_us):
                    detail = f"The valid key {key.id} has the name {key.name!r}."
                    raise ConflictError("key.exists", detail)
            return _insert(connection, stored)

        return self._database.write(write)

    def all(self) -> tuple[StoredKey, ...]:
        """Return every key, revoked ones too, in order of creation."""
        rows = self._database.fetch(select(access_key).order_by(access_key.c.created_at_us, access_key.c.key_id))
        return tuple(_stored_of(row) for row in rows)

    def revoke(self, key_id: str, at_us: int) -> AccessKey:
        """Make a key worthless from now on; NotFoundError ``key.unknown`` also when it was revoked before."""

        def write(connection: Connection) -> AccessKey:
            is_it = (access_key.c.key_id == key_id, access_key.c.revoked_at_us.is_(None))
            row = connection.execute(select(access_key).where(*is_it).with_for_update()).first()
            if row is None:
                raise NotFoundError("key.unknown", f"No key {key_id!r} is in force.")
            connection.execute(update(access_key).where(*is_it).values(revoked_at_us=at_us))
            connection.execute(delete(browser_session).where(browser_session.c.key_id == key_id))
            return replace(_stored_of(row).key, revoked_at_us=at_us)

        return self._database.write(write)

    def note_used(self, used_us: Mapping[str, int]) -> None:
        """Store when keys were last used."""

        def write(connection: Connection) -> None:
            for key_id, at_us in used_us.items():
                connection.execute(update(access_key).where(access_key.c.key_id == key_id).values(last_used_us=at_us))

        self._database.submit(write).result()

    def add_first_administrator(self, stored: StoredKey, audit_event: AuditEvent) -> bool:
        """Store an administrator's key with its audit entry unless one is in force; return whether it was stored."""

        def write(connection: Connection) -> bool:
            # two first starts at once: the second one waits here and then finds the key of the first
            lock_audit_head(connection)
            admins = connection.execute(select(access_key).where(access_key.c.role == Role.ADMIN.value)).all()
            if any(_stored_of(row).key.is_valid(audit_event.at_us) for row in admins):
                return False
            _insert(connection, stored)
            append_entry(connection, audit_event)
            return True

        return self._database.submit(write).result()

    def service_id(self) -> str:
        """Return the id of the service that the archive belongs to."""
        with self._database.read() as connection:
            return str(connection.scalar(select(archive_layout.c.service_id)))

    def open_session(self, session: BrowserSession, at_us: int) -> None:
        """Store a session; those that have ended by then are forgotten."""

        def write(connection: Connection) -> None:
            of_key = select(browser_session.c.digest).where(browser_session.c.key_id == session.key_id)
            surplus = of_key.order_by(browser_session.c.ends_at_us.desc()).offset(SESSIONS_PER_KEY - 1)
            digests = connection.scalars(surplus).all()
            is_over = or_(browser_session.c.ends_at_us <= at_us, browser_session.c.digest.in_(digests))
            connection.execute(delete(browser_session).where(is_over))
            connection.execute(browser_session.insert().values(asdict(session)))

        self._database.write(write)

    def end_session(self, digest: bytes) -> None:
        """Forget a session."""
        self._database.write(
            lambda each: each.execute(delete(browser_session).where(browser_session.c.digest == digest))
        )

    def sessions(self) -> dict[bytes, BrowserSession]:
        """Return the sessions by their digests, some that have ended among them."""
        rows = self._database.fetch(select(browser_session))
        return {bytes(row.digest): BrowserSession(bytes(row.digest), row.key_id, row.ends_at_us) for row in rows}


def _insert(connection: Connection, stored: StoredKey) -> AccessKey:
    values = asdict(stored.key)
    values |= {name: ",".join(values[name]) for name in _LISTS}
    connection.execute(access_key.insert().values(key_id=values.pop("id"), digest=stored.digest, **values))
    return stored.key


def _stored_of(row: Row[Any]) -> StoredKey:
    columns = dict(row._mapping) | {"role": Role(row.role)}  # noqa: SLF001 - the public name of it
    digest = columns.pop("digest")
    columns |= {name: tuple(filter(None, columns[name].split(","))) for name in _LISTS}
    return StoredKey(AccessKey(id=columns.pop("key_id"), **columns), bytes(digest))
