"""Audit entries on their way in: each one in a transaction, under the lock of the head."""

from collections.abc import Callable
from dataclasses import asdict
from typing import TypeVar

from sqlalchemy import Connection, select, update

from db.connection.writer import insert_new
from db.schema.tables import audit_entry, audit_head
from service.records.operations.access import GENESIS, AuditEntry, AuditEvent, AuditHead, naming_result, next_entry

Result = TypeVar("Result")


def append_entry(connection: Connection, event: AuditEvent) -> AuditEntry:
    """Add a deed to the chain in the transaction of a connection."""
    entry = next_entry(lock_audit_head(connection), event)
    values = {"number": entry.number, **asdict(event), "previous_hash": entry.previous_hash, "hash": entry.hash}
    connection.execute(audit_entry.insert().values(values))
    connection.execute(update(audit_head).values(number=entry.number, hash=entry.hash))
    return entry


def accompanied(
    work: Callable[[Connection], Result], event: AuditEvent
) -> Callable[[Connection], tuple[Result, AuditEntry]]:
    """Return a write that leaves its deed in the audit log: both are committed, or neither."""

    def write(connection: Connection) -> tuple[Result, AuditEntry]:
        result = work(connection)
        return result, append_entry(connection, naming_result(event, result))

    return write


def lock_audit_head(connection: Connection) -> AuditHead:
    """Return the head and keep every other writer of entries away until the transaction ends."""
    query = select(audit_head).with_for_update()
    row = connection.execute(query).first()
    if row is None:
        insert_new(connection, audit_head, [{"head_key": 1, "number": 0, "hash": GENESIS}])
        row = connection.execute(query).one()
    return AuditHead(row.number, row.hash)
