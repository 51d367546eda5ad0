"""Storing batches of measurements, the hot path: one lock, one look-up, one executemany and two updates a batch.

Of a batch ``received = accepted + duplicates + refused``. Whether a row is known is asked of the table only where its
epoch is not above the newest stored one of its source.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from sqlalchemy import Connection, Row, bindparam, select, update

from db.compiled import CompiledStatement
from db.mapping import flags_as_bytes, powers_as_bytes
from db.tables import head, measurement, source
from service.records.measurement import BatchReceipt, MeasurementBatch, Refusal

#: epochs in one query; SQLite before 3.32 binds 999 values at most
LOOKUP_CHUNK = 500

Content = tuple[bytes, bytes | None]

_ROW = (
    "spacecraft_key",
    "epoch_us",
    "source_key",
    "number",
    "plan_id",
    "seq",
    "received_at_us",
    "is_late",
    "feeds",
    "powers",
    "flags",
)
_INSERT_ROWS = CompiledStatement(measurement.insert(), *_ROW)
_LOCK_HEAD = CompiledStatement(
    select(head).where(head.c.spacecraft_key == bindparam("of_spacecraft")).with_for_update(), "of_spacecraft"
)
_READ_SOURCE = CompiledStatement(
    select(source).where(source.c.spacecraft_key == bindparam("of_spacecraft"), source.c.name == bindparam("of_name")),
    "of_spacecraft",
    "of_name",
)
_MOVE_HEAD = CompiledStatement(
    update(head)
    .where(head.c.spacecraft_key == bindparam("of_spacecraft"))
    .values(newest_number=bindparam("to_number"), newest_epoch_us=bindparam("to_epoch_us")),
    "of_spacecraft",
    "to_number",
    "to_epoch_us",
)
_MOVE_SOURCE = CompiledStatement(
    update(source)
    .where(source.c.spacecraft_key == bindparam("of_spacecraft"), source.c.source_key == bindparam("of_source"))
    .values(row_count=bindparam("to_count"), newest_epoch_us=bindparam("to_epoch_us")),
    "of_spacecraft",
    "of_source",
    "to_count",
    "to_epoch_us",
)


@dataclass(frozen=True, slots=True)
class PreparedBatch:
    """A batch as the writer needs it; made outside the writer's thread."""

    spacecraft_key: int
    batch: MeasurementBatch
    epochs_us: list[int]
    contents: list[Content]
    is_stale: list[bool]
    is_ascending: bool


@dataclass(frozen=True, slots=True)
class _Sorted:
    """What becomes of each row of a batch."""

    #: places of the rows to store
    accepted: Sequence[int]
    duplicates: int
    refused: tuple[Refusal, ...]


def prepare(spacecraft_key: int, batch: MeasurementBatch) -> PreparedBatch:
    """Return the batch with its rows as bytes."""
    epochs_us: list[int] = batch.epochs_us.tolist()
    contents = list(zip(powers_as_bytes(batch.power_dbm), flags_as_bytes(batch.flags), strict=True))
    is_ascending = all(earlier < later for earlier, later in pairwise(epochs_us))
    return PreparedBatch(spacecraft_key, batch, epochs_us, contents, batch.is_stale.tolist(), is_ascending)


def store_batch(connection: Connection, prepared: PreparedBatch) -> BatchReceipt:
    """Store and journal the new rows of a batch; runs in the writer's transaction."""
    if not prepared.epochs_us:
        return BatchReceipt(0, 0, 0, ())
    state = _LOCK_HEAD.run(connection, prepared.spacecraft_key).one()
    origin = _source(connection, prepared.spacecraft_key, prepared.batch.source)
    outcome = _sort(connection, prepared, origin)
    if not outcome.accepted:
        return BatchReceipt(0, outcome.duplicates, 0, outcome.refused)
    is_late = _lateness(prepared, outcome.accepted, state.consumed_epoch_us)
    _INSERT_ROWS.run_many(connection, _rows(prepared, outcome.accepted, is_late, state, origin))
    _advance(connection, prepared, outcome.accepted, state, origin)
    return BatchReceipt(len(is_late), outcome.duplicates, sum(is_late), outcome.refused)


def _source(connection: Connection, key: int, name: str) -> Row[Any]:
    """Return the source of a name; the first of a spacecraft becomes the prime one."""
    found = _READ_SOURCE.run(connection, key, name).first()
    if found is not None:
        return found
    known = connection.execute(select(source.c.source_key).where(source.c.spacecraft_key == key)).all()
    values = {"spacecraft_key": key, "source_key": len(known) + 1, "name": name, "is_prime": not known, "row_count": 0}
    connection.execute(source.insert().values(values))
    return _READ_SOURCE.run(connection, key, name).one()


def _sort(connection: Connection, prepared: PreparedBatch, origin: Row[Any]) -> _Sorted:
    """Tell new rows, duplicates and conflicts apart."""
    newest_us = origin.newest_epoch_us
    if prepared.is_ascending and (newest_us is None or prepared.epochs_us[0] > newest_us):
        return _Sorted(range(len(prepared.epochs_us)), 0, ())
    known = _stored(connection, origin, [] if newest_us is None else [e for e in prepared.epochs_us if e <= newest_us])
    accepted: list[int] = []
    refused: list[Refusal] = []
    duplicates = 0
    for place, (epoch_us, content) in enumerate(zip(prepared.epochs_us, prepared.contents, strict=True)):
        earlier = known.setdefault(epoch_us, content)
        if earlier is content:
            accepted.append(place)
        elif earlier == content:
            duplicates += 1
        else:
            refused.append(_conflict(prepared.batch, place))
    return _Sorted(accepted, duplicates, tuple(refused))


def _stored(connection: Connection, origin: Row[Any], epochs_us: list[int]) -> dict[int, Content]:
    """Return the content of those epochs of a source that are stored."""
    known: dict[int, Content] = {}
    for start in range(0, len(epochs_us), LOOKUP_CHUNK):
        query = select(measurement.c.epoch_us, measurement.c.powers, measurement.c.flags).where(
            measurement.c.spacecraft_key == origin.spacecraft_key,
            measurement.c.source_key == origin.source_key,
            measurement.c.epoch_us.in_(epochs_us[start : start + LOOKUP_CHUNK]),
        )
        known.update((epoch_us, (powers, flags)) for epoch_us, powers, flags in connection.execute(query))
    return known


def _conflict(batch: MeasurementBatch, place: int) -> Refusal:
    detail = (
        f"Source {batch.source!r} has sent other powers or flags for this epoch before; the first ones stay. "
        "Send a corrected row under its own epoch or from another source."
    )
    return Refusal(int(batch.index[place]), _seq(batch, place), "measurement.conflict", detail)


def _seq(batch: MeasurementBatch, place: int) -> int | None:
    return None if batch.first_seq is None else batch.first_seq + int(batch.index[place])


def _lateness(prepared: PreparedBatch, accepted: Sequence[int], consumed_us: int | None) -> list[bool]:
    """Return which of the accepted rows are late: stale, or below the newest epoch that the chain has consumed."""
    if consumed_us is None:
        return [prepared.is_stale[place] for place in accepted]
    return [prepared.is_stale[place] or prepared.epochs_us[place] < consumed_us for place in accepted]


def _rows(
    prepared: PreparedBatch, accepted: Sequence[int], is_late: Sequence[bool], state: Row[Any], origin: Row[Any]
) -> list[tuple[Any, ...]]:
    """Return the values of ``_ROW`` to insert, numbered on from the head."""
    batch, key, feeds = prepared.batch, prepared.spacecraft_key, bool(origin.is_prime)
    return [
        (
            key,
            prepared.epochs_us[place],
            origin.source_key,
            number,
            batch.plan_id,
            _seq(batch, place),
            batch.received_at_us,
            late,
            feeds,
            *prepared.contents[place],
        )
        for number, (place, late) in enumerate(zip(accepted, is_late, strict=True), start=state.newest_number + 1)
    ]


def _advance(
    connection: Connection, prepared: PreparedBatch, accepted: Sequence[int], state: Row[Any], origin: Row[Any]
) -> None:
    """Move the head of the spacecraft and the figures of the source past the stored rows."""
    key, stored = prepared.spacecraft_key, len(accepted)
    newest_us = max(prepared.epochs_us[place] for place in accepted)
    _MOVE_HEAD.run(connection, key, state.newest_number + stored, _later(newest_us, state.newest_epoch_us))
    _MOVE_SOURCE.run(
        connection, key, origin.source_key, origin.row_count + stored, _later(newest_us, origin.newest_epoch_us)
    )


def _later(epoch_us: int, other_us: int | None) -> int:
    return epoch_us if other_us is None else max(epoch_us, other_us)
