"""Audit log: implements ``service.ports.Audit``."""

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from sqlalchemy import ColumnElement, Row, select

from db.audit_chain import append_entry
from db.database import Repository
from db.schema.access_tables import audit_entry, audit_head
from service.records.operations.audit import GENESIS, AuditEntry, AuditEvent, AuditFilter, AuditHead

#: entries held at once while a chain is walked
_WALK = 2000
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
    """Return the conditions of a filter."""
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
