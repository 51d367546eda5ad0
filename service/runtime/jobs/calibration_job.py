"""Calibration jobs: read the windows from the archive, run the fit, store the draft's result."""

from collections.abc import Callable
from threading import Lock

from service.core.estimation.calibration.checks.turns import LONGEST_LAG_S
from service.errors import BusyError, ConflictError, SooError
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationError, CalibrationInput
from service.pipeline.calibration.minute_rows import mean_edges_us, minute_rows
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.config import CalibrationConfig
from service.ports.storage import Clock, Storage
from service.records.calibration import (
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    Window,
)
from service.records.epoch import US_PER_S
from service.records.inputs import Correction, Operation, PolarizationRecord, SlowInput, TelemetryRecord
from service.records.levels.measurement import Measurement
from service.records.operations.work import Job
from service.runtime.jobs.job_runner import JobAbortedError, JobRunner, Progress

#: operations and corrections that a calibration looks at, at most of each
_MAX_INPUTS = 1000
#: records of telemetry, or of polarimeters, that it looks at: three hours of one a second, whole turns of one in five
_MAX_RECORDS = 10_000
#: records of quiet days need not stand closer
_SPACED_US = 60 * US_PER_S
#: powers before and after the turns by which a lag is judged
_AROUND_US = int(LONGEST_LAG_S) * US_PER_S


class Calibrator:
    """Starts calibrations and makes them active.

    Parameters
    ----------
    storage : Storage
        The archive.
    clock : Clock
        For times of creation.
    jobs : JobRunner
        Runs one calibration after another.
    fit : callable
        Computes one, as `fitted` does.
    max_waiting : int
        Calibrations that wait or run at once.
    """

    def __init__(
        self,
        storage: Storage,
        clock: Clock,
        jobs: JobRunner,
        fit: Callable[[CalibrationInput], CalibrationResult],
        max_waiting: int,
    ) -> None:
        self._storage = storage
        self._clock = clock
        self._jobs = jobs
        self._fitted = fit
        self._max_waiting = max_waiting
        self._lock = Lock()
        self._waiting = 0
        #: of spacecraft and calibration
        self._job_ids: dict[tuple[str, int], str] = {}

    def start(self, spacecraft_id: str, request: CalibrationRequest, created_by: str) -> tuple[Calibration, Job]:
        """Store a draft and queue its fit.

        Raises
        ------
        NotFoundError
            No spacecraft, no carrier plan or no ephemeris.
        BusyError
            ``analysis.busy``: too many calibrations wait already.
        """
        plan = self._storage.catalogue.plan(spacecraft_id)
        ephemeris = self._storage.catalogue.ephemeris(spacecraft_id)
        with self._lock:
            if self._waiting >= self._max_waiting:
                raise BusyError("analysis.busy", f"{self._waiting} calibrations wait or run already")
            self._waiting += 1
        try:
            draft = self._storage.results.add_calibration(
                spacecraft_id, request, plan.id, ephemeris.id, self._clock.system_us(), created_by
            )
            job = self._jobs.add("calibration")
            with self._lock:
                self._job_ids[spacecraft_id, draft.id] = job.id
            self._jobs.run(job, lambda report: self._run(spacecraft_id, draft, report))
        except BaseException:
            self._leave()
            raise
        return draft, job

    def job_id(self, spacecraft_id: str, calibration_id: int) -> str | None:
        """Return the job that makes a calibration; None where it has ended, or another process runs it."""
        with self._lock:
            return self._job_ids.get((spacecraft_id, calibration_id))

    def activate(self, spacecraft_id: str, calibration_id: int, override_reason: str | None = None) -> Calibration:
        """Make a finished calibration the active one of its method.

        Raises
        ------
        ConflictError
            ``calibration.unfinished``: it has no result. ``calibration.turns_inconsistent``: clock, unit or sensor is
            contradicted and no reason to override is given.
        """
        calibration = self._storage.results.calibration(spacecraft_id, calibration_id)
        if calibration.state is CalibrationState.ACTIVE:
            return calibration
        if calibration.result is None:
            detail = f"calibration {calibration_id} has no result ({calibration.state.value}); " + (
                calibration.error or "its job has not ended"
            )
            raise ConflictError("calibration.unfinished", detail)
        if calibration.contradiction and not override_reason:
            raise ConflictError("calibration.turns_inconsistent", calibration.contradiction)
        return self._storage.results.activate_calibration(spacecraft_id, calibration_id, override_reason)

    def _run(self, spacecraft_id: str, draft: Calibration, report: Progress) -> None:
        """Run the fit of one draft and give up its place."""
        try:
            self._fit(spacecraft_id, draft, report)
        finally:
            self._leave()
            with self._lock:
                del self._job_ids[spacecraft_id, draft.id]

    def _fit(self, spacecraft_id: str, draft: Calibration, report: Progress) -> None:
        """Run the fit of one draft."""
        results = self._storage.results
        try:
            data = self._read(spacecraft_id, draft)
            report(0.3)
            result = self._fitted(data)
        except (CalibrationError, JobAbortedError, SooError) as error:
            results.finish_calibration(spacecraft_id, draft.id, None, str(error))
            raise JobAbortedError(str(error)) from error
        except Exception as error:
            results.finish_calibration(spacecraft_id, draft.id, None, f"internal error: {error!r}")
            raise
        results.finish_calibration(spacecraft_id, draft.id, result, None)

    def _leave(self) -> None:
        with self._lock:
            self._waiting -= 1

    def _read(self, spacecraft_id: str, draft: Calibration) -> CalibrationInput:
        """Read what the archive holds for a draft."""
        catalogue, archive, request = self._storage.catalogue, self._storage.archive, draft.request
        plan = catalogue.plan(spacecraft_id, draft.plan_id)
        operations = self._operations(spacecraft_id, request)
        edges_us = mean_edges_us(request, operations)
        start_us, stop_us = request.turns.start_us, request.turns.stop_us
        around = Window(max(0, start_us - _AROUND_US), stop_us + _AROUND_US)
        quiet, turns, surroundings = (
            minute_rows(archive.measurement_parts(spacecraft_id, window, plan.carrier_ids), plan.carrier_ids, edges_us)
            for window in (request.quiet, request.turns, around)
        )
        return CalibrationInput(
            request,
            plan,
            catalogue.ephemeris(spacecraft_id, draft.ephemeris_id),
            quiet.series,
            turns.series,
            archive.reference_series(spacecraft_id, request.turns),
            archive.reference_series(spacecraft_id, request.quiet),
            catalogue.spacecraft(spacecraft_id),
            operations,
            self._corrections(spacecraft_id, request),
            quiet.usual_measurements,
            quiet.first_dbm,
            self._telemetry(spacecraft_id, request),
            self._polarization(spacecraft_id, request),
            surroundings.series,
        )

    def _corrections(self, spacecraft_id: str, request: CalibrationRequest) -> tuple[Correction, ...]:
        """Return the announced corrections that overlap the turns."""
        entries = self._storage.archive.inputs(spacecraft_id, "correction", request.turns, _MAX_INPUTS, None)
        return tuple(entry.content for entry in entries if isinstance(entry.content, Correction))

    def _telemetry(self, spacecraft_id: str, request: CalibrationRequest) -> tuple[TelemetryRecord, ...]:
        """Return the records of the turns and of the quiet days."""
        found = self._reported(spacecraft_id, "telemetry", request)
        return tuple(one for one in found if isinstance(one, TelemetryRecord))

    def _polarization(self, spacecraft_id: str, request: CalibrationRequest) -> tuple[PolarizationRecord, ...]:
        """Return the records of the turns and of the quiet days."""
        found = self._reported(spacecraft_id, "polarization", request)
        return tuple(one for one in found if isinstance(one, PolarizationRecord))

    def _reported(
        self, spacecraft_id: str, kind: str, request: CalibrationRequest
    ) -> tuple[Measurement | SlowInput, ...]:
        """Return the records of the turns, the first of them where they are more than a calibration reads, and before.

        Of records of the quiet days that stand closer than a minute the first of a source is enough, and those of
        unloadings.
        """
        archive = self._storage.archive
        read = {each.number: each for each in archive.inputs(spacecraft_id, kind, request.turns, _MAX_RECORDS, None)}
        next_us: dict[str, int] = {}
        after = None
        while page := archive.inputs(spacecraft_id, kind, request.quiet, _MAX_RECORDS, after):
            for entry in page:
                one = entry.content
                if isinstance(one, TelemetryRecord | PolarizationRecord):
                    after = one.epoch_us, entry.number
                    source = one.source if isinstance(one, PolarizationRecord) else ""
                    is_unloading = isinstance(one, TelemetryRecord) and one.thrusters_active
                    if is_unloading or one.epoch_us >= next_us.get(source, one.epoch_us):
                        read[entry.number], next_us[source] = entry, one.epoch_us + _SPACED_US
        return tuple(each.content for each in read.values())

    def _operations(self, spacecraft_id: str, request: CalibrationRequest) -> tuple[Operation, ...]:
        """Return the declared operations that overlap a window, each once, by number."""
        found: dict[int, Operation] = {}
        for window in (request.quiet, request.turns):
            for entry in self._storage.archive.inputs(spacecraft_id, "operation", window, _MAX_INPUTS, None):
                if isinstance(entry.content, Operation):
                    found[entry.content.id] = entry.content
        return tuple(found[number] for number in sorted(found))


def fitted(config: CalibrationConfig, data: CalibrationInput) -> CalibrationResult:
    """Return the result of the method that was asked for."""
    if data.request.method is CalibrationMethod.GEOMETRY:
        return calibrate_geometry(data, config)
    return calibrate_paper(data, config)
