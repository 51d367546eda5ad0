"""Jobs: long work started by an operator, one at a time, its progress kept in the archive.

A job ends done or failed with a text; a process that dies leaves none running, for the next start marks what it left
as failed.
"""

import logging
import threading
import uuid
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor

from service.errors import SooError
from service.ports.archive import Results
from service.ports.storage import Clock
from service.records.operations.work import Job, JobState

_LOG = logging.getLogger("soo.jobs")

#: tells how far a job is, 0..1
Progress = Callable[[float], None]


class JobAbortedError(Exception):
    """The work cannot be done; the text gives the reason and the remedy."""


class JobInterruptedError(Exception):
    """The service stops; the job stays unfinished and goes on after the next start."""


class JobRunner:
    """Runs jobs one after another.

    Parameters
    ----------
    results : Results
        Where jobs are kept.
    clock : Clock
        For creation times.
    executor : Executor, optional
        Runs one piece of work at a time; a thread of its own by default.
    """

    def __init__(self, results: Results, clock: Clock, executor: Executor | None = None) -> None:
        self._results = results
        self._clock = clock
        self._executor = executor or ThreadPoolExecutor(1, thread_name_prefix="soo-job")
        self._is_stopping = threading.Event()
        self._lock = threading.Lock()
        #: jobs of this runner that have not ended
        self._unfinished: set[str] = set()

    def start(self) -> None:
        """Mark what a process that has ended left unfinished; called when this one begins to lead the archive."""
        with self._lock:
            text = "the service was restarted while the job ran; start it again"
            self._results.fail_unfinished_jobs(text, tuple(self._unfinished))

    def stop(self) -> None:
        """Ask the running job to end at its next progress report and wait for it."""
        self._is_stopping.set()
        self._executor.shutdown(wait=True, cancel_futures=True)

    def add(self, kind: str) -> Job:
        """Store a job that waits for its work."""
        job = Job(f"{kind}-{uuid.uuid4().hex[:12]}", kind, JobState.QUEUED, 0.0, self._clock.system_us())
        with self._lock:
            self._results.add_job(job)
            self._unfinished.add(job.id)
        return job

    def resume(self, job: Job, work: Callable[[Progress], None]) -> None:
        """Queue the work of a job that a former process left unfinished."""
        with self._lock:
            self._unfinished.add(job.id)
        self.run(job, work)

    def run(self, job: Job, work: Callable[[Progress], None]) -> None:
        """Queue the work of a job."""
        self._executor.submit(self._run, job.id, work)

    def _run(self, job_id: str, work: Callable[[Progress], None]) -> None:
        """Run one job and store how it ended."""

        def report(progress: float) -> None:
            if self._is_stopping.is_set():
                message = "the service is stopping; start the job again"
                raise JobAbortedError(message)
            self._results.update_job(job_id, JobState.RUNNING, progress)

        try:
            report(0.0)
            work(report)
            self._results.update_job(job_id, JobState.DONE, 1.0)
        except JobInterruptedError:
            _LOG.info("job %s goes on after the next start", job_id)
        except (JobAbortedError, SooError) as error:
            self._results.update_job(job_id, JobState.FAILED, 1.0, str(error))
        except Exception as error:  # noqa: BLE001 a job's fault must reach its operator, whatever it is
            _LOG.exception("job %s failed by an internal error", job_id)
            self._results.update_job(job_id, JobState.FAILED, 1.0, f"internal error, see the log: {error!r}")
        finally:
            with self._lock:
                self._unfinished.discard(job_id)
