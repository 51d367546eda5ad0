"""Examination of an archive: reads all of it in one transaction and says what is wrong, in words.

Each check returns diagnoses; the tables below say which ones run and in which order. A check that the database itself
cuts short is a fault with the database's words, never an exception.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from sqlalchemy import Connection, Row, Select, func, select
from sqlalchemy.exc import SQLAlchemyError

from db.database import Database
from db.maintenance.journal_ledger import Ledger, heads_of_all, named, orphans, read_ledger
from db.maintenance.summary_check import compare_summaries
from db.measurements.checksum_check import checked_tables
from db.operations.audit import SqlAudit
from db.schema.layout import LAYOUT, layout_of, refusal
from db.schema.tables import attitude, measurement, measurement_detail, result_segment, source, spacecraft, torque
from service.errors import StorageError
from service.ports import LIVE
from service.records.operations.audit import findings
from service.records.storage.diagnosis import Diagnosis

Report = Callable[[str], None]
#: settings of a PostgreSQL server, and what happens without them
_NEEDED = {
    "fsync": "a power loss can destroy the database",
    "full_page_writes": "a power loss can destroy the database",
    "synchronous_commit": "a power loss can lose acknowledged rows",
}
_RESTORE = "Restore a backup that `soo backup verify` calls sound: `soo backup restore`."


def examine(connection: Connection, report: Report) -> list[Diagnosis]:
    """Return the findings on the content of an archive.

    Parameters
    ----------
    connection : Connection
        Its transaction is the state that is examined.
    report : callable
        Told what is looked at next.
    """
    found: list[Diagnosis] = []
    for name, check in (("integrity", _integrity), ("layout", _layout)):
        report(name)
        found += guarded(name, partial(check, connection))
    if any(diagnosis.state == "fault" and diagnosis.check == "layout" for diagnosis in found):
        return found
    found += examine_content(connection, report)
    report("audit")
    return found + guarded("audit", partial(_audit, connection))


def examine_content(connection: Connection, report: Report) -> list[Diagnosis]:
    """Return whether journal, counts, sealed days and results agree; the layout is that of this program."""
    found: list[Diagnosis] = []
    try:
        names = {row.spacecraft_key: row.id for row in connection.execute(select(spacecraft))}
        states = heads_of_all(connection)
    except SQLAlchemyError as fault:
        return [_unreadable("journal", fault)]
    report("checksums")
    found += guarded("checksums", partial(_checksums, connection))
    for state in states:
        name = names.get(state.spacecraft_key, f"key {state.spacecraft_key}")
        report(f"journal of {name}")
        found += guarded("journal", partial(_one, connection, state, name))
    if not states:
        found.append(Diagnosis("journal", "ok", "no spacecraft yet"))
    return found


def guarded(check: str, run: Callable[[], Iterator[Diagnosis]]) -> list[Diagnosis]:
    """Run a check; what the database refuses to read is a fault."""
    try:
        return list(run())
    except (SQLAlchemyError, StorageError) as fault:
        return [_unreadable(check, fault)]


def _unreadable(check: str, fault: Exception) -> Diagnosis:
    """Return the diagnosis for what the database refuses to read."""
    said = str(getattr(fault, "orig", fault)).strip()
    return Diagnosis(check, "fault", f"the database cannot be read: {said}", _RESTORE)


def _integrity(connection: Connection) -> Iterator[Diagnosis]:
    """Ask the database whether it is whole."""
    if connection.dialect.name == "sqlite":
        yield from _sqlite_integrity(connection)
        return
    off = [name for name in _NEEDED if connection.exec_driver_sql(f"SHOW {name}").scalar() == "off"]
    for name in off:
        yield Diagnosis("server", "fault", f"the server runs with {name}=off: {_NEEDED[name]}", f"Set {name}=on.")
    if not off:
        version = connection.exec_driver_sql("SHOW server_version").scalar()
        yield Diagnosis("server", "ok", f"PostgreSQL {version} answers and keeps commits")


def _sqlite_integrity(connection: Connection) -> Iterator[Diagnosis]:
    said = [row[0] for row in connection.exec_driver_sql("PRAGMA integrity_check(5)")]
    if said != ["ok"]:
        yield Diagnosis("integrity", "fault", f"the file is damaged: {'; '.join(said)}", _RESTORE)
        return
    lost = list(connection.exec_driver_sql("PRAGMA foreign_key_check"))
    if lost:
        detail = f"{len(lost)} rows refer to a missing row, the first in table {lost[0][0]}"
        yield Diagnosis("integrity", "fault", detail, _RESTORE)
        return
    yield Diagnosis("integrity", "ok", "the file is whole")


def _layout(connection: Connection) -> Iterator[Diagnosis]:
    """Compare the layout with that of the program."""
    layout = layout_of(connection)
    if layout is None:
        advice = "Name the archive with --database; `soo serve` makes a new one."
        yield Diagnosis("layout", "fault", "this database holds no archive", advice)
    elif layout == LAYOUT:
        yield Diagnosis("layout", "ok", f"layout {layout}")
    else:
        yield Diagnosis("layout", "fault", refusal(layout), "Name another file or database with --database.")


def _checksums(connection: Connection) -> Iterator[Diagnosis]:
    """Compare rows with their checksums."""
    tables = checked_tables(connection)
    for table in tables:
        if table.differing:
            yield Diagnosis("checksums", "fault", table.damage(), _RESTORE)
        if table.lacking:
            detail = f"{table.lacking} rows of {table.name} have no checksum, where every row should have one"
            advice = "They were written by hand; compare them with a backup."
            yield Diagnosis("checksums", "warning", detail, advice)
    if not any(table.differing for table in tables):
        agreeing = sum(table.agreeing for table in tables)
        yield Diagnosis("checksums", "ok", f"{agreeing} rows agree with their checksums")


def _one(connection: Connection, state: Row[Any], name: str) -> Iterator[Diagnosis]:
    """Examine one spacecraft."""
    ledger = read_ledger(connection, state)
    yield from _segments(name, ledger)
    yield from compare_summaries(connection, state.spacecraft_key, name)
    yield from _journal(state, name, ledger)
    yield from _counts(connection, state, name, ledger)
    yield from _results(connection, state, name, ledger)


def _segments(name: str, ledger: Ledger) -> Iterator[Diagnosis]:
    for damage in ledger.damaged:
        yield Diagnosis("segments", "fault", f"{name}: {damage}", _RESTORE)
    if not ledger.damaged:
        detail = f"{name}: {ledger.segments} sealed days, {ledger.rows_sealed} rows, checksums agree"
        yield Diagnosis("segments", "ok", detail)


def _journal(state: Row[Any], name: str, ledger: Ledger) -> Iterator[Diagnosis]:
    """Every number is taken once."""
    holes, doubles = ledger.holes(), ledger.doubles()
    if len(doubles):
        detail = f"{name}: numbers {named(doubles.tolist())} occur more than once"
        yield Diagnosis("journal", "fault", detail, _RESTORE)
    if ledger.beyond:
        detail = f"{name}: {ledger.beyond} entries have numbers above the head, {state.newest_number}"
        yield Diagnosis("journal", "fault", detail, _RESTORE)
    # of a sealed day that cannot be read the numbers are not known; that is said already
    dropped = ledger.measurements_dropped
    if len(holes) > dropped and not ledger.damaged:
        kept = f", of which retention took {dropped}" if dropped else ""
        detail = f"{name}: {len(holes)} numbers are missing{kept}: {named(holes.tolist())}"
        yield Diagnosis("journal", "fault", detail, _RESTORE)
    if not (len(doubles) or ledger.beyond or len(holes) > dropped):
        gone = f", {dropped} taken away by retention" if dropped else ""
        yield Diagnosis("journal", "ok", f"{name}: numbers 1 to {state.newest_number} without holes{gone}")


def _counts(connection: Connection, state: Row[Any], name: str, ledger: Ledger) -> Iterator[Diagnosis]:
    """Heads and sources tell what is there."""
    wrong = []
    counted = 0
    for row in connection.execute(select(source).where(source.c.spacecraft_key == state.spacecraft_key)):
        held = ledger.rows_of_source.pop(row.source_key, 0)
        counted += row.row_count
        if held > row.row_count or held + ledger.measurements_dropped < row.row_count:
            wrong.append(f"source {row.name} counts {row.row_count} rows and has {held}")
    wrong += [f"{held} rows belong to no source" for held in ledger.rows_of_source.values()]
    if state.consumed_number > state.newest_number:
        wrong.append(f"the chain stands at {state.consumed_number}, beyond the journal's {state.newest_number}")
    wrong += _details(connection, state.spacecraft_key)
    if wrong:
        yield Diagnosis("counts", "fault", f"{name}: {'; '.join(wrong)}", _RESTORE)
        return
    yield Diagnosis("counts", "ok", f"{name}: {counted} rows, as its sources count")


def _details(connection: Connection, key: int) -> list[str]:
    """Return the faults of the details stored beside rows."""
    both = (measurement_detail.c.epoch_us == measurement.c.epoch_us) & (
        measurement_detail.c.source_key == measurement.c.source_key
    )
    query = (
        select(func.count())
        .select_from(measurement_detail)
        .outerjoin(measurement, both & (measurement.c.spacecraft_key == key))
        .where(measurement_detail.c.spacecraft_key == key, measurement.c.number.is_(None))
    )
    lost = connection.scalar(query) or 0
    return [f"{lost} rows of details belong to no measurement"] if lost else []


def _results(connection: Connection, state: Row[Any], name: str, ledger: Ledger) -> Iterator[Diagnosis]:
    """Every result has the row it was computed from, and a place in the order of results."""
    key = state.spacecraft_key
    wrong = []
    lost = orphans(connection, key, ledger)
    wrong += ledger.damaged_results
    if not ledger.damaged:
        for series, numbers in lost.items():
            wrong.append(f"{series} rows were computed from missing measurements: {named(numbers)}")
    sequences = 0
    newest = 0
    for table in (attitude, torque):
        query = select(func.count(table.c.sequence), func.max(table.c.sequence))
        count, last = connection.execute(query.where(table.c.spacecraft_key == key, table.c.version == LIVE)).one()
        sequences, newest = sequences + count, max(newest, last or 0)
    sealed = select(func.coalesce(func.sum(result_segment.c.row_count), 0), func.max(result_segment.c.last_sequence))
    is_live = (result_segment.c.spacecraft_key == key, result_segment.c.version == LIVE)
    rows_sealed, last = connection.execute(sealed.where(*is_live)).one()
    sequences, newest = sequences + int(rows_sealed), max(newest, last or 0)
    is_whole = newest == state.result_sequence and (sequences == newest or ledger.rows_dropped)
    if not is_whole:
        wrong.append(f"{sequences} results up to {newest}, where the head counts {state.result_sequence}")
    if wrong:
        advice = "`soo replay` computes results again from the rows; a backup has the live ones."
        yield Diagnosis("results", "fault", f"{name}: {'; '.join(wrong)}", advice)
        return
    yield Diagnosis(
        "results", "ok", f"{name}: {sequences} live results, {rows_sealed} of them sealed, each with its row"
    )


class _OneConnection(Database):
    """A database seen through one connection: every query in its transaction, no writes."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def fetch(self, statement: Select[Any]) -> Sequence[Row[Any]]:
        """Return all rows of a query."""
        return self._connection.execute(statement).all()

    def fetch_one(self, statement: Select[Any]) -> Row[Any] | None:
        """Return the first row of a query, if any."""
        return self._connection.execute(statement).first()


def _audit(connection: Connection) -> Iterator[Diagnosis]:
    """Walk the chain of the audit log."""
    audit = SqlAudit(_OneConnection(connection))
    broken = list(findings(audit.chain(), audit.head()))
    for finding in broken:
        yield Diagnosis("audit", "fault", finding.detail, "`soo audit verify` shows details; compare with a backup.")
    if not broken:
        yield Diagnosis("audit", "ok", f"{audit.head().number} entries, the chain holds")
