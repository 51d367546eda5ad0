"""Heads of journals: number and digest of the newest entry, which the service logs and the doctor compares.

A database that lost its newest transactions, as a file whose write-ahead log was deleted, is sound in itself. What it
lacks is told by a head that stands elsewhere. The digest is of what an entry says, so it stays when a day is sealed.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from hashlib import sha256
from typing import Any

import numpy as np
from sqlalchemy import Connection, select

from db.encoding.segments import SegmentCache
from db.measurements.measurement_pages import MeasurementPages
from db.schema.tables import head, journal, source, spacecraft
from service.records.inputs import JournalHead
from service.records.levels.measurement import DETAIL_NAMES, HeadState, Measurement, SourceState
from service.records.storage import Diagnosis

#: where the journal and its consumer stand, in the order of `HeadState`
HEAD_COLUMNS = (
    head.c.newest_number,
    head.c.consumed_number,
    head.c.newest_epoch_us,
    head.c.consumed_epoch_us,
    head.c.result_sequence,
)
#: in the order in which `source_state` takes them
SOURCE_COLUMNS = tuple(
    source.c[name] for name in ("name", "is_prime", "newest_epoch_us", "row_count", "rows_missing", "station", "key_id")
)
_DIGITS = 16
_LOST = "Stop the service. Restore a backup, or put the missing files back; then let the front ends send again."
_OTHER = "Right after a restore, wrong otherwise: compare the archive with a backup of before."


def source_state(row: Sequence[Any]) -> SourceState:
    """Return the state of a source from its columns."""
    name, is_prime, *figures = row
    return SourceState(name, "prime" if is_prime else "backup", *figures)


def head_states(connection: Connection) -> dict[str, HeadState]:
    """Return where the journal of each spacecraft and its consumer stand."""
    query = select(spacecraft.c.id, *HEAD_COLUMNS).join_from(head, spacecraft)
    return {row[0]: HeadState(*row[1:]) for row in connection.execute(query)}


def journal_heads(connection: Connection, cache: SegmentCache) -> list[JournalHead]:
    """Return the head of every journal that has entries."""
    query = select(spacecraft.c.id, spacecraft.c.spacecraft_key, head.c.newest_number)
    rows = connection.execute(query.join_from(spacecraft, head).where(head.c.newest_number > 0)).all()
    digests = [_digest(connection, cache, row.spacecraft_key, row.newest_number) for row in rows]
    held = zip(rows, digests, strict=True)
    return [JournalHead(row.id, row.newest_number, digest) for row, digest in held if digest is not None]


def compared_heads(connection: Connection, announced: Iterable[JournalHead]) -> Iterator[Diagnosis]:
    """Compare journals with heads that were logged; an entry that retention took away is not compared."""
    by_spacecraft: dict[str, list[JournalHead]] = {}
    for each in sorted(set(announced)):
        by_spacecraft.setdefault(each.spacecraft_id, []).append(each)
    query = select(spacecraft.c.spacecraft_key, head.c.newest_number).join_from(spacecraft, head)
    for name, heads in by_spacecraft.items():
        row = connection.execute(query.where(spacecraft.c.id == name)).first()
        key, newest = (0, 0) if row is None else row
        last = heads[-1].number
        if last > newest:
            detail = f"{name}: {last - newest} entries are lost: the log names {last}, the journal ends at {newest}"
            yield Diagnosis("log", "fault", detail, _LOST)
        cache = SegmentCache()
        held = [(each, _digest(connection, cache, key, each.number)) for each in heads if each.number <= newest]
        others = [each.number for each, digest in held if digest not in {None, each.digest}]
        if others:
            detail = (
                f"{name}: {len(others)} of {len(heads)} entries are not those that the log names, {others[0]} first"
            )
            yield Diagnosis("log", "fault", detail, _OTHER)
        elif last <= newest:
            yield Diagnosis("log", "ok", f"{name}: {len(heads)} entries are those that the log names, up to {last}")


def _digest(connection: Connection, cache: SegmentCache, key: int, number: int) -> str | None:
    """Return the digest of an entry, None when it is not held."""
    columns = (journal.c.kind, journal.c.key, journal.c.start_us, journal.c.stop_us, journal.c.document)
    is_it = (journal.c.spacecraft_key == key, journal.c.number == number)
    entry = connection.execute(select(*columns).where(*is_it)).first()
    if entry is not None:
        return sha256(json.dumps(list(entry)).encode()).hexdigest()[:_DIGITS]
    rows = MeasurementPages(connection, cache, key).of_numbers(number - 1, number, is_compared=False)
    return sha256(_content(rows[0])).hexdigest()[:_DIGITS] if rows else None


def _content(row: Measurement) -> bytes:
    """Return the content of a row as bytes, the same for the table of rows and for a sealed day."""
    plain = (row.epoch_us, row.received_at_us, row.number, row.source, row.plan_id, row.is_late, row.feeds_estimator)
    parts = [json.dumps([*plain, row.seq]).encode(), row.power_dbm.astype("<f4").tobytes()]
    parts.append(b"" if row.flags is None else row.flags.astype("<i4").tobytes())
    details = [] if row.details is None else [getattr(row.details, name) for name in DETAIL_NAMES]
    parts.append(np.array(details, dtype="<f4").tobytes())
    return b"".join(len(part).to_bytes(4, "little") + part for part in parts)
