"""Details of measurements beside powers: one blob for each row with any detail, in a table of its own.

A blob is one byte that says which figures of ``DETAIL_NAMES`` follow, and these as float32 little endian, carrier by
carrier. All rows of a batch carry the same figures, so that SQLite can take them in one step
(see ``db.measurements.row_insert``).
"""

import json
from typing import NamedTuple

import numpy as np
from sqlalchemy import Connection

from db.connection.prepared_statements import run_bare
from service.records.levels.attitude import BoolArray, FloatArray
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails

_AT_ONCE = """
INSERT INTO measurement_detail (spacecraft_key, source_key, epoch_us, figures)
SELECT ?1, ?2, row.value, substr(?3, 1 + row.key * ?4, ?4) FROM json_each(?5) AS row
"""
_AT_ONCE_ON_A_SERVER = """
INSERT INTO measurement_detail (spacecraft_key, source_key, epoch_us, figures)
SELECT %s, %s, row.epoch_us, substr(%s::bytea, (1 + (row.place - 1) * %s)::int, %s)
FROM unnest(%s::bigint[]) WITH ORDINALITY AS row (epoch_us, place)
"""


class PreparedDetails(NamedTuple):
    """Details of a batch as bytes."""

    #: (T,) whether a row states any figure at all
    is_stated: BoolArray
    #: bytes of one row
    width: int
    #: of all rows
    figures: bytes

    def of_row(self, position: int) -> bytes | None:
        """Return the figures of a row, None when it states none."""
        return self.figures[position * self.width : (position + 1) * self.width] if self.is_stated[position] else None


def prepare_details(details: CarrierDetails | None) -> PreparedDetails | None:
    """Return the details of a batch as bytes, None when no row states any figure."""
    if details is None:
        return None
    every = np.stack([getattr(details, name) for name in DETAIL_NAMES], axis=1).astype("<f4")
    is_known = ~np.isnan(every)
    kinds = np.flatnonzero(is_known.any(axis=(0, 2)))
    if not len(kinds):
        return None
    figures = np.ascontiguousarray(every[:, kinds]).reshape(len(every), -1).view(np.uint8)
    mask = np.full((len(every), 1), np.bitwise_or.reduce(1 << kinds), dtype=np.uint8)
    rows = np.hstack((mask, figures))
    return PreparedDetails(is_known.any(axis=(1, 2)), rows.shape[1], rows.tobytes())


def insert_details(
    connection: Connection, spacecraft_key: int, source_key: int, epochs_us: list[int], width: int, figures: bytes
) -> None:
    """Insert the details of rows, ``width`` bytes each."""
    if not epochs_us:
        return
    if connection.dialect.name == "sqlite":
        run_bare(connection, _AT_ONCE, (spacecraft_key, source_key, figures, width, json.dumps(epochs_us)))
    else:
        values = (spacecraft_key, source_key, figures, width, width, epochs_us)
        connection.exec_driver_sql(_AT_ONCE_ON_A_SERVER, values)


def details_of(blob: bytes, carriers: int) -> CarrierDetails:
    """Return the details in a blob, each (N,), read-only."""
    mask, stored = blob[0], np.frombuffer(blob, dtype="<f4", offset=1).reshape(-1, carriers)
    found: dict[str, FloatArray] = {}
    for kind, name in enumerate(DETAIL_NAMES):
        position = (mask & ((1 << kind) - 1)).bit_count()
        figures = stored[position].astype(np.float64) if mask >> kind & 1 else np.full(carriers, np.nan)
        figures.setflags(write=False)
        found[name] = figures
    return CarrierDetails(**found)
