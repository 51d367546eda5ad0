"""Forecast of the next start: entries of each journal since the checkpoint, or the alignment, from which it goes on."""

from collections.abc import Iterator

from sqlalchemy import ColumnElement, Connection, Table, func, select

from db.schema.tables import alignment, checkpoint, head, spacecraft
from service.records.storage.diagnosis import Diagnosis

#: processor time of an entry, s: both methods and the torque for sixteen carriers, on a machine of two cores
ENTRY_S = 1.5e-3
#: longer than this an operator should know before, s
LONG_S = 60.0


def restart_forecasts(connection: Connection, fingerprint: str) -> Iterator[Diagnosis]:
    """Yield how long the chain of each spacecraft is computed again; checkpoints of other fingerprints do not count."""
    heads = select(spacecraft.c.id, head.c.spacecraft_key, head.c.consumed_number).join(
        spacecraft, spacecraft.c.spacecraft_key == head.c.spacecraft_key
    )
    for name, key, consumed in connection.execute(heads.order_by(head.c.spacecraft_key)).all():
        kept = _newest(connection, checkpoint, key, consumed, checkpoint.c.fingerprint == fingerprint)
        aligned = _newest(connection, alignment, key, consumed)
        if not (kept or aligned):
            continue
        entries, since = consumed - max(kept, aligned), "checkpoint" if kept > aligned else "alignment"
        detail = (
            f"the next start of {name} consumes {entries} entries since its last {since}, {entries * ENTRY_S:.0f} s"
        )
        if entries * ENTRY_S <= LONG_S:
            yield Diagnosis("restart", "ok", detail)
        else:
            advice = "Start it when estimates can wait; rows are kept meanwhile, /readyz says how long it takes."
            yield Diagnosis("restart", "warning", detail, advice)


def _newest(connection: Connection, table: Table, key: int, consumed: int, *conditions: ColumnElement[bool]) -> int:
    """Return the newest journal number of a table up to a number, 0 where there is none."""
    is_own = (table.c.spacecraft_key == key, table.c.number <= consumed)
    return connection.scalar(select(func.max(table.c.number)).where(*is_own, *conditions)) or 0
