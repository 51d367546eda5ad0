"""A measuring station: analyzers, each with an acquisition, a spool and an uploader of its own, and their common end.

Law of this file: a lane starts two threads and ends them in order - first the acquisition after the sweep in hand, then
the uploader after what waits. A thread that dies takes the station down with its error; nothing runs on in half. Lanes
share nothing that one of them could hold up: no session, no connection, no queue.
"""

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from service.client.backoff import Backoff
from service.client.service_client import ServiceClient
from service.frontend.acquisition.acquisition import Acquisition
from service.frontend.acquisition.states import AcquisitionCounters, AcquisitionSettings
from service.frontend.measurement_task import MeasurementTask
from service.frontend.spool.spool import Spool
from service.frontend.upload.uploader import UploadCounters, Uploader, UploadSettings

logger = logging.getLogger("service.frontend.station")

#: how often the station looks whether its threads live, s
_POLL_S = 0.2


class StationError(Exception):
    """A thread of the station died; the error that killed it is the cause."""


@dataclass(frozen=True, slots=True)
class StationSummary:
    """Summary of a run."""

    acquisition: AcquisitionCounters
    upload: UploadCounters
    #: rows that the service had not accepted when the run ended; they wait in the spool
    undelivered: int
    #: those of them that were not on the disk: lost with the process
    unwritten: int = 0


class MeasuringStation:
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
    spool : Spool
        Where rows and traces wait for the service; the caller closes it.
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
        spool: Spool,
        now_us: Callable[[], int],
        make_backoff: Callable[[], Backoff] = Backoff,
    ) -> None:
        self.task = task
        self.upload = upload
        self.spool = spool
        self.resource = acquisition.resource
        self._stop = threading.Event()
        self.uploader = Uploader(client, upload, spool, now_us, make_backoff())
        self.acquisition = Acquisition(
            task, acquisition, spool.append, now_us, self._stop, make_backoff(), spool.append_trace
        )

    @property
    def link_id(self) -> str:
        """Name of the link in reports."""
        return f"{self.upload.spacecraft_id}.{self.upload.source}"

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
        measuring = _Worker(f"acquisition {self.link_id}", self.acquisition.run)
        sending = _Worker(f"uploader {self.link_id}", self.uploader.run)
        for worker in (measuring, sending):
            worker.start()
        while not self._stop.wait(_POLL_S):
            self.acquisition.poll()
            if not (measuring.is_alive() and sending.is_alive()):
                break
        self._stop.set()
        while measuring.is_alive():
            measuring.join(_POLL_S)
            self.acquisition.poll()
        self.uploader.finish()
        sending.join()
        for worker in (measuring, sending):
            if worker.error is not None:
                message = f"{worker.name} failed: {type(worker.error).__name__} {worker.error}"
                raise StationError(message) from worker.error
        return self._summary()

    def _summary(self) -> StationSummary:
        """Return the summary of the run."""
        state = self.spool.state
        if state.waiting:
            logger.warning("%s: %d rows wait in the spool for the next start", self.link_id, state.waiting)
        return StationSummary(self.acquisition.counters, self.uploader.counters, state.waiting, state.held)


def run_stations(stations: Sequence[MeasuringStation]) -> list[StationSummary]:
    """Run several stations until each has been stopped; one that dies stops the others.

    Raises
    ------
    StationError
        A thread of one of them died.
    """
    summaries: dict[str, StationSummary] = {}

    def run(station: MeasuringStation) -> None:
        try:
            summaries[station.link_id] = station.run()
        finally:
            for other in stations:
                other.stop()

    workers = [_Worker(station.link_id, lambda station=station: run(station)) for station in stations]  # type: ignore[misc]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    for worker in workers:
        if worker.error is not None:
            raise worker.error
    return [summaries[station.link_id] for station in stations]


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
            logger.exception("thread %s failed; the front end stops", self.name)
