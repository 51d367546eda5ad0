"""Putting a backup back: checked first, copied aside, swapped in at the end; what was there stays beside it.

On SQLite the old file keeps its content under a name with the time. On PostgreSQL the old tables move into a schema
with the time in its name, in the very transaction that brings the restored ones: a reader sees one or the other.
"""

import sqlite3
from pathlib import Path
from typing import NamedTuple

from sqlalchemy import Connection, text

from db.connection.engines import (
    COMPANIONS,
    copy_file,
    flush,
    open_engines,
    reading_engine,
    settle,
    sha256_of,
    sqlite_path,
)
from db.maintenance.backup import Report, read_manifest, verify_backup
from db.maintenance.integrity_check import examine_content
from db.maintenance.table_copy import copy_tables
from db.schema.layout import archive_layout, create_tables
from db.schema.tables import metadata
from service.records.storage import BackupError, Diagnosis, Manifest, worst

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
