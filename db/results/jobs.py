"""Jobs and checkpoints.

A job is one row: what is to be done, how far it is, and who does it. A process takes the open ones of the spacecraft
that it leads, in order of priority; the row says whose they are, so that no two processes run one.
"""

from collections.abc import Iterator
from dataclasses import asdict, fields
from itertools import pairwise
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, and_, delete, false, func, or_, select, true, update
from sqlalchemy.exc import IntegrityError

from db.database import Database, Repository
from db.schema.columns import agrees
from db.schema.tables import calibration as calibration_table
from db.schema.tables import checkpoint as checkpoint_table
from db.schema.tables import job as job_table
from db.schema.tables import live_member, spacecraft
from service.errors import BusyError, ConflictError, NotFoundError
from service.ports.archive import LIVE
from service.records.calibration import CalibrationState
from service.records.operations.work import PRIORITIES, STANDING_KINDS, Job, JobKind, JobState
from service.records.storage import Checkpoint

_UNFINISHED = (JobState.QUEUED.value, JobState.RUNNING.value)
#: code of the error where too many of a kind wait already
_BUSY_CODES = {JobKind.CALIBRATION: "analysis.busy", JobKind.REPLAY: "replay.busy"}


class SqlJobs(Repository):
    """Jobs in a relational database."""

    def add_job(self, job: Job, holder: str | None = None) -> None:
        """Store a new job; ConflictError ``job.exists``."""
        # a job keeps the books of a change; the request's audit entry goes with the change itself
        self._database.submit(lambda connection: insert_job(connection, job, None, holder)).result()

    def queue_job(self, job: Job) -> None:
        """Store a job that comes again and again, or queue it once more where it has ended."""
        again = {"state": JobState.QUEUED.value, "progress": 0.0, "error": None, "holder": None, "member_id": None}
        is_ended = and_(job_table.c.job_id == job.id, job_table.c.state.not_in(_UNFINISHED))

        def queue(connection: Connection) -> None:
            if connection.scalar(select(func.count()).where(job_table.c.job_id == job.id)):
                connection.execute(update(job_table).where(is_ended).values(again))
            else:
                insert_job(connection, job, None, None)

        self._database.submit(queue).result()

    def open_jobs(self, holder: str) -> list[Job]:
        """Return the unfinished jobs that are a holder's or nobody's, in the order in which they are to be done."""
        column = job_table.c
        query = select(job_table).where(column.state.in_(_UNFINISHED), self._is_free(holder))
        order = (column.priority, column.created_at_us, column.job_id)
        return [_job_of(row) for row in self._database.fetch(query.order_by(*order))]

    def hold_job(self, job_id: str, holder: str) -> bool:
        """Make an open job run in the hands of a holder; False where another has it, or it has ended."""
        values = {"state": JobState.RUNNING.value, "holder": holder, "member_id": self._database.leases.member}
        is_open = and_(job_table.c.job_id == job_id, job_table.c.state.in_(_UNFINISHED), self._is_free(holder))
        return self._changed(update(job_table).where(is_open).values(values))

    def report_job(self, job_id: str, holder: str, progress: float) -> bool:
        """Store how far a job is; False where it has ended meanwhile, or is another holder's."""
        return self._changed(update(job_table).where(_is_run_by(job_id, holder)).values(progress=progress))

    def let_go_of_job(self, job_id: str, holder: str) -> None:
        """Let others go on with a job."""
        free = {"state": JobState.QUEUED.value, "holder": None, "member_id": None}
        self._changed(update(job_table).where(_is_run_by(job_id, holder)).values(free))

    def free_jobs(self, holder: str) -> int:
        """Let the jobs of processes that have ended go on, and return how many; those of a holder stay its own."""
        is_others = and_(job_table.c.state.in_(_UNFINISHED), job_table.c.holder != holder)
        has_ended: ColumnElement[bool] = true()
        if self._database.leases.member is not None:
            live = select(live_member.c.member_id)
            has_ended = or_(job_table.c.member_id.is_(None), job_table.c.member_id.not_in(live))
        free = update(job_table).where(is_others, has_ended).values(holder=None, member_id=None)
        return int(self._database.write(lambda connection: connection.execute(free).rowcount))

    def end_job(self, job_id: str, error: str | None = None) -> None:
        """Store that a job is done, or why it failed; a calibration without a result fails with it."""
        state = JobState.DONE if error is None else JobState.FAILED
        ended = {"state": state.value, "progress": 1.0, "error": error}

        def end(connection: Connection) -> None:
            changed = update(job_table).where(job_table.c.job_id == job_id).values(ended).returning(*job_table.c)
            row = connection.execute(changed).first()
            if row is None:
                raise _no_job(job_id)
            if error is not None and row.kind == JobKind.CALIBRATION and row.subject:
                _fail_draft(connection, row.spacecraft_id, int(row.subject), error)

        self._database.write(end)

    def job(self, job_id: str) -> Job:
        """Return one job."""
        row = self._database.fetch_one(select(job_table).where(job_table.c.job_id == job_id))
        if row is None:
            raise _no_job(job_id)
        return _job_of(row)

    def unfinished_job_of(self, spacecraft_id: str, kind: JobKind, subject: str) -> str | None:
        """Return the id of the unfinished job of a subject, None where there is none."""
        column = job_table.c
        is_its = (column.spacecraft_id == spacecraft_id, column.kind == kind.value, column.subject == subject)
        row = self._database.fetch_one(select(column.job_id).where(*is_its, column.state.in_(_UNFINISHED)))
        return None if row is None else str(row.job_id)

    def newest_jobs(self, limit: int) -> list[Job]:
        """Return the jobs that persons made last, newest first."""
        column = job_table.c
        query = select(job_table).where(column.kind.not_in([kind.value for kind in STANDING_KINDS]))
        newest_first = (column.created_at_us.desc(), column.job_id.desc())
        return [_job_of(row) for row in self._database.fetch(query.order_by(*newest_first).limit(limit))]

    def _is_free(self, holder: str) -> ColumnElement[bool]:
        """Return the condition that a job is a holder's or nobody's."""
        live = select(live_member.c.member_id)
        # what a process on a file has left is freed when the next one leads
        has_ended = false() if self._database.leases.member is None else job_table.c.member_id.not_in(live)
        return or_(job_table.c.holder.is_(None), job_table.c.holder == holder, has_ended)

    def _changed(self, statement: Any) -> bool:
        return int(self._database.write(lambda connection: connection.execute(statement).rowcount)) > 0


def _is_run_by(job_id: str, holder: str) -> ColumnElement[bool]:
    column = job_table.c
    return and_(column.job_id == job_id, column.holder == holder, column.state == JobState.RUNNING.value)


def insert_job(connection: Connection, record: Job, most: int | None, holder: str | None = None) -> None:
    """Store a job; BusyError where so many of its kind are unfinished already."""
    if most is not None:
        is_such = (job_table.c.kind == record.kind, job_table.c.state.in_(_UNFINISHED))
        count = connection.scalar(select(func.count()).select_from(job_table).where(*is_such)) or 0
        if count >= most:
            raise BusyError(_BUSY_CODES[JobKind(record.kind)], f"{count} {record.kind}s wait or run already")
    values = asdict(record) | {"state": record.state.value, "holder": holder}
    values["priority"] = PRIORITIES.get(record.kind, max(PRIORITIES.values()))
    values["job_id"] = values.pop("id")
    try:
        connection.execute(job_table.insert().values(values))
    except IntegrityError as fault:
        raise ConflictError("job.exists", f"Job {record.id!r} exists already.") from fault


def _fail_draft(connection: Connection, spacecraft_id: str, calibration_id: int, error: str) -> None:
    """Mark a draft that has no result as failed."""
    column = calibration_table.c
    key = select(spacecraft.c.spacecraft_key).where(spacecraft.c.id == spacecraft_id).scalar_subquery()
    is_draft = (column.state == CalibrationState.DRAFT.value, column.result.is_(None))
    is_it = (column.spacecraft_key == key, column.calibration_id == calibration_id)
    failed = {"state": CalibrationState.FAILED.value, "error": error}
    connection.execute(update(calibration_table).where(*is_it, *is_draft).values(failed))


def _job_of(row: Row[Any]) -> Job:
    job_id, kind, state, *rest = tuple(row)[: len(fields(Job))]
    return Job(job_id, kind, JobState(state), *rest)


def _no_job(job_id: str) -> NotFoundError:
    return NotFoundError("job.unknown", f"There is no job {job_id!r}.")


#: latest ones that are kept beside those of days: one an hour, so that one is older than smoothed rows need, 125 min
LATEST = 4
_DAY_US = 86_400_000_000


def store_checkpoint(connection: Connection, key: int, version: str, made: Checkpoint) -> None:
    """Store a checkpoint in the transaction of the results before it, and drop those that it makes needless."""
    table = checkpoint_table
    is_own = and_(table.c.spacecraft_key == key, table.c.version == version)
    rows = connection.execute(select(table.c.number, table.c.epoch_us).where(is_own).order_by(table.c.number)).all()
    # a chain that was brought back may pass the same entry again
    needless = [row.number for row in rows if row.number >= made.number or version != LIVE]
    older = [(row.number, row.epoch_us) for row in rows if row.number < made.number]
    # an older one counts only as the last of its day
    needless += [
        number
        for (number, epoch_us), (_, next_us) in pairwise(older[: len(older) - LATEST + 2])
        if epoch_us // _DAY_US == next_us // _DAY_US
    ]
    if needless:
        connection.execute(delete(table).where(is_own, table.c.number.in_(needless)))
    connection.execute(table.insert().values(spacecraft_key=key, version=version, **asdict(made)))


def checkpoints(
    database: Database, key: int, version: str, fingerprint: str, until_number: int, before_us: int | None = None
) -> Iterator[Checkpoint]:
    """Yield the checkpoints of a version up to a journal number, newest first; damaged ones are left out."""
    table, number = checkpoint_table, until_number + 1
    is_before = true() if before_us is None else table.c.epoch_us < before_us
    while True:
        is_own = (table.c.spacecraft_key == key, table.c.version == version)
        is_fit = (table.c.fingerprint == fingerprint, table.c.number < number, is_before)
        row = database.fetch_one(select(table).where(*is_own, *is_fit).order_by(table.c.number.desc()).limit(1))
        if row is None:
            return
        number = row.number
        if agrees(table, row):
            yield Checkpoint(row.number, row.epoch_us, row.fingerprint, row.content)
