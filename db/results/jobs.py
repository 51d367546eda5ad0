"""Jobs, checkpoints, and replays with the versions of results that they wrote.

A job is one row: what is to be done, how far it is, and who does it. A process takes the open ones of the spacecraft
that it leads, in order of priority; the row says whose they are, so that no two processes run one.

A replay that is deleted is marked: from then on nothing reads its version or writes to it, and its number is not given
again. Its rows go afterwards, in short transactions.
"""

from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from functools import partial
from itertools import pairwise
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Select,
    and_,
    delete,
    false,
    func,
    not_,
    or_,
    select,
    true,
    update,
)
from sqlalchemy.exc import IntegrityError

from db.columns import agrees
from db.database import Database, Repository, next_id
from db.encoding.record_codec import decode, encode
from db.measurements.closed_days import ATTITUDE_BYTES, PARTS, TORQUE_BYTES, delete_some
from db.measurements.measurement_pages import MAX_NUMBER
from db.tables import calibration as calibration_table
from db.tables import checkpoint, live_member, spacecraft
from db.tables import checkpoint as checkpoint_table
from db.tables import job as job_table
from db.tables import replay as replay_table
from service.errors import BusyError, ConflictError, NotFoundError
from service.ports.archive import LIVE
from service.records.calibration import CalibrationState, Window
from service.records.operations.work import PRIORITIES, STANDING_KINDS, Job, JobKind, JobState, Replay, ReplayVersion
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


_FINISHED = (JobState.DONE, JobState.FAILED)
_SERIES = ("attitude", "torques")


class SqlReplays(Repository):
    """Replays in a relational database."""

    def add_replay(
        self,
        spacecraft_id: str,
        replay: Replay,
        job: Job | None = None,
        most: int | None = None,
        holder: str | None = None,
    ) -> Replay:
        """Store a replay (its id is ignored), with its job, and return it with its id."""

        def add(connection: Connection, key: int) -> Replay:
            stored = _insert_replay(connection, key, replay)
            if job is not None:
                insert_job(connection, replace(job, subject=stored.version), most, holder)
            return stored

        return self._change(spacecraft_id, add)

    def replay(self, spacecraft_id: str, version: str) -> ReplayVersion:
        """Return the replay that wrote a version, and what became of it."""
        key, number = self._database.key(spacecraft_id), number_of(version)
        row = None
        if number is not None:
            row = self._database.fetch_one(_versions(key).where(replay_table.c.replay_id == number))
        if row is None:
            raise _no_replay(spacecraft_id, version)
        return _version_of(row)

    def replays(
        self, spacecraft_id: str, window: Window, limit: int, after_id: int | None, *, newest_first: bool = False
    ) -> list[ReplayVersion]:
        """Return the replays whose span overlaps a window, beyond an id in order of id, or in the reverse order."""
        number = replay_table.c.replay_id
        query = _versions(self._database.key(spacecraft_id)).order_by(number.desc() if newest_first else number)
        if after_id is not None:
            query = query.where(number < after_id if newest_first else number > after_id)
        found = (_version_of(row) for row in self._database.fetch(query))
        inside = (
            each for each in found if each.replay.start_us < window.stop_us and window.start_us < each.replay.stop_us
        )
        return [each for each, _ in zip(inside, range(limit), strict=False)]

    def replay_checkpoint(self, spacecraft_id: str, version: str, fingerprint: str) -> Checkpoint | None:
        """Return the state from which a replay goes on; None when there is none that fits and is sound."""
        key = self._database.key(spacecraft_id)
        return next(checkpoints(self._database, key, version, fingerprint, MAX_NUMBER), None)

    def delete_replay(self, spacecraft_id: str, version: str) -> None:
        """Mark a replay as deleted; a job that still writes it ends at its next rows."""

        def mark(connection: Connection, key: int) -> None:
            is_it = _is_replay(key, number_of(version) or 0)
            marked = connection.execute(update(replay_table).where(is_it, _IS_HELD).values(is_deleted=True))
            if marked.rowcount == 0:
                raise _no_replay(spacecraft_id, version)
            is_state = (checkpoint.c.spacecraft_key == key, checkpoint.c.version == version)
            connection.execute(delete(checkpoint).where(*is_state))
            job_id = select(replay_table.c.job_id).where(is_it).scalar_subquery()
            is_open = job_table.c.state.not_in([state.value for state in _FINISHED])
            ended = {"state": JobState.FAILED.value, "error": f"{version} was deleted."}
            connection.execute(update(job_table).where(job_table.c.job_id == job_id, is_open).values(ended))

        self._change(spacecraft_id, mark)

    def drop_replays(self, spacecraft_id: str, created_before_us: int | None) -> Iterator[int]:
        """Delete finished replays made before an epoch, drop the rows of deleted ones, and yield how many a step."""
        key = self._database.key(spacecraft_id)
        return _dropped(self._database, spacecraft_id, self, key, created_before_us)


def number_of(version: str) -> int | None:
    """Return the number of the replay that writes a version; None for a text that names none."""
    number = version.removeprefix("replay-")
    is_number = version != number and number.isascii() and number.isdecimal() and len(number) < 10
    return int(number) if is_number and str(int(number)) == number else None


def note_rows(
    connection: Connection, key: int, version: str, attitude_rows: int, torque_rows: int, made: Checkpoint | None
) -> None:
    """Add to the count of what a replay wrote, and keep its state; ConflictError ``replay.deleted`` if it was."""
    number = number_of(version) or 0
    is_it = _is_replay(key, number)
    row = connection.execute(select(replay_table.c.is_deleted).where(is_it)).first()
    if row is not None and row.is_deleted:
        raise ConflictError("replay.deleted", f"{version} was deleted while it was computed.")
    columns = replay_table.c
    counts = {
        "attitude_rows": columns.attitude_rows + attitude_rows,
        "torque_rows": columns.torque_rows + torque_rows,
    }
    connection.execute(update(replay_table).where(is_it).values(counts))
    if made is not None:
        store_checkpoint(connection, key, version, made)


def check_held(connection: Connection, key: int, version: str) -> None:
    """Raise NotFoundError ``replay.unknown`` when a version was deleted, so that some of its rows may be gone."""
    number = number_of(version)
    is_deleted = select(replay_table.c.is_deleted)
    if number is not None and connection.scalar(is_deleted.where(_is_replay(key, number))):
        raise NotFoundError("replay.unknown", f"{version} was deleted.")


_IS_HELD = not_(replay_table.c.is_deleted)


def _is_replay(key: int, number: int) -> ColumnElement[bool]:
    return and_(replay_table.c.spacecraft_key == key, replay_table.c.replay_id == number)


def _versions(key: int) -> Select[Any]:
    """Return the query for the replays of a spacecraft that are not deleted, with their jobs."""
    columns = (replay_table.c.document, replay_table.c.attitude_rows, replay_table.c.torque_rows)
    of_job = (job_table.c.state, job_table.c.progress, job_table.c.error)
    joined = replay_table.outerjoin(job_table, replay_table.c.job_id == job_table.c.job_id)
    return select(*columns, *of_job).select_from(joined).where(replay_table.c.spacecraft_key == key, _IS_HELD)


def _version_of(row: Row[Any]) -> ReplayVersion:
    state = JobState.FAILED if row.state is None else JobState(row.state)
    size_bytes = ATTITUDE_BYTES * row.attitude_rows + TORQUE_BYTES * row.torque_rows
    return ReplayVersion(
        decode(Replay, row.document),
        state,
        row.progress or 0.0,
        row.error,
        row.attitude_rows,
        row.torque_rows,
        size_bytes,
    )


def _insert_replay(connection: Connection, key: int, record: Replay) -> Replay:
    stored = replace(record, id=next_id(connection, replay_table, "replay_id", key))
    values = {
        "spacecraft_key": key,
        "replay_id": stored.id,
        "document": encode(stored),
        "job_id": stored.job_id,
        "attitude_rows": 0,
        "torque_rows": 0,
        "is_deleted": False,
    }
    connection.execute(replay_table.insert().values(values))
    return stored


def _no_replay(spacecraft_id: str, version: str) -> NotFoundError:
    return NotFoundError("replay.unknown", f"There is no version {version[:60]!r} of {spacecraft_id!r}.")


def _dropped(
    database: Database, spacecraft_id: str, replays: SqlReplays, key: int, created_before_us: int | None
) -> Iterator[int]:
    """Yield how many rows each transaction took away."""
    if created_before_us is not None:
        for row in database.fetch(_versions(key)):
            found = _version_of(row)
            if found.state in _FINISHED and found.replay.created_at_us < created_before_us:
                replays.delete_replay(spacecraft_id, found.replay.version)
    columns = replay_table.c
    has_rows = or_(columns.attitude_rows > 0, columns.torque_rows > 0)
    waiting = select(columns.replay_id).where(columns.spacecraft_key == key, columns.is_deleted, has_rows)
    for row in database.fetch(waiting):
        for part in (part for series in _SERIES for part in PARTS[series]):
            is_its = part.table.c.version == f"replay-{row.replay_id}"
            step = partial(delete_some, key=key, part=part, may_go=is_its)
            while (rows := database.write(step)) > 0:
                yield rows
        emptied = update(replay_table).where(_is_replay(key, row.replay_id)).values(attitude_rows=0, torque_rows=0)
        database.write(partial(Connection.execute, statement=emptied))
