"""Evidence traces in rings, one a source; implements ``service.ports.Traces``.

A trace is stored once by source, sweep and epoch. What the ring has no place for goes in the transaction that stores
the new traces, oldest epoch first.
"""

import zlib
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, and_, delete, func, select

from db.database import Repository, lock_head, page_of, within
from db.schema.tables import trace as trace_table
from service.errors import ConflictError, NotFoundError
from service.records.calibration import Window
from service.records.epoch import format_epoch
from service.records.levels.attitude import FloatArray
from service.records.levels.trace import KeptTrace, Ring, Trace, TraceHead, TraceReceipt, TraceSettings

#: values in one query; SQLite before 3.32 binds 999 at most
_CHUNK = 500
#: the fastest level: the others gain a hundredth of the size
_PACK_LEVEL = 1
_SETTINGS = tuple(trace_table.c[field.name] for field in fields(TraceSettings))
_OF_HEAD = ("trace_id", "source", "epoch_us", "sweep", "points", "received_at_us", "size_bytes")
_HEAD = (*(trace_table.c[name] for name in _OF_HEAD), *_SETTINGS)


class SqlTraces(Repository):
    """Evidence traces in a relational database."""

    def append(
        self, spacecraft_id: str, source: str, traces: Sequence[Trace], received_at_us: int, ring: Ring
    ) -> TraceReceipt:
        """Store traces of one source and drop, oldest epoch first, what its ring has no place for."""
        key = self._database.key(spacecraft_id)
        offered = [_values(key, source, trace, received_at_us) for trace in traces]
        return self._database.write(lambda connection: _store(connection, key, source, offered, ring))

    def heads(
        self,
        spacecraft_id: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        source: str | None = None,
        sweep: str | None = None,
        *,
        newest_first: bool = False,
    ) -> list[TraceHead]:
        """Return kept traces without their points in order of (epoch, number) beyond a cursor."""
        column = trace_table.c
        query = _chosen(select(*_HEAD), self._database.key(spacecraft_id), source, sweep)
        inside = query.where(within(column.epoch_us, window))
        page = page_of(inside, column.epoch_us, column.trace_id, limit, after, newest_first=newest_first)
        return [_head_of(row) for row in self._database.fetch(page)]

    def trace(
        self, spacecraft_id: str, epoch_us: int, source: str | None = None, sweep: str | None = None
    ) -> KeptTrace:
        """Return the trace of an epoch; NotFoundError ``trace.unknown``, ConflictError ``trace.ambiguous``."""
        query = _chosen(select(*_HEAD, trace_table.c.powers), self._database.key(spacecraft_id), source, sweep)
        rows = self._database.fetch(query.where(trace_table.c.epoch_us == epoch_us).limit(2))
        if not rows:
            detail = f"No trace of {format_epoch(epoch_us)} is kept."
            raise NotFoundError("trace.unknown", detail)
        if len(rows) > 1:
            detail = "Several traces have this epoch."
            raise ConflictError("trace.ambiguous", detail)
        return KeptTrace(_head_of(rows[0]), unpacked(rows[0].powers))


def packed(power_dbm: FloatArray) -> bytes:
    """Return (B,) powers as float32 little endian, packed."""
    return zlib.compress(power_dbm.astype("<f4").tobytes(), _PACK_LEVEL)


def unpacked(blob: bytes) -> FloatArray:
    """Return stored powers widened to float64, shape (B,), read-only."""
    power_dbm = np.frombuffer(zlib.decompress(blob), dtype="<f4").astype(np.float64)
    power_dbm.setflags(write=False)
    return power_dbm


def _store(
    connection: Connection, key: int, source: str, offered: Sequence[dict[str, Any]], ring: Ring
) -> TraceReceipt:
    lock_head(connection, key)
    known = _known(connection, key, source, [values["epoch_us"] for values in offered])
    fresh: dict[tuple[int, str], dict[str, Any]] = {}
    for values in offered:
        name = values["epoch_us"], values["sweep"]
        if name not in known:
            fresh.setdefault(name, values)
    if fresh:
        connection.execute(trace_table.insert(), list(fresh.values()))
    return TraceReceipt(len(fresh), len(offered) - len(fresh), _drop(connection, key, source, ring))


def _known(connection: Connection, key: int, source: str, epochs_us: Sequence[int]) -> set[tuple[int, str]]:
    """Return epoch and sweep of those traces that are kept already."""
    known: set[tuple[int, str]] = set()
    for start in range(0, len(epochs_us), _CHUNK):
        is_one = (_of_source(key, source), trace_table.c.epoch_us.in_(epochs_us[start : start + _CHUNK]))
        rows = connection.execute(select(trace_table.c.epoch_us, trace_table.c.sweep).where(*is_one))
        known.update((row.epoch_us, row.sweep) for row in rows)
    return known


def _drop(connection: Connection, key: int, source: str, ring: Ring) -> int:
    """Drop the oldest traces of a source until the rest fits its ring; return how many."""
    is_its = _of_source(key, source)
    totals = select(func.count(), func.coalesce(func.sum(trace_table.c.size_bytes), 0)).where(is_its)
    count, size_bytes = connection.execute(totals).one()
    dropped = 0
    while count > ring.traces or size_bytes > ring.size_bytes:
        oldest = select(trace_table.c.trace_id, trace_table.c.size_bytes).where(is_its)
        rows = connection.execute(oldest.order_by(trace_table.c.epoch_us, trace_table.c.trace_id).limit(_CHUNK)).all()
        leaving = []
        for trace_id, size in rows:
            if count <= ring.traces and size_bytes <= ring.size_bytes:
                break
            leaving.append(trace_id)
            count, size_bytes = count - 1, size_bytes - size
        connection.execute(delete(trace_table).where(trace_table.c.trace_id.in_(leaving)))
        dropped += len(leaving)
    return dropped


def _of_source(key: int, source: str) -> ColumnElement[bool]:
    return and_(trace_table.c.spacecraft_key == key, trace_table.c.source == source)


def _chosen(query: Select[Any], key: int, source: str | None, sweep: str | None) -> Select[Any]:
    query = query.where(trace_table.c.spacecraft_key == key)
    if source is not None:
        query = query.where(trace_table.c.source == source)
    return query if sweep is None else query.where(trace_table.c.sweep == sweep)


def _values(key: int, source: str, trace: Trace, received_at_us: int) -> dict[str, Any]:
    """Return the columns of a trace."""
    powers = packed(trace.power_dbm)
    return {
        "spacecraft_key": key,
        "source": source,
        "epoch_us": trace.epoch_us,
        "sweep": trace.sweep,
        "size_bytes": len(powers),
        "received_at_us": received_at_us,
        "points": len(trace.power_dbm),
        **asdict(trace.settings),
        "powers": powers,
    }


def _head_of(row: Row[Any]) -> TraceHead:
    settings = TraceSettings(*(getattr(row, column.name) for column in _SETTINGS))
    return TraceHead(
        row.trace_id, row.source, row.epoch_us, row.sweep, settings, row.points, row.received_at_us, row.size_bytes
    )
