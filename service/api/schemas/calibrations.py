"""Documents of calibrations, alignments and replays."""

from dataclasses import asdict
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import (
    Answer,
    CommentText,
    Document,
    Epoch,
    Figure,
    LiveMethod,
    RowList,
    RowPage,
    WindowAnswer,
    members_of,
    record_of,
)
from service.pipeline.calibration.window_harmonics import CarrierHarmonic, DishLaw
from service.records import calibration as records
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import Axes
from service.records.operations.work import Replay, ReplayVersion
from service.records.record_fields import record_fields
from service.runtime.jobs.analysis import WindowHarmonics
from service.runtime.jobs.calibration import AlignmentRequest

Sensor = Literal["star_tracker", "earth_sensor", "radio_beacon", "other"]
#: what an operation of the archive is named by; it counts with int32
_LONGEST_DAYS = 100
_DAY_US = 86_400 * US_PER_S
Identifier = Annotated[int, Field(ge=1, le=2**31 - 1)]


class WindowDocument(Document):
    """Interval of epochs, start inclusive, stop exclusive."""

    start: Epoch
    stop: Epoch

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        """Refuse an interval without content."""
        if self.start >= self.stop:
            raise PydanticCustomError("range.invalid", "start must lie before stop")
        return self

    def to_record(self) -> records.Window:
        """Return the window that this document states."""
        return records.Window(self.start, self.stop)


class SensorsDocument(Document):
    """Sensor of each angle."""

    yaw: Sensor
    roll: Sensor
    pitch: Sensor


class SensorChoice(Document):
    """One sensor for all angles, or one for each."""

    source: Sensor | None = None
    sources: SensorsDocument | None = None

    @model_validator(mode="after")
    def _check_choice(self) -> Self:
        """Refuse both at once."""
        if self.source is not None and self.sources is not None:
            raise PydanticCustomError("sources.ambiguous", "source for all angles and sources for each are both given")
        return self

    @property
    def of_axis(self) -> tuple[str, str, str]:
        """Sensor of yaw, roll, pitch; the star tracker unless another is named."""
        if self.sources is not None:
            return self.sources.yaw, self.sources.roll, self.sources.pitch
        sensor = self.source or "star_tracker"
        return sensor, sensor, sensor


class CalibrationDocument(SensorChoice):
    """A calibration to be made."""

    quiet: WindowDocument
    """Days without turns: give harmonics and levels."""
    turns: WindowDocument
    """Calibration turns: give sensitivities."""
    method: records.CalibrationMethod

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        """Refuse windows whose rows do not fit the memory."""
        if any(window.stop - window.start > _LONGEST_DAYS * _DAY_US for window in (self.quiet, self.turns)):
            raise PydanticCustomError(
                "range.too_long", "a window of a calibration lasts at most {days} days", {"days": _LONGEST_DAYS}
            )
        return self

    def to_record(self) -> records.CalibrationRequest:
        """Return the request that this document states."""
        return records.CalibrationRequest(self.quiet.to_record(), self.turns.to_record(), self.method, *self.of_axis)


class ActivationDocument(Document):
    """Activation of a calibration."""

    override_reason: Annotated[CommentText, Field(min_length=1)] | None = None
    """Why it is activated although its turns are inconsistent."""


class CalibrationStartedAnswer(Answer):
    """A calibration that is being made."""

    id: int
    job: str


class HarmonicAnswer(members_of(records.Harmonic, types={"period_s": float}), Answer):
    """Daily harmonic of a carrier and how well it was found."""


class NoiseAnswer(members_of(records.NoiseComponent), Answer):
    """One coloured part of a carrier's noise."""


class StabilityAnswer(Answer):
    """First criterion: what the harmonic leaves."""

    residual_rms_db: Annotated[Figure, Field(validation_alias="stability_residual_rms_db")]
    drift_db_per_day: Figure


class LinearityAnswer(Answer):
    """Second criterion: departure from a straight line."""

    deviation_at_0p5_deg_db: Figure
    departure_deg: Annotated[Figure, Field(validation_alias="nonlinearity_deg")]
    """Greatest departure, in degrees of the carrier's own axis."""
    range_deg: Annotated[Figure, Field(validation_alias="linear_range_deg")]
    """Range in which it was judged."""


_CRITERIA = (
    *("stability_residual_rms_db", "drift_db_per_day", "deviation_at_0p5_deg_db"),
    *("nonlinearity_deg", "linear_range_deg"),
)


class CarrierCalibrationAnswer(
    members_of(records.CarrierCalibration, without=_CRITERIA, types={"noise": NoiseAnswer, "harmonic": HarmonicAnswer}),
    Answer,
):
    """Result of a calibration for one carrier."""

    stability: StabilityAnswer
    linearity: LinearityAnswer

    @classmethod
    def of(cls, carrier: records.CarrierCalibration) -> Self:
        """Return the answer for the calibration of a carrier."""
        return super().of(carrier, stability=carrier, linearity=carrier)


class ObservabilityAnswer(members_of(records.Observability), Answer):
    """Observability of the attitude by the selected carriers."""


class CalibrationAnswer(members_of(records.Calibration, without=("request", "result")), Answer):
    """One calibration; figures are there when its job has ended well."""

    method: records.CalibrationMethod
    quiet: WindowAnswer
    turns: WindowAnswer
    sources: SensorsDocument
    quality: dict[str, Figure | str | list[str]]
    """Figures of the fit as a whole, `warnings`, and `yaw_sign` and `common_sign`: proven, unproven or not_judged.
    While `yaw_sign` is unproven, the yaw of paper may have the wrong sign; `common_sign` is that of all axes together.
    `momentum` of the wheels by the turns: consistent, contradicted (the filter does not use it), not_checked, or
    not_stated where the catalogue has no `onboard.momentum`; `momentum_response_roll` and others must be 1. `rates`
    of the body likewise, not_stated without `onboard.rate_sensor` beside the loop; `rate_response_roll` and others.
    `turns` by the powers against the sensor's likewise: clock (`turn_lag_s`, positive = the powers are late), unit
    (`turn_scale`, angles of the sensor over those of the beams; sigma of its logarithm), motion
    (`turn_shared`, sigmas); contradicted, it is activated only with `override_reason`.
    `polarimeter` is the worst verdict on a polarimeter, `polarimeter_response` its figure; `polarimeter_feed_turn_deg`
    (turn of its feed, leakage taken for a turn, with which the filter begins), `polarimeter_leakage_deg`, each with its
    sigma, and `polarimeter_daily_deg` (amplitude) where ratios tell them. `gathered_constant_yaw_n_m`,
    `gathered_daily_yaw_n_m` (amplitude), `gathered_yaw_sigma_n_m`, the same of roll and pitch, and
    `gathered_torque_records`: torque from outside that gathered in the wheels on the quiet days."""
    observability: ObservabilityAnswer | None
    carriers: list[CarrierCalibrationAnswer]
    job: str | None
    """That makes it, while this process of the service runs it: its progress stands at `/jobs/{job_id}`."""

    @classmethod
    def of(cls, calibration: records.Calibration, *, job: str | None = None) -> Self:
        """Return the answer for a calibration and the job that makes it."""
        request, result = calibration.request, calibration.result
        return super().of(
            calibration,
            method=request.method,
            quiet=request.quiet,
            turns=request.turns,
            sources={"yaw": request.source_yaw, "roll": request.source_roll, "pitch": request.source_pitch},
            quality=_quality(result),
            observability=None if result is None else result.observability,
            carriers=[] if result is None else [CarrierCalibrationAnswer.of(c) for c in result.carriers],
            job=job,
        )


class CalibrationList(RowList[CalibrationAnswer]):
    """Calibrations, newest first."""


def _worst(checks: tuple[records.PolarimeterCheck, ...]) -> str:
    verdicts = {check.verdict for check in checks}
    for verdict in (
        records.MotionVerdict.CONTRADICTED,
        records.MotionVerdict.UNCHECKED,
        records.MotionVerdict.CONSISTENT,
    ):
        if verdict in verdicts:
            return verdict.value
    return "not_stated"


def _quality(result: records.CalibrationResult | None) -> dict[str, float | str | list[str]]:
    """Return the figures of the whole, the signs and the warnings."""
    if result is None:
        return {"warnings": []}
    words = {"yaw_sign": "not_judged", "common_sign": "not_judged", "momentum": "not_stated", "rates": "not_stated"}
    words["polarimeter"] = _worst(result.polarimeters)
    words["turns"] = "not_checked" if result.turns is None else result.turns.verdict.value
    if result.signs is not None:
        words["yaw_sign"] = "proven" if result.signs.is_yaw_proven else "unproven"
        words["common_sign"] = "proven" if result.signs.is_common_proven else "unproven"
    if result.momentum is not None:
        words["momentum"] = result.momentum.verdict.value
    if result.rates is not None:
        words["rates"] = result.rates.verdict.value
    return {**result.quality, **words, "warnings": list(result.warnings)}


AngleDeg = Annotated[float, Field(ge=-180, le=180)]
SigmaDeg = Annotated[float, Field(gt=0, le=180)]
_WINDOW_FIELDS = frozenset({"start", "stop", "sources"})
_MANUAL_FIELDS = frozenset({"epoch", "yaw_deg", "roll_deg", "pitch_deg", "sigma_deg"})
_DEFAULT_SENSOR = "star_tracker"


class SigmaDocument(Document):
    """One standard deviation of each angle."""

    yaw: SigmaDeg
    roll: SigmaDeg
    pitch: SigmaDeg


class AlignmentDocument(Document):
    """Either start, stop and source (or sources), or epoch, three angles and sigma_deg with source manual."""

    start: Epoch | None = None
    stop: Epoch | None = None
    source: Literal["star_tracker", "earth_sensor", "radio_beacon", "other", "manual"] | None = None
    sources: SensorsDocument | None = None
    """Sensor of each angle, in place of source."""
    epoch: Epoch | None = None
    yaw_deg: AngleDeg | None = None
    roll_deg: AngleDeg | None = None
    pitch_deg: AngleDeg | None = None
    sigma_deg: SigmaDocument | None = None
    override_reason: Annotated[CommentText, Field(min_length=1)] | None = None
    """Why the angles hold although the powers contradict them."""

    @property
    def is_manual(self) -> bool:
        """Return whether angles are stated by hand."""
        return self.source == "manual"

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        """Refuse anything but one whole form."""
        stated = {name for name in _WINDOW_FIELDS | _MANUAL_FIELDS if getattr(self, name) is not None}
        required = _MANUAL_FIELDS if self.is_manual else {"start", "stop"}
        foreign = stated & (_WINDOW_FIELDS if self.is_manual else _MANUAL_FIELDS)
        missing = required - stated
        if missing or foreign:
            raise PydanticCustomError(
                "alignment.shape",
                "an alignment has start and stop with source or sources, or epoch, yaw_deg, roll_deg, pitch_deg and "
                "sigma_deg with source manual; missing: {missing}; not of this form: {foreign}",
                {"missing": _listed(missing), "foreign": _listed(foreign)},
            )
        if self.source is not None and self.sources is not None:
            raise PydanticCustomError("sources.ambiguous", "source for all angles and sources for each are both given")
        if self.start is not None and self.stop is not None and self.start >= self.stop:
            raise PydanticCustomError("range.invalid", "start must lie before stop")
        return self

    def to_request(self, created_by: str) -> AlignmentRequest:
        """Return the request that this document states."""
        return AlignmentRequest(
            window=None if self.start is None or self.stop is None else records.Window(self.start, self.stop),
            source_of_axis=None if self.is_manual else self._of_axis(),
            stated=self._stated(),
            override_reason=self.override_reason,
            created_by=created_by,
        )

    def _of_axis(self) -> tuple[str, str, str]:
        """Return the sensor of yaw, roll, pitch."""
        if self.sources is not None:
            return self.sources.yaw, self.sources.roll, self.sources.pitch
        sensor = self.source or _DEFAULT_SENSOR
        return sensor, sensor, sensor

    def _stated(self) -> tuple[int, Axes, Axes] | None:
        """Return epoch, angles and sigmas stated by hand."""
        if self.epoch is None or self.yaw_deg is None or self.roll_deg is None or self.pitch_deg is None:
            return None
        if self.sigma_deg is None:
            return None
        sigma = self.sigma_deg
        angles = Axes(self.yaw_deg, self.roll_deg, self.pitch_deg)
        return self.epoch, angles, Axes(sigma.yaw, sigma.roll, sigma.pitch)


class CarrierReferenceAnswer(members_of(records.CarrierReference), Answer):
    """Reference power of one carrier, harmonic removed."""


class AlignmentAnswer(
    members_of(
        records.Alignment,
        flat=("attitude_deg",),
        types={
            "window": WindowAnswer,
            "references": CarrierReferenceAnswer,
            "references_by_method": dict[str, list[CarrierReferenceAnswer]],
        },
    ),
    Answer,
):
    """An alignment; the newest holds for every method."""


class AlignmentMadeAnswer(AlignmentAnswer):
    """New alignment, with the numbers of stored rows that it changes or leaves."""

    rows_recomputed: int
    """Stored rows later than `epoch` that get angles by this alignment: those that had none."""
    rows_kept: int
    """Stored rows later than `epoch` that keep the angles of an earlier alignment, because control may have acted on
    them; a replay with this alignment (order epoch) computes them again beside the stored ones."""


class AlignmentList(RowList[AlignmentAnswer]):
    """Alignments, newest first."""


def _listed(names: set[str] | frozenset[str]) -> str:
    return ", ".join(sorted(names)) or "nothing"


class DishLawAnswer(members_of(DishLaw), Answer):
    """`b1 m1 + b2 m2 - k |m|^2` dB: what a fixed dish makes of the satellite's motion m in its sky, deg."""


class CarrierHarmonicAnswer(HarmonicAnswer):
    """Daily change of one carrier; sigmas hold for independent residuals."""

    carrier: str
    law: str
    """one_harmonic, two_harmonics or dish_law; of a dish law the harmonics are those of its curve in the window."""
    second_amplitude_db: Figure
    """Of the harmonic of half the period; null where the law has none."""
    second_phase_rad: Figure
    dish_law: DishLawAnswer | None
    amplitude_sigma_db: Figure
    phase_sigma_rad: Figure
    offset_sigma_db: Figure
    converged: bool
    """True: the iteration came to rest."""

    @classmethod
    def of(cls, fit: CarrierHarmonic) -> Self:
        """Return the answer that tells the fit of a carrier."""
        return super().of(fit, dish_law=fit.dish, **asdict(fit.harmonic))


class WindowHarmonicsAnswer(Answer):
    """Daily change in a window, phase and motion from the newest ephemeris."""

    range: WindowAnswer
    method: Method
    plan_id: int
    ephemeris_id: int
    rows: int
    """Measurements in the window."""
    carriers: list[CarrierHarmonicAnswer]

    @classmethod
    def of(cls, window: records.Window, method: Method, harmonics: WindowHarmonics) -> Self:
        """Return the answer for the harmonics of a window."""
        carriers = [CarrierHarmonicAnswer.of(fit) for fit in harmonics.carriers]
        return super().of(harmonics, range=window, method=method, carriers=carriers)


class ReplayDocument(WindowDocument):
    """A stretch of the archive to run again."""

    method: LiveMethod | None = None
    """Null: every method."""
    calibration_id: Identifier | None = None
    """In place of those that the journal activates."""
    alignment_id: Identifier | None = None
    """In place of the one that held at start."""
    order: Literal["journal", "epoch"] = "journal"
    """As it was, or as it would have been with late rows in their place."""
    commands: bool = True
    """False leaves out the torques."""
    smooth: bool = False
    """True adds rows of method `robust_smoothed`: the robust rows after those that came later. They drive nothing."""

    @model_validator(mode="after")
    def _smooth_what_is_robust(self) -> Self:
        """Refuse to smooth where the robust method does not run."""
        if self.smooth and self.method is Method.PAPER:
            detail = "only the robust method has smoothed rows"
            raise PydanticCustomError("method.smoothed", detail)
        return self

    def to_replay(self) -> Replay:
        """Return the replay that this document asks for; number, job and time are given later."""
        return record_of(Replay, self, id=0, alignment_id=self.alignment_id or 0, job_id="", created_at_us=0)


class ReplayStartedAnswer(Answer):
    """A replay that is running."""

    id: int
    job: str
    version: str
    """Name under which its rows are read on history and export."""


class ReplayAnswer(
    members_of(ReplayVersion, without=("replay",), number=float),
    members_of(Replay, without=("id", "job_id", "is_fixed_alignment", "until_number")),
    ReplayStartedAnswer,
):
    """One replay; its rows are read when its state is ``done``."""

    @classmethod
    def of(cls, found: ReplayVersion) -> Self:
        """Return the answer for a replay and what became of it."""
        became = {name: getattr(found, name) for name in record_fields(ReplayVersion) if name != "replay"}
        return super().of(found.replay, job=found.replay.job_id, **became)


class ReplayPage(RowPage[ReplayAnswer]):
    """One page of replays."""
