"""Inserting rows of measurements, a run of rows at a time.

A run shares everything but epoch, powers and flags, and counts up number and sequence number. SQLite takes a run in one
step of one statement, because the driver gives up and wants back the interpreter's lock at every step: a hundred steps
took 0.5 ms alone and 60 ms beside one busy thread, one step takes 0.2 ms alone and 2 to 8 ms beside it.
"""

import json
from typing import Any, NamedTuple

from sqlalchemy import Connection

from db.compiled import run_bare
from db.tables import measurement

_AT_ONCE = """
INSERT INTO measurement
  (spacecraft_key, source_key, plan_id, received_at_us, feeds, is_late, number, seq, epoch_us, powers, flags)
SELECT ?1, ?2, ?3, ?4, ?5, ?6, ?7 + row.key, ?8 + row.key, row.value,
  substr(?9, 1 + row.key * ?10, ?10), substr(?11, 1 + row.key * ?10, ?10)
FROM json_each(?12) AS row
"""


class Run(NamedTuple):
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
    #: float32 little endian of all rows
    powers: bytes
    #: int32 little endian of all rows
    flags: bytes | None


def insert_run(connection: Connection, run: Run) -> None:
    """Insert the rows of a run."""
    if connection.dialect.name == "sqlite":
        width = len(run.powers) // len(run.epochs_us)
        run_bare(connection, _AT_ONCE, (*run[:8], run.powers, width, run.flags, json.dumps(run.epochs_us)))
    else:
        connection.execute(measurement.insert(), _values(run))


def _values(run: Run) -> list[dict[str, Any]]:
    """Return the columns of each row."""
    width = len(run.powers) // len(run.epochs_us)
    return [
        {
            "spacecraft_key": run.spacecraft_key,
            "source_key": run.source_key,
            "plan_id": run.plan_id,
            "received_at_us": run.received_at_us,
            "feeds": run.feeds,
            "is_late": run.is_late,
            "number": run.first_number + place,
            "seq": None if run.first_seq is None else run.first_seq + place,
            "epoch_us": epoch_us,
            "powers": run.powers[place * width : (place + 1) * width],
            "flags": None if run.flags is None else run.flags[place * width : (place + 1) * width],
        }
        for place, epoch_us in enumerate(run.epochs_us)
    ]
