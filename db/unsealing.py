"""Taking sealed days apart again: for a schema that knows only the table of rows."""

from sqlalchemy import Connection, delete, select

from db.measurement_details import insert_details, prepare_details
from db.segments import HEAD_COLUMNS, SegmentHead, read_piece
from db.tables import measurement, measurement_segment
from service.records.measurement import DETAIL_NAMES, CarrierDetails


def unseal_everything(connection: Connection) -> None:
    """Move the rows of all segments back into the table of rows."""
    # all heads first: what follows takes them away
    for found in [SegmentHead(*row) for row in connection.execute(select(*HEAD_COLUMNS))]:
        _unseal(connection, found)


def _unseal(connection: Connection, head: SegmentHead) -> None:
    piece = read_piece(connection, None, head)
    rows = []
    for place in range(head.row_count):
        row = piece.record(place)
        powers, flags = piece.content(place)
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
                "powers": powers,
                "flags": flags,
            }
        )
        if row.details is not None:
            stated = CarrierDetails(*(getattr(row.details, name)[None] for name in DETAIL_NAMES))
            _keep_details(connection, head, row.epoch_us, stated)
    connection.execute(measurement.insert(), rows)
    connection.execute(delete(measurement_segment).where(measurement_segment.c.segment_id == head.segment_id))


def _keep_details(connection: Connection, head: SegmentHead, epoch_us: int, stated: CarrierDetails) -> None:
    details = prepare_details(stated)
    if details is not None:
        values = ([epoch_us], details.width, details.figures)
        insert_details(connection, head.spacecraft_key, head.source_key, *values)
