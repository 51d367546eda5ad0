"""A measuring station: one acquisition and one uploader, each with its thread, and their common end.

Law of this file: it starts two threads and ends them in order - first the acquisition after the sweep in hand, then the
uploader after the queue. A thread that dies takes the station down with its error; nothing runs on in half.
"""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.acquisition import Acquisition, AcquisitionCounters, AcquisitionSettings
from service.frontend.measurement_task import MeasurementTask
from service.frontend.uploader import UploadCounters, Uploader, UploadSettings

logger = logging.getLogger("service.frontend.station")

#: how often the station looks whether its threads live, s
_LOOK_S = 0.2


class StationError(Exception):
    """A thread of the station died; the error that killed it is the cause."""


@dataclass(frozen=True, slots=True)
class StationSummary:
    """What a run came to."""

    acquisition: AcquisitionCounters
    upload: UploadCounters
    #: rows that the service had not taken when the run ended
    undelivered: int


class Station:
    """Measure a task on one analyzer for one spacecraft.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    acquisition : AcquisitionSettings
        Analyzer, pace, patience.
    upload : UploadSettings
        Destination, sizes, patience.
    client : ServiceClient
        Without retries of its own; the caller closes it.
    now_us : callable
        Present, microseconds UTC.
    make_backoff : callable
        Waiting times, one sequence for the analyzer and one for the service.
    """

    def __init__(
        self,
        task: MeasurementTask,
        acquisition: AcquisitionSettings,
        upload: UploadSettings,
        client: ServiceClient,
        now_us: Callable[[], int],
        make_backoff: Callable[[], Backoff] = Backoff,
    ) -> None:
        self._stop = threading.Event()
        task_ids = [carrier.id for carrier in task.carriers]
        self.uploader = Uploader(client, upload, task_ids, self._stop, make_backoff())
        self.acquisition = Acquisition(task, acquisition, self.uploader.put, now_us, self._stop, make_backoff())
        self._drain_s = upload.drain_s

    def stop(self) -> None:
        """Ask the station to end; safe to call from a signal handler and more than once."""
        self._stop.set()

    def run(self) -> StationSummary:
        """Run until `stop`; return what the run came to.

        Raises
        ------
        StationError
            One of the threads died.
        """
        measuring = _Worker("acquisition", self.acquisition.run)
        sending = _Worker("uploader", self.uploader.run)
        for worker in (measuring, sending):
            worker.start()
        while not self._stop.wait(_LOOK_S):
            if not (measuring.is_alive() and sending.is_alive()):
                break
        self._stop.set()
        measuring.join()
        self.uploader.finish()
        sending.join()
        for worker in (measuring, sending):
            if worker.error is not None:
                message = f"{worker.name} died: {type(worker.error).__name__} {worker.error}"
                raise StationError(message) from worker.error
        summary = StationSummary(self.acquisition.counters, self.uploader.counters, self.uploader.waiting)
        if summary.undelivered:
            logger.error("%d rows were not delivered within %g s", summary.undelivered, self._drain_s)
        return summary


class _Worker(threading.Thread):
    """Thread that keeps the error that ended it."""

    def __init__(self, name: str, work: Callable[[], None]) -> None:
        super().__init__(name=name, daemon=True)
        self.error: Exception | None = None
        self._work = work

    def run(self) -> None:
        """Work; an error is kept for the station, which raises it."""
        try:
            self._work()
        except Exception as error:
            self.error = error
            logger.exception("thread %s died", self.name)
