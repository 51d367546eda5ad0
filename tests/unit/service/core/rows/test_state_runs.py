"""Runs of states against the same runs found row by row, however rows are cut into stretches."""

import random
from itertools import pairwise

import pytest

from service.core.rows.row_gaps import Gap
from service.core.rows.state_runs import RowState, StateRun, Stretch, StretchSearch, coarsened, joined_stretches

S = 1_000_000
STATES = [RowState("status", "ACQUIRED"), RowState("inhibition", "fade"), RowState("exclusion", "step", "c01")]
FADE = RowState("fade", "downlink")


def stretch_of(rows: list[tuple[int, frozenset[RowState]]], pieces: int = 1) -> Stretch | None:
    """Return what is found in rows that come in pieces."""
    search, size = StretchSearch(), max(1, -(-len(rows) // pieces))
    for start in range(0, len(rows), size):
        part = rows[start : start + size]
        search.add([epoch_us for epoch_us, _ in part], [held for _, held in part])
    return search.end()


def runs_row_by_row(rows: list[tuple[int, frozenset[RowState]]]) -> list[StateRun]:
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
def test_runs_are_those_of_the_rows(seed: int) -> None:
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


def test_gaps_within_and_between_stretches_count_once() -> None:
    none: frozenset[RowState] = frozenset()
    first = stretch_of([(k * 10 * S, none) for k in range(20) if k not in {4, 5}])
    second = stretch_of([((30 + k) * 10 * S, none) for k in range(20)])
    found = joined_stretches([part for part in (first, second) if part], 0, 600 * S).gaps
    assert found == [Gap(40 * S, 60 * S, 2), Gap(200 * S, 300 * S, 10), Gap(500 * S, 600 * S, 10)]
    expected_earlier = joined_stretches([part for part in (second,) if part], 200 * S, 500 * S).gaps
    assert expected_earlier == [Gap(200 * S, 300 * S, 10)]


def test_without_rows_there_is_nothing() -> None:
    assert stretch_of([]) is None
    assert joined_stretches([], 0, 100) == ([], [], [])
    single = stretch_of([(5, frozenset({FADE}))])
    assert single is not None
    assert joined_stretches([single], 0, 100 * S) == ([StateRun(FADE, 5, 5, 1)], [], [])


@pytest.mark.parametrize("seed", range(10))
def test_coarse_runs_keep_every_row_and_no_more_than_near_ones_are_joined(seed: int) -> None:
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


def test_more_states_than_runs_are_allowed_leave_one_run_of_each() -> None:
    runs = [StateRun(RowState("exclusion", "step", f"c{k}"), k * S, k * S, 1) for k in range(5)]
    assert coarsened(runs, 2) == (0, runs)
