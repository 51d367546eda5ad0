"""States of live rows over time: runs of status, inhibitions, exclusions and others, and gaps.

Of each segment the runs are stored beside its bins. A day counts from them where every measurement of it that was
consumed has its row in a segment; the others are read as rows, the newest first, up to a bound.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, groupby, starmap
from typing import Any

from sqlalchemy import Connection, func, select

from db.database import Database, within
from db.encoding.column_blob import ColumnBlob, pack_columns
from db.encoding.segments import DAY_US, RowSeries, SegmentHead, day_of, heads, of_measurements
from db.measurements.retention import kept_from_us
from db.schema.tables import attitude, measurement, segment
from db.summaries import stored_blobs
from service.core.rows import Gap, History, RowState, StateRun, Stretch, StretchSearch, joined_stretches
from service.ports.archive import LIVE, ListPart
from service.records.calibration import Window
from service.records.levels.attitude import AttitudeRow

#: quantity of the summaries
STATES = "states"
#: kinds of rows beside the runs: gaps, with rows missing in the place of rows, and the stretch, with its period there
_GAP, _STRETCH = "gap", "stretch"
_STATE_COLUMNS = ("kind", "name", "carrier", "start_us", "stop_us", "rows")
#: rows of a method that one answer reads where no runs are stored: seven hours of a row a second
MOST_ROWS = 25_000


#: reader of attitude
Read = Callable[[ListPart], Sequence[AttitudeRow]]


def state_history(database: Database, key: int, method: str, read: Read, window: Window) -> History:
    """Return runs and gaps of a window: of sealed days as stored, of others from their newest rows."""
    stretches: list[Stretch] = []
    parts: list[History] = []
    stop_us, left = window.stop_us, MOST_ROWS
    with database.read() as connection:
        known = _parts(connection, RowSeries(key, attitude, LIVE, method), window)
    for part in reversed(known):
        if isinstance(part, Stretch):
            stretches.insert(0, part)
            continue
        rows, start_us = _newest_rows(read, part, left)
        left -= len(rows)
        found = stretch_of([rows])
        stretches[:0] = [] if found is None else [found]
        if start_us > part.start_us:
            parts.insert(0, joined_stretches(stretches, start_us, stop_us))
            parts.insert(0, History([], [], [(part.start_us, start_us)]))
            stretches, stop_us = [], part.start_us
    parts.insert(0, joined_stretches(stretches, window.start_us, stop_us))
    return History(*(list(chain.from_iterable(lists)) for lists in zip(*parts, strict=True)))


def _parts(connection: Connection, of: RowSeries, window: Window) -> list[Stretch | Window]:
    """Return the stored stretches of a window, and the windows beside them, in order."""
    found = heads(connection, of.of_segments(), day_of(window.start_us) * DAY_US, window.stop_us)
    days = {day: list(its) for day, its in groupby(found, lambda head: head.day)}
    whole = _whole_days(connection, of, days)
    blobs = stored_blobs(connection, [head.segment_id for day in whole for head in days[day]], STATES, 0)
    parts: list[Stretch | Window] = []
    rest_us = window.start_us
    for day in whole:
        stretches = _stretches(days[day], blobs)
        if stretches:
            parts += [Window(rest_us, day * DAY_US), *stretches] if rest_us < day * DAY_US else stretches
            rest_us = (day + 1) * DAY_US
    return [*parts, Window(rest_us, window.stop_us)] if rest_us < window.stop_us else parts


def _stretches(found: Sequence[SegmentHead], blobs: dict[int, bytes]) -> list[Stretch]:
    """Return the stretches of the segments of a day; none where one of them is missing or damaged."""
    try:
        return [stretch_from(blobs[head.segment_id]) for head in found]
    except (KeyError, ValueError):
        return []


def _whole_days(connection: Connection, of: RowSeries, days: dict[int, list[SegmentHead]]) -> list[int]:
    """Return the days on which each measurement that feeds has a sealed row of the series."""
    if not days:
        return []
    measured_from_us = kept_from_us(connection, of.key, "measurements")
    span = Window(min(days) * DAY_US, (max(days) + 1) * DAY_US)
    sealed = select(segment.c.day, func.sum(segment.c.feeding_count)).where(
        *of_measurements(of.key), segment.c.day.between(min(days), max(days))
    )
    counts = {row[0]: int(row[1]) for row in connection.execute(sealed.group_by(segment.c.day))}
    unsealed = select(measurement.c.epoch_us).where(
        measurement.c.spacecraft_key == of.key, measurement.c.feeds, within(measurement.c.epoch_us, span)
    )
    for epoch_us in connection.scalars(unsealed):
        counts[day_of(epoch_us)] = counts.get(day_of(epoch_us), 0) + 1
    rows = select(attitude.c.epoch_us).where(*of.of_rows(), within(attitude.c.epoch_us, span))
    mixed = {day_of(epoch_us) for epoch_us in connection.scalars(rows)}
    return [
        day
        for day, its in sorted(days.items())
        if day not in mixed
        and (day * DAY_US < measured_from_us or counts.get(day, 0) == sum(head.row_count for head in its))
    ]


def _newest_rows(read: Read, window: Window, most: int) -> tuple[Sequence[AttitudeRow], int]:
    """Return the newest rows of a window, whole epochs, and the epoch from which on they are all."""
    rows = read(ListPart(window, most + 1, newest_first=True))[::-1]
    if len(rows) <= most:
        return rows, window.start_us
    start_us = rows[0].epoch_us + 1
    return [row for row in rows if row.epoch_us >= start_us], start_us


def stretch_blob(found: Stretch) -> bytes:
    """Return the runs and gaps of a stretch as a blob."""
    whole = (_STRETCH, "", "", found.first_us, found.last_us, found.period_us)
    gaps = ((_GAP, "", "", *gap) for gap in found.gaps)
    columns = zip(whole, *gaps, *((*state, *numbers) for state, *numbers in found.runs), strict=True)
    return pack_columns(dict(zip(_STATE_COLUMNS, map(list, columns), strict=True)))


def stretch_from(blob: bytes) -> Stretch:
    """Return the runs and gaps of a blob; ValueError where it holds none."""
    held = ColumnBlob(blob)
    columns = [held.values(name, slice(None)) for name in _STATE_COLUMNS]
    first, *others = zip(*columns, strict=True)
    if first[0] != _STRETCH:
        message = f"states begin with {first[0]!r}"
        raise ValueError(message)
    gaps = [Gap(*numbers) for kind, _, _, *numbers in others if kind == _GAP]
    runs = [StateRun(RowState(*each[:3]), *each[3:]) for each in others if each[0] != _GAP]
    first_us, last_us, period_us = first[3:]
    return Stretch(first_us, last_us, period_us, runs, gaps)


def stretch_of(found: Iterable[Sequence[AttitudeRow]]) -> Stretch | None:
    """Return runs and gaps of rows that come in pieces; None where there is no row."""
    search = StretchSearch()
    for rows in found:
        search.add([row.epoch_us for row in rows], _states(rows))
    return search.end()


def _states(rows: Sequence[AttitudeRow]) -> Iterator[tuple[RowState, ...]]:
    """Yield the states of rows, one object for neighbours that have the same."""
    before: tuple[Any, ...] = ()
    states: tuple[RowState, ...] = ()
    for row in rows:
        held = (row.status, row.control_allowed, row.inhibitions, row.advice, row.downlink_fade, row.excluded)
        if held != before:
            before, states = held, tuple(dict.fromkeys(_states_of(row)))
        yield states


def _states_of(row: AttitudeRow) -> Iterator[RowState]:
    """Yield the states of a row."""
    yield RowState("status", row.status.value)
    if row.control_allowed:
        yield RowState("control", "allowed")
    yield from (RowState("inhibition", name) for name in row.inhibitions)
    yield from (RowState("advice", name) for name in row.advice)
    if row.downlink_fade:
        yield RowState("fade", "downlink")
    yield from starmap(_exclusion, row.excluded)


def _exclusion(carrier: str, reason: str) -> RowState:
    return RowState("exclusion", reason, carrier)
