"""Engines keep what is committed, keep readers from writing, and refuse databases that forget."""

import pytest
from sqlalchemy.exc import OperationalError

from db.connection.engines import open_engines, translated_faults
from service.errors import StorageError


@pytest.fixture
def engines(tmp_path):
    opened = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    yield opened
    opened.dispose()


@pytest.mark.parametrize("role", ["write", "read"])
def test_sqlite_is_durable(engines, role):
    with getattr(engines, role).connect() as connection:
        said = {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        }
    # synchronous 2 is FULL
    assert said == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}


def test_readers_cannot_write(engines):
    with engines.read.connect() as connection, pytest.raises(OperationalError, match="readonly"):
        connection.exec_driver_sql("CREATE TABLE t (a INT)")


def test_a_reader_sees_one_state_while_the_writer_goes_on(engines):
    with engines.write.begin() as connection:
        connection.exec_driver_sql("CREATE TABLE t (a INT)")
    with engines.read.connect() as reader:
        assert reader.exec_driver_sql("SELECT count(*) FROM t").scalar() == 0
        with engines.write.begin() as connection:
            connection.exec_driver_sql("INSERT INTO t VALUES (1)")
        assert reader.exec_driver_sql("SELECT count(*) FROM t").scalar() == 0
    with engines.read.connect() as reader:
        assert reader.exec_driver_sql("SELECT count(*) FROM t").scalar() == 1


def test_a_transaction_that_the_database_gave_up_does_not_pass_for_committed(engines):
    with engines.write.connect() as connection:
        transaction = connection.begin()
        connection.connection.driver_connection.execute("ROLLBACK")
        with pytest.raises(OperationalError, match="no transaction"):
            transaction.commit()


@pytest.mark.parametrize("url", ["sqlite://", "sqlite:///:memory:", "mysql://host/soo"])
def test_databases_that_cannot_keep_the_promise_are_refused(url):
    with pytest.raises(ValueError, match="database"):
        open_engines(url)


def test_faults_become_storage_errors_without_the_statement(engines):
    with pytest.raises(StorageError) as caught, translated_faults(), engines.read.connect() as connection:
        connection.exec_driver_sql("SELECT secret FROM nowhere")
    assert caught.value.code == "storage.unavailable"
    assert "no such table: nowhere" in caught.value.detail
    assert "secret" not in caught.value.detail
