"""Doctor of an archive, what is wrong with it and what to do; an operator's tools of an archive, over one URL."""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path

from sqlalchemy import ColumnElement, Connection, Engine, Table, func, select, text
from sqlalchemy.exc import SQLAlchemyError

from db.connection.engines import COMPANIONS, open_engines, reading_engine, sqlite_path, translated_faults
from db.connection.server_leases import leaders_of
from db.encoding.record_codec import decode, decode_all
from db.maintenance.backup import Report as BackupReport
from db.maintenance.backup import Restored, create_backup, restore_backup, verify_backup
from db.maintenance.integrity_check import Report, examine, guarded
from db.measurements.measurement_pages import compared_heads
from db.tables import (
    alarm,
    alignment,
    calibration,
    carrier_plan,
    checkpoint,
    ephemeris,
    head,
    measurement,
    spacecraft,
)
from service.errors import StorageError
from service.ports.archive import LIVE
from service.ports.storage import Clock
from service.records.calibration import Alignment, CalibrationRequest, CalibrationResult
from service.records.catalogue import Carrier, Ephemeris, Spacecraft
from service.records.epoch import US_PER_S, format_epoch
from service.records.inputs import JournalHead
from service.records.operations.alarms import Alarm
from service.records.storage import Diagnosis, Manifest

#: processor time of an entry, s: both methods and the torque for sixteen carriers, on a machine of two cores
ENTRY_S = 1.5e-3
#: longer than this an operator should know before, s
LONG_S = 60.0


def restart_forecasts(connection: Connection, fingerprint: str) -> Iterator[Diagnosis]:
    """Yield how long the chain of each spacecraft is computed again; checkpoints of other fingerprints do not count."""
    heads = select(spacecraft.c.id, head.c.spacecraft_key, head.c.consumed_number).join(
        spacecraft, spacecraft.c.spacecraft_key == head.c.spacecraft_key
    )
    is_fit = (checkpoint.c.version == LIVE, checkpoint.c.fingerprint == fingerprint)
    for name, key, consumed in connection.execute(heads.order_by(head.c.spacecraft_key)).all():
        kept = _newest(connection, checkpoint, key, consumed, *is_fit)
        aligned = _newest(connection, alignment, key, consumed)
        if not (kept or aligned):
            continue
        entries, since = consumed - max(kept, aligned), "checkpoint" if kept > aligned else "alignment"
        detail = (
            f"the next start of {name} consumes {entries} entries since its last {since}, {entries * ENTRY_S:.0f} s"
        )
        if entries * ENTRY_S <= LONG_S:
            yield Diagnosis("restart", "ok", detail)
        else:
            advice = "Start it when estimates can wait; rows are kept meanwhile, /readyz says how long it takes."
            yield Diagnosis("restart", "warning", detail, advice)


def _newest(connection: Connection, table: Table, key: int, consumed: int, *conditions: ColumnElement[bool]) -> int:
    """Return the newest journal number of a table up to a number, 0 where there is none."""
    is_own = (table.c.spacecraft_key == key, table.c.number <= consumed)
    return connection.scalar(select(func.max(table.c.number)).where(*is_own, *conditions)) or 0


#: a disk with less room is nearly full; with less than the second figure the next commits fail
FREE_BYTES_WARNING, FREE_BYTES_FAULT = 1 << 30, 64 << 20
#: a log beyond this has not been taken into the file for long
WAL_BYTES_WARNING = 256 << 20
#: how far clocks may differ
CLOCK_TOLERANCE_US = 5 * US_PER_S
#: 2025-01-01: a clock before it was never set
_CLOCK_IS_SET_US = 1_735_689_600 * US_PER_S


def diagnose(
    url: str, now_us: int, report: Report, announced: Sequence[JournalHead] = (), fingerprint: str | None = None
) -> list[Diagnosis]:
    """Return the findings on an archive.

    Parameters
    ----------
    url : str
        The archive.
    now_us : int
        Present of this computer, microseconds UTC.
    report : callable
        Told what is looked at next.
    announced : sequence of JournalHead
        Heads of journals that the service has logged.
    fingerprint : str, optional
        Of the checkpoints that fit this program.

    Raises
    ------
    ValueError
        The URL names no database that could be an archive.
    """
    engines = open_engines(url)
    path = sqlite_path(url)
    if path is None:
        return _examined(engines.read, now_us, report, announced, fingerprint)
    engines.dispose()
    report("file")
    found = list(_file(path))
    if any(diagnosis.check == "file" and diagnosis.state == "fault" for diagnosis in found):
        return found
    return found + _examined(reading_engine(path), now_us, report, announced, fingerprint)


def _examined(
    engine: Engine, now_us: int, report: Report, announced: Sequence[JournalHead], fingerprint: str | None
) -> list[Diagnosis]:
    """Connect and look inside."""
    try:
        with translated_faults(), engine.connect() as connection:
            found = examine(connection, report)
            if not any(each.check == "layout" and each.state == "fault" for each in found):
                report("clock")
                found += guarded("clock", partial(_clock, connection, now_us))
                found += guarded("documents", partial(_documents, connection))
                found += guarded("estimator", partial(_estimator, connection))
                found += guarded("log", partial(compared_heads, connection, announced))
                if connection.dialect.name == "postgresql":
                    found += guarded("leases", partial(_leaders, connection))
                if fingerprint is not None:
                    found += guarded("restart", partial(restart_forecasts, connection, fingerprint))
            return found
    except (StorageError, SQLAlchemyError) as fault:
        said = fault.detail if isinstance(fault, StorageError) else str(fault)
        return [Diagnosis("connection", "fault", said, "Start the database, or correct its address and rights.")]
    finally:
        engine.dispose()


def _file(path: Path) -> Iterator[Diagnosis]:
    if not path.is_file():
        advice = "Correct --database; a backup is put back by `soo backup restore`."
        yield Diagnosis("file", "fault", f"there is no file {path}", advice)
        return
    size = path.stat().st_size
    yield Diagnosis("file", "ok", f"{path}, {size} bytes")
    yield _permissions(path)
    yield _disk(path)
    yield _log(path)


def _permissions(path: Path) -> Diagnosis:
    """Return whether this user may write the file and the names beside it."""
    folder = path.resolve().parent
    lacking = [str(each) for each in (path, folder) if not os.access(each, os.W_OK)]
    if lacking:
        advice = "Give them to the user of the service (`chown`, `chmod u+w`), or mount the volume for writing."
        return Diagnosis("permissions", "fault", f"{' and '.join(lacking)} cannot be written by this user", advice)
    open_to_others = [each.name for each in _companions(path) if each.stat().st_mode & 0o077]
    if open_to_others:
        advice = "Only the user of the service needs them: `chmod 600` each; new archives are made so."
        return Diagnosis("permissions", "warning", f"{', '.join(open_to_others)} can be read by other users", advice)
    owner = path.stat().st_uid
    if owner != os.geteuid():
        advice = "Run this as the user of the service to see what the service sees."
        return Diagnosis("permissions", "warning", f"the file belongs to user {owner}, this is {os.geteuid()}", advice)
    return Diagnosis("permissions", "ok", "file and folder can be written")


def _companions(path: Path) -> list[Path]:
    """Return the file and what SQLite keeps beside it."""
    return [each for each in (path.with_name(path.name + ending) for ending in ("", *COMPANIONS)) if each.exists()]


def _disk(path: Path) -> Diagnosis:
    usage = shutil.disk_usage(path.resolve().parent)
    detail = f"{usage.free >> 20} MiB free of {usage.total >> 20} MiB"
    advice = "Make room, set retention, or move the archive to a larger disk."
    if usage.free < FREE_BYTES_FAULT:
        return Diagnosis("disk", "fault", detail, advice)
    if usage.free < FREE_BYTES_WARNING:
        return Diagnosis("disk", "warning", detail, advice)
    return Diagnosis("disk", "ok", detail)


def _log(path: Path) -> Diagnosis:
    """How much waits in the write-ahead log."""
    log = path.with_name(f"{path.name}-wal")
    size = log.stat().st_size if log.exists() else 0
    if size > WAL_BYTES_WARNING:
        advice = "A reader holds an old snapshot: end long exports and tools on the file; a restart merges the log."
        return Diagnosis("wal", "warning", f"{size >> 20} MiB wait in {log.name}", advice)
    return Diagnosis("wal", "ok", f"{size >> 20} MiB in the write-ahead log")


def _clock(connection: Connection, now_us: int) -> Iterator[Diagnosis]:
    """Compare this computer's clock with what it should agree with."""
    advice = "Set the clock and keep it by NTP; rows received meanwhile carry the wrong time of receipt."
    if now_us < _CLOCK_IS_SET_US:
        yield Diagnosis("clock", "fault", f"this computer's clock says {format_epoch(now_us)}", advice)
        return
    ahead = _newest_receipt_us(connection) - now_us
    if ahead > CLOCK_TOLERANCE_US:
        detail = f"the newest row was received {ahead / US_PER_S:.0f} s in the future of this clock"
        yield Diagnosis("clock", "fault", f"{detail}: it was ahead then, or has been set back", advice)
        return
    if connection.dialect.name == "postgresql":
        server_us = connection.scalar(text("SELECT (extract(epoch FROM clock_timestamp()) * 1000000)::bigint"))
        apart = abs(int(server_us or 0) - now_us)
        if apart > CLOCK_TOLERANCE_US + US_PER_S:
            yield Diagnosis("clock", "warning", f"the server's clock is {apart / US_PER_S:.0f} s away", advice)
            return
    yield Diagnosis("clock", "ok", f"{format_epoch(now_us)}, not behind any received row")


#: documents on which estimates rest: table, column, reader
_DOCUMENTS: tuple[tuple[Table, str, Callable[[str], object]], ...] = (
    (spacecraft, "document", partial(decode, Spacecraft)),
    (carrier_plan, "document", partial(decode_all, Carrier)),
    (ephemeris, "document", partial(decode, Ephemeris)),
    (calibration, "request", partial(decode, CalibrationRequest)),
    (calibration, "result", partial(decode, CalibrationResult)),
    (alignment, "document", partial(decode, Alignment)),
)


def _documents(connection: Connection) -> Iterator[Diagnosis]:
    """Read every document that estimates rest on."""
    read, unreadable = 0, 0
    for table, column, read_text in _DOCUMENTS:
        keys = [table.c[key.name] for key in table.primary_key]
        for *key, document in connection.execute(select(*keys, table.c[column]).where(table.c[column].is_not(None))):
            read += 1
            try:
                read_text(document)
            except StorageError as fault:
                unreadable += 1
                detail = f"{table.name} {'/'.join(map(str, key))}: {fault.detail}"
                yield Diagnosis("documents", "fault", detail, "Restore it from a backup, or make it again.")
    if not unreadable:
        yield Diagnosis("documents", "ok", f"{read} documents of the catalogue and of calibrations can be read")


def _estimator(connection: Connection) -> Iterator[Diagnosis]:
    """Yield for which spacecraft the estimator fails, by the alarm that the service has raised."""
    standing = [decode(Alarm, text) for text in connection.scalars(select(alarm.c.document).where(alarm.c.is_open))]
    failing = [each for each in standing if each.condition == "estimator_failed" and each.is_active]
    for each in failing:
        yield Diagnosis("estimator", "fault", f"{each.spacecraft_id}: {each.detail}", "Read the log of the service.")
    if not failing:
        yield Diagnosis("estimator", "ok", "no alarm says that it fails")


def _leaders(connection: Connection) -> Iterator[Diagnosis]:
    """Yield which process leads which spacecraft."""
    leaders = leaders_of(connection)
    for process in sorted(set(leaders.values())):
        names = ", ".join(sorted(name or "the archive" for name, each in leaders.items() if each == process))
        yield Diagnosis("leases", "ok", f"{process} leads {names}")
    idle = [name for name in connection.scalars(select(spacecraft.c.id)) if name not in leaders]
    if idle and leaders:
        advice = "Wait a few seconds; if it stays, start an estimator (`soo serve --no-http`)."
        yield Diagnosis("leases", "warning", f"nobody leads {', '.join(sorted(idle))}", advice)


def _newest_receipt_us(connection: Connection) -> int:
    """Return when the newest rows were received; 0 before the first."""
    newest = [0]
    for state in connection.execute(select(head.c.spacecraft_key, head.c.newest_number)):
        query = (
            select(measurement.c.epoch_us + measurement.c.delay_us)
            .where(measurement.c.spacecraft_key == state.spacecraft_key)
            .order_by(measurement.c.number.desc())
            .limit(1)
        )
        newest.append(connection.scalar(query) or 0)
    return max(newest)


class ArchiveTools:
    """Tools of an operator for an archive, from outside of the service.

    Parameters
    ----------
    url : str
        The archive.
    clock : Clock
        Tells the present.
    fingerprint : str
        Of the checkpoints that fit this program.
    """

    def __init__(self, url: str, clock: Clock, fingerprint: str) -> None:
        self.url = url
        self._clock = clock
        self._fingerprint = fingerprint

    def stamp(self) -> str:
        """Return the present as part of a name, to the second: 20261122T040302Z."""
        text = format_epoch(self._clock.system_us())
        return text.partition(".")[0].replace("-", "").replace(":", "") + "Z"

    def create(self, folder: Path, report: BackupReport) -> Manifest:
        """Make a backup; BackupError."""
        return create_backup(self.url, folder, self._clock.system_us(), report)

    def verify(self, folder: Path, report: BackupReport) -> list[Diagnosis]:
        """Return the findings on a backup; BackupError."""
        return verify_backup(folder, report)

    def restore(self, folder: Path, report: BackupReport, *, may_replace: bool) -> Restored:
        """Put a backup in the place of the archive; BackupError."""
        return restore_backup(folder, self.url, self.stamp(), report, may_replace=may_replace)

    def diagnose(self, report: Report, announced: Sequence[JournalHead] = ()) -> list[Diagnosis]:
        """Return the findings on the archive, compared with logged heads of journals."""
        return diagnose(self.url, self._clock.system_us(), report, announced, self._fingerprint)
