"""Runs of states: from when until when consecutive rows had the same status, inhibition, exclusion and so on.

A row has any number of states. A run is a longest sequence of consecutive rows that all have one state; it lasts from
its first to its last row. Stretches of rows are searched one by one and joined: what reaches over the end of one goes
on in the next.
"""

from collections.abc import Collection, Iterable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from service.core.rows.row_gaps import GAP_PERIODS, Gap, GapSearch, IntArray

_S = 1_000_000


class RowState(NamedTuple):
    """RowState of a row."""

    kind: str
    name: str
    #: empty where the state is not that of a carrier
    carrier: str = ""


class StateRun(NamedTuple):
    """Consecutive rows with one state: epochs of the first and of the last, microseconds UTC, and how many."""

    state: RowState
    start_us: int
    stop_us: int
    rows: int


class Stretch(NamedTuple):
    """Rows of one stretch of time, at least one."""

    first_us: int
    last_us: int
    #: usual distance of rows at its end; 0 where it has one row
    period_us: int
    #: by their first rows
    runs: Sequence[StateRun]
    gaps: Sequence[Gap]


class History(NamedTuple):
    """Runs and gaps of a span, each in order of start."""

    runs: list[StateRun]
    gaps: list[Gap]
    #: starts and stops, microseconds UTC, of what was not searched
    left_out_us: list[tuple[int, int]]


class StretchSearch:
    """Search for runs and gaps in the rows of one stretch, which come in pieces in order of epoch."""

    def __init__(self) -> None:
        self._gap_search = GapSearch()
        self._gaps: list[Gap] = []
        #: runs that the newest row belongs to: epoch of the first row, and how many rows came before it
        self._open: dict[RowState, tuple[int, int]] = {}
        self._runs: list[StateRun] = []
        self._first_us: int | None = None
        self._last_us = 0
        self._rows = 0

    def add(self, epochs_us: Sequence[int], states: Iterable[Collection[RowState]]) -> None:
        """Add rows with the states of each; equal states of neighbours may be the same object, which saves time."""
        self._gaps += self._gap_search.add(np.array(epochs_us, dtype=np.int64))
        before: Collection[RowState] | None = None
        for epoch_us, held in zip(epochs_us, states, strict=True):
            if held is not before:
                self._change(epoch_us, held)
                before = held
            self._last_us = epoch_us
            self._rows += 1
        if self._first_us is None and epochs_us:
            self._first_us = epochs_us[0]

    def end(self) -> Stretch | None:
        """Return what was found; None without a row."""
        self._change(self._last_us, ())
        self._gaps += self._gap_search.end()
        if self._first_us is None:
            return None
        runs = sorted(self._runs, key=lambda run: (run.start_us, run.state))
        return Stretch(self._first_us, self._last_us, self._gap_search.period_us, runs, self._gaps)

    def _change(self, epoch_us: int, held: Collection[RowState]) -> None:
        """End the runs of states that are gone, begin those of new ones."""
        for state in [state for state in self._open if state not in held]:
            start_us, before = self._open.pop(state)
            self._runs.append(StateRun(state, start_us, self._last_us, self._rows - before))
        for state in held:
            self._open.setdefault(state, (epoch_us, self._rows))


def joined_stretches(stretches: Sequence[Stretch], start_us: int, stop_us: int) -> History:
    """Return the runs and gaps of consecutive stretches that reach into [start, stop).

    What reaches over an end is returned whole, as far as the stretches go. Rows are expected from ``start_us`` and
    until ``stop_us``.
    """
    open_runs: dict[RowState, StateRun] = {}
    runs, gaps = [], _edge_gaps(stretches, start_us, stop_us)
    for position, stretch in enumerate(stretches):
        going_on, open_runs = open_runs, {}
        for run in stretch.runs:
            whole = run
            if run.start_us == stretch.first_us and (earlier := going_on.pop(run.state, None)) is not None:
                whole = StateRun(run.state, earlier.start_us, run.stop_us, earlier.rows + run.rows)
            if run.stop_us == stretch.last_us and position + 1 < len(stretches):
                open_runs[run.state] = whole
            else:
                runs.append(whole)
        runs += going_on.values()
        gaps += stretch.gaps
    inside = [run for run in runs if run.start_us < stop_us and run.stop_us >= start_us]
    missing = [gap for gap in gaps if gap.start_us < stop_us and gap.stop_us > start_us]
    return History(sorted(inside, key=lambda run: (run.start_us, run.state)), sorted(missing), [])


def _edge_gaps(stretches: Sequence[Stretch], start_us: int, stop_us: int) -> list[Gap]:
    """Return the gaps before, between and after stretches, by the usual distance of the rows beside them."""
    if not stretches:
        return []
    first, last = stretches[0], stretches[-1]
    edges = [(one.last_us, other.first_us, other.period_us or one.period_us) for one, other in pairwise(stretches)]
    edges.append((start_us - first.period_us, first.first_us, first.period_us))
    edges.append((last.last_us, stop_us, last.period_us))
    return [
        Gap(before_us + period_us, after_us, round((after_us - before_us) / period_us) - 1)
        for before_us, after_us, period_us in edges
        if period_us > 0 and after_us - before_us > GAP_PERIODS * period_us
    ]


def coarsened(runs: Sequence[StateRun], most: int) -> tuple[int, list[StateRun]]:
    """Return runs, and how near runs of one state were joined, s.

    0: they are at most ``most`` and nothing was joined. Otherwise runs of a state whose distance is at most that time
    stand as one, which counts the rows that have the state. The time is the least power of two that is enough, or that
    leaves one run of each state.

    Examples
    --------
    >>> fade = RowState("fade", "downlink")
    >>> coarsened([StateRun(fade, 0, 0, 1), StateRun(fade, 2_000_000, 2_000_000, 1)], 1)
    (2, [StateRun(state=RowState(kind='fade', name='downlink', carrier=''), start_us=0, stop_us=2000000, rows=2)])
    """
    # runs that are joined leave the distances to their neighbours as they are
    distances_us = np.sort(_distances_us(runs))
    # of the distances that must go, the greatest; where that leaves one run of each state, it is the last of all
    excess = min(len(runs) - most, len(distances_us))
    if excess <= 0:
        return 0, list(runs)
    join_s = 1
    while join_s * _S < distances_us[excess - 1]:
        join_s *= 2
    return join_s, _joined_within(runs, join_s * _S)


def _distances_us(runs: Sequence[StateRun]) -> IntArray:
    """Return the time from the end of each run to the next one of its state."""
    newest: dict[RowState, int] = {}
    found = []
    for state, start_us, stop_us, _ in runs:
        if state in newest:
            found.append(start_us - newest[state])
        newest[state] = stop_us
    return np.array(found, dtype=np.int64)


def _joined_within(runs: Sequence[StateRun], distance_us: int) -> list[StateRun]:
    """Return runs in order of start, those of a state that lie within a distance as one."""
    newest: dict[RowState, StateRun] = {}
    found = []
    for run in runs:
        earlier = newest.get(run.state)
        if earlier is not None and run.start_us - earlier.stop_us <= distance_us:
            newest[run.state] = StateRun(run.state, earlier.start_us, run.stop_us, earlier.rows + run.rows)
            continue
        if earlier is not None:
            found.append(earlier)
        newest[run.state] = run
    return sorted((*found, *newest.values()), key=lambda run: (run.start_us, run.state))
