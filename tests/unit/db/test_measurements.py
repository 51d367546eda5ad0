"""Rows are stored in runs as one by one, and missing numbers of a source are counted whatever comes in what order."""

from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete, select

from db.connection.engines import open_engines
from db.encoding.measurement_runs import insert_details
from db.encoding.power_codec import StoredRows
from db.measurements.row_insert import RowRun, insert_run
from db.measurements.sequence_numbers import RUNS_KEPT, Block, NumberedRow, SequenceNumbers, Tail, blocks_of
from db.schema.layout import create_tables
from db.schema.tables import measurement, measurement_detail, sequence_interval


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def engine(request, tmp_path_factory):
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path_factory.mktemp('rows') / 'soo.db'}"
    else:
        url = request.getfixturevalue("postgresql_cluster").new_database()
    engines = open_engines(url)
    with engines.write.begin() as connection:
        create_tables(connection)
    yield engines.write
    engines.dispose()


@st.composite
def blobs(draw, rows, least=1):
    width = draw(st.integers(least, 9))
    return StoredRows(width, draw(st.binary(min_size=rows * width, max_size=rows * width)))


@st.composite
def runs(draw):
    rows = draw(st.integers(1, 6))
    return RowRun(
        spacecraft_key=draw(st.integers(1, 9)),
        source_key=draw(st.integers(1, 9)),
        plan_id=draw(st.integers(1, 9)),
        received_at_us=draw(st.integers(-(1 << 61), 1 << 61)),
        feeds=draw(st.booleans()),
        is_late=draw(st.booleans()),
        first_number=draw(st.integers(1, 1 << 62)),
        first_seq=draw(st.none() | st.integers(0, 1 << 62)),
        epochs_us=draw(st.lists(st.integers(-(1 << 61), 1 << 61), min_size=rows, max_size=rows, unique=True)),
        powers=draw(blobs(rows)),
        flags=draw(st.none() | blobs(rows, 0)),
        figures=draw(st.none() | st.lists(st.none() | st.binary(max_size=9), min_size=rows, max_size=rows)),
    )


def rows_of(run):
    """Return the columns of each row."""
    return [
        {
            "spacecraft_key": run.spacecraft_key,
            "source_key": run.source_key,
            "plan_id": run.plan_id,
            "delay_us": run.received_at_us - epoch_us,
            "feeds": run.feeds,
            "is_late": run.is_late,
            "number": run.first_number + position,
            "seq": None if run.first_seq is None else run.first_seq + position,
            "epoch_us": epoch_us,
            "powers": run.powers.part(position, position + 1).rows,
            "flags": None if run.flags is None else run.flags.part(position, position + 1).rows,
            "checksum": run.checksums()[4 * position : 4 * position + 4],
        }
        for position, epoch_us in enumerate(run.epochs_us)
    ]


@settings(
    derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(run=runs())
def test_a_run_is_stored_as_its_rows(engine, run):
    stored = []
    for store in (lambda c: insert_run(c, run), lambda c: c.execute(measurement.insert(), rows_of(run))):
        with engine.begin() as connection:
            connection.execute(delete(measurement))
            store(connection)
            stored.append(connection.execute(select(measurement).order_by(measurement.c.number)).all())
    assert stored[0] == stored[1]
    assert len(stored[0]) == len(run.epochs_us)


@settings(
    derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)
@given(
    epochs_us=st.lists(st.integers(-(1 << 63), (1 << 63) - 1), min_size=1, max_size=6, unique=True),
    width=st.integers(1, 9),
    noise=st.randoms(use_true_random=False),
)
def test_details_are_stored_row_by_row(engine, epochs_us, width, noise):
    figures = noise.randbytes(width * len(epochs_us))
    with engine.begin() as connection:
        connection.execute(delete(measurement_detail))
        insert_details(connection, 3, 7, epochs_us, width, figures)
        stored = {row.epoch_us: row for row in connection.execute(select(measurement_detail))}
    assert [bytes(stored[epoch_us].figures) for epoch_us in epochs_us] == [
        figures[position * width : (position + 1) * width] for position in range(len(epochs_us))
    ]
    assert {(row.spacecraft_key, row.source_key) for row in stored.values()} == {(3, 7)}


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
