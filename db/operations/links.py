"""Links: their newest reports and what operators want of them; implements ``service.ports.Links``."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, Row, delete, func, select, update

from db.database import Repository
from db.encoding.json_documents import decode, encode
from db.schema.tables import link as link_table
from service.errors import ConflictError, NotFoundError
from service.records.epoch import US_PER_S
from service.records.operations.link import LinkReport, LinkState, update_period

#: no ground station has more; a key that invents ids ends here
MAX_LINKS = 1000


class SqlLinks(Repository):
    """Links in a relational database."""

    def report(self, reports: Sequence[LinkReport], at_us: int) -> tuple[LinkState, ...]:
        """Store the newest reports in one transaction and return what is wanted of each link."""

        def store(connection: Connection) -> tuple[LinkState, ...]:
            return tuple(_store(connection, report, at_us) for report in reports)

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
        return self._change(link_id, lambda state: replace(state, enabled=enabled))

    def request_reset(self, link_id: str) -> LinkState:
        """Ask a link to zero its counters and to begin again."""
        return self._change(link_id, lambda state: replace(state, resets=state.resets + 1))

    def remove(self, link_id: str) -> None:
        """Forget a link; it comes back with its next report, enabled."""
        is_it = link_table.c.link_id == link_id
        if self._database.write(lambda connection: connection.execute(delete(link_table).where(is_it)).rowcount) == 0:
            raise _no_link(link_id)

    def _change(self, link_id: str, change: Callable[[LinkState], LinkState]) -> LinkState:
        def write(connection: Connection) -> LinkState:
            stored = _locked(connection, link_id)
            if stored is None:
                raise _no_link(link_id)
            changed = change(stored)
            connection.execute(_replacement(changed))
            return changed

        return self._database.write(write)


def _store(connection: Connection, report: LinkReport, at_us: int) -> LinkState:
    stored = _locked(connection, report.id)
    if stored is None:
        if (connection.scalar(select(func.count()).select_from(link_table)) or 0) >= MAX_LINKS:
            detail = f"{MAX_LINKS} links are known already."
            raise ConflictError("link.too_many", detail)
        fresh = LinkState(report, at_us, None, enabled=True, resets=0)
        connection.execute(link_table.insert().values(link_id=report.id, **_values(fresh)))
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
    return update(link_table).where(link_table.c.link_id == state.report.id).values(**_values(state))


def _values(state: LinkState) -> dict[str, Any]:
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
