"""A file that is no longer the one that was opened is noticed before anybody is told that it keeps a row."""

import errno
import os
import shutil

import pytest
from sqlalchemy import text

from db.connection.engines import open_engines
from db.connection.file_identity import FileWatch
from db.schema.layout import create_tables
from service.errors import StorageError


@pytest.fixture
def engines(tmp_path):
    """An archive that is open."""
    opened = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    with opened.write.begin() as connection:
        create_tables(connection)
    yield opened
    opened.dispose()


def insert(engines, key):
    """Write a row."""
    with engines.write.begin() as connection:
        connection.exec_driver_sql("INSERT INTO spacecraft VALUES (?, 'craft-' || ?, '')", (key, key))


def stored(engines):
    """Return the keys of the rows."""
    with engines.read.connect() as connection:
        return list(connection.scalars(text("SELECT spacecraft_key FROM spacecraft")))


@pytest.mark.parametrize("name", ["soo.db", "soo.db-wal"])
def test_a_file_or_a_log_that_is_away_keeps_nothing_until_it_is_back(engines, tmp_path, name):
    insert(engines, 1)
    path, away = tmp_path / name, tmp_path / "away"
    path.rename(away)
    for use in (lambda: insert(engines, 2), lambda: stored(engines)):
        with pytest.raises(StorageError) as caught:
            use()
        assert caught.value.code == "storage.gone"
    assert not path.exists()
    away.rename(path)
    insert(engines, 3)
    assert stored(engines) == [1, 3]


def test_a_commit_that_the_file_system_disowns_is_not_acknowledged(engines, monkeypatch):
    """An fsync can end well although the journal was given up meanwhile; from then on nothing can be changed."""

    def refuse(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    insert(engines, 1)
    with monkeypatch.context() as changed:
        changed.setattr("db.connection.file_identity.os.removexattr", refuse)
        with pytest.raises(StorageError, match="cannot be written: Read-only file system") as caught:
            insert(engines, 2)
        # a repetition finds the row, writes nothing, and is not acknowledged either
        with pytest.raises(StorageError), engines.write.begin():
            pass
        assert stored(engines) == [1, 2]
    assert caught.value.code == "storage.unavailable"
    insert(engines, 3)


def test_a_log_that_was_deleted_costs_nothing_once_the_archive_is_opened_anew(engines, tmp_path):
    insert(engines, 1)
    watch = FileWatch(tmp_path / "soo.db")
    watch.note()
    (tmp_path / "soo.db-wal").unlink()
    assert watch.is_to_be_reopened()
    engines.dispose()
    again = open_engines(f"sqlite:///{tmp_path / 'soo.db'}")
    assert stored(again) == [1]
    again.dispose()


def test_a_commit_into_a_file_that_went_meanwhile_is_not_told_as_kept(engines, tmp_path):
    connection = engines.write.connect()
    transaction = connection.begin()
    connection.exec_driver_sql("INSERT INTO spacecraft VALUES (1, 'craft', '')")
    (tmp_path / "soo.db").unlink()
    with pytest.raises(StorageError) as caught:
        transaction.commit()
    connection.close()
    assert caught.value.code == "storage.gone"


def test_another_archive_in_its_place_is_told_from_another_file(engines, tmp_path):
    path, other = tmp_path / "soo.db", tmp_path / "other.db"
    insert(engines, 1)
    watch = FileWatch(path)
    watch.note()
    assert not watch.is_to_be_reopened()
    other.write_text("no database")
    other.replace(path)
    with pytest.raises(StorageError) as caught:
        insert(engines, 2)
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


def test_a_file_that_is_away_is_not_replaced(engines, tmp_path):
    watch = FileWatch(tmp_path / "soo.db")
    watch.note()
    (tmp_path / "soo.db").unlink()
    assert not watch.is_to_be_reopened()
