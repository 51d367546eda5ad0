"""Calibrations and alignments, the first part of ``service.ports.Results``."""

from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, Row, Select, select, update

from db.database import EpochSpan, Repository, add_entries, count_entries, next_id
from db.encoding.record_codec import decode, differs, digest_of, encode, with_digest
from db.results.jobs import insert_job
from db.tables import alignment as alignment_table
from db.tables import calibration as calibration_table
from service.errors import ConflictError, NotFoundError, StorageError
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
)
from service.records.inputs import AlignmentSet, CalibrationActivation
from service.records.operations.work import Job

#: in place of a state: the row keeps the number taken
_DELETED = "deleted"


class SqlCalibrations(Repository):
    """Calibrations and alignments in a relational database."""

    def add_calibration(
        self,
        spacecraft_id: str,
        request: CalibrationRequest,
        plan_id: int,
        ephemeris_id: int,
        created_at_us: int,
        created_by: str,
        job: Job | None = None,
        most: int | None = None,
    ) -> Calibration:
        """Store a draft without a result, with its job, and return it with its id."""
        draft = Calibration(
            0, plan_id, ephemeris_id, CalibrationState.DRAFT, request, created_at_us, created_by, result=None
        )

        def add(connection: Connection, key: int) -> Calibration:
            stored = _insert_calibration(connection, key, draft)
            if job is not None:
                insert_job(connection, replace(job, subject=str(stored.id)), most)
            return stored

        return self._change(spacecraft_id, add)

    def finish_calibration(
        self, spacecraft_id: str, calibration_id: int, result: CalibrationResult | None, error: str | None
    ) -> Calibration:
        """Store the result of a draft, or why it failed."""
        return self._change(spacecraft_id, _finish, calibration_id, result, error)

    def activate_calibration(
        self, spacecraft_id: str, calibration_id: int, override_reason: str | None = None
    ) -> Calibration:
        """Make a calibration the active one of its method, journaled; the former becomes superseded."""
        return self._change(spacecraft_id, _activate, calibration_id, override_reason)

    def delete_calibration(self, spacecraft_id: str, calibration_id: int) -> None:
        """Delete a draft or a failed calibration; its number is not given again."""
        self._change(spacecraft_id, _delete, calibration_id)

    def calibration(self, spacecraft_id: str, calibration_id: int) -> Calibration:
        """Return one calibration."""
        with self._read(spacecraft_id) as (connection, key):
            return _calibration(connection, key, calibration_id)

    def calibrations(self, spacecraft_id: str, state: CalibrationState | None = None) -> tuple[Calibration, ...]:
        """Return calibrations, newest first."""
        key = self._database.key(spacecraft_id)
        query = _calibrations(key).order_by(calibration_table.c.calibration_id.desc())
        if state is not None:
            query = query.where(calibration_table.c.state == state.value)
        return tuple(_calibration_of(row) for row in self._database.fetch(query))

    def add_alignment(self, spacecraft_id: str, alignment: Alignment) -> Alignment:
        """Store and journal an alignment (its id is ignored) and return it with its id."""
        return self._change(spacecraft_id, _insert_alignment, alignment)

    def alignment(self, spacecraft_id: str, alignment_id: int) -> Alignment:
        """Return one alignment."""
        return _alignment_of(self._alignment_row(spacecraft_id, alignment_id))

    def alignments(self, spacecraft_id: str) -> tuple[Alignment, ...]:
        """Return alignments, newest first."""
        key = self._database.key(spacecraft_id)
        query = select(alignment_table).where(alignment_table.c.spacecraft_key == key)
        rows = self._database.fetch(query.order_by(alignment_table.c.alignment_id.desc()))
        return tuple(map(_alignment_of, rows))

    def alignment_number(self, spacecraft_id: str, alignment_id: int) -> int:
        """Return the journal number of an alignment."""
        return int(self._alignment_row(spacecraft_id, alignment_id).number)

    def _alignment_row(self, spacecraft_id: str, alignment_id: int) -> Row[Any]:
        key = self._database.key(spacecraft_id)
        is_it = (alignment_table.c.spacecraft_key == key, alignment_table.c.alignment_id == alignment_id)
        row = self._database.fetch_one(select(alignment_table).where(*is_it))
        if row is None:
            raise NotFoundError("alignment.unknown", f"There is no alignment {alignment_id} of {spacecraft_id!r}.")
        return row


def _alignment_of(row: Row[Any]) -> Alignment:
    return decode(Alignment, row.document, f"alignment {row.alignment_id}")


def _calibrations(key: int) -> Select[Any]:
    is_its = (calibration_table.c.spacecraft_key == key, calibration_table.c.state != _DELETED)
    return select(calibration_table).where(*is_its)


def _calibration(connection: Connection, key: int, calibration_id: int) -> Calibration:
    return _calibration_of(_calibration_row(connection, key, calibration_id))


def _calibration_row(connection: Connection, key: int, calibration_id: int) -> Row[Any]:
    row = connection.execute(_calibrations(key).where(calibration_table.c.calibration_id == calibration_id)).first()
    if row is None:
        raise NotFoundError("calibration.unknown", f"There is no calibration {calibration_id} of this spacecraft.")
    return row


def _calibration_of(row: Row[Any]) -> Calibration:
    name = f"calibration {row.calibration_id}"
    return Calibration(
        id=row.calibration_id,
        plan_id=row.plan_id,
        ephemeris_id=row.ephemeris_id,
        state=CalibrationState(row.state),
        request=decode(CalibrationRequest, row.request, name),
        created_at_us=row.created_at_us,
        created_by=row.created_by,
        result=None if row.result is None else decode(CalibrationResult, row.result, name),
        error=row.error,
        override_reason=row.override_reason,
    )


def _insert_calibration(connection: Connection, key: int, draft: Calibration) -> Calibration:
    stored = replace(draft, id=next_id(connection, calibration_table, "calibration_id", key))
    values = {
        "spacecraft_key": key,
        "calibration_id": stored.id,
        "method": stored.request.method.value,
        "state": stored.state.value,
        "plan_id": stored.plan_id,
        "ephemeris_id": stored.ephemeris_id,
        "created_at_us": stored.created_at_us,
        "created_by": stored.created_by,
        "request": encode(stored.request),
    }
    connection.execute(calibration_table.insert().values(with_digest(calibration_table, values)))
    return stored


def _change_calibration(connection: Connection, key: int, calibration_id: int, values: dict[str, str | None]) -> None:
    is_it = (calibration_table.c.spacecraft_key == key, calibration_table.c.calibration_id == calibration_id)
    connection.execute(update(calibration_table).where(*is_it).values(values))


def _finish(
    connection: Connection, key: int, calibration_id: int, result: CalibrationResult | None, error: str | None
) -> Calibration:
    row = _calibration_row(connection, key, calibration_id)
    draft = _calibration_of(row)
    if draft.state is not CalibrationState.DRAFT or draft.result is not None:
        raise ConflictError("calibration.finished", f"Calibration {calibration_id} is finished.")
    state = CalibrationState.FAILED if result is None else CalibrationState.DRAFT
    document = None if result is None else encode(result)
    digest = digest_of(calibration_table, {**row._mapping, "result": document})  # noqa: SLF001 - SQLAlchemy's public name
    values = {"state": state.value, "result": document, "error": error, "digest": digest}
    _change_calibration(connection, key, calibration_id, values)
    return _calibration(connection, key, calibration_id)


def _delete(connection: Connection, key: int, calibration_id: int) -> None:
    found = _calibration(connection, key, calibration_id)
    if found.state not in {CalibrationState.DRAFT, CalibrationState.FAILED}:
        detail = f"Calibration {calibration_id} is {found.state} or was active; drafts and failed ones can be deleted."
        raise ConflictError("calibration.not_draft", detail)
    if found.state is CalibrationState.DRAFT and found.result is None:
        raise ConflictError("calibration.unfinished", f"Calibration {calibration_id} is being computed.")
    _change_calibration(connection, key, calibration_id, {"state": _DELETED})


def _activate(connection: Connection, key: int, calibration_id: int, override_reason: str | None) -> Calibration:
    row = _calibration_row(connection, key, calibration_id)
    if differs(calibration_table, row):
        raise StorageError("document.corrupt", f"Calibration {calibration_id} differs from its digest.")
    chosen = _calibration_of(row)
    if chosen.result is None:
        detail = f"Calibration {calibration_id} has no result and cannot be activated."
        raise ConflictError("calibration.no_result", detail)
    connection.execute(
        update(calibration_table)
        .where(
            calibration_table.c.spacecraft_key == key,
            calibration_table.c.method == chosen.request.method.value,
            calibration_table.c.state == CalibrationState.ACTIVE.value,
        )
        .values(state=CalibrationState.SUPERSEDED.value)
    )
    activated = replace(chosen, state=CalibrationState.ACTIVE, override_reason=override_reason)
    values = {"state": activated.state.value, "override_reason": override_reason}
    _change_calibration(connection, key, calibration_id, values)
    count = 1 + count_entries(connection, key, "activation")
    add_entries(connection, key, [(CalibrationActivation(calibration_id, count, row.digest), None)])
    return activated


def _insert_alignment(connection: Connection, key: int, record: Alignment) -> Alignment:
    _calibration(connection, key, record.calibration_id)
    stored = replace(record, id=next_id(connection, alignment_table, "alignment_id", key))
    span = EpochSpan(stored.epoch_us, stored.epoch_us)
    columns = {
        "spacecraft_key": key,
        "alignment_id": stored.id,
        "epoch_us": stored.epoch_us,
        "document": encode(stored),
    }
    values = with_digest(alignment_table, columns)
    values["number"] = add_entries(connection, key, [(AlignmentSet(stored.id, values["digest"]), span)])
    connection.execute(alignment_table.insert().values(values))
    return stored
