"""Backups: a consistent copy of an archive while the service runs, and the proof that a copy is whole.

A backup is a folder with two files: ``archive.db``, a SQLite archive, and ``manifest.json``, which tells what it must
hold. It gets its name when it is complete. SQLite is copied page by page inside one read transaction, so writers go on
and the copy is one state; PostgreSQL is copied row by row inside one REPEATABLE READ transaction into a SQLite
archive. That needs no ``pg_dump`` of the server's version, and the same backup can be put back on either database.
"""

import json
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from sqlalchemy import Connection, func, select
from sqlalchemy.exc import SQLAlchemyError

from db.connection.engines import Progress, flush, open_engines, reading_engine, settle, sha256_of, sqlite_path
from db.maintenance.integrity_check import examine
from db.maintenance.table_copy import copy_tables
from db.measurements.checksum_check import damage_of
from db.schema.layout import LAYOUT, create_tables, layout_of, refusal
from db.schema.tables import head, metadata, spacecraft
from service.records.storage import BackupError, Diagnosis, Manifest, SpacecraftCount

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
    source = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, isolation_level=None)
    target = sqlite3.connect(archive, isolation_level=None)
    archive.chmod(0o600)
    try:
        # a transaction that is open already is the one that every step reads in: writers cannot make it begin again
        source.execute("BEGIN")
        # the lock of that transaction comes with its first look
        source.execute("SELECT count(*) FROM sqlite_schema")
        target.execute("PRAGMA synchronous=OFF")
        source.backup(target, pages=_PAGES, progress=lambda _, left, total: progress(1 - left / max(total, 1)))
    finally:
        target.close()
        source.close()


def _copy_rows(url: str, archive: Path, progress: Progress) -> None:
    """Copy a PostgreSQL archive as one transaction sees it."""
    source, target = open_engines(url), open_engines(f"sqlite:///{archive}")
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
    """Return the row counts of each spacecraft."""
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
