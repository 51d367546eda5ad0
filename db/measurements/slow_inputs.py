"""Storing slow inputs: references, corrections, telemetry, weather, polarisation, reported commands and operations."""

from collections.abc import Sequence
from dataclasses import replace

from sqlalchemy import Connection, select, update

from db.database import EpochSpan, add_entries, lock_head, next_id
from db.encoding.record_codec import encode, kind_of
from db.schema.tables import journal, operation
from service.errors import InvalidInputError, NotFoundError
from service.records.inputs import (
    AttitudeReference,
    Correction,
    Operation,
    PolarizationRecord,
    TelemetryRecord,
    WeatherReport,
)
from service.records.journal import SlowInput
from service.records.levels.attitude import AppliedCommand, ReleasedCommand, ReportedCommand
from service.records.levels.measurement import InputReceipt, RowRefusal
from service.records.operations.release import InterlockHold

LOOKUP_CHUNK = 500
#: what carries its own key; everything else is journaled by the call that makes it
KEYED = (
    AttitudeReference
    | Correction
    | TelemetryRecord
    | WeatherReport
    | PolarizationRecord
    | AppliedCommand
    | ReleasedCommand
    | ReportedCommand
    | InterlockHold
)


def span_of(record: KEYED) -> EpochSpan:
    """Return the interval that a slow input holds for."""
    if isinstance(record, Correction):
        return EpochSpan(record.start_us, record.stop_us)
    if isinstance(record, AppliedCommand):
        return EpochSpan(record.command.epoch_us, record.command.valid_until_us)
    if isinstance(record, ReleasedCommand):
        return EpochSpan(record.released_us, record.stop_us)
    if isinstance(record, ReportedCommand):
        return EpochSpan(record.reported_us, record.reported_us)
    if isinstance(record, InterlockHold):
        return EpochSpan(record.at_us, None)
    return EpochSpan(record.epoch_us, record.epoch_us)


def store_inputs(connection: Connection, key: int, records: Sequence[SlowInput]) -> InputReceipt:
    """Store and journal those records whose key is new."""
    lock_head(connection, key)
    known = _stored(connection, key, records)
    accepted: list[tuple[SlowInput, EpochSpan | None]] = []
    refused: list[RowRefusal] = []
    for position, record in enumerate(map(_keyed, records)):
        name, document = (kind_of(record), record.key), encode(record)
        stored = known.get(name)
        if stored is None:
            known[name] = document
            accepted.append((record, span_of(record)))
        elif stored != document:
            detail = f"Another {name[0]} with the key {name[1]!r} is stored already; the first one stays."
            refused.append(RowRefusal(position, None, "input.conflict", detail))
    add_entries(connection, key, accepted)
    return InputReceipt(len(accepted), len(records) - len(accepted) - len(refused), tuple(refused))


def store_operation(connection: Connection, key: int, record: Operation) -> Operation:
    """Store and journal a new operation."""
    lock_head(connection, key)
    stored = replace(record, id=next_id(connection, operation, "operation_id", key), revision=1)
    number = _journal_operation(connection, key, stored)
    values = {"spacecraft_key": key, "operation_id": stored.id, "revision": 1, "number": number}
    connection.execute(operation.insert().values(values))
    return stored


def revise_operation(connection: Connection, key: int, record: Operation) -> Operation:
    """Store and journal a changed operation under the next revision."""
    lock_head(connection, key)
    is_it = (operation.c.spacecraft_key == key, operation.c.operation_id == record.id)
    revision = connection.scalar(select(operation.c.revision).where(*is_it))
    if revision is None:
        raise NotFoundError("operation.unknown", f"There is no operation {record.id} of this spacecraft.")
    stored = replace(record, revision=revision + 1)
    number = _journal_operation(connection, key, stored)
    connection.execute(update(operation).where(*is_it).values(revision=stored.revision, number=number))
    return stored


def _journal_operation(connection: Connection, key: int, record: Operation) -> int:
    return add_entries(connection, key, [(record, EpochSpan(record.start_us, record.stop_us))])


def _keyed(record: SlowInput) -> KEYED:
    if isinstance(record, KEYED):
        return record
    message = f"A record of kind {kind_of(record)!r} enters the journal with the call that makes it."
    raise InvalidInputError("input.kind", message)


def _stored(connection: Connection, key: int, records: Sequence[SlowInput]) -> dict[tuple[str, str], str]:
    """Return the documents of those records whose kind and key are stored."""
    wanted: dict[str, list[str]] = {}
    for record in records:
        wanted.setdefault(kind_of(record), []).append(record.key)
    known: dict[tuple[str, str], str] = {}
    for kind, keys in wanted.items():
        for start in range(0, len(keys), LOOKUP_CHUNK):
            query = select(journal.c.key, journal.c.document).where(
                journal.c.spacecraft_key == key,
                journal.c.kind == kind,
                journal.c.key.in_(keys[start : start + LOOKUP_CHUNK]),
            )
            known.update(((kind, name), document) for name, document in connection.execute(query))
    return known
