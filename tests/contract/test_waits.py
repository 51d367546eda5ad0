"""No wait has no end: a server that stopped, a lock that is held, a transaction that was ended for another one."""

import time
from concurrent.futures import wait

import pytest
from psycopg import Connection
from sqlalchemy import create_engine

from db.connection.postgresql_engines import BoundedConnection, NoAnswerError
from db.connection.writer import ATTEMPTS
from db.storage import SqlStorage
from service.errors import StorageError

#: a machine that stands still for so long fails a write, as it should: a busy one may for half a second
LIMIT_S = 3.0
#: far below one wait for each row, far above one for all of them: an answer that does not come, and a connection
BOUND_S = 60.0


@pytest.fixture
def impatient(setting, url):
    """The setting on a storage that does not wait for long."""
    first, setting.storage = setting.storage, SqlStorage(url, LIMIT_S)
    yield setting
    setting.storage.close()
    setting.storage = first


@pytest.fixture
def server(impatient):
    """The setting, on a server."""
    if impatient.storage._database.engines.write.dialect.name == "sqlite":
        pytest.skip("SQLite has one writer, which waits for nobody")
    return impatient


def failed(future):
    """Return the code of a write that must fail."""
    with pytest.raises(StorageError) as caught:
        future.result(BOUND_S)
    return caught.value.code


def lock_all(url):
    """Return a foreign connection that keeps every writer away."""
    engine = create_engine(url, isolation_level="AUTOCOMMIT") if url.startswith("sqlite") else create_engine(url)
    connection = engine.connect()
    if url.startswith("sqlite"):
        connection.connection.driver_connection.isolation_level = None
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    else:
        connection.exec_driver_sql("SELECT * FROM head FOR UPDATE")
    return connection


def test_a_lock_that_is_held_is_waited_for_once_by_all_who_wait(impatient, url):
    held = lock_all(url)
    began = time.monotonic()
    futures = [impatient.storage.archive.append_measurements(impatient.batch([epoch])) for epoch in range(200)]
    wait(futures, 120)
    # one wait for each would take ten minutes
    assert time.monotonic() - began < BOUND_S
    assert {failed(future) for future in futures} == {"storage.unavailable"}
    held.connection.driver_connection.rollback()
    held.close()
    held.engine.dispose()
    assert impatient.append(range(200)).accepted == 200


def test_readers_do_not_wait_for_a_lock(impatient, url):
    impatient.append([1])
    held = lock_all(url)
    assert len(impatient.rows()) == 1
    held.connection.driver_connection.rollback()
    held.close()
    held.engine.dispose()


def test_a_server_that_stopped_is_not_waited_for_without_end(server, postgresql_cluster):
    if postgresql_cluster.folder is None:
        pytest.skip("only a server of our own can be stopped")
    server.append([1000])
    with postgresql_cluster.stopped():
        began = time.monotonic()
        futures = [server.storage.archive.append_measurements(server.batch([epoch])) for epoch in range(100)]
        assert {failed(future) for future in futures} == {"storage.unavailable"}
        assert time.monotonic() - began < BOUND_S
    # what was given up may have been carried out, a part of it, after all
    receipts = [server.append([epoch]) for epoch in range(100)]
    assert [receipt.accepted + receipt.duplicates for receipt in receipts] == [1] * 100
    assert [row.epoch_us for row in server.rows()] == [*range(100), 1000]


def test_a_commit_whose_answer_was_lost_makes_the_row_a_duplicate(server, monkeypatch):
    def commit_unheard(connection):
        Connection.commit(connection)
        connection.pgconn.finish()
        message = "the server has not answered"
        raise NoAnswerError(message)

    with monkeypatch.context() as patch:
        patch.setattr(BoundedConnection, "commit", commit_unheard)
        assert failed(server.storage.archive.append_measurements(server.batch([5]))) == "storage.unavailable"
    receipt = server.append([5])
    assert (receipt.accepted, receipt.duplicates) == (0, 1)
    assert [entry.number for entry in server.storage.archive.journal(server.id, 3, 99)] == [4]


def deadlock(connection):
    """Fail as a statement fails that the server ended in favour of another transaction."""
    connection.exec_driver_sql("DO $$ BEGIN RAISE EXCEPTION USING ERRCODE = 'deadlock_detected'; END $$")


@pytest.mark.parametrize("is_alone", [True, False])
def test_a_group_that_lost_a_deadlock_runs_again(server, is_alone):
    runs = []

    def victim(connection):
        runs.append(1)
        if len(runs) < ATTEMPTS:
            deadlock(connection)
        return "done"

    others = [] if is_alone else [server.storage.archive.append_measurements(server.batch([7]))]
    reported = server.storage._database.submit(victim)
    assert reported.result(120) == "done"
    assert [other.result(120).accepted for other in others] == ([] if is_alone else [1])
    assert len(runs) == ATTEMPTS


def test_a_deadlock_without_end_is_told(server):
    assert failed(server.storage._database.submit(deadlock)) == "storage.unavailable"
    assert server.append([7]).accepted == 1


def test_groups_of_two_services_in_opposite_order_do_not_stop_each_other(setting, new_setting, url):
    other = new_setting()
    twins = [setting.storage, SqlStorage(url)]
    try:
        futures = []
        for position in range(150):
            batches = [setting.batch([position]), other.batch([position])]
            futures += [twins[0].archive.append_measurements(batch) for batch in batches]
            futures += [twins[1].archive.append_measurements(batch) for batch in reversed(batches)]
        receipts = [future.result(120) for future in futures]
        assert sum(receipt.accepted for receipt in receipts) == sum(receipt.duplicates for receipt in receipts) == 300
    finally:
        twins[1].close()
