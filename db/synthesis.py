"""Attitude of the live version: one row a consumed measurement, whether or not anything was computed for it.

The chain stores no row for a measurement that it consumed before a method had a calibration and an alignment. Such
rows are made here, on reading, with the reason that held when the measurement was consumed: journal numbers tell which
activations stood before it.
"""

from typing import Any

from sqlalchemy import Connection, Row, Select, and_, select

from db.database import beyond, within
from db.documents import decode
from db.mapping import attitude_of
from db.tables import attitude, calibration, head, journal, measurement
from service.ports import LIVE
from service.records.attitude import AttitudeRow, row_without_attitude
from service.records.calibration import CalibrationMethod, Window
from service.records.catalogue import Method
from service.records.inputs import CalibrationActivation


class Synthesis:
    """Reader of the live attitude of one method within one read transaction."""

    def __init__(self, connection: Connection, key: int, method: Method) -> None:
        self._connection = connection
        self._key = key
        self._method = method

    def rows(self, window: Window, limit: int, after: tuple[int, int] | None) -> list[AttitudeRow]:
        """Return rows in order of (epoch, number) beyond a cursor."""
        query = (
            self._query()
            .where(within(measurement.c.epoch_us, window))
            .where(beyond(measurement.c.epoch_us, measurement.c.number, after))
            .order_by(measurement.c.epoch_us, measurement.c.number)
            .limit(limit)
        )
        return self._records(query)

    def newest(self) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        query = self._query().order_by(measurement.c.epoch_us.desc(), measurement.c.number.desc()).limit(1)
        return next(iter(self._records(query)), None)

    def _query(self) -> Select[Any]:
        consumed = select(head.c.consumed_number).where(head.c.spacecraft_key == self._key).scalar_subquery()
        is_its_row = and_(
            attitude.c.spacecraft_key == measurement.c.spacecraft_key,
            attitude.c.version == LIVE,
            attitude.c.method == self._method.value,
            attitude.c.epoch_us == measurement.c.epoch_us,
            attitude.c.number == measurement.c.number,
        )
        return (
            select(
                attitude,
                measurement.c.epoch_us.label("measured_epoch_us"),
                measurement.c.received_at_us.label("measured_received_at_us"),
                measurement.c.number.label("measured_number"),
            )
            .select_from(measurement)
            .outerjoin(attitude, is_its_row)
            # the sum keeps the planner on the key by epoch: nearly every row is consumed
            .where(measurement.c.spacecraft_key == self._key, measurement.c.feeds, measurement.c.number + 0 <= consumed)
        )

    def _records(self, query: Select[Any]) -> list[AttitudeRow]:
        rows = self._connection.execute(query).all()
        if all(row.status is not None for row in rows):
            return [attitude_of(row) for row in rows]
        calibrated_number = self._calibrated_number()
        return [self._record(row, calibrated_number) for row in rows]

    def _record(self, row: Row[Any], calibrated_number: int | None) -> AttitudeRow:
        if row.status is not None:
            return attitude_of(row)
        is_calibrated = calibrated_number is not None and calibrated_number < row.measured_number
        inhibition = "not_aligned" if is_calibrated else "no_calibration"
        return row_without_attitude(
            row.measured_epoch_us, row.measured_received_at_us, row.measured_number, self._method, (inhibition,)
        )

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
