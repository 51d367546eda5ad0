"""Nothing acknowledged is lost, nothing unacknowledged is half there; every wait ends; old days are dropped whole."""

import threading
import time
from concurrent.futures import wait
from contextlib import contextmanager

import numpy as np
import pytest
from psycopg import Connection
from sqlalchemy import create_engine, event, select
from stored_records import ALARM, COMMAND

from db.connection.server_engines import BoundedConnection, NoAnswerError
from db.connection.writer import ATTEMPTS
from db.encoding.segments import DAY_US
from db.measurements import closed_days
from db.storage import SqlStorage
from db.tables import retention_mark
from service.errors import ConflictError, StorageError
from service.ports.archive import ListPart, Outcome
from service.records.calibration import Window
from service.records.catalogue import Method, Site, Spacecraft
from service.records.inputs import Correction, Operation
from service.records.levels.attitude import Axes
from service.records.levels.measurement import CarrierDetails, Ring, Trace, TraceSettings
from service.records.operations.alarms import AlarmChange, ChangeKind, EngineMemory
from service.records.operations.release import ReleaseChange
from service.records.operations.work import LinkReport


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
    setting.storage.alarms.save([AlarmChange(ChangeKind.RAISED, ALARM, ALARM.changed_at_us, is_told=True)])
    setting.storage.alarms.save_memory(setting.id, EngineMemory((), 11, 60.5))
    setting.storage.links.report([LinkReport("sa-1", "analyzer", setting.id, "sa-1", "MEASURE", {}, {}, 7)], 9)
    setting.storage.links.set_enabled("sa-1", enabled=False)
    setting.storage.links.request_reset("sa-1")
    setting.storage.releases.save(setting.id, 0, ReleaseChange("kept", "process-1", commands=(COMMAND,)))

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
                storage.alarms.open_alarms(ALARM.spacecraft_id),
                storage.alarms.memory(name),
                storage.links.link("sa-1"),
                storage.releases.stored(name),
                storage.releases.command(name, 1),
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
        setting.storage.results.free_jobs("late")
    assert caught.value.code == "storage.closed"
    reopened = SqlStorage(url)
    assert len(reopened.archive.measurements(setting.id, ListPart(make.ever, 9))) == 2
    reopened.close()


def test_a_future_that_was_cancelled_in_time_is_not_written(setting):
    release = held(setting.storage)
    future = setting.storage.archive.append_measurements(setting.batch([10]))
    assert future.cancel()
    release.set()
    assert setting.append([20]).accepted == 1
    assert [row.epoch_us for row in setting.rows()] == [20]


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


@contextmanager
def all_locked(url):
    """Keep every writer away by a foreign connection."""
    engine = create_engine(url, isolation_level="AUTOCOMMIT") if url.startswith("sqlite") else create_engine(url)
    with engine.connect() as connection:
        if url.startswith("sqlite"):
            connection.connection.driver_connection.isolation_level = None
            connection.exec_driver_sql("BEGIN IMMEDIATE")
        else:
            connection.exec_driver_sql("SELECT * FROM head FOR UPDATE")
        yield
        connection.connection.driver_connection.rollback()
    engine.dispose()


def test_a_lock_that_is_held_is_waited_for_once_by_all_who_wait(impatient, url):
    with all_locked(url):
        began = time.monotonic()
        futures = [impatient.storage.archive.append_measurements(impatient.batch([epoch])) for epoch in range(200)]
        wait(futures, 120)
        # one wait for each would take ten minutes
        assert time.monotonic() - began < BOUND_S
        assert {failed(future) for future in futures} == {"storage.unavailable"}
    assert impatient.append(range(200)).accepted == 200


def test_readers_do_not_wait_for_a_lock(impatient, url):
    impatient.append([1])
    with all_locked(url):
        assert len(impatient.rows()) == 1


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


def test_groups_of_two_services_in_opposite_order_share_journals_and_do_not_stop_each_other(setting, new_setting, url):
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
        for name in (setting.id, other.id):
            assert [entry.number for entry in twins[1].archive.journal(name, 3, 999)] == list(range(4, 154))
    finally:
        twins[1].close()


ALWAYS = 1 << 60


@pytest.fixture
def lived(setting, make, monkeypatch):
    """A spacecraft with four days of rows, the first two of them sealed, all consumed, with attitude and commands."""
    monkeypatch.setattr(closed_days, "ROWS_AT_ONCE", 2)
    figures = np.ones((4, 1, 3), dtype=np.float32)
    for day in range(4):
        for row in range(3):
            details = CarrierDetails(*figures) if row == 1 else None
            setting.append([day * DAY_US + row], source="sa-1", details=details)
        setting.append([day * DAY_US + 1], source="sa-2")
    list(setting.storage.archive.seal(setting.id, 2 * DAY_US, ALWAYS))
    setting.consume(
        [
            Outcome((make.attitude_row(row), make.attitude_row(row, Method.PAPER)), make.torque_command(row))
            for row in setting.rows()
            if row.feeds_estimator
        ]
    )
    return setting


def drop(setting, series, before_us):
    return sum(dropped.rows for dropped in setting.storage.archive.drop_before(setting.id, series, before_us))


def attitude(setting, make, method=Method.ROBUST):
    rows = setting.storage.results.attitude_rows(setting.id, "live", method, ListPart(make.ever, 99))
    return [(row.epoch_us, row.status.value) for row in rows]


@pytest.mark.parametrize("days", [1, 2, 3])
def test_measurements_go_day_by_day_from_segments_and_rows(lived, make, days):
    archive = lived.storage.archive
    assert archive.kept_from_us(lived.id, "measurements") < 0
    before, attitudes = lived.rows(), attitude(lived, make)
    # the part of a day counts as none
    assert drop(lived, "measurements", days * DAY_US + 5) == 4 * days
    assert drop(lived, "measurements", days * DAY_US + 5) == 0
    assert [row.number for row in lived.rows()] == [row.number for row in before if row.epoch_us >= days * DAY_US]
    assert archive.kept_from_us(lived.id, "measurements") == days * DAY_US
    with lived.storage._database.read() as connection:
        assert connection.scalar(select(retention_mark.c.rows_dropped)) == 4 * days
    # attitude outlives what it was computed from, and nothing is told twice
    assert attitude(lived, make) == attitudes
    pages = [lived.storage.results.attitude_rows(lived.id, "live", Method.ROBUST, ListPart(make.ever, 5))]
    while page := lived.storage.results.attitude_rows(
        lived.id, "live", Method.ROBUST, ListPart(make.ever, 5, (pages[-1][-1].epoch_us, pages[-1][-1].number))
    ):
        pages.append(page)
    assert [(row.epoch_us, row.status.value) for page in pages for row in page] == attitudes


def test_the_journal_goes_on_behind_what_was_dropped(lived):
    archive = lived.storage.archive
    drop(lived, "measurements", 3 * DAY_US)
    assert [entry.number for entry in archive.journal(lived.id, 3, 2)] == [16, 17]
    assert archive.journal(lived.id, 19, 2) == []
    list(archive.seal(lived.id, ALWAYS, ALWAYS))
    assert [entry.number for entry in archive.journal(lived.id, 3, 2)] == [16, 17]
    assert lived.append([3 * DAY_US + 9]).accepted == 1


def test_attitude_that_was_dropped_is_neither_shown_nor_awaited(lived, make):
    results = lived.storage.results
    lived.calibrate()
    lived.align(5)
    assert results.pending(lived.id, [Method.ROBUST]) == 0
    assert drop(lived, "attitude", 2 * DAY_US) == 12
    assert {epoch_us // DAY_US for epoch_us, _ in attitude(lived, make)} == {2, 3}
    assert {status for _, status in attitude(lived, make)} == {"ACQUIRED"}
    fresh = type(results)(lived.storage._database)
    assert fresh.pending(lived.id, [Method.ROBUST, Method.PAPER]) == 0
    assert [sequence for sequence, _ in results.results_after(lived.id, 0, 3)][:1] != []
    assert results.newest_attitude(lived.id, "live", Method.ROBUST).epoch_us == 3 * DAY_US + 2


def test_attitude_is_told_when_all_measurements_are_gone(lived, make):
    before = attitude(lived, make)
    drop(lived, "measurements", 4 * DAY_US)
    assert lived.rows() == []
    assert lived.storage.archive.newest_measurement(lived.id) is None
    assert attitude(lived, make) == before
    assert lived.storage.results.newest_attitude(lived.id, "live", Method.PAPER).epoch_us == 3 * DAY_US + 2


def test_commands_go_too_and_a_resumed_stream_goes_on_behind_them(lived, make):
    assert drop(lived, "torques", 2 * DAY_US) == 6
    assert len(lived.storage.results.commands(lived.id, "live", ListPart(make.ever, 99))) == 6
    drop(lived, "attitude", 2 * DAY_US)
    (first, *_) = lived.storage.results.results_after(lived.id, 0, 2)
    assert first[1].epoch_us == 2 * DAY_US


def test_what_the_chain_has_not_consumed_stays(setting):
    setting.append([0, DAY_US])
    list(setting.storage.archive.seal(setting.id, DAY_US, ALWAYS))
    assert drop(setting, "measurements", ALWAYS) == 0
    assert len(setting.rows()) == 2


def test_traces_go_by_age(setting):
    traces = setting.storage.traces
    settings = TraceSettings(1.0, 1.0, 1.0, 1.0, 1.0)
    one = [Trace(day * DAY_US, "sweep", settings, np.zeros(3)) for day in range(3)]
    traces.append(setting.id, "sa-1", one, 5, Ring(99, 1 << 20))
    assert drop(setting, "traces", 2 * DAY_US) == 2
    assert [head.epoch_us for head in traces.heads(setting.id, ListPart(Window(0, ALWAYS), 9))] == [2 * DAY_US]


def test_the_oldest_days_do_not_fit_a_size(lived):
    fitting_us = lived.storage.archive.fitting_us
    for series in ("measurements", "attitude", "torques"):
        assert fitting_us(lived.id, series, 1 << 30) is None
        # the newest day stays whatever it takes
        assert fitting_us(lived.id, series, 0) == 3 * DAY_US
    assert fitting_us(lived.id, "attitude", 2 * 6 * 320) == 2 * DAY_US
    assert fitting_us(lived.id, "traces", 0) is None
