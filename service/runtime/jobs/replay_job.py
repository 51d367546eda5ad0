"""Replays: the same chain over the same journal, written as a new version of the results.

In order of the journal a replay of a live span gives the live rows bit for bit. In order of epoch, or with another
calibration or alignment, it gives what would have been, with late rows in their place.
"""

import logging
from collections.abc import Callable
from dataclasses import replace
from threading import Lock

from service.errors import BusyError, ConflictError, InvalidInputError
from service.ports.storage import Clock, Storage
from service.records.calibration import Alignment, Window
from service.records.operations.work import Job, JobState, Replay
from service.runtime.jobs.job_runner import JobRunner, Progress
from service.runtime.jobs.workers import WorkerConfig

_LOG = logging.getLogger("soo.replay")
_UNFINISHED = (JobState.QUEUED, JobState.RUNNING)
_EVER, _EVERY = Window(-(1 << 62), 1 << 62), 1 << 30


class Replayer:
    """Starts replays.

    Parameters
    ----------
    storage : Storage
        The archive.
    clock : Clock
        For times of creation.
    jobs : JobRunner
        Runs one replay after another.
    run : callable
        Runs the replay of a spacecraft that wrote a version and reports its progress, as `ReplayRun` does.
    most : int
        Replays that wait or run at once.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        jobs: JobRunner,
        run: Callable[[str, str, Progress], None],
        most: int = WorkerConfig().max_replays,
    ) -> None:
        self._storage = storage
        self._clock = clock
        self._jobs = jobs
        self._run = run
        self._most = most
        self._starting = Lock()
        #: replays that are queued or run here
        self._here: set[tuple[str, int]] = set()

    def start(self, spacecraft_id: str, wanted: Replay) -> tuple[Replay, Job]:
        """Store a replay and queue it; id and job of ``wanted`` are ignored, alignment 0 = the one that held.

        Raises
        ------
        InvalidInputError
            ``range.invalid``: nothing between start and stop.
        ConflictError
            ``replay.not_aligned``: no alignment to start from.
        BusyError
            ``replay.busy``: too many wait or run already.
        """
        if wanted.start_us >= wanted.stop_us:
            raise InvalidInputError("range.invalid", "start must lie before stop")
        alignment = self._alignment(spacecraft_id, wanted)
        self._check_calibration(spacecraft_id, wanted.calibration_id)
        with self._starting:
            if len(self._here) >= self._most:
                raise BusyError("replay.busy", f"{len(self._here)} replays wait or run already")
            job = self._jobs.add("replay")
            stated = replace(
                wanted,
                alignment_id=alignment.id,
                is_fixed_alignment=wanted.alignment_id != 0,
                until_number=self._storage.archive.head(spacecraft_id).newest_number,
                job_id=job.id,
                created_at_us=self._clock.system_us(),
            )
            replay = self._storage.results.add_replay(spacecraft_id, stated)
            work = self._work(spacecraft_id, replay)
        self._jobs.run(job, work)
        return replay, job

    def resume(self) -> None:
        """Queue the replays that a process that has ended left unfinished; called when this service begins to lead."""
        results = self._storage.results
        for spacecraft in self._storage.catalogue.all_spacecraft():
            for found in results.replays(spacecraft.id, _EVER, _EVERY, 0):
                is_here = (spacecraft.id, found.replay.id) in self._here
                if found.state in _UNFINISHED and not is_here and results.acquire_job(found.replay.job_id):
                    _LOG.info("%s of %s goes on", found.replay.version, spacecraft.id)
                    self._jobs.resume(results.job(found.replay.job_id), self._work(spacecraft.id, found.replay))

    def _work(self, spacecraft_id: str, replay: Replay) -> Callable[[Progress], None]:
        """Return the work of a replay's job."""
        name = spacecraft_id, replay.id
        self._here.add(name)

        def work(report: Progress) -> None:
            try:
                self._run(spacecraft_id, replay.version, report)
            finally:
                self._here.discard(name)

        return work

    def _alignment(self, spacecraft_id: str, wanted: Replay) -> Alignment:
        """Return the alignment to start from: the one asked for, or the newest before the start, or the first."""
        if wanted.alignment_id:
            return self._storage.results.alignment(spacecraft_id, wanted.alignment_id)
        newest_first = self._storage.results.alignments(spacecraft_id)
        if not newest_first:
            detail = f"{spacecraft_id} was never aligned, so there is nothing to replay from"
            raise ConflictError("replay.not_aligned", detail)
        earlier = [alignment for alignment in newest_first if alignment.epoch_us <= wanted.start_us]
        held = (
            one for one in earlier if wanted.order == "epoch" or not self._came_after_rows(spacecraft_id, one, wanted)
        )
        return next(held, newest_first[-1])

    def _came_after_rows(self, spacecraft_id: str, alignment: Alignment, wanted: Replay) -> bool:
        """Return whether rows of the span were stored, and so consumed under a former alignment, before this one.

        What the live run made of them stands; only a replay that starts with the former alignment makes it again.
        """
        number = self._storage.results.alignment_number(spacecraft_id, alignment.id)
        first = next(self._storage.archive.measurements_after(spacecraft_id, wanted.start_us - 1, number), None)
        return first is not None and first.epoch_us < wanted.stop_us

    def _check_calibration(self, spacecraft_id: str, calibration_id: int | None) -> None:
        """Refuse a calibration in place of the journal's that has no result."""
        if (
            calibration_id is not None
            and self._storage.results.calibration(spacecraft_id, calibration_id).result is None
        ):
            raise ConflictError("calibration.unfinished", f"calibration {calibration_id} has no result")
