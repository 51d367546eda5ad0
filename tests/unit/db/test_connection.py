"""Engines keep what is committed; a file that was exchanged is noticed; batches are inserted; the writer goes on."""

import errno
import math
import os
import shutil
from threading import Event

import pytest
from sqlalchemy import create_engine, select, text
from sqlalchemy.dialects.postgresql import psycopg
from sqlalchemy.exc import IntegrityError, OperationalError
from sqlalchemy.schema import CreateTable

from db.columns import checksums_of
from db.connection.engines import FileWatch, open_engines, translated_faults
from db.connection.writer import GROUP_LIMIT, Writer, insert_new
from db.results.stored_rows import attitude_columns
from db.tables import attitude, create_tables, measurement
from service.errors import StorageError
from service.records.catalogue import Method
from service.records.levels.attitude import row_without_attitude


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


@pytest.fixture
def identity_engines(tmp_path):
    """An archive that is open."""
    opened = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    with opened.write.begin() as connection:
        create_tables(connection)
    yield opened
    opened.dispose()


def insert(engines, key):
    """Write a row."""
    with engines.write.begin() as connection:
        connection.exec_driver_sql("INSERT INTO spacecraft VALUES (?, 'craft-' || ?, '', '')", (key, key))


def stored(engines):
    """Return the keys of the rows."""
    with engines.read.connect() as connection:
        return list(connection.scalars(text("SELECT spacecraft_key FROM spacecraft")))


@pytest.mark.parametrize("name", ["soo.db", "soo.db-wal"])
def test_a_file_or_a_log_that_is_away_keeps_nothing_until_it_is_back(identity_engines, tmp_path, name):
    insert(identity_engines, 1)
    path, away = tmp_path / name, tmp_path / "away"
    path.rename(away)
    for use in (lambda: insert(identity_engines, 2), lambda: stored(identity_engines)):
        with pytest.raises(StorageError) as caught:
            use()
        assert caught.value.code == "storage.gone"
    assert not path.exists()
    away.rename(path)
    insert(identity_engines, 3)
    assert stored(identity_engines) == [1, 3]


def test_a_commit_that_the_file_system_disowns_is_not_acknowledged(identity_engines, monkeypatch):
    """An fsync can end well although the journal was given up meanwhile; from then on nothing can be changed."""

    def refuse(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    insert(identity_engines, 1)
    with monkeypatch.context() as changed:
        changed.setattr("db.connection.engines.os.removexattr", refuse)
        with pytest.raises(StorageError, match="cannot be written: Read-only file system") as caught:
            insert(identity_engines, 2)
        # a repetition finds the row, writes nothing, and is not acknowledged either
        with pytest.raises(StorageError), identity_engines.write.begin():
            pass
        assert stored(identity_engines) == [1, 2]
    assert caught.value.code == "storage.unavailable"
    insert(identity_engines, 3)


def test_a_log_that_was_deleted_costs_nothing_once_the_archive_is_opened_anew(identity_engines, tmp_path):
    insert(identity_engines, 1)
    watch = FileWatch(tmp_path / "soo.db")
    watch.note()
    (tmp_path / "soo.db-wal").unlink()
    assert watch.is_to_be_reopened()
    identity_engines.dispose()
    again = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    assert stored(again) == [1]
    again.dispose()


def test_a_commit_into_a_file_that_went_meanwhile_is_not_told_as_kept(identity_engines, tmp_path):
    connection = identity_engines.write.connect()
    transaction = connection.begin()
    connection.exec_driver_sql("INSERT INTO spacecraft VALUES (1, 'craft', '', '')")
    (tmp_path / "soo.db").unlink()
    with pytest.raises(StorageError) as caught:
        transaction.commit()
    connection.close()
    assert caught.value.code == "storage.gone"


def test_another_archive_in_its_place_is_told_from_another_file(identity_engines, tmp_path):
    path, other = tmp_path / "soo.db", tmp_path / "other.db"
    insert(identity_engines, 1)
    watch = FileWatch(path)
    watch.note()
    assert not watch.is_to_be_reopened()
    other.write_text("no database")
    other.replace(path)
    with pytest.raises(StorageError) as caught:
        insert(identity_engines, 2)
    assert caught.value.code == "storage.replaced"
    assert not watch.is_to_be_reopened()
    # the log of the file that was open would be taken for one of the new file
    assert not (tmp_path / "soo.db-wal").exists()
    assert (tmp_path / "soo.db-wal.of-replaced").exists()
    made = open_engines(f"sqlite:///{other}")
    with made.write.begin() as connection:
        create_tables(connection)
    made.dispose()
    shutil.move(other, path)
    assert watch.is_to_be_reopened()


def test_a_file_that_is_away_is_not_replaced(identity_engines, tmp_path):
    watch = FileWatch(tmp_path / "soo.db")
    watch.note()
    (tmp_path / "soo.db").unlink()
    assert not watch.is_to_be_reopened()


@pytest.fixture
def rows():
    """Return three rows without angles, all of whose figures are NaN."""
    return [row_without_attitude(60 * k, 60 * k + 1, k, Method.ROBUST, ("not_aligned",)) for k in (1, 2, 3)]


def columns_of(rows, carriers=None):
    columns = attitude_columns(7, "live", rows, [row.number for row in rows], [None] * len(rows))
    return {**columns, "carriers": [carriers] * len(rows)}


def test_rows_that_stand_stay_as_they_are(rows):
    engine = create_engine("sqlite://")
    with engine.begin() as connection:
        attitude.create(connection)
        assert insert_new(connection, attitude, columns_of(rows[:2])) == 2
        changed = columns_of(rows, b"other")
        assert insert_new(connection, attitude, changed) == 1
        stored = connection.execute(select(attitude).order_by(attitude.c.epoch_us)).all()
    engine.dispose()
    assert [row.carriers for row in stored] == [None, None, b"other"]
    checksums = checksums_of(attitude, columns_of(rows[:2])) + checksums_of(attitude, changed)[2:]
    assert [row.checksum for row in stored] == checksums
    assert all(math.isnan(row.common_db) for row in stored)
    assert insert_new(connection, attitude, dict.fromkeys(changed, ())) == 0


def test_a_row_that_stands_is_an_error_where_none_may(rows):
    engine = create_engine("sqlite://")
    with engine.begin() as connection:
        attitude.create(connection)
        insert_new(connection, attitude, columns_of(rows[:1]), may_exist=False)
        with pytest.raises(IntegrityError):
            insert_new(connection, attitude, columns_of(rows), may_exist=False)
    engine.dispose()


def test_more_than_a_group_waiting_at_once_is_all_written_in_order(tmp_path):
    engines = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    writer, released, written = Writer(engines.write), Event(), []
    blocking = writer.submit(lambda _connection: released.wait(60))
    waiting = [
        writer.submit(lambda _connection, number=number: number, written.append) for number in range(3 * GROUP_LIMIT)
    ]
    released.set()
    assert blocking.result(60)
    assert [future.result(60) for future in waiting] == list(range(3 * GROUP_LIMIT)) == written
    writer.close()
    engines.dispose()


def test_columns_have_the_server_s_types():
    dialect = psycopg.dialect()
    assert "powers BYTEA NOT NULL" in str(CreateTable(measurement).compile(dialect=dialect))
    made = str(CreateTable(attitude).compile(dialect=dialect))
    # FLOAT without a precision is double precision on this server
    assert "yaw_deg FLOAT," in made
    assert "epoch_us BIGINT NOT NULL" in made
