"""Alignment: the step after which no outside angle reaches the estimator."""

from dataclasses import dataclass, replace

from service.errors import ConflictError, InvalidInputError
from service.pipeline.alignment.alignment import AlignedPowers, align_methods
from service.pipeline.config import AlignmentConfig
from service.pipeline.inputs.sensor_angles import StatedAngles, smooth_angles
from service.ports.storage import Clock, Storage
from service.records.calibration import Alignment, Calibration, CalibrationMethod, CalibrationState, Window
from service.records.catalogue import Ephemeris
from service.records.epoch import US_PER_S, format_epoch
from service.records.levels.attitude import Axes

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
        """Return warnings on gaps of the catalogue."""
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
