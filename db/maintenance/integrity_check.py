"""Check of an archive: rows, each compared with its checksum, journal, summaries."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Row, Select, Table, func, select
from sqlalchemy.exc import SQLAlchemyError

from db.columns import row_name, soundness
from db.database import Database
from db.encoding.record_codec import damaged_documents
from db.encoding.segments import SegmentHead, heads_where, of_measurements, read_chunk, series_of
from db.measurements.closed_days import MeasurementRows
from db.operations.access import SqlAudit
from db.results.result_samples import ResultRows
from db.results.stored_rows import TABLES, read_results
from db.sealing import Bins, RowKind, differences
from db.tables import (
    LAYOUT,
    attitude,
    head,
    journal,
    layout_of,
    measurement,
    metadata,
    refusal,
    retention_mark,
    segment,
    source,
    spacecraft,
    summary,
    torque,
)
from service.errors import StorageError
from service.ports.archive import LIVE
from service.records.epoch import format_epoch
from service.records.levels.attitude import IntArray
from service.records.operations.access import findings
from service.records.storage import Diagnosis

_CHECKED_AT_ONCE = 10_000
#: rows of the table with the largest blobs that are held at once
_SEGMENTS_AT_ONCE = 8
#: rows, or numbers, that a report names at most
_NAMED = 5


class CheckedTable(NamedTuple):
    """Comparison of the rows of one table."""

    name: str
    #: rows that agree with their checksum, rows that have none
    agreeing: int
    lacking: int
    differing: int
    #: the first of the rows that differ
    named: tuple[str, ...]

    def damage(self) -> str:
        """Return in words which rows differ."""
        more = f" and {self.differing - len(self.named)} more" if self.differing > len(self.named) else ""
        return f"{self.differing} rows of {self.name} differ from their checksum: {'; '.join(self.named)}{more}"


def checked_tables(connection: Connection) -> list[CheckedTable]:
    """Compare every row of every table that has checksums; memory is that of some thousand rows."""
    return [_checked(connection, table) for table in metadata.sorted_tables if "checksum" in table.c]


def document_damage(name: str) -> str:
    """Return in words that a document is damaged."""
    return f"{name} differs from its digest"


def damage_of(connection: Connection) -> list[str]:
    """Return in words which rows and documents are damaged, also where the database refuses to read them."""
    try:
        rows = [table.damage() for table in checked_tables(connection) if table.differing]
        return [*rows, *map(document_damage, damaged_documents(connection))]
    except SQLAlchemyError as fault:
        return [f"rows cannot be read: {getattr(fault, 'orig', fault)}"]


def _checked(connection: Connection, table: Table) -> CheckedTable:
    agreeing = lacking = differing = 0
    named: list[str] = []
    at_once = _SEGMENTS_AT_ONCE if table is segment else _CHECKED_AT_ONCE
    options = {"stream_results": True, "max_row_buffer": at_once}
    for rows in connection.execute(select(table), execution_options=options).partitions(at_once):
        wrong = [row for row, is_sound in zip(rows, soundness(table, rows), strict=True) if not is_sound]
        without = sum(row.checksum is None for row in rows)
        lacking += without
        differing += len(wrong)
        agreeing += len(rows) - without - len(wrong)
        named += [row_name(table, row) for row in wrong[: _NAMED - len(named)]]
    return CheckedTable(table.name, agreeing, lacking, differing, tuple(named))


_FETCH = 50_000


@dataclass
class Ledger:
    """Numbers of one spacecraft's journal.

    Attributes
    ----------
    times_held : ndarray, shape (newest + 1,)
        How often each number is taken; place 0 is none.
    beyond : int
        Entries with numbers above the head.
    rows_of_source : dict
        Measurements by key of their source.
    rows_dropped : dict
        What retention has taken away of each series.
    kept_from_us : int
        Epoch from which on measurements are kept.
    damaged : list of str
        What is wrong with sealed days that cannot be read.
    damaged_results : list of str
        The same of results, where these have been read.
    """

    times_held: NDArray[np.uint8]
    beyond: int = 0
    rows_of_source: dict[int, int] = field(default_factory=dict)
    rows_dropped: dict[str, int] = field(default_factory=dict)
    kept_from_us: int = 0
    rows_sealed: int = 0
    segments: int = 0
    damaged: list[str] = field(default_factory=list)
    damaged_results: list[str] = field(default_factory=list)

    def count(self, numbers: IntArray) -> None:
        """Count numbers in."""
        known = numbers[(numbers >= 1) & (numbers < len(self.times_held))]
        self.beyond += len(numbers) - len(known)
        np.add.at(self.times_held, known, np.uint8(1))

    @property
    def measurements_dropped(self) -> int:
        """Return how many measurements retention has taken away."""
        return self.rows_dropped.get("measurements", 0)

    def holes(self) -> IntArray:
        """Return the numbers that nothing holds."""
        return np.flatnonzero(self.times_held[1:] == 0) + 1

    def doubles(self) -> IntArray:
        """Return the numbers that are taken more than once."""
        return np.flatnonzero(self.times_held > 1)


def read_ledger(connection: Connection, state: Row[Any]) -> Ledger:
    """Return the ledger of the spacecraft whose head is given."""
    key = state.spacecraft_key
    ledger = Ledger(np.zeros(int(state.newest_number) + 1, dtype=np.uint8))
    for table in (journal, measurement):
        for numbers in _numbers(connection, table, table.c.spacecraft_key == key):
            ledger.count(numbers)
    counted = select(measurement.c.source_key, func.count()).where(measurement.c.spacecraft_key == key)
    ledger.rows_of_source = {row[0]: row[1] for row in connection.execute(counted.group_by(measurement.c.source_key))}
    for mark in connection.execute(select(retention_mark).where(retention_mark.c.spacecraft_key == key)):
        ledger.rows_dropped[mark.series] = mark.rows_dropped
        if mark.series == "measurements":
            ledger.kept_from_us = mark.kept_from_us
    _add_segments(connection, key, ledger)
    return ledger


def orphans(connection: Connection, key: int, ledger: Ledger) -> dict[str, list[int]]:
    """Return numbers of measurements that results name and nothing holds, by table; below a mark none can be told."""
    found = {}
    for table in (attitude, torque):
        lacking: list[int] = []
        is_kept = (table.c.spacecraft_key == key) & (table.c.epoch_us >= ledger.kept_from_us)
        sealed = _sealed_numbers(connection, key, table, ledger)
        for numbers in chain(_numbers(connection, table, is_kept), sealed):
            inside = (numbers >= 1) & (numbers < len(ledger.times_held))
            is_held = np.zeros(len(numbers), dtype=np.bool_)
            is_held[inside] = ledger.times_held[numbers[inside]] > 0
            lacking += numbers[~is_held].tolist()
        if lacking:
            found[table.name] = sorted(set(lacking))
    return found


def named(numbers: list[int]) -> str:
    """Return a few numbers in words.

    Examples
    --------
    >>> named([3, 4, 9])
    '3, 4, 9'
    """
    shown = ", ".join(map(str, numbers[:_NAMED]))
    return shown if len(numbers) <= _NAMED else f"{shown} and {len(numbers) - _NAMED} more"


def _add_segments(connection: Connection, key: int, ledger: Ledger) -> None:
    """Count the numbers of sealed days in, and note which days are damaged."""
    for found in heads_where(connection, *of_measurements(key)):
        ledger.segments += 1
        ledger.rows_sealed += found.row_count
        held = ledger.rows_of_source.get(found.source_key, 0)
        ledger.rows_of_source[found.source_key] = held + found.row_count
        numbers = _numbers_of(connection, found, ledger)
        if numbers is not None:
            ledger.count(numbers)


def _numbers_of(connection: Connection, found: SegmentHead, ledger: Ledger) -> IntArray | None:
    """Return the numbers of a sealed day; None, and a note, when it cannot be read."""
    try:
        chunk = read_chunk(connection, None, found)
        chunk.all_flags()
        chunk.details()
    except StorageError as error:
        ledger.damaged.append(error.detail)
        return None
    return chunk.numbers


def _sealed_numbers(connection: Connection, key: int, table: Table, ledger: Ledger) -> Iterator[IntArray]:
    """Yield the numbers of measurements that sealed results name, and note which segments are damaged."""
    is_its = (segment.c.spacecraft_key == key, segment.c.series == table.name)
    for found in heads_where(connection, *is_its):
        try:
            results = read_results(connection, found)
            results.rows()
        except StorageError as error:
            ledger.damaged_results.append(error.detail)
            continue
        yield results.numbers[results.epochs_us >= ledger.kept_from_us]


def _numbers(connection: Connection, table: Table, condition: ColumnElement[bool]) -> Iterator[IntArray]:
    """Yield the numbers of a table, some at a time."""
    options = {"stream_results": True, "max_row_buffer": _FETCH}
    result = connection.execute(select(table.c.number).where(condition), execution_options=options)
    for rows in result.partitions(_FETCH):
        yield np.fromiter((row[0] for row in rows), dtype=np.int64, count=len(rows))


#: segments of a series, about, whose summaries are compared with their rows
_COMPARED = 10
_ADVICE = "Charts and timelines of these days are wrong, exports are not. Restore a backup that is known to be sound."


def compare_summaries(connection: Connection, key: int, name: str) -> Iterator[Diagnosis]:
    """Yield whether evenly chosen summaries of a spacecraft agree with their rows, where those can be read."""
    compared, wrong = 0, []
    for series in (measurement, *TABLES.values()):
        its = list(heads_where(connection, segment.c.spacecraft_key == key, segment.c.series == series.name))
        # evenly chosen, the first among them
        for found in its[:: max(1, len(its) // _COMPARED)]:
            kind: RowKind = MeasurementRows() if series is measurement else ResultRows()
            try:
                rows = kind.sealed(connection, found)
            except StorageError:
                continue
            compared += 1
            if not _agree(connection, found, kind.columns_and_bins(series_of(found, series), rows)[1]):
                wrong.append(format_epoch(found.first_epoch_us)[:10])
    if wrong:
        detail = f"{name}: {len(wrong)} of {compared} summaries differ from their rows: {', '.join(sorted(set(wrong)))}"
        yield Diagnosis("summaries", "fault", detail, _ADVICE)
    else:
        yield Diagnosis("summaries", "ok", f"{name}: {compared} summaries compared with their rows")


def _agree(connection: Connection, found: SegmentHead, made: Bins) -> bool:
    """Return whether the summaries of a segment are those made again; sums to rounding."""
    query = select(summary).where(summary.c.segment_id == found.segment_id)
    stored = {(row.quantity, row.bin_s): row.content for row in connection.execute(query)}
    return stored.keys() == made.keys() and not any(any(differences(stored[name], made[name])) for name in made)


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
        states = connection.execute(select(head).order_by(head.c.spacecraft_key)).all()
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
    layout = layout_of(connection)
    if layout is None:
        advice = "Name the archive with --database; `soo serve` makes a new one."
        yield Diagnosis("layout", "fault", "this database holds no archive", advice)
    elif layout == LAYOUT:
        yield Diagnosis("layout", "ok", f"layout {layout}")
    else:
        yield Diagnosis("layout", "fault", refusal(layout), "Name another file or database with --database.")


def _checksums(connection: Connection) -> Iterator[Diagnosis]:
    """Compare rows with their checksums, documents with their digests."""
    tables = checked_tables(connection)
    for table in tables:
        if table.differing:
            yield Diagnosis("checksums", "fault", table.damage(), _RESTORE)
        if table.lacking:
            detail = f"{table.lacking} rows of {table.name} have no checksum, where every row should have one"
            advice = "They were written by hand; compare them with a backup."
            yield Diagnosis("checksums", "warning", detail, advice)
    documents = list(damaged_documents(connection))
    yield from (Diagnosis("checksums", "fault", document_damage(name), _RESTORE) for name in documents)
    if not (documents or any(table.differing for table in tables)):
        agreeing = sum(table.agreeing for table in tables)
        yield Diagnosis("checksums", "ok", f"{agreeing} rows agree with their checksums")


def _one(connection: Connection, state: Row[Any], name: str) -> Iterator[Diagnosis]:
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
    if wrong:
        yield Diagnosis("counts", "fault", f"{name}: {'; '.join(wrong)}", _RESTORE)
        return
    yield Diagnosis("counts", "ok", f"{name}: {counted} rows, as its sources count")


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
    sealed = select(func.coalesce(func.sum(segment.c.row_count), 0), func.max(segment.c.last_sequence))
    is_live = (segment.c.spacecraft_key == key, segment.c.version == LIVE)
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
