"""Insertion of a batch: rows that stand stay, values are those of the columns, the checksum is that of the row."""

import math

import pytest
from sqlalchemy import create_engine, select
from sqlalchemy.dialects.postgresql import psycopg

from db.connection.row_insertion import insert_new
from db.encoding.row_mapping import attitude_values
from db.schema.row_checksum import checksum_of
from db.schema.tables import attitude
from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude


@pytest.fixture
def rows():
    """Return the columns of three rows without angles, all of whose figures are NaN."""
    made = [row_without_attitude(60 * k, 60 * k + 1, k, Method.ROBUST, ("not_aligned",)) for k in (1, 2, 3)]
    return [{**attitude_values(7, "live", row, row.number), "carriers": None} for row in made]


def test_rows_that_stand_stay_as_they_are(rows):
    engine = create_engine("sqlite://")
    with engine.begin() as connection:
        attitude.create(connection)
        assert insert_new(connection, attitude, rows[:2]) == 2
        changed = [{**row, "carriers": b"other"} for row in rows]
        assert insert_new(connection, attitude, changed) == 1
        stored = connection.execute(select(attitude).order_by(attitude.c.epoch_us)).all()
    engine.dispose()
    assert [row.carriers for row in stored] == [None, None, b"other"]
    assert [row.checksum for row in stored] == [checksum_of(attitude, row) for row in (*rows[:2], changed[2])]
    assert all(math.isnan(row.common_db) for row in stored)
    assert insert_new(connection, attitude, []) == 0


def test_values_go_by_name_to_postgresql(rows):
    class Recorder:
        dialect, rowcount = psycopg.dialect(), 3

        def exec_driver_sql(self, text, values, **_options):
            self.said = text, values
            return self

    recorder = Recorder()
    assert insert_new(recorder, attitude, rows) == 3
    text, values = recorder.said
    assert text.endswith("ON CONFLICT DO NOTHING")
    assert all(f"%({name})s" in text for name in values[0])
    assert [each["epoch_us"] for each in values] == [60, 120, 180]
    assert {each["common_db"] for each in values} == {None}
