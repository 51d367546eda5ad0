"""Links of front ends, and the evidence traces that came over them."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, fields, replace
from typing import Any

import numpy as np
from sqlalchemy import ColumnElement, Connection, Row, Select, and_, delete, func, select, update

from db.columns import sound_rows
from db.database import Repository, page_of
from db.encoding.record_codec import decode, encode
from db.tables import link as link_table
from db.tables import trace as trace_table
from service.errors import ConflictError, NotFoundError
from service.ports.archive import ListPart
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import FloatArray
from service.records.levels.measurement import KeptTrace, Ring, Trace, TraceHead, TraceReceipt, TraceSettings
from service.records.operations.work import LinkReport, LinkState, update_period

#: no ground station has more; a key that invents ids ends here
MAX_LINKS = 1000


class SqlLinks(Repository):
    """Links in a relational database."""

    def report(self, reports: Sequence[LinkReport], at_us: int) -> tuple[LinkState, ...]:
        """Store the newest reports in one transaction and return what is wanted of each link."""

        def store(connection: Connection) -> tuple[LinkState, ...]:
            return tuple(_store_report(connection, report, at_us) for report in reports)

        return self._database.write(store)

    def links(self, spacecraft_id: str | None = None) -> tuple[LinkState, ...]:
        """Return all links, or those of one spacecraft, in order of id."""
        query = select(link_table).order_by(link_table.c.link_id)
        if spacecraft_id is not None:
            query = query.where(link_table.c.spacecraft_id == spacecraft_id)
        return tuple(_state_of(row) for row in self._database.fetch(query))

    def link(self, link_id: str) -> LinkState:
        """Return one link; NotFoundError ``link.unknown``."""
        row = self._database.fetch_one(select(link_table).where(link_table.c.link_id == link_id))
        if row is None:
            raise _no_link(link_id)
        return _state_of(row)

    def set_enabled(self, link_id: str, *, enabled: bool) -> LinkState:
        """Enable or disable a link until the next call."""
        return self._change_link(link_id, lambda state: replace(state, enabled=enabled))

    def request_reset(self, link_id: str) -> LinkState:
        """Ask a link to zero its counters and to begin again."""
        return self._change_link(link_id, lambda state: replace(state, resets=state.resets + 1))

    def remove(self, link_id: str) -> None:
        """Forget a link; it comes back with its next report, enabled."""
        is_it = link_table.c.link_id == link_id
        if self._database.write(lambda connection: connection.execute(delete(link_table).where(is_it)).rowcount) == 0:
            raise _no_link(link_id)

    def _change_link(self, link_id: str, change: Callable[[LinkState], LinkState]) -> LinkState:
        def write(connection: Connection) -> LinkState:
            stored = _locked(connection, link_id)
            if stored is None:
                raise _no_link(link_id)
            changed = change(stored)
            connection.execute(_replacement(changed))
            return changed

        return self._database.write(write)


def _store_report(connection: Connection, report: LinkReport, at_us: int) -> LinkState:
    stored = _locked(connection, report.id)
    if stored is None:
        if (connection.scalar(select(func.count()).select_from(link_table)) or 0) >= MAX_LINKS:
            detail = f"{MAX_LINKS} links are known already."
            raise ConflictError("link.too_many", detail)
        fresh = LinkState(report, at_us, None, enabled=True, resets=0)
        connection.execute(link_table.insert().values(link_id=report.id, **_link_values(fresh)))
        return fresh
    interval_s = max(at_us - stored.reported_at_us, 0) / US_PER_S
    period_s = update_period(stored.learned_period_s, interval_s)
    reported = replace(stored, report=report, reported_at_us=at_us, learned_period_s=period_s)
    connection.execute(_replacement(reported))
    return reported


def _locked(connection: Connection, link_id: str) -> LinkState | None:
    """Return a link and keep other writers of it away until the transaction ends."""
    query = select(link_table).where(link_table.c.link_id == link_id).with_for_update()
    row = connection.execute(query).first()
    return None if row is None else _state_of(row)


def _replacement(state: LinkState) -> Any:
    return update(link_table).where(link_table.c.link_id == state.report.id).values(**_link_values(state))


def _link_values(state: LinkState) -> dict[str, Any]:
    """Return the columns of a link beside its id."""
    return {
        "spacecraft_id": state.report.spacecraft_id,
        "reported_at_us": state.reported_at_us,
        "learned_period_s": state.learned_period_s,
        "enabled": state.enabled,
        "resets": state.resets,
        "document": encode(state.report),
    }


def _state_of(row: Row[Any]) -> LinkState:
    # the column reads NULL as NaN
    learned_s = None if row.learned_period_s != row.learned_period_s else row.learned_period_s
    return LinkState(
        decode(LinkReport, row.document), row.reported_at_us, learned_s, enabled=bool(row.enabled), resets=row.resets
    )


def _no_link(link_id: str) -> NotFoundError:
    return NotFoundError("link.unknown", f"No link {link_id!r} has reported.")


#: values in one query
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
        offered = [_trace_values(source, trace, received_at_us) for trace in traces]
        return self._change(spacecraft_id, _store_traces, source, offered, ring)

    def heads(
        self, spacecraft_id: str, part: ListPart, source: str | None = None, sweep: str | None = None
    ) -> list[TraceHead]:
        """Return kept traces without their points in order of (epoch, number) beyond a cursor."""
        column = trace_table.c
        query = _chosen(select(*_HEAD), self._database.key(spacecraft_id), source, sweep)
        page = page_of(query, column.epoch_us, column.trace_id, part)
        return [_head_of(row) for row in self._database.fetch(page)]

    def trace(
        self, spacecraft_id: str, epoch_us: int, source: str | None = None, sweep: str | None = None
    ) -> KeptTrace:
        """Return the trace of an epoch; NotFoundError ``trace.unknown``, ConflictError ``trace.ambiguous``."""
        query = _chosen(select(trace_table), self._database.key(spacecraft_id), source, sweep)
        rows = sound_rows(trace_table, self._database.fetch(query.where(trace_table.c.epoch_us == epoch_us).limit(2)))
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


def _store_traces(
    connection: Connection, key: int, source: str, offered: Sequence[dict[str, Any]], ring: Ring
) -> TraceReceipt:
    known = _known(connection, key, source, [values["epoch_us"] for values in offered])
    fresh: dict[tuple[int, str], dict[str, Any]] = {}
    for values in offered:
        name = values["epoch_us"], values["sweep"]
        if name not in known:
            fresh.setdefault(name, values)
    if fresh:
        connection.execute(trace_table.insert(), [{"spacecraft_key": key, **values} for values in fresh.values()])
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


def _trace_values(source: str, trace: Trace, received_at_us: int) -> dict[str, Any]:
    powers = packed(trace.power_dbm)
    return {
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
