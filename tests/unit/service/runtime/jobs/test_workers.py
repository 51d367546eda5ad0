"""Worker processes: bounded in number, waiting and time, and replaced when they die."""

import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

from service.errors import BusyError, ConflictError, InvalidInputError, UnavailableError
from service.runtime.jobs.job_runner import JobInterruptedError
from service.runtime.jobs.workers import WorkerConfig, Workers

pytestmark = pytest.mark.timeout(300)


@pytest.fixture
def make_workers():
    """Give a maker of worker processes; they end with the test."""
    made = []

    def make(**bounds):
        made.append(Workers(WorkerConfig(**bounds)))
        return made[-1]

    yield make
    for workers in made:
        workers.stop()


def await_end(process_id):
    """Wait until a process has ended; one that is not yet collected counts as ended."""
    deadline, stat = time.monotonic() + 60, Path(f"/proc/{process_id}/stat")
    # it may end between the opening of the file and its reading
    with suppress(FileNotFoundError, ProcessLookupError):
        while stat.read_text().rpartition(")")[2].split()[0] != "Z":
            assert time.monotonic() < deadline, "the process lives"
            time.sleep(0.01)


def test_work_is_done_in_another_process_that_yields_to_the_service(make_workers):
    workers = make_workers(processes=1)
    assert workers.analyse(pow, 2, 10).result() == 1024
    assert workers.run(os.getpid) == workers.run(os.getpid) != os.getpid()
    assert workers.run(os.nice, 0) > os.nice(0)


def test_what_the_work_raises_reaches_the_caller_and_the_process_stays(make_workers):
    workers = make_workers(processes=1)
    process_id = workers.run(os.getpid)
    with pytest.raises(ValueError, match="invalid literal"):
        workers.run(int, "x")
    with pytest.raises(ConflictError) as caught:
        workers.run(raise_conflict)
    assert (caught.value.code, caught.value.detail) == ("thing.busy", "wait")
    assert workers.run(os.getpid) == process_id


def raise_conflict():
    """Raise an error of the service in the worker."""
    raise ConflictError("thing.busy", "wait")


def test_one_too_many_is_refused_and_leaving_makes_room(make_workers):
    workers = make_workers(processes=1, max_waiting=1)
    waiting = [workers.analyse(time.sleep, 0.5) for _ in range(2)]
    with pytest.raises(BusyError, match=r"analysis\.busy: 2 analyses"):
        workers.analyse(time.sleep, 0)
    for each in waiting:
        each.result()
    assert workers.analyse(pow, 2, 3).result() == 8


def test_work_beyond_its_time_is_ended_with_its_process_and_harms_no_other(make_workers):
    workers = make_workers(processes=2, analysis_timeout_s=1.0)
    process_id = workers.analyse(os.getpid).result()
    began = time.monotonic()
    endless = workers.analyse(time.sleep, 10_000)
    with pytest.raises(InvalidInputError, match=r"analysis\.too_long: it was ended after 1 s"):
        endless.result()
    # neither a calibration beside it nor what comes next notices
    assert workers.run(pow, 2, 4) == 16
    assert time.monotonic() - began < 200
    await_end(process_id)


def test_a_process_that_died_at_rest_is_replaced_unseen(make_workers):
    workers = make_workers(processes=1)
    first = workers.run(os.getpid)
    os.kill(first, signal.SIGKILL)
    await_end(first)
    # the pool may learn of the death only with the next work; then this work tells it, and the one after that runs
    try:
        second = workers.run(os.getpid)
    except UnavailableError:
        second = workers.run(os.getpid)
    assert second != first


def test_a_process_that_dies_at_work_says_so(make_workers):
    workers = make_workers(processes=1)
    with pytest.raises(UnavailableError, match=r"analysis\.ended: its worker process ended unexpectedly"):
        workers.run(os._exit, 1)
    assert workers.run(pow, 2, 5) == 32


def test_a_stop_ends_what_is_computed_and_what_waits(make_workers):
    workers = make_workers(processes=1)
    process_id = workers.run(os.getpid)
    working, waiting = workers.analyse(time.sleep, 10_000), workers.analyse(time.sleep, 10_000)
    while not working.running():
        time.sleep(0.01)
    workers.stop()
    with pytest.raises(UnavailableError, match="the service is stopping"):
        working.result()
    assert waiting.cancelled()
    await_end(process_id)
    for refused in (workers.analyse, workers.run):
        with pytest.raises(UnavailableError, match="the service is stopping"):
            refused(pow, 2, 2)


@pytest.mark.parametrize("bound", [{"processes": 0}, {"max_calibrations": 0}, {"analysis_timeout_s": 0.0}])
def test_bounds_that_let_nothing_through_are_refused(bound):
    with pytest.raises(ValueError, match="at least one process"):
        WorkerConfig(**bound)


def end_at_first(folder, times):
    """Die a number of times, then leave a mark."""
    died = len(list(folder.iterdir()))
    (folder / str(died)).touch()
    if died < times:
        os.kill(os.getpid(), signal.SIGKILL)


def leave_process_id(path):
    """Write the number of this process."""
    path.write_text(str(os.getpid()))


def await_prepared(path):
    """Return the number of the prepared process."""
    deadline = time.monotonic() + 60
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < deadline, "no process was prepared"
        time.sleep(0.01)
    return int(path.read_text())


def test_a_prepared_process_takes_the_first_work_and_ends_with_the_workers(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.prepare(0.0, partial(leave_process_id, tmp_path / "id"))
    process_id = await_prepared(tmp_path / "id")
    workers.prepare(0.0, partial(os._exit, 1))
    assert workers.run(os.getpid) == process_id
    workers.stop()
    await_end(process_id)


def test_work_goes_on_in_another_process_when_the_prepared_one_was_killed(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.prepare(0.0, partial(leave_process_id, tmp_path / "id"))
    process_id = await_prepared(tmp_path / "id")
    os.kill(process_id, signal.SIGKILL)
    await_end(process_id)
    workers.complete(leave_process_id, tmp_path / "second")
    assert int((tmp_path / "second").read_text()) != process_id


def test_a_stop_before_its_time_leaves_no_process_prepared(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.prepare(0.2, partial(leave_process_id, tmp_path / "id"))
    workers.stop()
    workers.prepare(0.0, partial(leave_process_id, tmp_path / "id"))
    time.sleep(1.0)
    assert not (tmp_path / "id").exists()


def test_work_that_goes_on_where_it_was_gets_another_process_when_its_own_dies(make_workers, tmp_path):
    workers = make_workers(processes=1)
    workers.complete(end_at_first, tmp_path, 2)
    assert len(list(tmp_path.iterdir())) == 3
    with pytest.raises(UnavailableError, match="ended unexpectedly"):
        workers.complete(end_at_first, tmp_path, 99)


def test_a_stop_interrupts_work_that_goes_on_later(make_workers, tmp_path):
    workers = make_workers(processes=1)
    with ThreadPoolExecutor(1) as threads:
        waiting = threads.submit(workers.complete, mark_and_sleep, tmp_path)
        while not list(tmp_path.iterdir()):
            time.sleep(0.01)
        workers.stop()
        with pytest.raises(JobInterruptedError):
            waiting.result(timeout=60)


def mark_and_sleep(folder):
    """Leave a mark and sleep for longer than any test."""
    (folder / "mark").touch()
    time.sleep(600)
