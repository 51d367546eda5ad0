"""Summaries of live attitude and torque commands by day: made when the day is over, made again after a late row.

A day is summarised only once the chain has consumed a later one, so rows of the newest day never touch a summary. A
late row deletes those of its day in the transaction that stores it. A summary that is being made is a row without
bytes: where its rows were read before a late one came, it is gone, and nothing is stored.
"""

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, cast

import numpy as np
from sqlalchemy import ColumnElement, Connection, and_, delete, func, select

from db.connection.writer import insert_new
from db.database import Database, lock_head
from db.encoding.segments import DAY_US, day_of
from db.encoding.summary_codec import ATTITUDE, READ_AT_ONCE, Stored, SummaryBlobs, pack_day
from db.newest_rows import RowPages
from db.results.carrier_summaries import CarrierRow, blobs_by_plan, store_carriers
from db.results.state_summaries import store_states, stretch_of
from db.results.stored_rows import pages
from db.schema.tables import attitude, head, torque
from db.schema.tables import attitude_summary as table
from service.core.rows import Stretch, Summaries
from service.errors import StorageError
from service.ports.archive import Intervals
from service.records.calibration import Window
from service.records.levels.attitude import AttitudeRow, FloatArray, IntArray, TorqueCommand

_LOG = logging.getLogger(__name__)
#: name under which the commands of all methods are summarised
TORQUE = "torque"
#: columns of attitude that are sampled in intervals of any length: the angles; of torque there is none
SAMPLED = 3
#: of a day without rows
NO_ROWS = SummaryBlobs(b"", b"", None, b"")
Row = AttitudeRow | TorqueCommand


class _Made(NamedTuple):
    """Summaries of one day."""

    attitude: SummaryBlobs
    by_plan: Mapping[int, SummaryBlobs]
    #: None of commands
    states: Stretch | None


def complete(
    database: Database,
    key: int,
    name: str,
    read: RowPages[Row],
    before_us: int,
    read_carriers: RowPages[CarrierRow] | None = None,
) -> Iterator[int]:
    """Summarise the days of a series that ended before an epoch and have no summary; yield 1 for each."""
    with database.read() as connection:
        consumed_us = connection.scalar(select(head.c.consumed_epoch_us).where(head.c.spacecraft_key == key))
    stop_us = min(day_of(before_us), day_of(consumed_us or 0)) * DAY_US
    query = select(table.c.start_us).where(_is_of(key, name), table.c.day.is_not(None))
    held = {row.start_us for row in database.fetch(query)}
    start_us = -(1 << 62)
    while start_us < stop_us:
        try:
            first = read(Window(start_us, stop_us), 1, None)
            if not first:
                return
            start_us = day_of(first[0].epoch_us) * DAY_US
            if start_us not in held and _make(database, key, name, read, read_carriers, start_us):
                yield 1
        except StorageError as fault:
            start_us = _damaged_day_us(database, key, name, start_us, fault)
            _LOG.warning("the day is not summarised: %s", fault.detail)
        held.add(start_us)
        while start_us in held:
            start_us += DAY_US


def _damaged_day_us(database: Database, key: int, name: str, start_us: int, fault: StorageError) -> int:
    """Return the day of the first row from an epoch on that is not sealed, which a fault is about; or raise it."""
    series = torque if name == TORQUE else attitude
    query = select(func.min(series.c.epoch_us)).where(series.c.spacecraft_key == key, series.c.epoch_us >= start_us)
    with database.read() as connection:
        first_us = connection.scalar(query)
    if fault.code != "storage.corrupt" or first_us is None:
        raise fault
    return day_of(first_us) * DAY_US


def sampled(
    database: Database,
    key: int,
    name: str,
    read: RowPages[Row],
    window: Window,
    intervals: Intervals,
    columns: int = SAMPLED,
) -> Iterator[Summaries]:
    """Yield the rows of a window in buckets that lie within one interval each: of days with a sound summary from it.

    Of the first columns, where an interval may end anywhere; with more of them, a day in which one ends between two of
    the buckets is read as rows.
    """
    query = (
        select(table.c.summary_id, table.c.start_us)
        .where(_is_of(key, name), table.c.day.is_not(None))
        .where(table.c.start_us > window.start_us - DAY_US, table.c.start_us < window.stop_us)
        .order_by(table.c.start_us)
    )
    stored = [Stored(row.summary_id, row.start_us, row.start_us + DAY_US - 1) for row in database.fetch(query)]
    # each day is read once, from its summary or as rows: a row that comes meanwhile is counted once or not yet
    rest_us = window.start_us
    for start in range(0, len(stored), READ_AT_ONCE):
        some = stored[start : start + READ_AT_ONCE]
        with database.read() as connection:
            buckets, found = ATTITUDE.read(
                connection, some, intervals, slice(columns), has_rows=columns <= _framed(name)
            )
        if buckets is not None:
            yield buckets
        for day in (each for each in some if each.summary_id in found):
            yield from _as_rows(read, Window(rest_us, day.first_us), columns)
            rest_us = max(rest_us, day.last_us + 1)
    yield from _as_rows(read, Window(rest_us, window.stop_us), columns)


def forget_days(connection: Connection, key: int, consumed_epoch_us: int | None, epochs_us: Iterable[int]) -> None:
    """Delete the summaries of days before that of the consumer's epoch, for which results are stored now."""
    newest = -math.inf if consumed_epoch_us is None else day_of(consumed_epoch_us)
    days_us = sorted({day_of(epoch_us) * DAY_US for epoch_us in epochs_us if day_of(epoch_us) < newest})
    for start in range(0, len(days_us), READ_AT_ONCE):
        is_one = table.c.start_us.in_(days_us[start : start + READ_AT_ONCE])
        connection.execute(delete(table).where(table.c.spacecraft_key == key, is_one))


def day_blobs(read: RowPages[Row], start_us: int, name: str) -> SummaryBlobs:
    """Return the summary of the rows of a day that a method computed."""
    parts = [_computed(rows) for rows in pages(read, Window(start_us, start_us + DAY_US))]
    found = [part for part in parts if len(part[0])]
    if not found:
        return NO_ROWS
    epochs_us, values = (np.concatenate(arrays) for arrays in zip(*found, strict=True))
    return pack_day(epochs_us, values, _framed(name))


def _framed(name: str) -> int:
    """Return of how many columns of a series rows are kept."""
    return 0 if name == TORQUE else SAMPLED


def _computed(rows: Sequence[Row]) -> tuple[IntArray, FloatArray]:
    """Return epochs and figures of the rows that a method computed."""
    # a row without a calibration says only that nothing was computed
    computed = [row for row in rows if isinstance(row, TorqueCommand) or row.calibration_id is not None]
    epochs_us = np.array([row.epoch_us for row in computed], dtype=np.int64)
    return epochs_us, np.array([_figures(row) for row in computed], dtype=np.float64)


def _figures(row: Row) -> tuple[float, ...]:
    """Return what is summarised of a row, of attitude `ATTITUDE_FIGURES`; a new figure stands at the end."""
    if isinstance(row, TorqueCommand):
        return row.impulse_n_m_s
    others = (row.residual_rms_db, row.common_db, row.downlink_fade_db, row.carriers_used, row.control_allowed)
    return (*row.attitude_deg, *row.sigma_deg, *row.protection_deg, *others)


def _as_rows(read: RowPages[Row], window: Window, columns: int) -> Iterator[Summaries]:
    """Yield the first columns of the rows of a window."""
    if window.start_us < window.stop_us:
        for rows in pages(read, window):
            epochs_us, values = _computed(rows)
            if len(epochs_us):
                yield Summaries.of_rows(epochs_us, values[:, :columns])


def _make(
    database: Database,
    key: int,
    name: str,
    read: RowPages[Row],
    read_carriers: RowPages[CarrierRow] | None,
    start_us: int,
) -> bool:
    """Summarise a day; False when a late row came meanwhile."""
    write = partial(database.leases.under, name=database.name(key))
    summary_id = database.write(write(partial(_begin, key=key, name=name, start_us=start_us)))
    blobs = day_blobs(read, start_us, name)
    by_plan = {} if read_carriers is None else blobs_by_plan(read_carriers, start_us)
    states = None if name == TORQUE else stretch_of(cast(Any, read), Window(start_us, start_us + DAY_US))
    made = _Made(blobs, by_plan, states)
    return database.write(write(partial(_finish, key=key, summary_id=summary_id, made=made)))


def _begin(connection: Connection, key: int, name: str, start_us: int) -> int:
    """Store a summary without bytes and return its id."""
    values = {"spacecraft_key": key, "method": name, "start_us": start_us}
    insert_new(connection, table, [values])
    query = select(table.c.summary_id).where(_is_of(key, name), table.c.start_us == start_us)
    return int(connection.execute(query).scalar_one())


def _finish(connection: Connection, key: int, summary_id: int, made: _Made) -> bool:
    """Give a summary its bytes if it is still there."""
    lock_head(connection, key)
    is_it = and_(table.c.summary_id == summary_id, table.c.day.is_(None))
    begun: Any = connection.execute(select(table).where(is_it)).first()
    if begun is None:
        return False
    # replaced, not updated: its checksum is that of the whole row
    connection.execute(delete(table).where(is_it))
    values = {"spacecraft_key": key, "method": begun.method, "start_us": begun.start_us}
    stored: Any = connection.execute(table.insert().values(**values, **made.attitude._asdict()))
    store_carriers(connection, stored.inserted_primary_key[0], made.by_plan)
    store_states(connection, stored.inserted_primary_key[0], made.states)
    return True


def _is_of(key: int, name: str) -> ColumnElement[bool]:
    return and_(table.c.spacecraft_key == key, table.c.method == name)
