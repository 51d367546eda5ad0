"""Catalogue: spacecraft, carrier plans and ephemerides; implements ``service.ports.Catalogue``."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

from sqlalchemy import Connection, Row, Select, Table, case, delete, func, select, true, update
from sqlalchemy.exc import IntegrityError

from db.database import EpochSpan, Repository, add_entries, count_entries, next_id
from db.encoding.record_codec import damaged_documents, decode, decode_all, encode, encode_all, with_digest
from db.measurements.measurement_pages import HEAD_COLUMNS, SOURCE_COLUMNS, source_state
from db.tables import (
    alignment,
    calibration,
    carrier_plan,
    ephemeris,
    head,
    journal,
    link,
    measurement,
    retention_mark,
    segment,
    source,
)
from db.tables import spacecraft as spacecraft_table
from service.errors import ConflictError, NotFoundError
from service.records.calibration import CalibrationState
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Spacecraft
from service.records.inputs import EphemerisChange, PlanChange, SpacecraftChange
from service.records.levels.measurement import HeadState, Whereabouts

#: in place of the digest of a withdrawn plan: its content is not found again, rows of it stay readable
_WITHDRAWN = "withdrawn"


class SqlCatalogue(Repository):
    """Catalogue in a relational database."""

    def add_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a new spacecraft; ConflictError ``spacecraft.exists``."""
        self._database.write(lambda connection: _insert_spacecraft(connection, spacecraft))

    def replace_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a changed spacecraft under its id."""
        self._change(spacecraft.id, _replace_spacecraft, spacecraft)

    def spacecraft(self, spacecraft_id: str) -> Spacecraft:
        """Return one spacecraft."""
        query = select(spacecraft_table.c.document).join(head).where(spacecraft_table.c.id == spacecraft_id)
        row = self._database.fetch_one(query)
        if row is None:
            raise _no_spacecraft(spacecraft_id)
        return _spacecraft_of(spacecraft_id, row.document)

    def whereabouts(self, spacecraft_id: str) -> Whereabouts:
        """Return where everything of a spacecraft stands, by one statement."""
        rows = self._database.fetch(_whereabouts(spacecraft_id))
        if not rows:
            raise _no_spacecraft(spacecraft_id)
        row = rows[0]
        sources = (each[-len(SOURCE_COLUMNS) :] for each in rows)
        states = tuple(source_state(each) for each in sources if each[0] is not None)
        newest = (row.input_number, row.alignment_id, row.calibration_id, row.kept_from_us)
        links = (row.links, row.reported_us, row.resets, row.enabled)
        return Whereabouts(HeadState(*row[: len(HEAD_COLUMNS)]), states, row.digest, *newest, links)

    def all_spacecraft(self) -> tuple[Spacecraft, ...]:
        """Return all spacecraft in order of id."""
        rows = self._database.fetch(select(spacecraft_table.c.id, spacecraft_table.c.document).join(head))
        return tuple(sorted((_spacecraft_of(*row) for row in rows), key=lambda found: found.id))

    def delete_spacecraft(self, spacecraft_id: str) -> None:
        """Delete a spacecraft without rows; ConflictError ``spacecraft.has_rows``. Its id is not given again."""
        self._change(spacecraft_id, _delete_spacecraft, spacecraft_id)
        self._database.forget(spacecraft_id)

    def withdraw_plan(self, spacecraft_id: str, plan_id: int) -> None:
        """Withdraw a plan, journaled; NotFoundError ``plan.unknown``, ConflictError ``plan.in_use``."""
        self._change(spacecraft_id, _withdraw_plan, spacecraft_id, plan_id)

    def put_plan(self, spacecraft_id: str, carriers: Sequence[Carrier], sha256: str) -> CarrierPlan:
        """Return the plan with this content, storing and journaling it when it is new or no longer the newest."""
        return self._change(spacecraft_id, _put_plan, tuple(carriers), sha256)

    def plan(self, spacecraft_id: str, plan_id: int | None = None) -> CarrierPlan:
        """Return one plan, or the one put last; NotFoundError ``plan.unknown`` or ``plan.none``."""
        key = self._database.key(spacecraft_id)
        row = self._database.fetch_one(_version(carrier_plan, "plan_id", key, plan_id))
        if row is None:
            raise _no_version(spacecraft_id, "plan", "carrier plan", plan_id)
        return _plan_of(row)

    def put_ephemeris(self, spacecraft_id: str, ephemeris: Ephemeris) -> Ephemeris:
        """Store and journal an ephemeris (its id is ignored) and return it with its id."""
        return self._change(spacecraft_id, _put_ephemeris, ephemeris)

    def ephemeris(self, spacecraft_id: str, ephemeris_id: int | None = None) -> Ephemeris:
        """Return one ephemeris, or the newest; NotFoundError ``ephemeris.unknown`` or ``ephemeris.none``."""
        key = self._database.key(spacecraft_id)
        row = self._database.fetch_one(_version(ephemeris, "ephemeris_id", key, ephemeris_id))
        if row is None:
            raise _no_version(spacecraft_id, "ephemeris", "ephemeris", ephemeris_id)
        return decode(Ephemeris, row.document, f"ephemeris {row.ephemeris_id} of {spacecraft_id}")

    def damaged_documents(self, spacecraft_id: str) -> tuple[str, ...]:
        """Return the names of the documents in force that differ from their digests."""
        with self._read(spacecraft_id) as (connection, key):
            return tuple(damaged_documents(connection, key))


@lru_cache(maxsize=1024)
def _spacecraft_of(spacecraft_id: str, document: str) -> Spacecraft:
    """Return a spacecraft by its document: those of hundreds are asked for each second, and hardly ever change."""
    return decode(Spacecraft, document, f"catalogue entry of {spacecraft_id}")


def _no_spacecraft(spacecraft_id: str) -> NotFoundError:
    return NotFoundError("spacecraft.unknown", f"There is no spacecraft {spacecraft_id!r}.")


def _whereabouts(spacecraft_id: str) -> Select[Any]:
    """Return the query for what `whereabouts` tells."""
    key, own, mark = spacecraft_table.c.spacecraft_key, link.c, retention_mark.c
    is_active = calibration.c.state == CalibrationState.ACTIVE.value
    newest = {
        "input_number": select(func.max(journal.c.number)).where(journal.c.spacecraft_key == key),
        "alignment_id": select(func.max(alignment.c.alignment_id)).where(alignment.c.spacecraft_key == key),
        "calibration_id": select(func.max(calibration.c.calibration_id)).where(
            calibration.c.spacecraft_key == key, is_active
        ),
        "kept_from_us": select(mark.kept_from_us).where(mark.spacecraft_key == key, mark.series == "attitude"),
    }
    # instants are added: a report that comes late must count as well
    reports = select(
        func.count().label("links"),
        func.coalesce(func.sum(own.reported_at_us), 0).label("reported_us"),
        func.coalesce(func.sum(own.resets), 0).label("resets"),
        func.coalesce(func.sum(case((own.enabled, 1), else_=0)), 0).label("enabled"),
    ).where(own.spacecraft_id == spacecraft_id)
    links = reports.subquery()
    numbers = (query.scalar_subquery().label(name) for name, query in newest.items())
    columns = (*HEAD_COLUMNS, spacecraft_table.c.digest, *numbers, *links.c, *SOURCE_COLUMNS)
    joined = spacecraft_table.join(head).join(links, true()).outerjoin(source, source.c.spacecraft_key == key)
    query = select(*columns).select_from(joined).where(spacecraft_table.c.id == spacecraft_id)
    return query.order_by(source.c.source_key)


def _insert_spacecraft(connection: Connection, spacecraft: Spacecraft) -> None:
    values = with_digest(spacecraft_table, {"id": spacecraft.id, "document": encode(spacecraft)})
    try:
        insert = spacecraft_table.insert().values(values).returning(spacecraft_table.c.spacecraft_key)
        key = connection.execute(insert).scalar_one()
    except IntegrityError as fault:
        detail = f"Spacecraft {spacecraft.id!r} exists already, or was deleted: an id is given once."
        raise ConflictError("spacecraft.exists", detail) from fault
    start = {"spacecraft_key": key, "newest_number": 0, "consumed_number": 0, "result_sequence": 0}
    connection.execute(head.insert().values(start))
    add_entries(connection, key, [(SpacecraftChange(spacecraft, 1, values["digest"]), None)])


def _replace_spacecraft(connection: Connection, key: int, spacecraft: Spacecraft) -> None:
    is_it = spacecraft_table.c.spacecraft_key == key
    values = with_digest(spacecraft_table, {"id": spacecraft.id, "document": encode(spacecraft)})
    connection.execute(update(spacecraft_table).where(is_it).values(values))
    count = 1 + count_entries(connection, key, "spacecraft")
    add_entries(connection, key, [(SpacecraftChange(spacecraft, count, values["digest"]), None)])


def _put_plan(connection: Connection, key: int, carriers: tuple[Carrier, ...], sha256: str) -> CarrierPlan:
    newest = connection.execute(_version(carrier_plan, "plan_id", key, None)).first()
    if newest is not None and newest.sha256 == sha256:
        return _plan_of(newest)
    plan = CarrierPlan(next_id(connection, carrier_plan, "plan_id", key), sha256, carriers)
    document = encode_all(Carrier, carriers)
    columns = {"spacecraft_key": key, "plan_id": plan.id, "sha256": sha256, "document": document}
    values = with_digest(carrier_plan, columns)
    connection.execute(carrier_plan.insert().values(values))
    add_entries(connection, key, [(PlanChange(plan.id, digest=values["digest"]), None)])
    return plan


def _delete_spacecraft(connection: Connection, key: int, spacecraft_id: str) -> None:
    """Take the head away: without it there is no spacecraft, its row keeps the id taken."""
    if connection.execute(select(source).where(source.c.spacecraft_key == key)).first() is not None:
        raise ConflictError(
            "spacecraft.has_rows", f"Spacecraft {spacecraft_id!r} has measurements and cannot be deleted."
        )
    connection.execute(delete(head).where(head.c.spacecraft_key == key))


def _withdraw_plan(connection: Connection, key: int, spacecraft_id: str, plan_id: int) -> None:
    row = connection.execute(_version(carrier_plan, "plan_id", key, plan_id)).first()
    if row is None or row.sha256 == _WITHDRAWN:
        raise _no_version(spacecraft_id, "plan", "carrier plan", plan_id)
    for table in (measurement, segment, calibration):
        found = select(table.c.plan_id).where(table.c.spacecraft_key == key, table.c.plan_id == plan_id)
        if connection.execute(found.limit(1)).first() is not None:
            detail = f"Rows or calibrations use plan {plan_id}, so it stays."
            raise ConflictError("plan.in_use", detail)
    is_it = (carrier_plan.c.spacecraft_key == key, carrier_plan.c.plan_id == plan_id)
    connection.execute(update(carrier_plan).where(*is_it).values(sha256=_WITHDRAWN))
    newest = connection.execute(_version(carrier_plan, "plan_id", key, None)).first()
    if newest is not None and newest.plan_id < plan_id:
        entry = PlanChange(newest.plan_id, after_withdrawal_of=plan_id, digest=newest.digest)
        add_entries(connection, key, [(entry, None)])


def _put_ephemeris(connection: Connection, key: int, record: Ephemeris) -> Ephemeris:
    stored = replace(record, id=next_id(connection, ephemeris, "ephemeris_id", key))
    columns = {"spacecraft_key": key, "ephemeris_id": stored.id, "document": encode(stored)}
    values = with_digest(ephemeris, columns)
    connection.execute(ephemeris.insert().values(values))
    span = EpochSpan(stored.valid_start_us, stored.valid_stop_us)
    add_entries(connection, key, [(EphemerisChange(stored.id, values["digest"]), span)])
    return stored


def _plan_of(row: Row[Any]) -> CarrierPlan:
    is_withdrawn = row.sha256 == _WITHDRAWN
    carriers = decode_all(Carrier, row.document, f"carrier plan {row.plan_id}")
    return CarrierPlan(row.plan_id, row.sha256, carriers, is_withdrawn=is_withdrawn)


def _version(table: Table, column: str, key: int, wanted: int | None) -> Select[Any]:
    """Return the query for one version of a spacecraft's table, or for its newest."""
    query = select(table).where(table.c.spacecraft_key == key)
    if wanted is None:
        query = query.where(table.c.sha256 != _WITHDRAWN) if table is carrier_plan else query
        return query.order_by(table.c[column].desc()).limit(1)
    return query.where(table.c[column] == wanted)


def _no_version(spacecraft_id: str, code: str, noun: str, wanted: int | None) -> NotFoundError:
    if wanted is None:
        return NotFoundError(f"{code}.none", f"Spacecraft {spacecraft_id!r} has no {noun} yet.")
    return NotFoundError(f"{code}.unknown", f"Spacecraft {spacecraft_id!r} has no {noun} {wanted}.")
