"""Counting rows that still lack a result.

Results are never taken away, so rows once found complete stay complete: below a journal number that is remembered for
each alignment and method nothing has to be counted again, and the count costs what has come since.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from sqlalchemy import Connection, delete, func, not_, or_, select
from sqlalchemy.sql.elements import ColumnElement

from db.encoding.segments import DAY_US, RowSeries, SegmentCache, heads_of_numbers, read_chunk
from db.measurements.closed_days import kept_from_us
from db.measurements.measurement_pages import MAX_NUMBER
from db.results.stored_rows import newest_sealed_us, stored_numbers
from db.schema.tables import alignment, attitude, complete_mark, head, measurement
from service.ports.archive import LIVE
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import IntArray


class PendingCount:
    """Counter of pending rows, with what it knows to be complete."""

    def __init__(self) -> None:
        #: journal number up to which every row after the alignment has all results
        self._complete: dict[tuple[int, int, tuple[str, ...]], int] = {}

    def count(self, connection: Connection, cache: SegmentCache, key: int, methods: Sequence[Method]) -> int:
        """Return how many rows after the newest alignment lack a result of one of the methods; 0 without one."""
        newest = (
            select(alignment.c.alignment_id, alignment.c.epoch_us)
            .where(alignment.c.spacecraft_key == key)
            .order_by(alignment.c.alignment_id.desc())
            .limit(1)
        )
        aligned = connection.execute(newest).first()
        if aligned is None or not methods:
            return 0
        names = tuple(sorted(method.value for method in methods))
        known = (key, int(aligned.alignment_id), names)
        number = connection.scalar(select(head.c.newest_number).where(head.c.spacecraft_key == key)) or 0
        complete = self._complete.get(known)
        if complete is None:
            complete = _stored(connection, known)
        # what retention has taken away is not awaited
        epoch_us = max(aligned.epoch_us, kept_from_us(connection, key, "attitude") - 1)
        sealed_us = newest_sealed_us(connection, key)
        count, first = _lacking_rows(connection, key, max(epoch_us, sealed_us), complete, names)
        for numbers in _lacking_unsealed(connection, key, Window(epoch_us + 1, sealed_us + 1), complete, names):
            count += len(numbers)
            first = min(first or int(numbers.min()), int(numbers.min()))
        for numbers in _lacking_sealed(connection, cache, key, epoch_us, complete, names):
            count += len(numbers)
            first = min(first or int(numbers.min()), int(numbers.min()))
        self._complete[known] = number if first is None else first - 1
        return count

    def store(self, connection: Connection, key: int) -> None:
        """Store what is known to be complete of a spacecraft, for the first count after a start."""
        for known, number in list(self._complete.items()):
            if known[0] == key and number > _stored(connection, known):
                is_it = (complete_mark.c.spacecraft_key == key, complete_mark.c.methods == ",".join(known[2]))
                connection.execute(delete(complete_mark).where(*is_it))
                values = {"spacecraft_key": key, "methods": ",".join(known[2]), "alignment_id": known[1]}
                connection.execute(complete_mark.insert().values(**values, number=number))


def _stored(connection: Connection, known: tuple[int, int, tuple[str, ...]]) -> int:
    """Return the stored number of an alignment and methods, 0 where there is none."""
    key, alignment_id, names = known
    query = select(complete_mark.c.number).where(
        complete_mark.c.spacecraft_key == key,
        complete_mark.c.methods == ",".join(names),
        complete_mark.c.alignment_id == alignment_id,
    )
    return connection.scalar(query) or 0


def _lacking_rows(
    connection: Connection, key: int, epoch_us: int, complete: int, names: Sequence[str]
) -> tuple[int, int | None]:
    """Return how many rows of the table of rows lack a result, and the smallest of their numbers."""
    query = (
        select(func.count(), func.min(measurement.c.number))
        .where(measurement.c.spacecraft_key == key, measurement.c.number > complete)
        # the sum keeps the planner on the index by number, where only what has come since is read
        .where(measurement.c.feeds, measurement.c.epoch_us + 0 > epoch_us)
        .where(or_(*(not_(_has_result(name)) for name in names)))
    )
    count, first = connection.execute(query).one()
    return int(count), first


def _lacking_unsealed(
    connection: Connection, key: int, window: Window, complete: int, names: Sequence[str]
) -> Iterator[IntArray]:
    """Yield the numbers of rows of the table of rows that lack a result, where results may be sealed."""
    if window.start_us >= window.stop_us:
        return
    query = (
        select(measurement.c.epoch_us, measurement.c.number)
        .where(measurement.c.spacecraft_key == key, measurement.c.number > complete, measurement.c.feeds)
        .where(measurement.c.epoch_us + 0 >= window.start_us, measurement.c.epoch_us + 0 < window.stop_us)
    )
    rows = np.array([tuple(row) for row in connection.execute(query)], dtype=np.int64).reshape(-1, 2)
    for day in np.unique(rows[:, 0] // DAY_US).tolist():
        numbers = rows[rows[:, 0] // DAY_US == day, 1]
        lacking = _lacking(connection, key, Window(day * DAY_US, (day + 1) * DAY_US), numbers, names)
        if len(lacking):
            yield lacking


def _lacking_sealed(
    connection: Connection, cache: SegmentCache, key: int, epoch_us: int, complete: int, names: Sequence[str]
) -> Iterator[IntArray]:
    """Yield the numbers of sealed rows that lack a result, segment by segment."""
    for found in heads_of_numbers(connection, key, complete, MAX_NUMBER):
        if found.last_epoch_us <= epoch_us or not found.feeding_count:
            continue
        chunk = read_chunk(connection, cache, found)
        numbers = chunk.numbers[chunk.feeds & (chunk.epochs_us > epoch_us) & (chunk.numbers > complete)]
        window = Window(found.first_epoch_us, found.last_epoch_us + 1)
        lacking = _lacking(connection, key, window, numbers, names)
        if len(lacking):
            yield lacking


def _lacking(connection: Connection, key: int, window: Window, numbers: IntArray, names: Sequence[str]) -> IntArray:
    """Return those numbers of measurements of a window that lack a result."""
    is_whole = np.ones(len(numbers), dtype=np.bool_)
    for name in names:
        held = stored_numbers(connection, RowSeries(key, attitude, LIVE, name), window)
        is_whole &= np.isin(numbers, held)
    return numbers[~is_whole]


def _has_result(method: str) -> ColumnElement[bool]:
    """Return the condition that the live version holds a result of a method for a measurement."""
    return (
        select(attitude.c.number)
        .where(
            attitude.c.spacecraft_key == measurement.c.spacecraft_key,
            attitude.c.version == LIVE,
            attitude.c.method == method,
            attitude.c.epoch_us == measurement.c.epoch_us,
            attitude.c.number == measurement.c.number,
        )
        .correlate(measurement)
        .exists()
    )
