"""One step for a run of rows stores what one row at a time would store."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sqlalchemy import delete, select

from db.engine import open_engines
from db.migrate import upgrade
from db.row_insert import Run, _values, insert_run
from db.tables import measurement


@pytest.fixture(scope="module")
def engine(tmp_path_factory):
    engines = open_engines(f"sqlite:///{tmp_path_factory.mktemp('rows') / 'soo.db'}")
    upgrade(engines.write)
    yield engines.write
    engines.dispose()


@st.composite
def runs(draw):
    rows, width = draw(st.integers(1, 6)), 4 * draw(st.integers(1, 4))
    blob = st.binary(min_size=rows * width, max_size=rows * width)
    return Run(
        spacecraft_key=draw(st.integers(1, 9)),
        source_key=draw(st.integers(1, 9)),
        plan_id=draw(st.integers(1, 9)),
        received_at_us=draw(st.integers(-(1 << 62), 1 << 62)),
        feeds=draw(st.booleans()),
        is_late=draw(st.booleans()),
        first_number=draw(st.integers(1, 1 << 62)),
        first_seq=draw(st.none() | st.integers(0, 1 << 62)),
        epochs_us=draw(st.lists(st.integers(-(1 << 63), (1 << 63) - 1), min_size=rows, max_size=rows, unique=True)),
        powers=draw(blob),
        flags=draw(st.none() | blob),
    )


@settings(derandomize=True, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(run=runs())
def test_a_run_is_stored_as_its_rows(engine, run):
    stored = []
    for store in (lambda c: insert_run(c, run), lambda c: c.execute(measurement.insert(), _values(run))):
        with engine.begin() as connection:
            connection.execute(delete(measurement))
            store(connection)
            stored.append(connection.execute(select(measurement).order_by(measurement.c.number)).all())
    assert stored[0] == stored[1]
    assert len(stored[0]) == len(run.epochs_us)
