"""Checkpoints of live chains: the latest few and one of each day are kept."""

from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from typing import Any

from sqlalchemy import Connection, delete, select, true

from db.database import Database
from db.measurements.checksum_check import agrees
from db.schema.row_checksum import checksum_of
from db.schema.tables import checkpoint as checkpoint_table
from service.records.storage.checkpoint import Checkpoint

#: latest ones that are kept beside those of days: one an hour, so that one is older than smoothed rows need, 125 min
LATEST = 4
_DAY_US = 86_400_000_000


def store_checkpoint(connection: Connection, key: int, made: Checkpoint) -> None:
    """Store a checkpoint in the transaction of the results before it, and drop those that it makes needless."""
    table = checkpoint_table
    is_own = table.c.spacecraft_key == key
    rows = connection.execute(select(table.c.number, table.c.epoch_us).where(is_own).order_by(table.c.number)).all()
    # a chain that was brought back may pass the same entry again
    needless = [row.number for row in rows if row.number >= made.number]
    older = [(row.number, row.epoch_us) for row in rows if row.number < made.number]
    # an older one counts only as the last of its day
    needless += [
        number
        for (number, epoch_us), (_, next_us) in pairwise(older[: len(older) - LATEST + 2])
        if epoch_us // _DAY_US == next_us // _DAY_US
    ]
    if needless:
        connection.execute(delete(table).where(is_own, table.c.number.in_(needless)))
    values = {
        "spacecraft_key": key,
        "number": made.number,
        "epoch_us": made.epoch_us,
        "fingerprint": made.fingerprint,
        "content": made.content,
    }
    connection.execute(table.insert().values(values))


def checkpoints(
    database: Database, key: int, fingerprint: str, until_number: int, before_us: int | None
) -> Iterator[Checkpoint]:
    """Yield the checkpoints of a fingerprint up to a journal number, newest first; damaged ones are left out."""
    table, number = checkpoint_table, until_number + 1
    is_before = true() if before_us is None else table.c.epoch_us < before_us
    while True:
        is_fit = (table.c.spacecraft_key == key, table.c.fingerprint == fingerprint, table.c.number < number, is_before)
        row = database.fetch_one(select(table).where(*is_fit).order_by(table.c.number.desc()).limit(1))
        if row is None:
            return
        number = row.number
        values: Any = row._mapping  # noqa: SLF001 - SQLAlchemy's public name
        if agrees(row.checksum, partial(checksum_of, table, values)):
            yield Checkpoint(row.number, row.epoch_us, row.fingerprint, row.content)
