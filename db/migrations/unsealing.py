"""Taking sealed days apart and packed powers out again: for schemas that know only the plain table of rows."""

from collections.abc import Sequence
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Connection,
    Integer,
    LargeBinary,
    Row,
    Select,
    bindparam,
    column,
    delete,
    inspect,
    select,
    table,
    tuple_,
    update,
)

from db.encoding.measurement_details import insert_details, prepare_details
from db.encoding.power_codec import unpack_flags, unpack_parts
from db.encoding.segments import HEAD_COLUMNS, SegmentHead, read_chunk
from db.results.result_segments import opened
from db.results.stored_rows import TABLES
from db.schema.tables import measurement_segment, result_segment
from service.records.levels.measurement import DETAIL_NAMES, CarrierDetails

_ROWS = 2000
#: the table of rows as it was until schema 0008
_plain = table(
    "measurement",
    column("spacecraft_key", Integer),
    column("epoch_us", BigInteger),
    column("source_key", Integer),
    column("number", BigInteger),
    column("plan_id", Integer),
    column("seq", BigInteger),
    column("received_at_us", BigInteger),
    column("is_late", Boolean),
    column("feeds", Boolean),
    column("powers", LargeBinary),
    column("flags", LargeBinary),
)
_KEY = (_plain.c.spacecraft_key, _plain.c.epoch_us, _plain.c.source_key)
_SET_PLAIN = (
    update(_plain)
    .where(*(part == bindparam(f"of_{part.name}") for part in _KEY))
    .values(powers=bindparam("to_powers"), flags=bindparam("to_flags"))
)


def unpack_everything(connection: Connection) -> None:
    """Write powers and flags of all rows of the table of rows as float32 and int32, four bytes a carrier."""
    position = tuple_(*_KEY)
    query: Select[Any] = select(*_KEY, _plain.c.powers, _plain.c.flags).order_by(*_KEY).limit(_ROWS)
    rows = connection.execute(query).all()
    while rows:
        connection.execute(_SET_PLAIN, _as_plain(rows))
        rows = connection.execute(query.where(position > tuple(rows[-1][:3]))).all()


def _as_plain(rows: Sequence[Row[Any]]) -> list[dict[str, Any]]:
    """Return what rows are to hold."""
    changed = []
    for positions, power_dbm in unpack_parts([row.powers for row in rows]):
        for position, powers in zip(positions, power_dbm, strict=True):
            row = rows[position]
            flags = None if row.flags is None else unpack_flags(row.flags, len(powers)).astype("<i4").tobytes()
            key = {f"of_{part.name}": value for part, value in zip(_KEY, row, strict=False)}
            changed.append({**key, "to_powers": powers.tobytes(), "to_flags": flags})
    return changed


def unseal_results(connection: Connection) -> None:
    """Move the rows of all segments of results back into their tables."""
    for (segment_id,) in connection.execute(select(result_segment.c.segment_id)).all():
        head = connection.execute(select(result_segment).where(result_segment.c.segment_id == segment_id)).one()
        rows = opened(connection, head).rows(TABLES[head.series], slice(None))
        # columns that a later version added are gone already; the insertion makes the checksum
        present = {each["name"] for each in inspect(connection).get_columns(head.series)} - {"checksum"}
        values = [{name: value for name, value in row._asdict().items() if name in present} for row in rows]
        connection.execute(TABLES[head.series].insert(), values)


def unseal_everything(connection: Connection) -> None:
    """Move the rows of all segments back into the table of rows."""
    # all heads first: what follows takes them away
    for found in [SegmentHead(*row) for row in connection.execute(select(*HEAD_COLUMNS))]:
        _unseal(connection, found)


def _unseal(connection: Connection, head: SegmentHead) -> None:
    chunk = read_chunk(connection, None, head)
    rows = []
    for position in range(head.row_count):
        row = chunk.record(position)
        flags = chunk.flags(position)
        rows.append(
            {
                "spacecraft_key": head.spacecraft_key,
                "epoch_us": row.epoch_us,
                "source_key": head.source_key,
                "number": row.number,
                "plan_id": row.plan_id,
                "seq": row.seq,
                "received_at_us": row.received_at_us,
                "is_late": row.is_late,
                "feeds": row.feeds_estimator,
                "powers": chunk.power_dbm()[position].tobytes(),
                "flags": None if flags is None else flags.astype("<i4").tobytes(),
            }
        )
        if row.details is not None:
            stated = CarrierDetails(*(getattr(row.details, name)[None] for name in DETAIL_NAMES))
            _keep_details(connection, head, row.epoch_us, stated)
    connection.execute(_plain.insert(), rows)
    connection.execute(delete(measurement_segment).where(measurement_segment.c.segment_id == head.segment_id))


def _keep_details(connection: Connection, head: SegmentHead, epoch_us: int, stated: CarrierDetails) -> None:
    details = prepare_details(stated)
    if details is not None:
        values = ([epoch_us], details.width, details.figures)
        insert_details(connection, head.spacecraft_key, head.source_key, *values)
