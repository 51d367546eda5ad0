"""Summaries of the states of live rows: runs of status, inhibitions, exclusions and others, and gaps, by day.

They are made, stored and deleted together with the summary of the attitude of their day.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import chain, starmap
from typing import Any, Protocol

import zstandard
from sqlalchemy import Connection, select

from db.database import Database
from db.encoding.segments import DAY_US
from db.newest_rows import RowPages
from db.results.stored_rows import pages
from db.schema.columns import agrees, checksum_of
from db.schema.tables import attitude_summary, state_summary
from service.core.rows import Gap, History, RowState, StateRun, Stretch, StretchSearch, joined_stretches
from service.records.calibration import Window
from service.records.levels.attitude import AttitudeRow

#: kind under which gaps are stored beside the runs, rows missing in the place of rows
_GAP = "gap"
#: rows of a method that one answer reads where there are no summaries: seven hours of a row a second
MOST_ROWS = 25_000


class EitherEnd(Protocol):
    """Pages of attitude from either end of a window."""

    def __call__(
        self, window: Window, limit: int, after: tuple[int, int] | None, /, *, newest_first: bool = False
    ) -> Sequence[AttitudeRow]:
        """Return rows beyond a cursor."""


def stretch_of(read: RowPages[AttitudeRow], window: Window) -> Stretch | None:
    """Return runs and gaps of the rows of a window; None where there is no row."""
    return _stretch(pages(read, window))


def store_states(connection: Connection, summary_id: int, stretch: Stretch | None) -> None:
    """Store the states that go with a summary of attitude."""
    if stretch is None:
        return
    gaps = (((_GAP, "", ""), *gap) for gap in stretch.gaps)
    flat = [(*state, *numbers) for state, *numbers in (*stretch.runs, *gaps)]
    values: dict[str, Any] = {
        "summary_id": summary_id,
        "first_us": stretch.first_us,
        "last_us": stretch.last_us,
        "period_us": stretch.period_us,
        "content": zstandard.ZstdCompressor().compress(json.dumps(flat, separators=(",", ":")).encode()),
    }
    connection.execute(state_summary.insert().values(values))


def stored_states(connection: Connection, summary_id: int) -> Stretch | None:
    """Return the states that go with a summary of attitude; None where there are none or they are damaged."""
    row = connection.execute(select(state_summary).where(state_summary.c.summary_id == summary_id)).first()
    return None if row is None else _stored(row)


def state_history(database: Database, key: int, method: str, read: EitherEnd, window: Window) -> History:
    """Return runs and gaps of a window: of days with a sound summary from it, of the others from their newest rows."""
    stretches: list[Stretch] = []
    parts: list[History] = []
    stop_us, left = window.stop_us, MOST_ROWS
    for part in reversed(_parts(database, key, method, window)):
        if isinstance(part, Stretch):
            stretches.insert(0, part)
            continue
        rows, start_us = _newest_rows(read, part, left)
        left -= len(rows)
        found = _stretch([rows])
        stretches[:0] = [] if found is None else [found]
        if start_us > part.start_us:
            parts.insert(0, joined_stretches(stretches, start_us, stop_us))
            parts.insert(0, History([], [], [(part.start_us, start_us)]))
            stretches, stop_us = [], part.start_us
    parts.insert(0, joined_stretches(stretches, window.start_us, stop_us))
    return History(*(list(chain.from_iterable(lists)) for lists in zip(*parts, strict=True)))


def _parts(database: Database, key: int, method: str, window: Window) -> list[Stretch | Window]:
    """Return the stored stretches of a window, and the windows beside them, in order."""
    day = attitude_summary.c
    query = (
        select(state_summary, day.start_us)
        .join(attitude_summary, day.summary_id == state_summary.c.summary_id)
        .where(day.spacecraft_key == key, day.method == method)
        .where(day.start_us > window.start_us - DAY_US, day.start_us < window.stop_us)
        .order_by(day.start_us)
    )
    parts: list[Stretch | Window] = []
    rest_us = window.start_us
    for row in database.fetch(query):
        stored = _stored(row)
        if stored is not None:
            parts += [Window(rest_us, row.start_us), stored] if rest_us < row.start_us else [stored]
            rest_us = row.start_us + DAY_US
    return [*parts, Window(rest_us, window.stop_us)] if rest_us < window.stop_us else parts


def _newest_rows(read: EitherEnd, window: Window, most: int) -> tuple[Sequence[AttitudeRow], int]:
    """Return the newest rows of a window, whole epochs, and the epoch from which on they are all."""
    rows = read(window, most + 1, None, newest_first=True)[::-1]
    if len(rows) <= most:
        return rows, window.start_us
    start_us = rows[0].epoch_us + 1
    return [row for row in rows if row.epoch_us >= start_us], start_us


def _stretch(found: Iterable[Sequence[AttitudeRow]]) -> Stretch | None:
    """Return runs and gaps of rows that come in pieces; None where there is no row."""
    search = StretchSearch()
    for rows in found:
        search.add([row.epoch_us for row in rows], _states(rows))
    return search.end()


def _stored(row: Any) -> Stretch | None:
    """Return a stored stretch, None where it is damaged: its rows are still there."""
    if not agrees(row.checksum, partial(checksum_of, state_summary, row._asdict())):
        return None
    runs, gaps = [], []
    for kind, name, carrier, *numbers in json.loads(zstandard.ZstdDecompressor().decompress(row.content)):
        if kind == _GAP:
            gaps.append(Gap(*numbers))
        else:
            runs.append(StateRun(RowState(kind, name, carrier), *numbers))
    return Stretch(row.first_us, row.last_us, row.period_us, runs, gaps)


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
