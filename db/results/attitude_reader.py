"""Attitude of the live version: one row a consumed measurement, whether or not anything was computed for it.

The chain stores no row for a measurement that it consumed before a method had a calibration and an alignment. Such
rows are made here, on reading, with the reason that held when the measurement was consumed: journal numbers tell which
activations stood before it.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property
from itertools import starmap
from typing import NamedTuple

from sqlalchemy import Connection, and_, func, select

from db.database import ALL_ROWS, newest_rows, position_of
from db.encoding.measurement_runs import ChunkRun
from db.encoding.record_codec import decode
from db.encoding.segments import RowSeries, SegmentCache
from db.measurements.measurement_pages import EVER, LIGHT, Chosen, MeasurementPages
from db.measurements.retention import kept_from_us
from db.results.stored_rows import attitude_of, attitudes_of, newest_row, stored_rows
from db.schema.columns import sound_rows
from db.schema.tables import attitude, calibration, head, journal, retention_mark
from service.ports.archive import LIVE, ListPart
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import Method
from service.records.inputs import CalibrationActivation
from service.records.levels.attitude import AttitudeRow, row_without_attitude


def newest_computed(connection: Connection, key: int, method: Method) -> AttitudeRow | None:
    """Return the newest stored row of a method where it is the row of the newest consumed measurement.

    One statement; None says that an `AttitudeReader` must search.
    """
    mark = select(retention_mark.c.kept_from_us).where(
        retention_mark.c.spacecraft_key == key, retention_mark.c.series == "attitude"
    )
    is_newest = attitude.c.epoch_us >= head.c.consumed_epoch_us
    is_kept = attitude.c.epoch_us >= func.coalesce(mark.scalar_subquery(), attitude.c.epoch_us)
    query = (
        select(attitude, and_(is_newest, is_kept).label("is_answer"))
        .where(attitude.c.spacecraft_key == key, attitude.c.version == LIVE, attitude.c.method == method.value)
        .join(head, head.c.spacecraft_key == attitude.c.spacecraft_key)
        .order_by(attitude.c.epoch_us.desc(), attitude.c.number.desc())
    )
    row = next(iter(sound_rows(attitude, connection.execute(query.limit(1)))), None)
    return attitude_of(row) if row is not None and row.is_answer else None


class _Consumed(NamedTuple):
    """A consumed measurement."""

    epoch_us: int
    number: int
    received_at_us: int


class AttitudeReader:
    """Reader of the live attitude of one method within one read transaction."""

    def __init__(self, connection: Connection, cache: SegmentCache, key: int, method: Method) -> None:
        self._connection = connection
        self._pages = MeasurementPages(connection, cache, key)
        self._key = key
        self._method = method
        self._stored = RowSeries(key, attitude, LIVE, method.value)
        self._measured_from_us = kept_from_us(connection, key, "measurements")

    def rows(self, part: ListPart) -> list[AttitudeRow]:
        """Return the rows of a part of the list."""
        start_us = max(part.window.start_us, kept_from_us(self._connection, self._key, "attitude"))
        # of measurements that retention took away the attitude alone is left
        left = Window(start_us, min(part.window.stop_us, self._measured_from_us))
        rest = Window(max(start_us, self._measured_from_us), part.window.stop_us)
        pieces = [(left, self._left), (rest, self._measured)]
        found: list[AttitudeRow] = []
        for window, read in pieces[::-1] if part.newest_first else pieces:
            if len(found) < part.limit and window.start_us < window.stop_us:
                found += read(part._replace(window=window, limit=part.limit - len(found)))
        return found

    def newest(self) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        begin_us = max(kept_from_us(self._connection, self._key, "attitude"), self._measured_from_us)
        newest = self._pages.newest(self._consumed(Window(begin_us, EVER.stop_us)))
        if newest is not None:
            return self._records([_Consumed(*newest)])[0]
        row = newest_row(self._connection, self._stored, self._measured_from_us)
        return None if row is None else attitude_of(row)

    def _left(self, part: ListPart) -> list[AttitudeRow]:
        return attitudes_of(stored_rows(self._connection, self._stored, part))

    def _measured(self, part: ListPart) -> list[AttitudeRow]:
        if part.newest_first:
            return newest_rows(self._measured, self._start_of_newest, part)
        runs = self._pages.read(self._consumed(part.window), part.limit, part.after, columns=LIGHT)
        return self._records([measurement for run in runs for measurement in _of_run(run)])

    def _start_of_newest(self, window: Window, count: int) -> int:
        return self._pages.start_of_newest(self._consumed(window), count)

    def _consumed(self, window: Window) -> Chosen:
        """Return the selection of the measurements that the chain has consumed."""
        number = self._connection.scalar(select(head.c.consumed_number).where(head.c.spacecraft_key == self._key))
        return Chosen(window, feeds_only=True, before_number=(number or 0) + 1)

    def _records(self, measurements: Sequence[_Consumed]) -> list[AttitudeRow]:
        if not measurements:
            return []
        window = Window(measurements[0].epoch_us, measurements[-1].epoch_us + 1)
        rows = attitudes_of(stored_rows(self._connection, self._stored, ListPart(window, ALL_ROWS)))
        stored = {position_of(row): row for row in rows}
        return [
            stored.get((measurement.epoch_us, measurement.number)) or self._without_attitude(measurement)
            for measurement in measurements
        ]

    def _without_attitude(self, measurement: _Consumed) -> AttitudeRow:
        is_calibrated = self._calibrated_number is not None and self._calibrated_number < measurement.number
        inhibition = "not_aligned" if is_calibrated else "no_calibration"
        return row_without_attitude(
            measurement.epoch_us, measurement.received_at_us, measurement.number, self._method, (inhibition,)
        )

    @cached_property
    def _calibrated_number(self) -> int | None:
        """Return the number of the activation from which on the method had a calibration."""
        held = select(calibration.c.calibration_id, calibration.c.method)
        methods = {
            row[0]: row[1] for row in self._connection.execute(held.where(calibration.c.spacecraft_key == self._key))
        }
        activations = (
            select(journal.c.number, journal.c.document)
            .where(journal.c.spacecraft_key == self._key, journal.c.kind == "activation")
            .order_by(journal.c.number)
        )
        for number, document in self._connection.execute(activations):
            method = methods[decode(CalibrationActivation, document).calibration_id]
            # a geometry calibration carries the paper part too; a paper one serves only paper
            if self._method is Method.PAPER or method == CalibrationMethod.GEOMETRY.value:
                return int(number)
        return None


def _of_run(run: ChunkRun) -> Iterator[_Consumed]:
    columns = (run.chunk.epochs_us, run.chunk.numbers, run.chunk.received_at_us)
    return starmap(_Consumed, zip(*(column[run.positions].tolist() for column in columns), strict=True))
