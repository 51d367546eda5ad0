"""Figures of stretches of rows: samples of equal intervals, summaries of buckets, gaps, runs of states."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from itertools import count, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.core.arrays import FloatArray, IntArray

#: a distance of more periods than this lacks a row
GAP_PERIODS = 1.5
#: rows whose median distance is the usual one
STRETCH_ROWS = 500


class Gap(NamedTuple):
    """Instants without a row: start inclusive, stop exclusive, microseconds UTC."""

    start_us: int
    stop_us: int
    rows_missing: int


class GapSearch:
    """Search for gaps in rows that come in pieces.

    Parameters
    ----------
    start_us : int
        Where rows are expected from; None = from the first row on.
    """

    def __init__(self, start_us: int | None = None) -> None:
        self._start_us = start_us
        self._held = np.empty(0, dtype=np.int64)
        self._last_us: int | None = None
        self._period_us = 0.0

    @property
    def period_us(self) -> int:
        """Usual distance of the newest rows; 0 where none is known."""
        return round(self._period_us)

    def add(self, epochs_us: IntArray) -> Iterator[Gap]:
        """Yield the gaps that rows in order of epoch complete; rows of one epoch count as one."""
        self._held = np.concatenate([self._held, epochs_us])
        while len(self._held) >= STRETCH_ROWS:
            stretch, self._held = self._held[:STRETCH_ROWS], self._held[STRETCH_ROWS:]
            yield from self._stretch(stretch)

    def end(self, stop_us: int | None = None) -> Iterator[Gap]:
        """Yield the last gaps, with the one between the last row and where rows are expected to, if it is given."""
        if len(self._held):
            yield from self._stretch(self._held)
            self._held = self._held[:0]
        if stop_us is not None and self._last_us is not None:
            yield from self._between(np.array([self._last_us, stop_us]))

    def _stretch(self, epochs_us: IntArray) -> Iterator[Gap]:
        steps_us = np.diff(epochs_us)
        steps_us = steps_us[steps_us > 0]
        if len(steps_us):
            self._period_us = float(np.median(steps_us))
        if self._last_us is not None:
            epochs_us = np.concatenate([[self._last_us], epochs_us])
        elif self._start_us is not None and self._period_us > 0.0:
            # a row that stood right at the start would have been the first
            epochs_us = np.concatenate([[self._start_us - round(self._period_us)], epochs_us])
        yield from self._between(epochs_us)
        self._last_us = int(epochs_us[-1])

    def _between(self, epochs_us: IntArray) -> Iterator[Gap]:
        """Yield the gaps between rows."""
        if self._period_us <= 0.0:
            return
        periods = np.diff(epochs_us) / self._period_us
        for position in np.flatnonzero(periods > GAP_PERIODS).tolist():
            start_us = int(epochs_us[position]) + round(self._period_us)
            yield Gap(start_us, int(epochs_us[position + 1]), round(float(periods[position])) - 1)


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


#: behind every epoch
NEVER_US = 1 << 62


class Summaries(NamedTuple):
    """Buckets of B stretches of rows, C columns each; epochs in microseconds UTC."""

    #: (B,) epochs of the first and of the last row, whether or not they hold values
    first_us: IntArray
    last_us: IntArray
    #: (B, C) rows that hold a value
    counts: IntArray
    #: (B, C) 0 where there is none
    sums: FloatArray
    #: (B, C) inf and -inf where there is none
    minima: FloatArray
    maxima: FloatArray
    #: (B, C) first row that holds the extreme, behind every epoch where there is none
    minimum_us: IntArray
    maximum_us: IntArray

    @classmethod
    def of_rows(cls, epochs_us: IntArray, values: NDArray[np.floating]) -> "Summaries":
        """Return each row as a bucket; values (T, C), NaN = absent."""
        wide = values.astype(np.float64)
        is_held = ~np.isnan(wide)
        held_us = np.where(is_held, epochs_us[:, None], NEVER_US)
        low, high = np.where(is_held, wide, np.inf), np.where(is_held, wide, -np.inf)
        sums = np.where(is_held, wide, 0.0)
        return cls(epochs_us, epochs_us, is_held.astype(np.int64), sums, low, high, held_us, held_us)

    def at(self, positions: NDArray[np.integer] | NDArray[np.bool_] | slice) -> "Summaries":
        """Return some of the buckets."""
        return Summaries._make(array[positions] for array in self)

    def columns(self, columns: IntArray | slice) -> "Summaries":
        """Return some of the columns."""
        return Summaries._make((self.first_us, self.last_us, *(array[:, columns] for array in self[2:])))

    def gathered(self, owners: IntArray) -> "Summaries":
        """Return one bucket for each run of equal owners, (B,)."""
        starts = np.flatnonzero(np.diff(owners, prepend=owners[:1] - 1))
        if len(starts) == len(owners):
            return self
        lengths = np.diff(starts, append=len(owners))
        minima = np.minimum.reduceat(self.minima, starts, axis=0)
        maxima = np.maximum.reduceat(self.maxima, starts, axis=0)
        at_minima = np.where(self.minima == np.repeat(minima, lengths, axis=0), self.minimum_us, NEVER_US)
        at_maxima = np.where(self.maxima == np.repeat(maxima, lengths, axis=0), self.maximum_us, NEVER_US)
        return Summaries(
            np.minimum.reduceat(self.first_us, starts),
            np.maximum.reduceat(self.last_us, starts),
            np.add.reduceat(self.counts, starts, axis=0),
            np.add.reduceat(self.sums, starts, axis=0),
            minima,
            maxima,
            np.minimum.reduceat(at_minima, starts, axis=0),
            np.minimum.reduceat(at_maxima, starts, axis=0),
        )


def joined(parts: Sequence[Summaries]) -> Summaries:
    """Return the buckets of some parts, at least one, as they follow each other."""
    return Summaries._make(np.concatenate(arrays) for arrays in zip(*parts, strict=True))


#: lengths of whole intervals, s; longer ones are whole days
_BELOW_HOUR_S = (1, 2, 5, 10, 15, 20, 30, 60, 120, 300, 600, 900, 1200, 1800)
_WHOLE_S = (*_BELOW_HOUR_S, 3600, 7200, 10_800, 14_400, 21_600, 28_800, 43_200)
_DAY_S = 86_400


def whole_intervals(start_us: int, stop_us: int, most: int) -> tuple[int, int, int]:
    """Return the span widened to whole intervals of UTC, start and stop in microseconds, and how many there are.

    They are seconds, minutes, hours or days long, the shortest that are at most ``most``: summaries have their buckets.

    Examples
    --------
    >>> whole_intervals(7, 90 * 60_000_000, 3)
    (0, 5400000000, 3)
    """
    steps_us = _step_lengths_us(stop_us - start_us, most)
    each = ((step_us, start_us // step_us, -(-stop_us // step_us)) for step_us in steps_us)
    step_us, first, behind = next(found for found in each if found[2] - found[1] <= most)
    return first * step_us, behind * step_us, behind - first


def _step_lengths_us(span_us: int, most: int) -> Iterator[int]:
    """Yield lengths of intervals, ascending: whole days from about the shortest that would do, without an end."""
    yield from (1_000_000 * step for step in _WHOLE_S)
    fewest_days = max(1, span_us // (most * _DAY_S * 1_000_000))
    yield from (days * _DAY_S * 1_000_000 for days in count(fewest_days))


class SampleBins:
    """Intervals of several columns that rows and summaries of rows are added to, in any order.

    Parameters
    ----------
    start_us, stop_us : int
        Span, microseconds UTC; stop exclusive.
    count : int
        Intervals.
    columns : int
        Columns of values.
    """

    def __init__(self, start_us: int, stop_us: int, count: int, columns: int) -> None:
        # in whole numbers of any size: the products exceed 64 bits
        begins = [start_us - (-position * (stop_us - start_us) // count) for position in range(count)]
        self._bounds_us = np.array([*begins, stop_us], dtype=np.int64)
        self._count = count
        none = Summaries.of_rows(self._bounds_us[:-1], np.full((count, columns), np.nan))
        self._held = Summaries._make(array.copy() for array in none)

    def add(self, epochs_us: IntArray, values: NDArray[np.floating]) -> None:
        """Add rows, values of shape (T, columns); NaN = absent."""
        self.add_summaries(Summaries.of_rows(epochs_us, values))

    def add_summaries(self, buckets: Summaries, columns: IntArray | None = None) -> None:
        """Add buckets that lie within one interval each, or outside the span.

        ``columns`` are the columns of the intervals that those of the buckets belong to, the same ones by default.
        """
        owners = self._owners(buckets.first_us)
        order = np.argsort(owners, kind="stable")
        first, last = np.searchsorted(owners[order], (0, self._count))
        inside = order[first:last]
        if not len(inside):
            return
        found = buckets.at(inside).gathered(owners[inside])
        cells = np.unique(owners[inside])[:, None], np.arange(found.counts.shape[1]) if columns is None else columns
        held = self._held
        held.counts[cells] += found.counts
        held.sums[cells] += found.sums
        for extremes, epochs_us, new, new_us, is_better in (
            (held.minima, held.minimum_us, found.minima, found.minimum_us, np.less),
            (held.maxima, held.maximum_us, found.maxima, found.maximum_us, np.greater),
        ):
            is_new = is_better(new, extremes[cells])
            is_equal = new == extremes[cells]
            extremes[cells] = np.where(is_new, new, extremes[cells])
            earlier_us = np.where(is_equal, np.minimum(new_us, epochs_us[cells]), epochs_us[cells])
            epochs_us[cells] = np.where(is_new, new_us, earlier_us)

    def hold(self, first_us: IntArray, last_us: IntArray) -> NDArray[np.bool_]:
        """Return which of some stretches lie within one interval each, or outside the span."""
        return np.asarray(self._owners(first_us) == self._owners(last_us))

    def all_intervals(self) -> Summaries:
        """Return what every interval holds, in order, those without a row among them; ``first_us`` is its begin."""
        return self._held

    def _owners(self, epochs_us: IntArray) -> IntArray:
        """Return the interval of each epoch: -1 before the first, ``count`` behind the last."""
        return np.asarray(np.searchsorted(self._bounds_us, epochs_us, side="right") - 1)
