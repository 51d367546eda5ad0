"""Inserting rows of measurements, a run of rows at a time.

A run shares everything but epoch, powers and flags, and counts up number and sequence number. SQLite takes a run in one
step of one statement, because the driver gives up and wants back the interpreter's lock at every step: a hundred steps
took 0.5 ms alone and 60 ms beside one busy thread, one step takes 0.2 ms alone and 2 to 8 ms beside it.
"""

import json
from collections.abc import Sequence
from itertools import count, repeat
from typing import NamedTuple

from sqlalchemy import Connection

from db.connection.prepared_statements import run_bare
from db.encoding.power_codec import StoredRows
from db.schema.row_checksum import measurement_checksums

_AT_ONCE = """
INSERT INTO measurement
  (spacecraft_key, source_key, plan_id, delay_us, feeds, is_late, number, seq, epoch_us, powers, flags,
   checksum)
SELECT ?1, ?2, ?3, ?4 - row.value, ?5, ?6, ?7 + row.key, ?8 + row.key, row.value,
  substr(?9, 1 + row.key * ?10, ?10), substr(?11, 1 + row.key * ?12, ?12), substr(?13, 1 + row.key * 4, 4)
FROM json_each(?14) AS row
"""
_AT_ONCE_ON_A_SERVER = """
INSERT INTO measurement
  (spacecraft_key, source_key, plan_id, delay_us, feeds, is_late, number, seq, epoch_us, powers, flags,
   checksum)
SELECT %s, %s, %s, %s::bigint - row.epoch_us, %s, %s, %s::bigint + row.place, %s::bigint + row.place, row.epoch_us,
  substr(%s::bytea, (1 + row.place * %s)::int, %s), substr(%s::bytea, (1 + row.place * %s)::int, %s),
  substr(%s::bytea, (1 + row.place * 4)::int, 4)
FROM (SELECT epoch_us, place - 1 AS place FROM unnest(%s::bigint[]) WITH ORDINALITY AS given (epoch_us, place)) AS row
"""


class RowRun(NamedTuple):
    """Rows to insert, in order of journal number."""

    spacecraft_key: int
    source_key: int
    plan_id: int
    received_at_us: int
    feeds: bool
    is_late: bool
    #: journal number of the first row
    first_number: int
    #: sequence number of the first row
    first_seq: int | None
    epochs_us: list[int]
    #: of all rows, as ``db.encoding.power_codec`` lays them out
    powers: StoredRows
    flags: StoredRows | None
    #: what each row states beside, None for those that state nothing; None when no row does
    figures: Sequence[bytes | None] | None

    def checksums(self) -> bytes:
        """Checksums of all rows, one behind another."""
        shared = (self.spacecraft_key, self.source_key, self.plan_id, self.is_late, self.feeds)
        columns = (
            self.epochs_us,
            count(self.first_number),
            repeat(None) if self.first_seq is None else count(self.first_seq),
            [self.received_at_us - epoch_us for epoch_us in self.epochs_us],
            self.powers.each(len(self.epochs_us)),
            repeat(None) if self.flags is None else self.flags.each(len(self.epochs_us)),
            repeat(None) if self.figures is None else self.figures,
        )
        return measurement_checksums(shared, zip(*columns, strict=False))


def insert_run(connection: Connection, run: RowRun) -> None:
    """Insert the rows of a run."""
    width, powers = run.powers
    flag_width, flags = (0, None) if run.flags is None else run.flags
    if connection.dialect.name == "sqlite":
        # no part of no bytes is NULL to SQLite, no part of any byte is an empty blob
        of_any = b"\0" if flags == b"" else flags
        parts = (powers, width, of_any, flag_width, run.checksums())
        values = (*run[:8], *parts, json.dumps(run.epochs_us))
        run_bare(connection, _AT_ONCE, values)
    else:
        blobs = (powers, width, width, flags, flag_width, flag_width, run.checksums())
        connection.exec_driver_sql(_AT_ONCE_ON_A_SERVER, (*run[:8], *blobs, run.epochs_us))
