"""Missing numbers of a source are counted whatever comes in what order."""

from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete, select

from db.connection.engines import open_engines
from db.measurements.sequence_numbers import RUNS_KEPT, Block, NumberedRow, SequenceNumbers, Tail, blocks_of
from db.tables import create_tables, sequence_interval

BLOCKS = st.lists(
    st.tuples(st.integers(0, 40), st.integers(0, 5), st.integers(0, 99), st.booleans()), min_size=1, max_size=40
)


@pytest.fixture(scope="module")
def sequence_engine(tmp_path_factory):
    engines = open_engines(f"sqlite:///{tmp_path_factory.mktemp('numbers') / 'soo.db'}")
    with engines.write.begin() as connection:
        create_tables(connection)
    yield engines.write
    engines.dispose()


def intervals(connection, tail: Tail) -> dict[int, list[tuple[int, int]]]:
    """Return the intervals of each run in order."""
    found = {tail.run: [(tail.start, tail.last)]}
    for row in connection.execute(select(sequence_interval)):
        found.setdefault(row.run, []).append((row.first_seq, row.last_seq))
    return {run: sorted(parts) for run, parts in found.items()}


@settings(
    derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(drawn=BLOCKS)
def test_the_count_is_what_the_intervals_leave_out(sequence_engine, drawn):
    with sequence_engine.begin() as connection:
        connection.execute(delete(sequence_interval))
        numbers, tail, newest_us, lost = SequenceNumbers(connection, 1, 1), None, None, 0
        for first, more, epoch_us, wants_ahead in drawn:
            is_ahead = newest_us is None or (wants_ahead and epoch_us > newest_us)
            before = tail
            tail = numbers.added(tail, Block(first, first + more, epoch_us, is_ahead), newest_us)
            newest_us = epoch_us if newest_us is None else max(newest_us, epoch_us)
            assert before is None or tail.run >= before.run
        parts = intervals(connection, tail)
    if tail.run <= RUNS_KEPT:
        for run in parts.values():
            # disjoint, apart by one at least
            gaps = [after[0] - before[1] - 1 for before, after in pairwise(run)]
            assert all(gap > 0 for gap in gaps), run
            lost += sum(gaps)
        assert tail.rows_missing == lost


def test_runs_that_are_no_longer_kept_leave_no_rows_behind(sequence_engine):
    with sequence_engine.begin() as connection:
        connection.execute(delete(sequence_interval))
        numbers, tail = SequenceNumbers(connection, 1, 1), None
        for k in range(3 * RUNS_KEPT):
            tail = numbers.added(tail, Block(0, 9, 10 * k + 1, is_ahead=True), 10 * k)
        assert set(intervals(connection, tail)) == set(range(2 * RUNS_KEPT + 1, 3 * RUNS_KEPT + 1))
        connection.execute(delete(sequence_interval))


def test_held_rows_carry_a_block_on_and_neither_begin_nor_end_one():
    rows = [
        NumberedRow(4, 40, is_new=False),
        NumberedRow(5, 50, is_new=True),
        NumberedRow(6, 60, is_new=False),
        NumberedRow(7, 70, is_new=True),
        NumberedRow(8, 80, is_new=False),
        NumberedRow(10, 100, is_new=True),
    ]
    assert list(blocks_of(rows, newest_us=90)) == [
        Block(5, 7, 50, is_ahead=False),
        Block(10, 10, 100, is_ahead=True),
    ]
