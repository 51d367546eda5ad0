"""Jobs and replays, a part of ``service.ports.Results``."""

from dataclasses import asdict, replace

from sqlalchemy import Connection, select, update
from sqlalchemy.exc import IntegrityError

from db.database import Repository, lock_head, next_id
from db.encoding.json_documents import decode, encode
from db.schema.tables import calibration as calibration_table
from db.schema.tables import job as job_table
from db.schema.tables import replay as replay_table
from service.errors import ConflictError, NotFoundError
from service.records.calibration import CalibrationState
from service.records.operations.job import Job, JobState, Replay

_UNFINISHED = (JobState.QUEUED.value, JobState.RUNNING.value)


class SqlJobs(Repository):
    """Jobs and replays in a relational database."""

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
        """Mark jobs that a former process left queued or running as failed, and their drafts; return how many jobs."""
        jobs = update(job_table).where(job_table.c.state.in_(_UNFINISHED))
        is_draft = calibration_table.c.state == CalibrationState.DRAFT.value
        drafts = update(calibration_table).where(is_draft, calibration_table.c.result.is_(None))

        def change(connection: Connection) -> int:
            connection.execute(drafts.values(state=CalibrationState.FAILED.value, error=error))
            return connection.execute(jobs.values(state=JobState.FAILED.value, error=error)).rowcount

        return self._database.write(change)

    def add_replay(self, spacecraft_id: str, replay: Replay) -> Replay:
        """Store a replay (its id is ignored) and return it with its id."""
        key = self._database.key(spacecraft_id)
        return self._database.write(lambda connection: _insert_replay(connection, key, replay))

    def replay(self, spacecraft_id: str, version: str) -> Replay:
        """Return the replay that wrote a version."""
        key = self._database.key(spacecraft_id)
        number = version.removeprefix("replay-")
        query = select(replay_table.c.document).where(replay_table.c.spacecraft_key == key)
        if version != number and number.isascii() and number.isdecimal() and len(number) < 10:
            row = self._database.fetch_one(query.where(replay_table.c.replay_id == int(number)))
            if row is not None and (found := decode(Replay, row.document)).version == version:
                return found
        raise NotFoundError("replay.unknown", f"There is no version {version[:60]!r} of {spacecraft_id!r}.")


def _insert_job(connection: Connection, record: Job) -> None:
    values = asdict(record) | {"state": record.state.value}
    values["job_id"] = values.pop("id")
    try:
        connection.execute(job_table.insert().values(values))
    except IntegrityError as fault:
        raise ConflictError("job.exists", f"Job {record.id!r} exists already.") from fault


def _insert_replay(connection: Connection, key: int, record: Replay) -> Replay:
    lock_head(connection, key)
    stored = replace(record, id=next_id(connection, replay_table, "replay_id", key))
    values = {"spacecraft_key": key, "replay_id": stored.id, "document": encode(stored)}
    connection.execute(replay_table.insert().values(values))
    return stored


def _no_job(job_id: str) -> NotFoundError:
    return NotFoundError("job.unknown", f"There is no job {job_id!r}.")
