"""Backups: a consistent copy of an archive while the service runs, and the proof that a copy is whole.

A backup is a folder with two files: ``archive.db``, a SQLite archive, and ``manifest.json``, which tells what it must
hold. It gets its name when it is complete. SQLite is copied page by page inside one read transaction, so writers go on
and the copy is one state; PostgreSQL is copied row by row inside one REPEATABLE READ transaction into a SQLite
archive. That needs no ``pg_dump`` of the server's version, and the same backup can be put back on either database.

Putting a backup back: checked first, copied aside, swapped in at the end; what was there stays beside it.

On SQLite the old file keeps its content under a name with the time. On PostgreSQL the old tables move into a schema
with the time in its name, in the very transaction that brings the restored ones: a reader sees one or the other.
"""

import json
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import Connection, Integer, Table, func, select, text
from sqlalchemy.exc import SQLAlchemyError

from db.connection.engines import (
    COMPANIONS,
    Progress,
    copy_file,
    flush,
    open_engines,
    reading_engine,
    settle,
    sha256_of,
    sqlite_path,
)
from db.maintenance.integrity_check import damage_of, examine, examine_content
from db.tables import LAYOUT, archive_layout, create_tables, head, layout_of, metadata, refusal, spacecraft
from service.records.storage import BackupError, Diagnosis, Manifest, SpacecraftCount, sqlite_url, worst

_ROWS = 2000
#: rows with large blobs are held few at a time
_ROWS_OF_BLOBS = 100
_BLOB_TABLES = frozenset({"checkpoint", "segment", "summary", "trace"})


def copy_tables(source: Connection, target: Connection, progress: Progress) -> None:
    """Copy every row of every table into empty tables."""
    tables = metadata.sorted_tables
    total = sum(source.scalar(select(func.count()).select_from(table)) or 0 for table in tables) or 1
    done = 0
    for table in tables:
        for rows in _pages(source, table):
            target.execute(table.insert(), rows)
            done += len(rows)
            progress(done / total)
        if target.dialect.name == "postgresql":
            _move_sequence(target, table)


def _pages(source: Connection, table: Table) -> Iterator[list[dict[str, Any]]]:
    """Yield the rows of a table, some at a time."""
    at_once = _ROWS_OF_BLOBS if table.name in _BLOB_TABLES else _ROWS
    options = {"stream_results": True, "max_row_buffer": at_once}
    result = source.execute(select(table), execution_options=options)
    for rows in result.partitions(at_once):
        yield [dict(row._mapping) for row in rows]  # noqa: SLF001 - SQLAlchemy's public name


def _move_sequence(target: Connection, table: Table) -> None:
    """Let the numbers that PostgreSQL gives go on behind those that were copied."""
    column = table.autoincrement_column
    if column is None or not isinstance(column.type, Integer):
        return
    name = target.scalar(select(func.pg_get_serial_sequence(table.name, column.name)))
    if name is not None:
        newest = target.scalar(select(func.max(column)))
        target.execute(select(func.setval(name, newest or 1, newest is not None)))


ARCHIVE_FILE, MANIFEST_FILE = "archive.db", "manifest.json"
#: 8 MiB a step, between which the progress is told
_PAGES = 2048

#: told which step is done by which share
Report = Callable[[str, float], None]


def create_backup(url: str, folder: Path, made_at_us: int, report: Report) -> Manifest:
    """Make a backup and return what it holds.

    Parameters
    ----------
    url : str
        Archive; the service may be running on it.
    folder : Path
        Becomes the backup; must not exist.
    made_at_us : int
        Present, microseconds UTC.
    report : callable
        Told the progress.

    Raises
    ------
    BackupError
        The folder exists, or there is no archive of this layout to copy.
    """
    if folder.exists():
        message = f"{folder} exists: a backup never overwrites one; choose another name"
        raise BackupError(message)
    with _unfinished_backups(folder) as partial:
        archive = partial / ARCHIVE_FILE
        kind = _copy(url, archive, lambda share: report("copy", share))
        # what is made from it is another service, where nobody is signed in
        with closing(sqlite3.connect(archive)) as connection, connection:
            connection.execute("DELETE FROM browser_session")
            connection.execute("UPDATE archive_layout SET service_id = lower(hex(randomblob(8)))")
        settle(archive)
        manifest = _described(archive, kind, made_at_us, report)
        (partial / MANIFEST_FILE).write_text(manifest.as_text(), encoding="utf-8")
        flush(partial / MANIFEST_FILE)
    return manifest


def verify_backup(folder: Path, report: Report) -> list[Diagnosis]:
    """Return the findings on a backup; the backup is not changed.

    Raises
    ------
    BackupError
        The folder is no backup.
    """
    manifest = read_manifest(folder)
    archive = folder / manifest.file
    found = [_same_bytes(manifest, archive, report)]
    if found[0].state == "fault":
        return found
    engine = reading_engine(archive, is_settled=True)
    with engine.connect() as connection:
        report("counts", 0.0)
        found.append(_same_counts(manifest, connection))
        report("content", 0.0)
        found += [
            replace(each, advice=each.advice and "Use another backup, and check the archive with `soo doctor`.")
            for each in examine(connection, lambda _: None)
        ]
        report("content", 1.0)
    return found


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of a backup; BackupError unless it is of this layout."""
    path = folder / MANIFEST_FILE
    if not path.is_file():
        message = f"{folder} is no backup: there is no {MANIFEST_FILE} in it"
        raise BackupError(message)
    try:
        document: Any = json.loads(path.read_text(encoding="utf-8"))
        if document.get("layout") != LAYOUT:
            raise BackupError(refusal(document.get("layout", 0), "backup"))
        counts = {name: SpacecraftCount(**count) for name, count in document.pop("spacecraft").items()}
        return Manifest(spacecraft=counts, **document)
    except (ValueError, KeyError, TypeError, AttributeError) as fault:
        message = f"the manifest cannot be read: {fault}"
        raise BackupError(message) from fault


@contextmanager
def _unfinished_backups(folder: Path) -> Iterator[Path]:
    """Give a folder to fill; it gets its name when all of it is on the disk, and goes when anything fails."""
    partial = folder.with_name(f".{folder.name}.partial")
    # what an interrupted run has left
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(mode=0o700, parents=True)
    try:
        yield partial
        flush(partial)
        partial.rename(folder)
        flush(folder.parent)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def _copy(url: str, archive: Path, progress: Progress) -> str:
    """Copy an archive into a new file and return where it was kept."""
    path = sqlite_path(url)
    if path is None:
        _copy_rows(url, archive, progress)
        return "postgresql"
    if not path.is_file():
        message = f"there is no archive {path}"
        raise BackupError(message)
    try:
        with reading_engine(path).connect() as reading:
            _demand_layout(reading)
        _copy_pages(path, archive, progress)
    except (sqlite3.Error, SQLAlchemyError) as fault:
        message = f"{path} cannot be copied: {getattr(fault, 'orig', fault)}; `soo doctor` says what is wrong with it"
        raise BackupError(message) from fault
    return "sqlite"


def _demand_layout(archive: Connection) -> None:
    """Raise BackupError unless this is an archive of the layout of this program."""
    layout = layout_of(archive)
    if layout != LAYOUT:
        message = "the database holds no archive" if layout is None else refusal(layout)
        raise BackupError(message)


def _copy_pages(path: Path, archive: Path, progress: Progress) -> None:
    """Copy a SQLite file as one transaction sees it."""
    reading = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, isolation_level=None)
    with closing(reading) as source, closing(sqlite3.connect(archive, isolation_level=None)) as target:
        archive.chmod(0o600)
        # a transaction that is open already is the one that every step reads in: writers cannot make it begin again
        source.execute("BEGIN")
        # the lock of that transaction comes with its first look
        source.execute("SELECT count(*) FROM sqlite_schema")
        target.execute("PRAGMA synchronous=OFF")
        source.backup(target, pages=_PAGES, progress=lambda _, left, total: progress(1 - left / max(total, 1)))


def _copy_rows(url: str, archive: Path, progress: Progress) -> None:
    """Copy a PostgreSQL archive as one transaction sees it."""
    source, target = open_engines(url), open_engines(sqlite_url(str(archive)))
    try:
        with source.read.connect() as reading:
            _demand_layout(reading)
            with target.write.begin() as writing:
                create_tables(writing)
                copy_tables(reading, writing, progress)
    finally:
        target.dispose()
        source.dispose()


def _described(archive: Path, kind: str, made_at_us: int, report: Report) -> Manifest:
    """Return the manifest of a file that nobody writes any more."""
    digest = sha256_of(archive, lambda share: report("sha256", share))
    report("checksums", 0.0)
    with reading_engine(archive, is_settled=True).connect() as connection:
        return Manifest(
            damaged=damage_of(connection),
            made_at_us=made_at_us,
            made_from=kind,
            layout=LAYOUT,
            file=ARCHIVE_FILE,
            size_bytes=archive.stat().st_size,
            sha256=digest,
            tables=_rows_of_tables(connection),
            spacecraft=_rows_of_spacecraft(connection),
        )


def _rows_of_tables(connection: Connection) -> dict[str, int]:
    """Return how many rows each table holds."""
    return {
        name: connection.scalar(select(func.count()).select_from(table)) or 0
        for name, table in sorted(metadata.tables.items())
    }


def _rows_of_spacecraft(connection: Connection) -> dict[str, SpacecraftCount]:
    tables = {name: table for name, table in sorted(metadata.tables.items()) if "spacecraft_key" in table.c}
    query = select(head, spacecraft.c.id).join(spacecraft).order_by(spacecraft.c.id)
    heads = connection.execute(query).all()
    rows: dict[int, dict[str, int]] = {each.spacecraft_key: dict.fromkeys(tables, 0) for each in heads}
    for name, table in tables.items():
        key = table.c.spacecraft_key
        for of_spacecraft, count in connection.execute(select(key, func.count()).group_by(key)):
            rows.get(of_spacecraft, {})[name] = count
    return {
        each.id: SpacecraftCount(
            newest_number=each.newest_number,
            consumed_number=each.consumed_number,
            newest_epoch_us=each.newest_epoch_us,
            result_sequence=each.result_sequence,
            rows=rows[each.spacecraft_key],
        )
        for each in heads
    }


def _same_bytes(manifest: Manifest, archive: Path, report: Report) -> Diagnosis:
    advice = "This backup was changed or is incomplete; use another one."
    if not archive.is_file():
        return Diagnosis("file", "fault", f"{manifest.file} is not there", advice)
    size = archive.stat().st_size
    if size != manifest.size_bytes:
        return Diagnosis("file", "fault", f"{size} bytes, the manifest says {manifest.size_bytes}", advice)
    if sha256_of(archive, lambda share: report("sha256", share)) != manifest.sha256:
        return Diagnosis("file", "fault", "the SHA-256 is not that of the manifest", advice)
    return Diagnosis("file", "ok", f"{size} bytes, the SHA-256 agrees")


def _same_counts(manifest: Manifest, connection: Connection) -> Diagnosis:
    """Compare counts and newest numbers with the manifest."""
    differing = [
        f"{name}: {manifest.tables.get(name)} in the manifest, {count} in the file"
        for name, count in _rows_of_tables(connection).items()
        if manifest.tables.get(name) != count
    ]
    if differing or _rows_of_spacecraft(connection) != manifest.spacecraft:
        detail = "; ".join(differing) or "counts of a spacecraft are not those of the manifest"
        return Diagnosis("manifest", "fault", detail, "This backup was changed; use another one.")
    rows = sum(manifest.tables.values())
    return Diagnosis("manifest", "ok", f"{rows} rows of {len(manifest.spacecraft)} spacecraft, as the manifest says")


_OURS = text(
    "SELECT c.relname FROM pg_class c JOIN pg_namespace n ON n.oid = c.relnamespace "
    "WHERE n.nspname = current_schema() AND c.relkind = 'r' AND c.relname = ANY(:names)"
)
_FUNCTIONS = text(
    "SELECT DISTINCT p.proname FROM pg_trigger t JOIN pg_proc p ON p.oid = t.tgfoid "
    "JOIN pg_class c ON c.oid = t.tgrelid JOIN pg_namespace n ON n.oid = c.relnamespace "
    "WHERE NOT t.tgisinternal AND n.nspname = current_schema() AND c.relname = ANY(:names)"
)
_OTHERS = text(
    "SELECT count(*) FROM pg_stat_activity WHERE datname = current_database() "
    "AND pid <> pg_backend_pid() AND backend_type = 'client backend'"
)


class Restored(NamedTuple):
    """Result of a restore."""

    manifest: Manifest
    #: name under which the former archive is kept, None when there was none
    aside: str | None


def restore_backup(folder: Path, url: str, stamp: str, report: Report, *, may_replace: bool) -> Restored:
    """Put a backup in the place of an archive.

    Parameters
    ----------
    folder : Path
        The backup.
    url : str
        Where the archive is to stand; nobody may be using it.
    stamp : str
        Becomes part of the name under which what was there is kept.
    report : callable
        Told the progress.
    may_replace : bool
        Whether an archive that is there may be moved aside.

    Raises
    ------
    BackupError
        The backup is not sound or of another layout, an archive is there and may not be replaced, or it is in use.
    """
    manifest = read_manifest(folder)
    _demand_sound(manifest, verify_backup(folder, report), "the backup is not sound")
    path = sqlite_path(url)
    if path is not None:
        return _to_file(folder, manifest, path, stamp, report, may_replace=may_replace)
    return _to_server(folder, manifest, url, stamp, report, may_replace=may_replace)


def _to_file(
    folder: Path, manifest: Manifest, path: Path, stamp: str, report: Report, *, may_replace: bool
) -> Restored:
    if path.exists() and not may_replace:
        message = f"there is an archive {path}; --replace moves it aside"
        raise BackupError(message)
    work = path.with_name(f".{path.name}.restoring")
    try:
        _remove(work)
        copy_file(folder / manifest.file, work, lambda share: report("copy", share))
        if sha256_of(work, lambda share: report("sha256 of the copy", share)) != manifest.sha256:
            message = f"the copy {work} differs from the backup: check the disk"
            raise BackupError(message)
        flush(work)
        aside = _moved_aside(path, stamp) if path.exists() else None
        work.replace(path)
        flush(path.parent)
    finally:
        _remove(work)
    return Restored(manifest, None if aside is None else str(aside))


def _moved_aside(path: Path, stamp: str) -> Path:
    """Keep an archive under another name, without ever being without a file under its own."""
    aside = path.with_name(f"{path.name}.before-{stamp}")
    try:
        # succeeds only for who is alone, and leaves one file
        settle(path)
    except sqlite3.OperationalError as fault:
        if "locked" in str(fault):
            message = f"{path} is in use: stop the service first"
            raise BackupError(message) from fault
    except sqlite3.DatabaseError:
        # a damaged archive is moved as it is
        pass
    for ending in COMPANIONS:
        companion = path.with_name(path.name + ending)
        if companion.exists():
            companion.replace(aside.with_name(aside.name + ending))
    aside.hardlink_to(path)
    return aside


def _to_server(
    folder: Path, manifest: Manifest, url: str, stamp: str, report: Report, *, may_replace: bool
) -> Restored:
    source, target = reading_engine(folder / manifest.file, is_settled=True), open_engines(url)
    try:
        with source.connect() as reading, target.write.begin() as writing:
            # tables are moved, and a reader of them is not waited for without end
            writing.execute(text("SET LOCAL lock_timeout = '30s'"))
            aside = _tables_aside(writing, stamp, may_replace=may_replace)
            create_tables(writing)
            copy_tables(reading, writing, lambda share: report("tables", share))
            found = examine_content(writing, lambda name: report(name, 0.0))
            _demand_sound(manifest, found, "the restored tables are not sound")
    finally:
        source.dispose()
        target.dispose()
    return Restored(manifest, aside)


def _tables_aside(connection: Connection, stamp: str, *, may_replace: bool) -> str | None:
    """Move the tables of an archive into a schema of their own and return its name, None when there are none."""
    names = [*metadata.tables, archive_layout.name]
    tables = list(connection.scalars(_OURS, {"names": names}))
    if not tables:
        return None
    if not may_replace:
        message = "the database holds an archive; --replace moves its tables aside"
        raise BackupError(message)
    if connection.scalar(_OTHERS):
        message = "the database is in use: stop the service first"
        raise BackupError(message)
    aside = f"soo_before_{stamp}".lower()
    functions = list(connection.scalars(_FUNCTIONS, {"names": names}))
    connection.execute(text(f'CREATE SCHEMA "{aside}"'))
    for table in tables:
        connection.execute(text(f'ALTER TABLE "{table}" SET SCHEMA "{aside}"'))
    for function in functions:
        connection.execute(text(f'ALTER FUNCTION "{function}"() SET SCHEMA "{aside}"'))
    return f"schema {aside}"


def _demand_sound(manifest: Manifest, found: list[Diagnosis], what: str) -> None:
    """Raise BackupError with the first fault, if there is one.

    Rows that were damaged when the backup was made are put back as they are: all else would be lost with them.
    """
    found = [each for each in found if not (manifest.damaged and each.check == "checksums")]
    if worst(found) == "fault":
        fault = next(diagnosis for diagnosis in found if diagnosis.state == "fault")
        message = f"{what}: {fault.check}: {fault.detail}"
        raise BackupError(message)


def _remove(work: Path) -> None:
    """Remove a working copy with what SQLite keeps beside it."""
    for ending in ("", *COMPANIONS):
        work.with_name(work.name + ending).unlink(missing_ok=True)
