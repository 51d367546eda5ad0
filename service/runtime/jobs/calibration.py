"""Calibrations: jobs that read the windows from the archive, run the fit and store the draft's result.

Alignments: the step after which no outside angle reaches the estimator.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

from service.core.estimation.calibration.turns import LONGEST_LAG_S
from service.errors import ConflictError, InvalidInputError
from service.pipeline.alignment.alignment import AlignedPowers, align_methods
from service.pipeline.calibration.geometry_calibration import calibrate_geometry
from service.pipeline.calibration.geometry_rows import CalibrationInput
from service.pipeline.calibration.minute_rows import mean_edges_us, minute_rows
from service.pipeline.calibration.paper_calibration import calibrate_paper
from service.pipeline.config import AlignmentConfig, CalibrationConfig
from service.pipeline.inputs.sensor_angles import StatedAngles, smooth_angles
from service.ports.archive import ListPart
from service.ports.storage import Clock, Storage
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationState,
    Window,
)
from service.records.catalogue import Ephemeris
from service.records.epoch import US_PER_S, format_epoch
from service.records.inputs import Correction, Operation, PolarizationRecord, TelemetryRecord
from service.records.levels.attitude import Axes
from service.records.operations.work import Job, JobKind
from service.runtime.jobs.job_runner import new_job
from service.runtime.live.journal_consumer import every_input

#: operations and corrections that a calibration looks at, at most of each
_MAX_INPUTS = 1000
#: records of telemetry, or of polarimeters, that it looks at: three hours of one a second, whole turns of one in five
_MAX_RECORDS = 10_000
#: records of quiet days need not stand closer
_SPACED_US = 60 * US_PER_S
#: powers before and after the turns by which a lag is judged
_AROUND_US = int(LONGEST_LAG_S) * US_PER_S
_Record = TypeVar("_Record", bound=TelemetryRecord | PolarizationRecord)


class Calibrator:
    """Starts calibrations and makes them active.

    Parameters
    ----------
    storage : Storage
        The archive.
    clock : Clock
        For times of creation.
    notify : callable
        Tells that there is a job.
    most : int
        Calibrations that wait or run at once.
    """

    def __init__(self, storage: Storage, clock: Clock, notify: Callable[[], None], most: int) -> None:
        self._storage, self._clock, self._notify, self._most = storage, clock, notify, most

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
        job = new_job(JobKind.CALIBRATION, spacecraft_id, self._clock)
        draft = self._storage.results.add_calibration(
            *(spacecraft_id, request, plan.id, ephemeris.id, job.created_at_us, created_by), job, self._most
        )
        self._notify()
        return draft, job

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


class CalibrationWork:
    """Work of the jobs of calibrations.

    Parameters
    ----------
    storage : Storage
        The archive.
    config : CalibrationConfig
        Configuration of the fits.
    """

    def __init__(self, storage: Storage, config: CalibrationConfig) -> None:
        self._storage, self._config = storage, config

    def __call__(self, job: Job) -> Iterator[float]:
        """Fit a draft, in pieces: reading is one, the fit another."""
        spacecraft_id, results = job.spacecraft_id or "", self._storage.results
        draft = results.calibration(spacecraft_id, int(job.subject or 0))
        if draft.state is not CalibrationState.DRAFT or draft.result is not None:
            # it was stored right before a process ended
            return
        data = self._read(spacecraft_id, draft)
        yield 0.3
        is_joint = draft.request.method is CalibrationMethod.GEOMETRY
        result = (calibrate_geometry if is_joint else calibrate_paper)(data, self._config)
        results.finish_calibration(spacecraft_id, draft.id, result, None)

    def _read(self, spacecraft_id: str, draft: Calibration) -> CalibrationInput:
        """Read what the archive holds for a draft."""
        catalogue, archive, request = self._storage.catalogue, self._storage.archive, draft.request
        plan = catalogue.plan(spacecraft_id, draft.plan_id)
        operations = self._operations(spacecraft_id, request)
        corrections = archive.inputs(spacecraft_id, "correction", ListPart(request.turns, _MAX_INPUTS))
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
            tuple(entry.content for entry in corrections if isinstance(entry.content, Correction)),
            quiet.usual_measurements,
            quiet.first_dbm,
            self._reported(spacecraft_id, "telemetry", TelemetryRecord, request),
            self._reported(spacecraft_id, "polarization", PolarizationRecord, request),
            surroundings.series,
        )

    def _reported(
        self, spacecraft_id: str, name: str, kind: type[_Record], request: CalibrationRequest
    ) -> tuple[_Record, ...]:
        """Return the records of the turns, the first of them where they are more than a calibration reads, and before.

        Of records of the quiet days that stand closer than a minute the first of a source is enough, and those of
        unloadings.
        """
        archive = self._storage.archive
        turns = archive.inputs(spacecraft_id, name, ListPart(request.turns, _MAX_RECORDS))
        read = {each.number: each for each in turns}
        next_us: dict[str, int] = {}
        for entry in every_input(archive, spacecraft_id, name, request.quiet, is_compared=True):
            one = entry.content
            if isinstance(one, kind):
                source = one.source if isinstance(one, PolarizationRecord) else ""
                is_unloading = isinstance(one, TelemetryRecord) and one.thrusters_active
                if is_unloading or one.epoch_us >= next_us.get(source, one.epoch_us):
                    read[entry.number], next_us[source] = entry, one.epoch_us + _SPACED_US
        return tuple(each.content for each in read.values() if isinstance(each.content, kind))

    def _operations(self, spacecraft_id: str, request: CalibrationRequest) -> tuple[Operation, ...]:
        """Return the declared operations that overlap a window, each once, by number."""
        found: dict[int, Operation] = {}
        for window in (request.quiet, request.turns):
            for entry in self._storage.archive.inputs(spacecraft_id, "operation", ListPart(window, _MAX_INPUTS)):
                if isinstance(entry.content, Operation):
                    found[entry.content.id] = entry.content
        return tuple(found[number] for number in sorted(found))


_UNKNOWN_COUPLING = (
    "onboard.roll_yaw_coupling is not stated: roll tells nothing of yaw, which is known from the powers alone; state "
    "true where the on-board mode holds a fixed inertial rate, false where it turns with the orbit"
)


@dataclass(frozen=True, slots=True)
class AlignmentRequest:
    """Request of an operator for an alignment: a window and its sensors, or angles stated by hand."""

    window: Window | None
    #: sensor of yaw, roll, pitch; used with a window
    source_of_axis: tuple[str, str, str] | None
    #: angles by hand
    stated: tuple[int, Axes, Axes] | None
    override_reason: str | None
    created_by: str


class Aligner:
    """Makes alignments from the archive."""

    def __init__(self, storage: Storage, clock: Clock, config: AlignmentConfig) -> None:
        self._storage = storage
        self._clock = clock
        self._config = config

    def align(self, spacecraft_id: str, request: AlignmentRequest) -> Alignment:
        """Store an alignment and return it.

        Raises
        ------
        ConflictError
            ``alignment.no_calibration``: none is active. ``alignment.inconsistent``: the powers contradict the angles
            and no reason to override was given.
        InvalidInputError
            ``alignment.no_reference``, ``alignment.no_powers``: the window lacks angles or powers.
        """
        active = self._active_calibrations(spacecraft_id)
        stated, window = self._angles(spacecraft_id, request)
        results = [calibration.result for calibration in active.values() if calibration.result is not None]
        carrier_ids = list(dict.fromkeys(carrier.id for result in results for carrier in result.carriers))
        series = self._storage.archive.measurement_series(spacecraft_id, window, carrier_ids)
        ephemeris = self._storage.catalogue.ephemeris(spacecraft_id)
        powers = align_methods(series, stated, active, ephemeris, self._config)
        if len(powers.references) < 4:
            raise InvalidInputError("alignment.no_powers", self._too_few(len(powers.references), window, ephemeris))
        self._refuse_contradiction(powers, stated, request)
        source = ",".join(sorted(set(request.source_of_axis))) if request.source_of_axis else "manual"
        made = powers.to_record(stated, window, source, request.created_by, self._clock.system_us())
        alignment = replace(made, override_reason=request.override_reason, warnings=self._warnings(spacecraft_id))
        return self._storage.results.add_alignment(spacecraft_id, alignment)

    def _warnings(self, spacecraft_id: str) -> tuple[str, ...]:
        onboard = self._storage.catalogue.spacecraft(spacecraft_id).onboard
        return (_UNKNOWN_COUPLING,) if onboard.roll_yaw_coupling is None else ()

    def _active_calibrations(self, spacecraft_id: str) -> dict[CalibrationMethod, Calibration]:
        """Return the active calibration of each kind of fit."""
        self._storage.catalogue.spacecraft(spacecraft_id)
        active = self._storage.results.calibrations(spacecraft_id, CalibrationState.ACTIVE)
        if not active:
            detail = f"no calibration of {spacecraft_id} is active"
            raise ConflictError("alignment.no_calibration", detail)
        return {calibration.request.method: calibration for calibration in active}

    def _angles(self, spacecraft_id: str, request: AlignmentRequest) -> tuple[StatedAngles, Window]:
        """Return the angles to start from and the window of powers that belongs to them."""
        if request.stated is not None:
            epoch_us, attitude_deg, sigma_deg = request.stated
            window = Window(epoch_us - int(self._config.manual_window_s * US_PER_S), epoch_us + 1)
            return StatedAngles(epoch_us, attitude_deg, sigma_deg), window
        if request.window is None or request.source_of_axis is None:
            raise InvalidInputError("alignment.shape", "neither a window with its sources nor an epoch with its angles")
        references = self._storage.archive.reference_series(spacecraft_id, request.window)
        stated, missing = smooth_angles(references, request.source_of_axis)
        if stated is None:
            wanted = ", ".join(sorted(set(request.source_of_axis)))
            detail = (
                f"no {' and '.join(missing)} of {wanted} between {format_epoch(request.window.start_us)} and "
                f"{format_epoch(request.window.stop_us)}"
            )
            raise InvalidInputError("alignment.no_reference", detail)
        return stated, request.window

    def _too_few(self, carriers: int, window: Window, ephemeris: Ephemeris) -> str:
        """Return the text that says how many carriers have powers that can be used, and of a short ephemeris."""
        text = (
            f"{carriers} carriers have {self._config.min_rows} rows or more between "
            f"{format_epoch(window.start_us)} and {format_epoch(window.stop_us)}; 4 are needed"
        )
        if ephemeris.valid_start_us <= window.start_us and window.stop_us <= ephemeris.valid_stop_us + 1:
            return text
        return (
            f"{text}, and the ephemeris reaches from {format_epoch(ephemeris.valid_start_us)} to "
            f"{format_epoch(ephemeris.valid_stop_us)}"
        )

    def _refuse_contradiction(self, powers: AlignedPowers, stated: StatedAngles, request: AlignmentRequest) -> None:
        """Refuse angles that the powers speak against, unless the operator overrides."""
        consistency = powers.consistency
        if consistency.probability >= self._config.min_probability or request.override_reason:
            return
        yaw, roll, pitch = consistency.offset_deg
        detail = (
            f"the powers contradict the angles at {format_epoch(stated.epoch_us)} (chi-square "
            f"{consistency.chi_square:.1f}, p {consistency.probability:.1e}): they tell of yaw {yaw:+.2f}, roll "
            f"{roll:+.2f}, pitch {pitch:+.2f} deg beside them"
        )
        raise ConflictError("alignment.inconsistent", detail)
