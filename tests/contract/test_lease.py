"""Leases: one process of an archive has that of a spacecraft, the next one gets it, and late writes are refused."""

import time
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import pytest
from sqlalchemy import text

from db.connection import lease
from db.connection.server_leases import require_own_session
from db.maintenance.doctor import diagnose
from db.storage import SqlStorage
from db.tables import LEASE_US
from service.errors import StorageError
from service.ports.archive import Outcome
from service.ports.storage import ARCHIVE
from service.records.epoch import US_PER_S
from service.records.operations.alarms import EngineMemory
from service.records.operations.work import Job, JobState
from service.runtime.clock import system_now_us


@pytest.fixture
def open_storage(setting, url):
    """Opener of the storages of further processes on the same archive."""
    opened = []

    def make(limit_s=10.0):
        opened.append(SqlStorage(url, limit_s))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


@pytest.fixture
def on_server(url):
    """Skip where the archive is a file."""
    if url.startswith("sqlite"):
        pytest.skip("a file has one lease, which ends with its process")


def outcome_of(row, make):
    """Return two results of a row."""
    return Outcome((make.attitude_row(row),), make.torque_command(row))


def held(storage, names=(), *, is_estimator=True):
    """Poll, and return the names among some, and the archive, that are led."""
    term = storage.leases.poll(is_estimator=is_estimator)
    return {name for name in (ARCHIVE, *names) if term(name)}


def carried_out(storage, statement, **values):
    """Carry out a statement of the server."""
    with storage._database.engines.write.begin() as connection:
        connection.execute(text(statement), values)


def end_session(storage):
    """End the session of a process as its kill does, without a word to its storage."""
    leases = storage.leases
    if storage._database.engines.write.dialect.name == "sqlite":
        # a process that loses this lock has ended
        leases.give_back()
    else:
        carried_out(storage, "SELECT pg_terminate_backend(:pid)", pid=leases._pid)


def await_lease(storage, name):
    """Poll until a lease is held: a server sees a moment later that a connection has ended."""
    deadline_s = time.monotonic() + 120.0
    while name not in held(storage, [name]):
        assert time.monotonic() < deadline_s
        time.sleep(0.005)


def is_stored(setting):
    """Append a row, and return whether it was."""
    try:
        return setting.append([10]).accepted == 1
    except StorageError:
        return False


@pytest.fixture
def silence(url, monkeypatch):
    """Function that lets others have had no word of a process for longer than a lease."""

    def silence(storage):
        if url.startswith("sqlite"):
            later = SimpleNamespace(monotonic=lambda: time.monotonic() + 2 * LEASE_US / US_PER_S, sleep=time.sleep)
            monkeypatch.setattr(lease, "time", later)
            return
        silent = "UPDATE member SET seen_at_us = seen_at_us - :us WHERE member_id = :id"
        carried_out(storage, silent, us=LEASE_US, id=storage.leases.member)

    return silence


def test_one_has_it_until_it_gives_it_back(setting, open_storage):
    first, twin = setting.storage, open_storage()
    assert held(first, [setting.id]) == {ARCHIVE, setting.id}
    assert held(first, [setting.id]) == {ARCHIVE, setting.id}, "who has it has it"
    assert held(twin, [setting.id]) == set()
    first.leases.give_back()
    await_lease(twin, setting.id)
    assert held(first, [setting.id]) == set()


def test_a_closed_storage_holds_nothing(setting, open_storage):
    third, twin = open_storage(), open_storage()
    assert held(third, [setting.id]) == {ARCHIVE, setting.id}
    assert held(twin, [setting.id]) == set()
    third.close()
    await_lease(twin, setting.id)


def test_what_is_written_under_a_lost_lease_is_refused(setting, open_storage, make):
    first, twin = setting.storage, open_storage()
    setting.append([10])
    row = setting.rows()[0]
    assert setting.id in held(first, [setting.id])
    assert setting.consume([outcome_of(row, make)]) == 2
    end_session(first)
    await_lease(twin, setting.id)
    setting.append([20])
    later = outcome_of(setting.rows()[1], make)
    for write in (lambda: setting.consume([later]), lambda: first.alarms.save_memory(setting.id, EngineMemory())):
        with pytest.raises(StorageError) as caught:
            write()
        assert caught.value.code == "lease.lost"
    assert first.archive.head(setting.id).consumed_number == row.number
    assert held(first, [setting.id]) == set()
    # rows are anybody's to store
    assert setting.append([30]).accepted == 1
    head = twin.archive.head(setting.id)
    assert twin.results.save_outcomes(setting.id, "live", [later], head.newest_number, head.newest_epoch_us) == 4


def test_who_never_asked_for_it_writes_as_before(setting, open_storage, make):
    assert setting.id in held(open_storage(), [setting.id])
    setting.append([10])
    row = setting.rows()[0]
    assert setting.consume([outcome_of(row, make)]) == 2


def test_who_is_no_estimator_leads_nothing(setting, open_storage):
    assert held(setting.storage, [setting.id], is_estimator=False) == set()
    twin = open_storage()
    assert held(twin, [setting.id]) == {ARCHIVE, setting.id}
    assert held(twin, [setting.id], is_estimator=False) == set() or setting.storage.leases.member is None


def test_refused_telemetry_is_counted_whichever_process_refuses_it(setting, open_storage):
    first, twin = setting.storage, open_storage()
    memory = EngineMemory((), 11, 60.5)
    assert held(first, [setting.id])
    for one, refused, count in ((first, [True], 1), (twin, [True, True], 3), (twin, [False], 0), (first, [True], 1)):
        one.alarms.count_refused(setting.id, refused)
        first.alarms.save_memory(setting.id, memory)
        assert [one.alarms.refused().get(setting.id, 0) for one in (first, twin)] == [count, count]
        assert twin.alarms.memory(setting.id) == memory


def test_a_lock_on_a_file_that_was_taken_away_is_none(setting, open_storage, url):
    if not url.startswith("sqlite"):
        pytest.skip("a server keeps its locks itself")
    first, twin = setting.storage, open_storage()
    assert held(first) == {ARCHIVE}
    Path(f"{url.removeprefix('sqlite:///')}-lease").unlink()
    assert held(twin) == {ARCHIVE}
    with pytest.raises(StorageError, match=r"lease\.lost"):
        first.alarms.save_memory(setting.id, EngineMemory())
    assert held(first) == set()


def test_an_archive_that_is_away_gives_no_lease(tmp_path):
    storage = SqlStorage(f"sqlite:///{tmp_path / 'no' / 'folder' / 'soo.db'}")
    assert held(storage) == set()
    storage.close()


def test_a_server_that_is_away_gives_no_lease_and_says_so(tmp_path, caplog):
    storage = SqlStorage(f"postgresql+psycopg://nobody@/none?host={tmp_path}")
    assert held(storage) == set()
    assert storage.leases.wait(0.01) == frozenset()
    assert "the archive gives no leases" in caplog.text
    storage.close()


@pytest.mark.usefixtures("on_server")
def test_processes_share_the_spacecraft_out(setting, new_setting, open_storage):
    names = [setting.id, *(new_setting().id for _ in range(4))]
    first, second, third = (open_storage() for _ in range(3))
    assert held(first, names) == {ARCHIVE, *names}
    # a share is 3 of 5; the first gives 2 back at its next poll
    assert held(second, names) == set()
    kept = held(first, names)
    assert (len(kept), ARCHIVE in kept) == (4, True)
    assert held(second, names) == set(names) - kept
    # what is not an estimator has no share
    assert held(third, names, is_estimator=False) == set()
    assert held(first, names) == kept
    leaders = first.leases.leaders()
    assert leaders == {name: (first if name in kept else second).leases.name for name in (ARCHIVE, *names)}
    second.leases.give_back()
    assert held(first, names) == {ARCHIVE, *names}


def test_a_stopped_process_and_a_dead_host_lose_their_leases_after_15_s(setting, open_storage, make, silence):
    """Their locks and sessions still stand: what counts is their silence."""
    first, twin = setting.storage, open_storage()
    assert held(first, [setting.id]) == {ARCHIVE, setting.id}
    assert held(twin, [setting.id]) == set()
    silence(first)
    assert held(twin, [setting.id]) == {ARCHIVE, setting.id}
    setting.append([10])
    with pytest.raises(StorageError, match=rf"lease\.lost.*lead {setting.id} now"):
        setting.consume([outcome_of(setting.rows()[0], make)])
    assert held(first, [setting.id]) == set()


def test_signs_of_life_are_seen_by_who_waits(setting, open_storage, silence):
    first, twin = setting.storage, open_storage()
    held(first)
    held(twin, is_estimator=False)
    silence(first)
    held(twin, is_estimator=False)
    assert twin.leases.silent_s() > 0.0
    before_s = twin.leases.silent_s()
    held(first)
    held(twin, is_estimator=False)
    assert 0.0 <= twin.leases.silent_s() < before_s


@pytest.mark.usefixtures("on_server")
def test_a_process_that_was_silent_and_alone_goes_on(setting, make, silence):
    first = setting.storage
    before = first.leases.poll(is_estimator=True)(setting.id)
    silence(first)
    assert first.leases.poll(is_estimator=True)(setting.id) == before
    setting.append([10])
    assert setting.consume([outcome_of(setting.rows()[0], make)]) == 2


@pytest.mark.usefixtures("on_server")
def test_a_write_that_has_begun_is_waited_for(setting, open_storage, silence):
    first, twin = setting.storage, open_storage()
    assert setting.id in held(first, [setting.id])
    with first._database.engines.read.connect() as connection:
        connection.execute(text("SET TRANSACTION READ WRITE"))
        first.leases.under(lambda _: None, setting.id)(connection)
        silence(first)
        assert held(twin, [setting.id]) == {ARCHIVE}
    assert held(twin, [setting.id]) == {ARCHIVE, setting.id}


@pytest.mark.usefixtures("on_server")
def test_a_lost_connection_costs_no_lease_that_nobody_wanted(setting, caplog):
    leases = setting.storage.leases
    term, member = leases.poll(is_estimator=True)(setting.id), leases.member
    end_session(setting.storage)
    assert held(setting.storage, [setting.id]) == set()
    await_lease(setting.storage, setting.id)
    assert (leases.poll(is_estimator=True)(setting.id), leases.member) in ((term, member), (term + 1, member + 1))
    assert "leads nothing until it does" in caplog.text


@pytest.mark.usefixtures("on_server")
def test_a_pooler_in_transaction_mode_is_refused(storage):
    """Such a pooler gives one session to two connections in turn: here two connections are one."""
    storage.require_sessions()
    engine = storage._database.leases._connected().engine.execution_options(isolation_level="AUTOCOMMIT")
    with engine.connect() as session, pytest.raises(ValueError, match="let the pooler run in session mode"):
        require_own_session(session, session)


@pytest.mark.usefixtures("on_server")
def test_a_session_that_changes_under_a_process_costs_its_leases(setting, caplog):
    assert held(setting.storage, [setting.id]) == {ARCHIVE, setting.id}
    setting.storage.leases._pid += 1
    assert held(setting.storage, [setting.id]) == set()
    assert "pooler" in caplog.text


@pytest.mark.usefixtures("on_server")
def test_a_writer_waits_for_its_own_spacecraft_alone(setting, new_setting, open_storage):
    other, twin = new_setting(), open_storage()
    key = setting.storage._database.key(setting.id)
    begun, released = Event(), Event()
    slow = twin._database.submit(lambda _: (begun.set(), released.wait(120)), key=key)
    assert begun.wait(120)
    other.append([10])
    same = setting.storage.archive.append_measurements(setting.batch([10]))
    # what may write any spacecraft waits for all
    some = open_storage()._database.submit(lambda _: None)
    with pytest.raises(TimeoutError):
        some.result(0.2)
    assert not same.done()
    released.set()
    for each in (slow, same, some):
        each.result(120)
    assert same.result().accepted == 1


@pytest.mark.usefixtures("on_server")
def test_the_doctor_says_who_leads(setting, new_setting, open_storage, url):
    first, twin = setting.storage, open_storage()
    assert not [each for each in diagnose(url, system_now_us(), lambda _: None) if each.check == "leases"]
    assert held(first, [setting.id]) == {ARCHIVE, setting.id}
    held(twin)
    (found,) = [each for each in diagnose(url, system_now_us(), lambda _: None) if each.check == "leases"]
    assert (found.state, found.detail) == ("ok", f"{first.leases.name} leads {setting.id}, the archive")
    unled = new_setting().id
    warned = [each for each in diagnose(url, system_now_us(), lambda _: None) if each.state == "warning"]
    assert [each.detail for each in warned if each.check == "leases"] == [f"nobody leads {unled}"]


@pytest.mark.usefixtures("on_server")
def test_changes_are_announced_to_others(setting, open_storage):
    twin = open_storage()
    held(setting.storage), held(twin)
    setting.append([10])
    deadline_s = time.monotonic() + 120.0
    while not (heard := twin.leases.wait(0.1)):
        assert time.monotonic() < deadline_s
    assert heard == {setting.id}
    assert setting.storage.leases.wait(0.1) == frozenset(), "its own it knows"


@pytest.mark.usefixtures("on_server")
def test_jobs_of_a_process_that_lives_go_on(setting, open_storage, silence):
    first, twin = setting.storage, open_storage()
    held(first), held(twin)
    first.results.add_job(Job("fit-1", "calibration", JobState.QUEUED, 0.0, 1))
    assert first.results.hold_job("fit-1", "first")
    assert not twin.results.hold_job("fit-1", "twin")
    assert twin.results.open_jobs("twin") == []
    assert twin.results.free_jobs("twin") == 0
    ended = twin.leases.ended()
    silence(first)
    held(twin)
    assert twin.leases.ended() == ended + 1
    assert [job.id for job in twin.results.open_jobs("twin")] == ["fit-1"]
    assert twin.results.hold_job("fit-1", "twin")
    assert not first.results.report_job("fit-1", "first", 0.5), "it is the other's now"
    silence(twin)
    assert first.results.free_jobs("first") == 1


@pytest.mark.usefixtures("on_server")
@pytest.mark.parametrize("state", ["active", "idle in transaction"])
def test_a_writer_that_was_stopped_between_its_statements_is_ended(setting, open_storage, state):
    stopped, other = open_storage(), open_storage(1.0)
    with closing(stopped._database.engines.write.connect()) as connection:
        connection.begin()
        # as a series of statements leaves the server: one is done, the next one and the end of the series are not
        session = connection.connection.driver_connection.pgconn
        session.enter_pipeline_mode()
        session.send_query_params(b"SELECT 1 FROM head FOR UPDATE", None)
        if state == "idle in transaction":
            session.pipeline_sync()
            session.send_describe_prepared(b"")
        session.send_flush_request()
        while session.flush():
            pass
        kept = replace(setting, storage=other)
        with pytest.raises(StorageError, match="timeout"):
            kept.append([10])
        with other._database.engines.read.connect() as reader:
            found = reader.scalar(
                text("SELECT state FROM pg_stat_activity WHERE pid = :pid"), {"pid": session.backend_pid}
            )
        assert found == state
        deadline_s = time.monotonic() + 120.0
        while not is_stored(kept):
            other.leases.poll(is_estimator=False)
            assert time.monotonic() < deadline_s
        connection.invalidate()
        connection.rollback()
