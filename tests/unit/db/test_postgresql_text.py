"""Statements of the hot path read as PostgreSQL wants them, so that several processes keep one journal."""

import pytest
from sqlalchemy import select
from sqlalchemy.dialects.postgresql import psycopg
from sqlalchemy.schema import CreateTable

from db.connection.prepared_statements import PreparedStatement
from db.measurements.ingest import _MOVE_SOURCE, _READ_STATE
from db.measurements.ingest_grouped import _READ_STATES
from db.schema.tables import attitude, head, measurement


class Recorder:
    """A connection that keeps what it is told to run."""

    dialect = psycopg.dialect()

    def exec_driver_sql(self, text, values):
        self.said = text, values
        return self


@pytest.mark.parametrize("statement", [_MOVE_SOURCE, _READ_STATE, _READ_STATES])
def test_values_go_by_name(statement):
    recorder = Recorder()
    values = range(len(statement._names))
    statement.run(recorder, *values)
    text, named = recorder.said
    assert named == dict(zip(statement._names, values, strict=True))
    assert all(f"%({name})s" in text for name in named)


def test_a_wrong_number_of_values_is_an_error():
    with pytest.raises(ValueError, match="zip"):
        _MOVE_SOURCE.run(Recorder(), 1)


def test_the_head_is_locked_where_others_write_too():
    lock = select(head).with_for_update()
    recorder = Recorder()
    PreparedStatement(lock).run(recorder)
    assert recorder.said[0].endswith("FOR UPDATE")


def test_columns_have_the_server_s_types():
    assert "powers BYTEA NOT NULL" in str(CreateTable(measurement).compile(dialect=Recorder.dialect))
    made = str(CreateTable(attitude).compile(dialect=Recorder.dialect))
    # FLOAT without a precision is double precision on this server
    assert "yaw_deg FLOAT," in made
    assert "epoch_us BIGINT NOT NULL" in made
