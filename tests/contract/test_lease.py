"""The lease: one service of an archive has it, the next one gets it, and nothing is written under a lost one."""

import time
from pathlib import Path

import pytest

from db.storage import SqlStorage
from service.errors import StorageError
from service.ports import Outcome
from service.records.operations.alarm_memory import EngineMemory


@pytest.fixture
def twin(setting, url):
    """A second service's storage on the same archive."""
    other = SqlStorage(url)
    yield other
    other.close()


def outcome_of(row, make):
    """Return two results of a row."""
    return Outcome((make.attitude_row(row),), make.torque_command(row))


def lose(storage):
    """Take the lease's foundation away without a word to its holder."""
    hold = storage.lease._hold
    if storage._database.engines.write.dialect.name == "sqlite":
        # a process that loses this lock has ended
        storage.lease.give_back()
    else:
        with storage._database.engines.write.begin() as connection:
            connection.exec_driver_sql(f"SELECT pg_terminate_backend({hold._pid})")


def await_lease(storage):
    """Take the lease once the last holder's is over: a server sees a moment later that a connection has ended."""
    deadline_s = time.monotonic() + 120.0
    while not storage.lease.acquire():
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def test_one_has_it_until_it_gives_it_back(setting, twin):
    first = setting.storage
    assert first.lease.acquire()
    assert first.lease.acquire(), "who has it has it"
    assert not twin.lease.acquire()
    assert first.lease.is_held()
    assert not twin.lease.is_held()
    first.lease.give_back()
    assert not first.lease.is_held()
    await_lease(twin)
    assert not first.lease.acquire()


def test_a_closed_storage_holds_nothing(setting, twin, url):
    third = SqlStorage(url)
    assert third.lease.acquire()
    assert not twin.lease.acquire()
    third.close()
    await_lease(twin)


def test_what_is_written_under_a_lost_lease_is_refused(setting, twin, make):
    first = setting.storage
    setting.append([10])
    row = setting.rows()[0]
    assert first.lease.acquire()
    assert setting.consume([outcome_of(row, make)]) == 2
    lose(first)
    await_lease(twin)
    setting.append([20])
    later = outcome_of(setting.rows()[1], make)
    for write in (lambda: setting.consume([later]), lambda: first.alarms.save_memory(setting.id, EngineMemory())):
        with pytest.raises(StorageError) as caught:
            write()
        assert caught.value.code == "lease.lost"
    assert first.archive.head(setting.id).consumed_number == row.number
    assert not first.lease.is_held()
    # rows are anybody's to take in
    assert setting.append([30]).accepted == 1
    head = twin.archive.head(setting.id)
    assert twin.results.save_outcomes(setting.id, "live", [later], head.newest_number, head.newest_epoch_us) == 4


def test_who_never_asked_for_it_writes_as_before(setting, twin, make):
    assert twin.lease.acquire()
    setting.append([10])
    row = setting.rows()[0]
    assert setting.consume([outcome_of(row, make)]) == 2


def test_a_lock_on_a_file_that_was_taken_away_is_none(setting, twin, url):
    if not url.startswith("sqlite"):
        pytest.skip("a server keeps its locks itself")
    first = setting.storage
    assert first.lease.acquire()
    Path(f"{url.removeprefix('sqlite:///')}-lease").unlink()
    assert twin.lease.acquire()
    assert not first.lease.is_held()
    with pytest.raises(StorageError, match=r"lease\.lost"):
        first.alarms.save_memory(setting.id, EngineMemory())
    assert not first.lease.acquire()


def test_an_archive_that_is_away_gives_no_lease(tmp_path):
    storage = SqlStorage(f"sqlite:///{tmp_path / 'no' / 'folder' / 'soo.db'}")
    assert not storage.lease.acquire()
    assert not storage.lease.is_held()
    storage.close()
