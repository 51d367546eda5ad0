"""Backups: a consistent copy of an archive while the service runs, and the proof that a copy is whole.

A backup is a folder with two files: ``archive.db``, a SQLite archive, and ``manifest.json``, which tells what it must
hold. It gets its name when it is complete. SQLite is copied page by page inside one read transaction, so writers go on
and the copy is one state; PostgreSQL is copied row by row inside one REPEATABLE READ transaction into a SQLite
archive. That needs no ``pg_dump`` of the server's version, and the same backup can be put back on either database.
"""

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import ColumnElement, Connection, column, func, inspect, select, table, text

from db.connection.engines import open_engines
from db.connection.sqlite_files import Progress, flush, reading_engine, settle, sha256_of, sqlite_path
from db.connection.storage_state import newest_revision
from db.maintenance.integrity_check import OLDER, examine
from db.maintenance.table_copy import copy_tables
from db.measurements.checksum_check import damage_of
from db.migrations.migrate import upgrade
from db.schema.schema_version import version_of
from service.records.storage.backup import BackupError, Manifest, SpacecraftCount, parse_manifest
from service.records.storage.diagnosis import Diagnosis

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
        The folder exists, or there is nothing to copy.
    """
    if folder.exists():
        message = f"{folder} exists: a backup never overwrites one; choose another name"
        raise BackupError(message)
    with _unfinished_backups(folder) as partial:
        archive = partial / ARCHIVE_FILE
        kind = _copy(url, archive, lambda share: report("copy", share))
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
        found += [_of_backup(diagnosis) for diagnosis in examine(connection, lambda _: None)]
        report("content", 1.0)
    return found


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of a backup; BackupError."""
    path = folder / MANIFEST_FILE
    if not path.is_file():
        message = f"{folder} is no backup: there is no {MANIFEST_FILE} in it"
        raise BackupError(message)
    return parse_manifest(path.read_text(encoding="utf-8"))


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
    _copy_pages(path, archive, progress)
    return "sqlite"


def _copy_pages(path: Path, archive: Path, progress: Progress) -> None:
    """Copy a SQLite file as one transaction sees it."""
    source = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, isolation_level=None)
    target = sqlite3.connect(archive, isolation_level=None)
    archive.chmod(0o600)
    try:
        # a transaction that is open already is the one that every step reads in: writers cannot make it begin again
        source.execute("BEGIN")
        if not source.execute("SELECT count(*) FROM sqlite_schema WHERE name = 'alembic_version'").fetchone()[0]:
            message = f"{path} holds no archive"
            raise BackupError(message)
        target.execute("PRAGMA synchronous=OFF")
        source.backup(target, pages=_PAGES, progress=lambda _, left, total: progress(1 - left / max(total, 1)))
    except sqlite3.Error as fault:
        message = f"{path} cannot be copied: {fault}; `soo doctor` says what is wrong with it"
        raise BackupError(message) from fault
    finally:
        target.close()
        source.close()


def _copy_rows(url: str, archive: Path, progress: Progress) -> None:
    """Copy a PostgreSQL archive as one transaction sees it."""
    source, target = open_engines(url), open_engines(f"sqlite:///{archive}")
    try:
        with source.read.connect() as reading:
            version = version_of(reading)
            if version != newest_revision():
                message = f"the schema is {version}, this version copies {newest_revision()}: start `soo serve` once"
                raise BackupError(message)
            upgrade(target.write)
            archive.chmod(0o600)
            with target.write.begin() as writing:
                copy_tables(reading, writing, progress)
    finally:
        target.dispose()
        source.dispose()


def _described(archive: Path, kind: str, made_at_us: int, report: Report) -> Manifest:
    """Return the manifest of a file that nobody writes any more."""
    digest = sha256_of(archive, lambda share: report("sha256", share))
    report("checksums", 0.0)
    with reading_engine(archive, is_settled=True).connect() as connection:
        # an older schema has no checksums
        has_checksums = version_of(connection) == newest_revision()
        return Manifest(
            damaged=damage_of(connection) if has_checksums else [],
            made_at_us=made_at_us,
            made_from=kind,
            schema_version=version_of(connection) or "",
            file=ARCHIVE_FILE,
            size_bytes=archive.stat().st_size,
            sha256=digest,
            tables=_rows_of_tables(connection),
            spacecraft=_rows_of_spacecraft(connection),
        )


def _rows_of_tables(connection: Connection) -> dict[str, int]:
    """Return how many rows each table holds, whatever the schema."""
    names = sorted(inspect(connection).get_table_names())
    return {name: int(connection.scalar(select(func.count()).select_from(table(name))) or 0) for name in names}


def _rows_of_spacecraft(connection: Connection) -> dict[str, SpacecraftCount]:
    """Return the row counts of each spacecraft, in any schema."""
    inspector = inspect(connection)
    tables = [
        name
        for name in sorted(inspector.get_table_names())
        if any(each["name"] == "spacecraft_key" for each in inspector.get_columns(name))
    ]
    heads = connection.execute(
        text(
            "SELECT spacecraft_key, id, newest_number, consumed_number, newest_epoch_us, result_sequence "
            "FROM spacecraft JOIN head USING (spacecraft_key) ORDER BY id"
        )
    ).all()
    rows: dict[int, dict[str, int]] = {head.spacecraft_key: dict.fromkeys(tables, 0) for head in heads}
    for name in tables:
        of_spacecraft: ColumnElement[int] = column("spacecraft_key")
        for key, count in connection.execute(
            select(of_spacecraft, func.count()).select_from(table(name)).group_by(of_spacecraft)
        ):
            rows.get(key, {})[name] = count
    return {
        head.id: SpacecraftCount(
            newest_number=head.newest_number,
            consumed_number=head.consumed_number,
            newest_epoch_us=head.newest_epoch_us,
            result_sequence=head.result_sequence,
            rows=rows[head.spacecraft_key],
        )
        for head in heads
    }


def _same_bytes(manifest: Manifest, archive: Path, report: Report) -> Diagnosis:
    """Compare the file with the manifest."""
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


def _of_backup(diagnosis: Diagnosis) -> Diagnosis:
    """Return a diagnosis of the archive as one of its backup: an older schema is none of its faults."""
    check, state, detail = diagnosis.check, diagnosis.state, diagnosis.detail
    if check == "schema" and detail.endswith(OLDER):
        return Diagnosis(check, "ok", f"{detail}; a restore migrates it and looks at its content then")
    return Diagnosis(
        check, state, detail, "Use another backup, and check the archive with `soo doctor`." if diagnosis.advice else ""
    )
