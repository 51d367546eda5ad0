"""Documents of calibrations: requests, and results with all criteria of the choice of carriers."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import Answer, Document, Epoch, Figure, RowList, WindowAnswer
from service.api.schemas.record_answers import members_of
from service.records.calibration import (
    Calibration,
    CalibrationMethod,
    CalibrationRequest,
    CalibrationResult,
    CarrierCalibration,
    Harmonic,
    MotionVerdict,
    Observability,
    PolarimeterCheck,
    Window,
)
from service.records.epoch import US_PER_S
from service.records.noise import NoiseComponent

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

    def to_record(self) -> Window:
        """Return the window that this document states."""
        return Window(self.start, self.stop)


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
    method: CalibrationMethod

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        """Refuse windows whose rows do not fit the memory."""
        if any(window.stop - window.start > _LONGEST_DAYS * _DAY_US for window in (self.quiet, self.turns)):
            raise PydanticCustomError(
                "range.too_long", "a window of a calibration lasts at most {days} days", {"days": _LONGEST_DAYS}
            )
        return self

    def to_record(self) -> CalibrationRequest:
        """Return the request that this document states."""
        return CalibrationRequest(self.quiet.to_record(), self.turns.to_record(), self.method, *self.of_axis)


class CalibrationStartedAnswer(Answer):
    """A calibration that is being made."""

    id: int
    job: str


class HarmonicAnswer(members_of(Harmonic, types={"period_s": float}), Answer):
    """Daily harmonic of a carrier and how well it was found."""


class NoiseAnswer(members_of(NoiseComponent), Answer):
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
    members_of(CarrierCalibration, without=_CRITERIA, types={"noise": NoiseAnswer, "harmonic": HarmonicAnswer}), Answer
):
    """Result of a calibration for one carrier."""

    stability: StabilityAnswer
    linearity: LinearityAnswer

    @classmethod
    def of(cls, carrier: CarrierCalibration) -> Self:
        """Return the answer for the calibration of a carrier."""
        return super().of(carrier, stability=carrier, linearity=carrier)


class ObservabilityAnswer(members_of(Observability), Answer):
    """Observability of the attitude by the selected carriers."""


class CalibrationAnswer(members_of(Calibration, without=("request", "result")), Answer):
    """One calibration; figures are there when its job has ended well."""

    method: CalibrationMethod
    quiet: WindowAnswer
    turns: WindowAnswer
    sources: SensorsDocument
    quality: dict[str, Figure | str | list[str]]
    """Figures of the fit as a whole, `warnings`, and `yaw_sign` and `common_sign`: proven, unproven or not_judged.
    While `yaw_sign` is unproven, yaw is not controlled; `common_sign` is that of all axes of the sensors together.
    `momentum` of the wheels by the turns: consistent, contradicted (the filter does not use it), not_checked, or
    not_stated where the catalogue has no `onboard.momentum`; `momentum_response_roll` and others must be 1. `rates`
    of the body likewise, not_stated without `onboard.rate_sensor` beside the loop; `rate_response_roll` and others.
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
    def of(cls, calibration: Calibration, *, job: str | None = None) -> Self:
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


class CalibrationList(RowList):
    """Calibrations, newest first."""

    rows: list[CalibrationAnswer]


def _worst(checks: tuple[PolarimeterCheck, ...]) -> str:
    """Return the worst verdict on a polarimeter."""
    verdicts = {check.verdict for check in checks}
    for verdict in (MotionVerdict.CONTRADICTED, MotionVerdict.UNCHECKED, MotionVerdict.CONSISTENT):
        if verdict in verdicts:
            return verdict.value
    return "not_stated"


def _quality(result: CalibrationResult | None) -> dict[str, float | str | list[str]]:
    """Return the figures of the whole, the signs and the warnings."""
    if result is None:
        return {"warnings": []}
    words = {"yaw_sign": "not_judged", "common_sign": "not_judged", "momentum": "not_stated", "rates": "not_stated"}
    words["polarimeter"] = _worst(result.polarimeters)
    if result.signs is not None:
        words["yaw_sign"] = "proven" if result.signs.is_yaw_proven else "unproven"
        words["common_sign"] = "proven" if result.signs.is_common_proven else "unproven"
    if result.momentum is not None:
        words["momentum"] = result.momentum.verdict.value
    if result.rates is not None:
        words["rates"] = result.rates.verdict.value
    return {**result.quality, **words, "warnings": list(result.warnings)}
