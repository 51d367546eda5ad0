"""Documents that estimates rest on: spacecraft, carrier plans, ephemerides, calibrations, alignments.

Each has a digest from its creation on. The journal entry that puts a document into force names it by that digest, so a
document that was changed in the database differs from its own digest, or from the one in the journal. It is read all
the same, so that a replay stays equal; what differs is for the interlock, the doctor and backups.
"""

import json
from collections.abc import Iterator, Mapping
from hashlib import sha256
from typing import Any

from sqlalchemy import Connection, Row, Table, select

from db.schema.columns import agrees
from db.schema.tables import alignment, calibration, carrier_plan, ephemeris, journal, spacecraft
from service.records.calibration import CalibrationState

#: columns of each table that its digest covers, the number of a document first
COVERED: dict[Table, tuple[str, ...]] = {
    spacecraft: ("id", "document"),
    carrier_plan: ("plan_id", "document"),
    ephemeris: ("ephemeris_id", "document"),
    calibration: ("calibration_id", "method", "plan_id", "ephemeris_id", "request", "result"),
    alignment: ("alignment_id", "epoch_us", "document"),
}
#: table of the document that an entry of a kind puts into force
_NAMED_BY: dict[str, Table] = {
    "spacecraft": spacecraft,
    "plan": carrier_plan,
    "ephemeris": ephemeris,
    "activation": calibration,
    "alignment": alignment,
}


def digest_of(table: Table, values: Mapping[str, Any]) -> str:
    """Return the digest of a document, hexadecimal: SHA-256 of its covered columns as JSON."""
    return sha256(json.dumps([values.get(name) for name in COVERED[table]]).encode()).hexdigest()


def with_digest(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a new document with its digest."""
    return {**values, "digest": digest_of(table, values)}


def differs(table: Table, row: Row[Any]) -> bool:
    """Return whether a stored document differs from its own digest."""
    return bool(row.digest != digest_of(table, row._asdict()))


def damaged_documents(connection: Connection, key: int | None = None) -> Iterator[str]:
    """Yield the names of documents that differ from their digest or from the one in the journal.

    Of one spacecraft those in force; without a key all documents of all spacecraft.
    """
    owners = select(spacecraft).order_by(spacecraft.c.spacecraft_key)
    for owner in connection.execute(owners if key is None else owners.where(spacecraft.c.spacecraft_key == key)).all():
        of = f" of {owner.id}" if key is None else ""
        yield from (f"{name}{of}" for name in _damaged(connection, owner, in_force=key is not None))


def _damaged(connection: Connection, owner: Row[Any], *, in_force: bool) -> Iterator[str]:
    """Yield the names of the damaged documents of a spacecraft."""
    named: dict[Table, dict[Any, str]] = {table: {} for table in COVERED}
    is_entry = (journal.c.spacecraft_key == owner.spacecraft_key, journal.c.kind.in_(_NAMED_BY))
    for entry in connection.execute(select(journal).where(*is_entry).order_by(journal.c.number)):
        if not agrees(journal, entry):
            yield f"journal entry {entry.number}"
            continue
        table, content = _NAMED_BY[entry.kind], json.loads(entry.document)
        number = owner.id if table is spacecraft else content[COVERED[table][0]]
        # the last to come into force stands last
        named[table].pop(number, None)
        named[table][number] = content["digest"]
    for table, digests in named.items():
        rows = select(table).where(table.c.spacecraft_key == owner.spacecraft_key)
        if in_force and table is calibration:
            rows = rows.where(table.c.state == CalibrationState.ACTIVE.value)
        elif in_force:
            rows = rows.where(table.c[COVERED[table][0]].in_(list(digests)[-1:]))
        for row in connection.execute(rows.order_by(table.c[COVERED[table][0]])):
            number = row._mapping[COVERED[table][0]]  # noqa: SLF001
            if differs(table, row) or digests.get(number, row.digest) != row.digest:
                yield "catalogue entry" if table is spacecraft else f"{table.name.replace('_', ' ')} {number}"
