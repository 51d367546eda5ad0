"""Rows of the archive in bins, across gaps and in runs of one state."""

import random
from itertools import pairwise

import numpy as np
import pytest
from example_counts import examples
from hypothesis import given, settings
from hypothesis import strategies as st

from service.core.rows import (
    STRETCH_ROWS,
    Gap,
    GapSearch,
    RowState,
    SampleBins,
    StateRun,
    StretchSearch,
    coarsened,
    joined_stretches,
)


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 40), st.integers(1, 60), st.integers(1, 10**12))
def test_every_row_is_counted_once_in_its_interval(seed, count, rows, span_us):
    rng = np.random.default_rng(seed)
    start_us = 1_795_219_200_000_000
    epochs_us = np.sort(start_us + rng.integers(0, span_us, rows))
    values = rng.normal(0.0, 1.0, (rows, 2)).astype(np.float32)
    values[rng.random((rows, 2)) < 0.2] = np.nan
    bins = SampleBins(start_us, start_us + span_us, count, 2)
    cut = rng.integers(0, rows + 1)
    bins.add(epochs_us[:cut], values[:cut])
    bins.add(epochs_us[cut:], values[cut:])
    positions = np.array([(each - start_us) * count // span_us for each in epochs_us.tolist()])
    samples = bins.all_intervals()
    assert samples.first_us.tolist() == [start_us + -(-position * span_us // count) for position in range(count)]
    for column, position in np.ndindex(2, count):
        inside = (positions == position) & np.isfinite(values[:, column])
        level, cell = values[inside, column], (position, column)
        assert samples.counts[cell] == len(level)
        if len(level):
            # float64 sums of float32: the order of adding changes the last digits
            assert samples.sums[cell] == pytest.approx(level.astype(float).sum(), rel=1e-12, abs=1e-12)
            assert (samples.minima[cell], samples.maxima[cell]) == (level.min(), level.max())
            assert samples.minimum_us[cell] == epochs_us[inside][level.argmin()]
            assert samples.maximum_us[cell] == epochs_us[inside][level.argmax()]


def test_no_rows_no_samples():
    bins = SampleBins(0, 10, 5, 1)
    bins.add(np.empty(0, dtype=np.int64), np.empty((0, 1)))
    assert bins.all_intervals().counts.tolist() == [[0]] * 5


S = 1_000_000


def gaps_of(epochs_s, chunks=1, start_s=None, stop_s=None):
    """Return the gaps of rows that come in pieces, in seconds."""
    search = GapSearch(None if start_s is None else start_s * S)
    found: list[Gap] = []
    for chunk in np.array_split(np.array([round(each * S) for each in epochs_s]), chunks):
        found += search.add(chunk)
    found += search.end(None if stop_s is None else stop_s * S)
    return [Gap(gap.start_us // S, gap.stop_us // S, gap.rows_missing) for gap in found]


@pytest.mark.parametrize("chunks", [1, 2, 7])
def test_missing_rows_are_counted(chunks):
    rows = [10 * k for k in range(100) if k not in {3, 50, 51, 52}]
    assert gaps_of(rows, chunks) == [(30, 40, 1), (500, 530, 3)]


def test_jitter_is_no_gap():
    rng = np.random.default_rng(4)
    assert gaps_of([10 * k + rng.uniform(-2.0, 2.0) for k in range(2000)], 3) == []


def test_another_period_from_a_stretch_on_is_no_gap():
    fast = [float(k) for k in range(STRETCH_ROWS)]
    slow = [STRETCH_ROWS + 10.0 * k for k in range(STRETCH_ROWS)]
    assert gaps_of([*fast, *slow]) == []


def test_a_gap_between_stretches_counts_once():
    rows = [float(k) for k in range(STRETCH_ROWS)] + [STRETCH_ROWS + 4.0 + k for k in range(STRETCH_ROWS)]
    assert gaps_of(rows) == [(STRETCH_ROWS, STRETCH_ROWS + 4, 4)]


def test_edges_count_where_rows_are_expected():
    rows = [50.0, 60.0, 70.0]
    assert gaps_of(rows) == []
    assert gaps_of(rows, start_s=20, stop_s=100) == [(20, 50, 3), (80, 100, 2)]
    assert gaps_of(rows, start_s=50, stop_s=80) == []


def test_rows_of_one_epoch_count_as_one():
    assert gaps_of([0, 0, 10, 10, 20, 50]) == [(30, 50, 2)]


@pytest.mark.parametrize("rows", [[], [5.0], [5.0, 5.0]])
def test_without_a_distance_there_is_no_gap(rows):
    assert gaps_of(rows, start_s=0, stop_s=100) == []


STATES = [RowState("status", "ACQUIRED"), RowState("inhibition", "fade"), RowState("exclusion", "step", "c01")]
FADE = RowState("fade", "downlink")


def stretch_of(rows, pieces=1):
    """Return what is found in rows that come in pieces."""
    search, size = StretchSearch(), max(1, -(-len(rows) // pieces))
    for start in range(0, len(rows), size):
        part = rows[start : start + size]
        search.add([epoch_us for epoch_us, _ in part], [held for _, held in part])
    return search.end()


def runs_row_by_row(rows):
    """Return the runs the slow way: each state of its own."""
    found = []
    for state in STATES:
        held = [position for position, (_, states) in enumerate(rows) if state in states]
        ends = [k for k, (one, other) in enumerate(pairwise(held)) if other > one + 1] + [len(held) - 1]
        begin = 0
        for end in ends if held else ():
            found.append(StateRun(state, rows[held[begin]][0], rows[held[end]][0], end - begin + 1))
            begin = end + 1
    return sorted(found, key=lambda run: (run.start_us, run.state))


@pytest.mark.parametrize("seed", range(30))
def test_runs_are_those_of_the_rows(seed):
    dice = random.Random(seed)
    share = dice.choice([0.05, 0.5, 0.95])
    epochs_us = [60 * S * k for k in range(400) if dice.random() < 0.97]
    held = frozenset(STATES)
    rows = []
    for epoch_us in epochs_us:
        held = frozenset(each for each in STATES if dice.random() < 0.5) if dice.random() < share else held
        rows.append((epoch_us, held))
    bounds = [0, *sorted(dice.sample(range(1, len(rows)), dice.randrange(6))), len(rows)]
    parts = [stretch_of(rows[start:stop], dice.randint(1, 5)) for start, stop in pairwise(bounds)]
    history = joined_stretches([part for part in parts if part], epochs_us[0], epochs_us[-1] + 1)
    assert history.runs == runs_row_by_row(rows)
    first_us, last_us = sorted(dice.sample(epochs_us, 2))
    inside = joined_stretches([part for part in parts if part], first_us, last_us)
    assert inside.runs == [run for run in history.runs if run.start_us < last_us and run.stop_us >= first_us]


def test_gaps_within_and_between_stretches_count_once():
    none: frozenset[RowState] = frozenset()
    first = stretch_of([(k * 10 * S, none) for k in range(20) if k not in {4, 5}])
    second = stretch_of([((30 + k) * 10 * S, none) for k in range(20)])
    found = joined_stretches([part for part in (first, second) if part], 0, 600 * S).gaps
    assert found == [Gap(40 * S, 60 * S, 2), Gap(200 * S, 300 * S, 10), Gap(500 * S, 600 * S, 10)]
    expected_earlier = joined_stretches([part for part in (second,) if part], 200 * S, 500 * S).gaps
    assert expected_earlier == [Gap(200 * S, 300 * S, 10)]


def test_without_rows_there_is_nothing():
    assert stretch_of([]) is None
    assert joined_stretches([], 0, 100) == ([], [], [])
    single = stretch_of([(5, frozenset({FADE}))])
    assert single is not None
    assert joined_stretches([single], 0, 100 * S) == ([StateRun(FADE, 5, 5, 1)], [], [])


@pytest.mark.parametrize("seed", range(10))
def test_coarse_runs_keep_every_row_and_no_more_than_near_ones_are_joined(seed):
    dice = random.Random(seed)
    rows = [(k * 60 * S, frozenset(each for each in STATES if dice.random() < 0.3)) for k in range(2000)]
    runs = runs_row_by_row(rows)
    assert coarsened(runs, len(runs)) == (0, runs)
    most = dice.choice([3, 20, 200])
    join_s, found = coarsened(runs, most)
    assert len(found) <= most
    for state in STATES:
        of_state = [run for run in found if run.state == state]
        assert sum(run.rows for run in of_state) == sum(state in held for _, held in rows)
        assert all(other.start_us - one.stop_us > join_s * S for one, other in pairwise(of_state))
        edges = {edge for run in runs if run.state == state for edge in (run.start_us, run.stop_us)}
        assert edges.issuperset(edge for run in of_state for edge in (run.start_us, run.stop_us))


def test_more_states_than_runs_are_allowed_leave_one_run_of_each():
    runs = [StateRun(RowState("exclusion", "step", f"c{k}"), k * S, k * S, 1) for k in range(5)]
    assert coarsened(runs, 2) == (0, runs)
