"""Jobs: every one ends, and says how."""

import threading

import pytest

from service.errors import ConflictError
from service.records.operations.job import JobState
from service.runtime.jobs.job_runner import JobAbortedError, JobRunner


@pytest.fixture
def ground(new_ground):
    """A station; no alignment is needed."""
    return new_ground()


def run(ground, work):
    job = ground.jobs.add("test")
    assert ground.storage.results.job(job.id).state is JobState.QUEUED
    ground.jobs.run(job, work)
    ground.finish(job.id)
    return ground.storage.results.job(job.id)


def test_a_job_that_works_is_done_and_its_progress_is_kept(ground):
    seen = []

    def work(report):
        report(0.4)
        running = [job for job in ids if ground.storage.results.job(job).state is JobState.RUNNING]
        seen.extend(ground.storage.results.job(job).progress for job in running)

    job = ground.jobs.add("test")
    ids = [job.id]
    ground.jobs.run(job, work)
    assert ground.finish(job.id) is JobState.DONE
    ended = ground.storage.results.job(job.id)
    assert (ended.progress, ended.error, seen) == (1.0, None, [0.4])
    assert ended.created_at_us == ground.clock.system_us()
    assert ended.id.startswith("test-")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (JobAbortedError("no turns in the window"), "no turns in the window"),
        (ConflictError("thing.busy", "wait"), "thing.busy: wait"),
        (KeyError("c05"), "internal error, see the log: KeyError('c05')"),
    ],
)
def test_a_job_that_fails_says_why(ground, error, text, caplog):
    def work(_report):
        raise error

    ended = run(ground, work)
    assert (ended.state, ended.error) == (JobState.FAILED, text)
    assert ("Traceback" in caplog.text) == isinstance(error, KeyError)


def test_jobs_run_one_after_another(ground):
    order = []
    jobs = [ground.jobs.add("test") for _ in range(3)]
    for k, job in enumerate(jobs):
        ground.jobs.run(job, lambda _report, k=k: order.append(k))
    ground.finish(jobs[-1].id)
    assert order == [0, 1, 2]


def test_a_stop_ends_the_running_job_at_its_next_report_and_drops_the_others(ground):
    started = threading.Event()

    def work(report):
        started.set()
        ground.jobs._is_stopping.wait(120)
        report(0.5)

    running, waiting = ground.jobs.add("test"), ground.jobs.add("test")
    ground.jobs.run(running, work)
    ground.jobs.run(waiting, work)
    started.wait(120)
    ground.jobs.stop()
    ended = ground.storage.results.job(running.id)
    assert (ended.state, ended.error) == (JobState.FAILED, "the service is stopping; start the job again")
    assert ground.storage.results.job(waiting.id).state is JobState.QUEUED
    # the next start tells the operator
    JobRunner(ground.storage.results, ground.clock).start()
    left = ground.storage.results.job(waiting.id)
    assert left.state is JobState.FAILED
    assert "restarted while the job ran; start it again" in left.error
