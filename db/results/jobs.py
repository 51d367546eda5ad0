"""Jobs, a part of ``service.ports.Results``."""

from dataclasses import asdict

from sqlalchemy import Connection, not_, select, update
from sqlalchemy.exc import IntegrityError

from db.database import Repository
from db.schema.tables import calibration as calibration_table
from db.schema.tables import job as job_table
from db.schema.tables import replay as replay_table
from service.errors import ConflictError, NotFoundError
from service.records.calibration import CalibrationState
from service.records.operations.job import Job, JobState

_UNFINISHED = (JobState.QUEUED.value, JobState.RUNNING.value)


class SqlJobs(Repository):
    """Jobs in a relational database."""

    def add_job(self, job: Job) -> None:
        """Store a new job; ConflictError ``job.exists``."""
        # a job keeps the books of a change; the request's audit entry goes with the change itself
        self._database.submit(lambda connection: _insert_job(connection, job)).result()

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
        return Job(row.job_id, row.kind, JobState(row.state), row.progress, row.created_at_us, row.error)

    def fail_unfinished_jobs(self, error: str) -> int:
        """Mark jobs that a former process left unfinished as failed, and their drafts; return how many jobs.

        Those of replays stay: they go on from where they are.
        """
        of_replay = select(replay_table.c.job_id).where(replay_table.c.job_id == job_table.c.job_id)
        jobs = update(job_table).where(job_table.c.state.in_(_UNFINISHED), not_(of_replay.exists()))
        is_draft = calibration_table.c.state == CalibrationState.DRAFT.value
        drafts = update(calibration_table).where(is_draft, calibration_table.c.result.is_(None))

        def change(connection: Connection) -> int:
            connection.execute(drafts.values(state=CalibrationState.FAILED.value, error=error))
            return connection.execute(jobs.values(state=JobState.FAILED.value, error=error)).rowcount

        return self._database.write(change)


def _insert_job(connection: Connection, record: Job) -> None:
    values = asdict(record) | {"state": record.state.value}
    values["job_id"] = values.pop("id")
    try:
        connection.execute(job_table.insert().values(values))
    except IntegrityError as fault:
        raise ConflictError("job.exists", f"Job {record.id!r} exists already.") from fault


def _no_job(job_id: str) -> NotFoundError:
    return NotFoundError("job.unknown", f"There is no job {job_id!r}.")
