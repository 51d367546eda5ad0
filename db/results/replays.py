"""Replays and the versions of results that they wrote, a part of ``service.ports.Results``.

A replay that is deleted is marked: from then on nothing reads its version or writes to it, and its number is not given
again. Its rows go afterwards, in short transactions.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, and_, delete, not_, or_, select, update

from db.database import Database, Repository, lock_head, next_id
from db.encoding.record_codec import decode, encode
from db.measurements.measurement_pages import MAX_NUMBER
from db.measurements.retention import ATTITUDE_BYTES, PARTS, TORQUE_BYTES, delete_named
from db.results.jobs import checkpoints, insert_job, store_checkpoint
from db.schema.tables import checkpoint
from db.schema.tables import job as job_table
from db.schema.tables import replay as replay_table
from service.errors import ConflictError, NotFoundError
from service.records.calibration import Window
from service.records.operations.work import Job, JobState, Replay, ReplayVersion
from service.records.storage import Checkpoint

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
        key = self._database.key(spacecraft_id)

        def add(connection: Connection) -> Replay:
            stored = _insert_replay(connection, key, replay)
            if job is not None:
                insert_job(connection, replace(job, subject=stored.version), most, holder)
            return stored

        return self._database.write(add)

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
        key, number = self._database.key(spacecraft_id), number_of(version)
        is_it = _is_replay(key, number or 0)

        def mark(connection: Connection) -> None:
            lock_head(connection, key)
            marked = connection.execute(update(replay_table).where(is_it, _IS_HELD).values(is_deleted=True))
            if marked.rowcount == 0:
                raise _no_replay(spacecraft_id, version)
            is_state = (checkpoint.c.spacecraft_key == key, checkpoint.c.version == version)
            connection.execute(delete(checkpoint).where(*is_state))
            job_id = select(replay_table.c.job_id).where(is_it).scalar_subquery()
            is_open = job_table.c.state.not_in([state.value for state in _FINISHED])
            ended = {"state": JobState.FAILED.value, "error": f"{version} was deleted."}
            connection.execute(update(job_table).where(job_table.c.job_id == job_id, is_open).values(ended))

        self._database.write(mark)

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
    lock_head(connection, key)
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
            step = partial(_drop_some, key=key, version=f"replay-{row.replay_id}", part=part)
            while (rows := database.write(step)) > 0:
                yield rows
        emptied = update(replay_table).where(_is_replay(key, row.replay_id)).values(attitude_rows=0, torque_rows=0)
        database.write(partial(Connection.execute, statement=emptied))


def _drop_some(connection: Connection, *, key: int, version: str, part: Any) -> int:
    """Drop some rows of a version from a table and count them; 0 when there are none."""
    table = part.table
    is_its = (table.c.spacecraft_key == key, table.c.version == version, part.is_its)
    names = connection.execute(select(*part.key, part.rows).where(*is_its).limit(part.at_once)).all()
    delete_named(connection, key, table, part.key, names)
    return sum(int(name[-1]) for name in names)
