"""Jobs: the most urgent first, piece by piece, by one process at a time, whatever ends one."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from db.storage import SqlStorage
from service.errors import ConflictError, InvalidInputError, StorageError, UnavailableError
from service.pipeline.calibration.geometry_rows import CalibrationError
from service.records.operations.work import Job, JobKind, JobState
from service.runtime.jobs import job_runner
from service.runtime.jobs.job_runner import (
    JobPieces,
    JobRunner,
    JobWorker,
    Standing,
    WorkerConfig,
    new_job,
)


@pytest.fixture
def storage(tmp_path: Path) -> Iterator[SqlStorage]:
    opened = SqlStorage(f"sqlite:///{tmp_path / 'soo.db'}")
    opened.prepare()
    yield opened
    opened.close()


@pytest.fixture(autouse=True)
def _short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """A piece ends wherever it may."""
    monkeypatch.setattr(job_runner, "PIECE_S", 0.0)


CLOCK: Any = SimpleNamespace(system_us=lambda: 77)


def add(storage: SqlStorage, kind: JobKind, spacecraft_id: str = "a") -> str:
    job = new_job(kind, spacecraft_id, CLOCK)
    storage.results.add_job(job)
    return job.id


def runner_of(storage: SqlStorage, work: Callable[[Job], Iterator[float]], **changes: Any) -> JobRunner:
    pieces = JobPieces(dict.fromkeys(JobKind, work))
    return JobRunner(storage, CLOCK, pieces.advance, **changes)


def quarters(done: list[str]) -> Callable[[Job], Iterator[float]]:
    """Return a work of four pieces, which notes each."""

    def work(job: Job) -> Iterator[float]:
        for quarter in range(4):
            done.append(job.kind)
            yield quarter / 4

    return work


def test_a_calibration_waits_for_one_piece_of_a_replay(storage: SqlStorage) -> None:
    done: list[str] = []
    runner = runner_of(storage, quarters(done))
    replay = add(storage, JobKind.REPLAY)
    assert runner.poll_once()
    assert runner.poll_once()
    calibration = add(storage, JobKind.CALIBRATION)
    while runner.poll_once():
        pass
    assert done == ["replay"] * 2 + ["calibration"] * 4 + ["replay"] * 2
    assert [storage.results.job(each).state for each in (replay, calibration)] == [JobState.DONE] * 2


def test_a_replay_does_not_wait_for_what_smoothing_has_to_catch_up_with(storage: SqlStorage) -> None:
    done: list[str] = []
    runner = runner_of(storage, quarters(done))
    for spacecraft_id in "abc":
        add(storage, JobKind.SMOOTHING, spacecraft_id)
    assert runner.poll_once()
    add(storage, JobKind.REPLAY)
    while runner.poll_once():
        pass
    assert done[:9] == ["smoothing", "replay"] * 4 + ["smoothing"]
    assert done.count("smoothing") == 12


def test_a_calibration_that_is_started_during_a_piece_comes_next(storage: SqlStorage, wait: Any) -> None:
    """By the thread, as in the service: no job is asked for twice, nobody waits for a poll."""
    is_in_piece, may_go, done = threading.Event(), threading.Event(), list[str]()

    def work(job: Job) -> Iterator[float]:
        done.append(job.kind)
        if job.kind == JobKind.REPLAY and not is_in_piece.is_set():
            is_in_piece.set()
            assert may_go.wait(60)
        yield 0.5
        done.append(job.kind)

    runner = runner_of(storage, work)
    runner.start()
    try:
        replay = add(storage, JobKind.REPLAY)
        runner.notify()
        assert is_in_piece.wait(60)
        add(storage, JobKind.CALIBRATION)
        may_go.set()
        wait(lambda: storage.results.job(replay).state is JobState.DONE)
    finally:
        runner.stop()
    assert done == ["replay", "calibration", "calibration", "replay"]


def test_jobs_of_a_kind_are_done_one_after_another_and_say_how_far_they_are(storage: SqlStorage) -> None:
    shares = []

    def work(job: Job) -> Iterator[float]:
        yield 0.4
        shares.append((job.id, storage.results.job(job.id).progress, storage.results.job(job.id).state))

    runner = runner_of(storage, work)
    jobs = [add(storage, JobKind.REPLAY) for _ in range(3)]
    while runner.poll_once():
        pass
    assert sorted(shares) == sorted((job, 0.4, JobState.RUNNING) for job in jobs)
    assert [job for job, _, _ in shares] == sorted(jobs)
    ended = storage.results.job(jobs[0])
    assert (ended.progress, ended.error, ended.created_at_us) == (1.0, None, 77)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (CalibrationError("no turns in the window"), "no turns in the window"),
        (ConflictError("thing.busy", "wait"), "thing.busy: wait"),
        (KeyError("c05"), "internal error, see the log: KeyError('c05')"),
    ],
)
def test_a_job_that_fails_says_why(storage: SqlStorage, error: Exception, text: str, caplog: Any) -> None:
    def work(_job: Job) -> Iterator[float]:
        yield 0.1
        raise error

    runner, job = runner_of(storage, work), add(storage, JobKind.CALIBRATION)
    while runner.poll_once():
        pass
    ended = storage.results.job(job)
    assert (ended.state, ended.error) == (JobState.FAILED, text)
    assert ("Traceback" in caplog.text) == isinstance(error, KeyError)


def test_two_processes_never_run_one_job(storage: SqlStorage) -> None:
    first_done: list[str] = []
    second_done: list[str] = []
    first, second = (runner_of(storage, quarters(done)) for done in (first_done, second_done))
    add(storage, JobKind.REPLAY)
    assert first.poll_once()
    assert not second.poll_once()
    while first.poll_once():
        pass
    assert (len(first_done), second_done) == (4, [])


def test_who_leads_no_spacecraft_runs_none_and_what_moves_is_let_go_of(storage: SqlStorage) -> None:
    terms, done, other_done = {"a": 1}, list[str](), list[str]()
    first = runner_of(storage, quarters(done), turn=lambda name: terms.get(name, 0))
    other = runner_of(storage, quarters(other_done), turn=lambda name: int(name not in terms))
    add(storage, JobKind.REPLAY)
    assert not other.poll_once()
    assert first.poll_once()
    terms.clear()
    assert not first.poll_once()
    while other.poll_once():
        pass
    # the other one begins where the archive says, which is all that it knows
    assert (len(done), len(other_done)) == (1, 4)


def test_a_piece_that_meets_a_lost_lease_leaves_the_job_to_the_next(storage: SqlStorage) -> None:
    def work(_job: Job) -> Iterator[float]:
        raise StorageError("lease.lost", "another process may lead a now")
        yield 0.0

    job = add(storage, JobKind.SMOOTHING)
    assert runner_of(storage, work).poll_once()
    assert storage.results.job(job).state is JobState.QUEUED


def test_jobs_of_a_process_that_was_killed_go_on_in_the_next_one(storage: SqlStorage) -> None:
    done: list[str] = []
    killed, following = runner_of(storage, quarters([])), runner_of(storage, quarters(done))
    job = add(storage, JobKind.CALIBRATION)
    assert killed.poll_once()
    assert not following.poll_once()
    following.take_over()
    while following.poll_once():
        pass
    assert (storage.results.job(job).state, len(done)) == (JobState.DONE, 4)


def test_a_job_that_was_ended_meanwhile_is_not_gone_on_with(storage: SqlStorage) -> None:
    done: list[str] = []
    runner, job = runner_of(storage, quarters(done)), add(storage, JobKind.REPLAY)
    assert runner.poll_once()
    storage.results.end_job(job, "replay-1 was deleted.")
    assert not runner.poll_once()
    assert len(done) == 1
    assert storage.results.job(job).error == "replay-1 was deleted."


def test_a_stop_leaves_what_is_under_way_open(storage: SqlStorage, wait: Any) -> None:
    done: list[str] = []
    runner = runner_of(storage, quarters(done))

    def ended(_job: Job, _open: frozenset[str]) -> float:
        runner._is_stopping = True
        raise UnavailableError("analysis.ended", "the service is stopping; start it again")

    runner._advance = ended
    job = add(storage, JobKind.CALIBRATION)
    runner.start()
    runner.stop()
    assert storage.results.job(job).state in (JobState.QUEUED, JobState.RUNNING)


def test_a_process_that_dies_again_and_again_fails_its_job(storage: SqlStorage) -> None:
    deaths = []

    def dying(_job: Job, _open: frozenset[str]) -> float:
        deaths.append(1)
        raise UnavailableError("analysis.ended", "its worker process ended unexpectedly; start it again")

    runner, job = JobRunner(storage, CLOCK, dying), add(storage, JobKind.REPLAY)
    while runner.poll_once():
        pass
    assert len(deaths) == 4
    assert storage.results.job(job).error == "analysis.ended: its worker process ended unexpectedly; start it again"


def test_after_a_process_that_dies_the_thread_rests(
    storage: SqlStorage, monkeypatch: pytest.MonkeyPatch, wait: Any
) -> None:
    monkeypatch.setattr(job_runner, "POLL_S", 0.0)
    rests, deaths = list[int](), list[int]()

    class Wake(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            rests.append(len(deaths))
            return super().wait(timeout)

    def dying(_job: Job, _open: frozenset[str]) -> float:
        deaths.append(1)
        raise UnavailableError("analysis.ended", "its worker process ended unexpectedly; start it again")

    with monkeypatch.context() as patched:
        patched.setattr(threading, "Event", Wake)
        runner, job = JobRunner(storage, CLOCK, dying), add(storage, JobKind.REPLAY)
    runner.start()
    wait(lambda: storage.results.job(job).state is JobState.FAILED)
    runner.stop()
    assert {1, 2, 3} <= set(rests)


def test_standing_work_is_queued_when_it_is_due_and_told_of_when_it_fails(
    storage: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job_runner, "POLL_S", 0.0)
    due, failed = [["a", ""], [], ["a"]], list[str]()

    def work(_job: Job) -> Iterator[float]:
        raise StorageError("storage.full", "no space")
        yield 0.0

    standing = Standing(JobKind.SEALING, lambda: due.pop(0) if due else [], failed.append)
    runner = runner_of(storage, work, standing=[standing])
    while runner.poll_once():
        pass
    assert sorted(failed) == ["", "a", "a"]
    states = [storage.results.job(name).state for name in ("sealing-a", "sealing-service")]
    assert states == [JobState.FAILED] * 2
    assert storage.results.newest_jobs(9) == []


def test_an_archive_that_does_not_answer_ends_no_thread(storage: SqlStorage, wait: Any) -> None:
    done: list[str] = []
    runner, faults = runner_of(storage, quarters(done)), [StorageError("storage.unavailable", "no disk")]
    open_jobs = runner._results.open_jobs

    def failing(holder: str) -> list[Job]:
        if faults:
            raise faults.pop()
        return open_jobs(holder)

    runner._results = SimpleNamespace(
        open_jobs=failing,
        **{name: getattr(storage.results, name) for name in ("hold_job", "report_job", "end_job", "let_go_of_job")},
    )
    job = add(storage, JobKind.REPLAY)
    runner.start()
    runner.notify()
    try:
        wait(lambda: storage.results.job(job).state is JobState.DONE)
    finally:
        runner.stop()


def test_the_process_is_prepared_when_there_is_nothing_else_to_do(storage: SqlStorage) -> None:
    prepared = threading.Event()
    runner = JobRunner(storage, CLOCK, quarters([]), prepare=prepared.set)
    runner.prepared_after_s = 0.0
    runner.start()
    try:
        assert prepared.wait(60)
    finally:
        runner.stop()


# ---- the worker process
def works(folder: Path) -> tuple[Any, dict[str, Callable[[Job], Iterator[float]]]]:
    """Return what the process of tests does: a job of two pieces that tells of its process."""

    def tell(job: Job) -> Iterator[float]:
        (folder / job.id).write_text(f"{os.getpid()} {os.nice(0)}")
        yield 0.5
        (folder / f"{job.id} again").write_text(str(os.getpid()))

    def conflict(_job: Job) -> Iterator[float]:
        raise ConflictError("thing.busy", "wait")
        yield 0.0

    def forever(_job: Job) -> Iterator[float]:
        (folder / "begun").touch()
        time.sleep(10_000)
        yield 0.0

    def end(_job: Job) -> Iterator[float]:
        os._exit(1)
        yield 0.0

    storage = SimpleNamespace(leases=SimpleNamespace(borrow=lambda _: None))
    kinds = {"calibration": forever, "replay": tell, "smoothing": conflict, "sealing": end}
    job_runner.PIECE_S = 0.0
    return storage, kinds


@pytest.fixture
def make_worker(tmp_path: Path) -> Iterator[Callable[..., JobWorker]]:
    made: list[JobWorker] = []

    def make(**changes: Any) -> JobWorker:
        made.append(JobWorker(partial(works, tmp_path), **changes))
        return made[-1]

    yield make
    for worker in made:
        worker.stop()


def job_of(kind: str) -> Job:
    return Job(f"{kind}-1", kind, JobState.RUNNING, 0.0, 0)


NONE: frozenset[str] = frozenset()


@pytest.mark.timeout(300)
def test_pieces_are_done_in_one_other_process_that_yields_to_the_service(
    make_worker: Callable[..., JobWorker], tmp_path: Path
) -> None:
    worker, job = make_worker(), job_of("replay")
    assert worker.advance(job, frozenset([job.id])) == 0.5
    assert worker.advance(job, frozenset([job.id])) is None
    process_id, niceness = (tmp_path / job.id).read_text().split()
    assert process_id == (tmp_path / f"{job.id} again").read_text() != str(os.getpid())
    assert int(niceness) > os.nice(0)
    # what is forgotten begins again
    worker.advance(job, NONE)
    assert worker.advance(job, NONE) == 0.5
    with pytest.raises(ConflictError) as caught:
        worker.advance(job_of("smoothing"), NONE)
    assert (caught.value.code, caught.value.detail) == ("thing.busy", "wait")
    assert worker.call(os.getpid) == int(process_id)


@pytest.mark.timeout(300)
def test_a_calibration_beyond_its_time_is_ended_with_its_process(make_worker: Callable[..., JobWorker]) -> None:
    worker = make_worker(job_timeout_s=1.0)
    process_id = worker.call(os.getpid)
    with pytest.raises(InvalidInputError, match=r"analysis\.too_long: it was ended after 1 s"):
        worker.advance(job_of("calibration"), NONE)
    assert worker.call(os.getpid) != process_id


@pytest.mark.timeout(300)
def test_a_process_that_dies_says_so_and_the_next_piece_has_another(make_worker: Callable[..., JobWorker]) -> None:
    worker = make_worker()
    with pytest.raises(UnavailableError, match=r"analysis\.ended: its worker process ended unexpectedly"):
        worker.advance(job_of("sealing"), NONE)
    process_id = worker.call(os.getpid)
    os.kill(process_id, signal.SIGKILL)
    # the pool may learn of the death only with the next work; then this work tells it, and the one after that runs
    try:
        following = worker.call(os.getpid)
    except UnavailableError:
        following = worker.call(os.getpid)
    assert following != process_id


@pytest.mark.timeout(300)
def test_a_stop_ends_what_is_computed(make_worker: Callable[..., JobWorker], tmp_path: Path, wait: Any) -> None:
    worker = make_worker()
    process_id, errors = worker.call(os.getpid), list[Exception]()

    def advance() -> None:
        try:
            worker.advance(job_of("calibration"), NONE)
        except UnavailableError as error:
            errors.append(error)

    thread = threading.Thread(target=advance)
    thread.start()
    wait((tmp_path / "begun").exists)
    worker.stop()
    thread.join(60)
    assert [str(error) for error in errors] == ["analysis.ended: the service is stopping; start it again"]
    with pytest.raises(UnavailableError, match="the service is stopping"):
        worker.call(os.getpid)
    assert process_id


@pytest.mark.parametrize("bound", [{"max_replays": 0}, {"max_calibrations": 0}, {"job_timeout_s": 0.0}])
def test_bounds_that_let_nothing_through_are_refused(bound: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="at least one calibration"):
        WorkerConfig(**bound)
