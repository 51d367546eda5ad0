"""The ledger of a journal: which numbers are held, and by what; for examinations, not for the running service.

Every number from 1 to the head's newest is taken exactly once, by a measurement (in a row or in a sealed day) or by a
slow input. Memory: one byte a number.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import ColumnElement, Connection, Row, Table, func, select

from db.encoding.segments import SegmentHead, heads, read_chunk
from db.results.result_segments import opened, paged
from db.schema.tables import attitude, head, journal, measurement, result_segment, retention_mark, torque
from service.errors import StorageError
from service.records.levels.attitude import IntArray

_FETCH = 50_000
_FOR_EVER_US = 1 << 62
#: numbers that a report names at most
_NAMED = 5


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


def heads_of_all(connection: Connection) -> list[Row[Any]]:
    """Return the heads of all spacecraft."""
    return list(connection.execute(select(head).order_by(head.c.spacecraft_key)))


def _add_segments(connection: Connection, key: int, ledger: Ledger) -> None:
    """Count the numbers of sealed days in, and note which days are damaged."""
    for segment in heads(connection, key, 0, _FOR_EVER_US):
        ledger.segments += 1
        ledger.rows_sealed += segment.row_count
        held = ledger.rows_of_source.get(segment.source_key, 0)
        ledger.rows_of_source[segment.source_key] = held + segment.row_count
        numbers = _numbers_of(connection, segment, ledger)
        if numbers is not None:
            ledger.count(numbers)


def _numbers_of(connection: Connection, segment: SegmentHead, ledger: Ledger) -> IntArray | None:
    """Return the numbers of a sealed day; None, and a note, when it cannot be read."""
    try:
        chunk = read_chunk(connection, None, segment)
        chunk.extras()
    except StorageError as error:
        ledger.damaged.append(error.detail)
        return None
    return chunk.numbers


def _sealed_numbers(connection: Connection, key: int, table: Table, ledger: Ledger) -> Iterator[IntArray]:
    """Yield the numbers of measurements that sealed results name, and note which segments are damaged."""
    segment_id = result_segment.c.segment_id
    is_its = (result_segment.c.spacecraft_key == key, result_segment.c.series == table.name)
    for found in paged(connection, select(result_segment).where(*is_its).order_by(segment_id), segment_id):
        try:
            segment = opened(connection, found)
        except StorageError as error:
            ledger.damaged_results.append(error.detail)
            continue
        yield segment.numbers[segment.epochs_us >= ledger.kept_from_us]


def _numbers(connection: Connection, table: Table, condition: ColumnElement[bool]) -> Iterator[IntArray]:
    """Yield the numbers of a table, some at a time."""
    options = {"stream_results": True, "max_row_buffer": _FETCH}
    result = connection.execute(select(table.c.number).where(condition), execution_options=options)
    for rows in result.partitions(_FETCH):
        yield np.fromiter((row[0] for row in rows), dtype=np.int64, count=len(rows))
