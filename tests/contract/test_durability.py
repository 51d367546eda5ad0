"""Nothing acknowledged is lost, nothing unacknowledged is half there: groups, restarts, full disks, closing."""

import threading
from concurrent.futures import wait

import pytest
from sqlalchemy import event

from db.storage import SqlStorage
from service.errors import ConflictError, StorageError
from service.ports import Outcome
from service.records.catalogue import Site, Spacecraft
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import Axes


def held(storage):
    """Return a pair of events: the writer has stopped, and let it go on."""
    stopped, release = threading.Event(), threading.Event()

    def stop(_connection):
        stopped.set()
        release.wait(120)

    storage._database.submit(stop)
    stopped.wait(120)
    return release


def test_a_group_shares_one_commit(setting):
    commits = []
    event.listen(setting.storage._database.engines.write, "commit", commits.append)
    release = held(setting.storage)
    futures = [setting.storage.archive.append_measurements(setting.batch([epoch_us])) for epoch_us in range(20)]
    release.set()
    wait(futures, 120)
    assert [future.result().accepted for future in futures] == [1] * 20
    # one for the function that held the writer, one for the group
    assert len(commits) == 2


def test_a_failing_function_takes_nothing_of_its_group_with_it(setting):
    database = setting.storage._database

    def fail(connection):
        connection.exec_driver_sql("DELETE FROM measurement")
        raise ConflictError("test.fault", "on purpose")

    setting.append([1])
    release = held(setting.storage)
    before = setting.storage.archive.append_measurements(setting.batch([10, 20]))
    failing = database.submit(fail)
    broken = database.submit(lambda connection: connection.exec_driver_sql("SELECT nonsense"))
    after = setting.storage.archive.append_measurements(setting.batch([20, 30]))
    release.set()
    assert before.result(120).accepted == 2
    assert (after.result(120).accepted, after.result(120).duplicates) == (1, 1)
    with pytest.raises(ConflictError):
        failing.result(120)
    with pytest.raises(Exception, match="nonsense"):
        broken.result(120)
    assert [row.epoch_us for row in setting.rows()] == [1, 10, 20, 30]
    assert [entry.number for entry in setting.storage.archive.journal(setting.id, 3, 99)] == [4, 5, 6, 7]


def test_a_commit_that_fails_fails_the_whole_group_and_the_next_one_works(setting):
    database = setting.storage._database
    if database.engines.write.dialect.name != "sqlite":
        pytest.skip("only SQLite lets a test defer a foreign key to the commit")

    def orphan(connection):
        connection.exec_driver_sql("PRAGMA defer_foreign_keys=ON")
        connection.exec_driver_sql("INSERT INTO operation VALUES (12345, 1, 1, 1)")

    release = held(setting.storage)
    futures = [setting.storage.archive.append_measurements(setting.batch([epoch_us])) for epoch_us in (10, 20)]
    futures.append(database.submit(orphan))
    release.set()
    for future in futures:
        with pytest.raises(StorageError, match="FOREIGN KEY"):
            future.result(120)
    assert setting.rows() == []
    assert setting.append([10]).accepted == 1


def test_a_full_disk_is_a_storage_error_and_keeps_what_was_acknowledged(setting):
    engine = setting.storage._database.engines.write
    if engine.dialect.name != "sqlite":
        pytest.skip("only SQLite lets a test limit its size")
    with engine.connect() as connection:
        pages = connection.exec_driver_sql("PRAGMA page_count").scalar()
        connection.exec_driver_sql(f"PRAGMA max_page_count={pages + 8}")
        connection.rollback()
    stored = 0
    fault = None
    while fault is None:
        batch = setting.batch(range(stored, stored + 100))
        fault = setting.storage.archive.append_measurements(batch).exception(120)
        stored += 0 if fault else 100
    with pytest.raises(StorageError) as caught:
        raise fault
    assert caught.value.code == "storage.unavailable"
    assert "full" in caught.value.detail
    assert len(setting.rows()) == stored == setting.storage.archive.head(setting.id).newest_number - 3
    with engine.connect() as connection:
        connection.exec_driver_sql("PRAGMA max_page_count=1000000")
        connection.rollback()
    assert setting.append([-5]).accepted == 1


def test_a_restart_keeps_everything_and_goes_on_counting(setting, url, make):
    setting.append([10, 20], flags=[(1, 2, 3), None])
    setting.storage.archive.append_inputs(setting.id, [Correction(1, 2, Axes(0.1, 0.2, 0.3))])
    setting.storage.archive.add_operation(setting.id, Operation(0, "eclipse", 1, 2))
    setting.calibrate()
    setting.align(5)
    setting.consume([Outcome((make.attitude_row(setting.rows()[0]),), make.torque_command(setting.rows()[0]))])

    def everything(storage):
        archive, results, name = storage.archive, storage.results, setting.id
        return repr(
            [
                storage.catalogue.all_spacecraft(),
                archive.journal(name, 0, 99),
                archive.head(name),
                archive.sources(name),
                archive.operation(name, 1),
                results.calibrations(name),
                results.alignments(name),
                results.results_after(name, 0, 99),
            ]
        )

    before = everything(setting.storage)
    setting.storage.close()
    setting.storage = SqlStorage(url)
    setting.storage.prepare()
    try:
        assert everything(setting.storage) == before
        assert setting.append([10, 20], flags=[(1, 2, 3), None]).duplicates == 2
        assert setting.append([30]).accepted == 1
        assert setting.rows()[-1].number == setting.storage.archive.head(setting.id).newest_number == 10
    finally:
        setting.storage.close()


def test_close_commits_what_is_queued_and_then_refuses(setting, url, make):
    release = held(setting.storage)
    futures = [setting.storage.archive.append_measurements(setting.batch([epoch_us])) for epoch_us in (10, 20)]
    closing = threading.Thread(target=setting.storage.close)
    closing.start()
    release.set()
    closing.join(120)
    assert [future.result(0).accepted for future in futures] == [1, 1]
    with pytest.raises(StorageError) as caught:
        setting.storage.results.fail_unfinished_jobs("late")
    assert caught.value.code == "storage.closed"
    reopened = SqlStorage(url)
    assert len(reopened.archive.measurements(setting.id, make.ever, 9, None)) == 2
    reopened.close()


def test_a_future_that_was_cancelled_in_time_is_not_written(setting):
    release = held(setting.storage)
    future = setting.storage.archive.append_measurements(setting.batch([10]))
    assert future.cancel()
    release.set()
    assert setting.append([20]).accepted == 1
    assert [row.epoch_us for row in setting.rows()] == [20]


def test_two_storages_on_one_database_share_one_journal(setting, url):
    other = SqlStorage(url)
    try:
        twins = [setting.storage.archive, other.archive]
        futures = [twins[position % 2].append_measurements(setting.batch([position // 2])) for position in range(40)]
        receipts = [future.result(120) for future in futures]
        assert sum(receipt.accepted for receipt in receipts) == sum(receipt.duplicates for receipt in receipts) == 20
        assert [entry.number for entry in other.archive.journal(setting.id, 3, 99)] == list(range(4, 24))
    finally:
        other.close()


def test_the_state_of_a_database_without_an_archive_is_a_fault(storage, tmp_path):
    assert storage.state().queued_writes == 0
    empty = SqlStorage(f"sqlite:///{tmp_path / 'empty.db'}")
    with pytest.raises(StorageError):
        empty.state()
    empty.close()


def test_a_database_that_cannot_be_opened_is_a_storage_error(tmp_path):
    storage = SqlStorage(f"sqlite:///{tmp_path / 'no' / 'such' / 'folder' / 'soo.db'}")
    record = Spacecraft("a", "A", 90.0, Site(0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), 0.05)
    for call in (storage.state, storage.prepare, lambda: storage.catalogue.add_spacecraft(record)):
        with pytest.raises(StorageError) as caught:
            call()
        assert caught.value.code == "storage.unavailable"
    storage.close()
