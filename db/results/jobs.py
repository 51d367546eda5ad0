"""Jobs and checkpoints."""

from collections.abc import Collection, Iterator
from dataclasses import asdict
from functools import partial
from itertools import pairwise
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, and_, delete, func, not_, or_, select, true, update
from sqlalchemy.exc import IntegrityError

from db.database import Database, Repository
from db.schema.columns import agrees, checksum_of
from db.schema.tables import calibration as calibration_table
from db.schema.tables import checkpoint as checkpoint_table
from db.schema.tables import job as job_table
from db.schema.tables import live_member
from db.schema.tables import replay as replay_table
from service.errors import ConflictError, NotFoundError
from service.records.calibration import CalibrationState
from service.records.operations.work import Job, JobState
from service.records.storage import Checkpoint

_UNFINISHED = (JobState.QUEUED.value, JobState.RUNNING.value)


class SqlJobs(Repository):
    """Jobs in a relational database."""

    def add_job(self, job: Job) -> None:
        """Store a new job; ConflictError ``job.exists``."""
        # a job keeps the books of a change; the request's audit entry goes with the change itself
        member_id = self._database.leases.member
        self._database.submit(lambda connection: _insert_job(connection, job, member_id)).result()

    def update_job(self, job_id: str, state: JobState, progress: float, error: str | None = None) -> None:
        """Store how far a job is."""
        change = update(job_table).where(job_table.c.job_id == job_id)
        values = change.values(state=state.value, progress=progress, error=error)
        if self._database.write(lambda connection: connection.execute(values).rowcount) == 0:
            raise _no_job(job_id)

    def job(self, job_id: str) -> Job:
        """Return one job."""
        row = self._database.fetch_one(select(job_table).where(job_table.c.job_id == job_id))
        if row is None:
            raise _no_job(job_id)
        return _job_of(row)

    def newest_jobs(self, limit: int) -> list[Job]:
        """Return the jobs that were made last, newest first."""
        query = select(job_table).order_by(job_table.c.created_at_us.desc(), job_table.c.job_id.desc())
        return [_job_of(row) for row in self._database.fetch(query.limit(limit))]

    def fail_unfinished_jobs(self, error: str, but: Collection[str] = ()) -> int:
        """Mark jobs that a former process left unfinished as failed, and their drafts; return how many jobs.

        Those of replays stay: they go on from where they are. So do those named, and those of processes that live.
        """
        of_replay = select(replay_table.c.job_id).where(replay_table.c.job_id == job_table.c.job_id)
        unfinished = and_(job_table.c.state.in_(_UNFINISHED), not_(of_replay.exists()))
        is_draft = calibration_table.c.state == CalibrationState.DRAFT.value
        drafts = update(calibration_table).where(is_draft, calibration_table.c.result.is_(None))

        def change(connection: Connection) -> int:
            is_left = and_(unfinished, _is_left(connection), job_table.c.job_id.not_in(but))
            failed = connection.execute(
                update(job_table).where(is_left).values(state=JobState.FAILED.value, error=error)
            ).rowcount
            # a draft does not name its job: where one goes on, its draft may be any
            if connection.scalar(select(func.count()).select_from(job_table).where(unfinished)) == 0:
                connection.execute(drafts.values(state=CalibrationState.FAILED.value, error=error))
            return failed

        return self._database.write(change)

    def acquire_job(self, job_id: str) -> bool:
        """Make an unfinished job that of this process; False where it is another's that lives."""
        is_it = job_table.c.job_id == job_id
        mine = {"member_id": self._database.leases.member}

        def change(connection: Connection) -> bool:
            left = and_(is_it, _is_left(connection))
            return connection.execute(update(job_table).where(left).values(mine)).rowcount > 0

        return self._database.write(change)


def _is_left(connection: Connection) -> ColumnElement[bool]:
    """Return the condition that a job is not one of a process that lives."""
    if connection.dialect.name == "sqlite":
        return true()
    return or_(job_table.c.member_id.is_(None), job_table.c.member_id.not_in(select(live_member.c.member_id)))


def _insert_job(connection: Connection, record: Job, member_id: int | None) -> None:
    values = asdict(record) | {"state": record.state.value, "member_id": member_id}
    values["job_id"] = values.pop("id")
    try:
        connection.execute(job_table.insert().values(values))
    except IntegrityError as fault:
        raise ConflictError("job.exists", f"Job {record.id!r} exists already.") from fault


def _job_of(row: Row[Any]) -> Job:
    return Job(row.job_id, row.kind, JobState(row.state), row.progress, row.created_at_us, row.error)


def _no_job(job_id: str) -> NotFoundError:
    return NotFoundError("job.unknown", f"There is no job {job_id!r}.")


#: latest ones that are kept beside those of days: one an hour, so that one is older than smoothed rows need, 125 min
LATEST = 4
_DAY_US = 86_400_000_000


def store_checkpoint(connection: Connection, key: int, made: Checkpoint) -> None:
    """Store a checkpoint in the transaction of the results before it, and drop those that it makes needless."""
    table = checkpoint_table
    is_own = table.c.spacecraft_key == key
    rows = connection.execute(select(table.c.number, table.c.epoch_us).where(is_own).order_by(table.c.number)).all()
    # a chain that was brought back may pass the same entry again
    needless = [row.number for row in rows if row.number >= made.number]
    older = [(row.number, row.epoch_us) for row in rows if row.number < made.number]
    # an older one counts only as the last of its day
    needless += [
        number
        for (number, epoch_us), (_, next_us) in pairwise(older[: len(older) - LATEST + 2])
        if epoch_us // _DAY_US == next_us // _DAY_US
    ]
    if needless:
        connection.execute(delete(table).where(is_own, table.c.number.in_(needless)))
    values = {
        "spacecraft_key": key,
        "number": made.number,
        "epoch_us": made.epoch_us,
        "fingerprint": made.fingerprint,
        "content": made.content,
    }
    connection.execute(table.insert().values(values))


def checkpoints(
    database: Database, key: int, fingerprint: str, until_number: int, before_us: int | None
) -> Iterator[Checkpoint]:
    """Yield the checkpoints of a fingerprint up to a journal number, newest first; damaged ones are left out."""
    table, number = checkpoint_table, until_number + 1
    is_before = true() if before_us is None else table.c.epoch_us < before_us
    while True:
        is_fit = (table.c.spacecraft_key == key, table.c.fingerprint == fingerprint, table.c.number < number, is_before)
        row = database.fetch_one(select(table).where(*is_fit).order_by(table.c.number.desc()).limit(1))
        if row is None:
            return
        number = row.number
        values: Any = row._mapping  # noqa: SLF001 - SQLAlchemy's public name
        if agrees(row.checksum, partial(checksum_of, table, values)):
            yield Checkpoint(row.number, row.epoch_us, row.fingerprint, row.content)
