"""Counting rows that still lack a result.

Results are never taken away, so rows once found complete stay complete: below a journal number that is remembered for
each alignment and method nothing has to be counted again, and the count costs what has come since.
"""

from collections.abc import Sequence

from sqlalchemy import Connection, func, not_, or_, select
from sqlalchemy.sql.elements import ColumnElement

from db.tables import alignment, attitude, head, measurement
from service.ports import LIVE
from service.records.catalogue import Method


class PendingCount:
    """Counter of pending rows, with what it knows to be complete."""

    def __init__(self) -> None:
        #: journal number up to which every row after the alignment has all results
        self._complete: dict[tuple[int, int, tuple[str, ...]], int] = {}

    def count(self, connection: Connection, key: int, methods: Sequence[Method]) -> int:
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
        lacking = (
            select(func.count(), func.min(measurement.c.number))
            .where(measurement.c.spacecraft_key == key, measurement.c.number > self._complete.get(known, 0))
            # the sum keeps the planner on the index by number, where only what has come since is read
            .where(measurement.c.feeds, measurement.c.epoch_us + 0 > aligned.epoch_us)
            .where(or_(*(not_(_has_result(name)) for name in names)))
        )
        count, first = connection.execute(lacking).one()
        self._complete[known] = number if first is None else first - 1
        return int(count)


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
