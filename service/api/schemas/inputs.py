"""Documents of slow inputs, sent in batches, and of operations that the control centre declares."""

from collections.abc import Iterable
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import (
    MAX_ROWS,
    AnglesDocument,
    Answer,
    AnyEpoch,
    CommentText,
    Document,
    Epoch,
    Name,
    RefusalAnswer,
    RowPage,
    Text,
    axes_of,
    members_of,
    record_of,
)
from service.records.epoch import EARLIEST_EPOCH_US, LATEST_EPOCH_US, format_epoch
from service.records.inputs import (
    AttitudeReference,
    Correction,
    Operation,
    PolarizationRecord,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import NO_ANGLES

#: code and detail of a refused row
Fault = tuple[str, str]
_NO_ANGLE: Fault = ("value.absent", "the row states no angle at all; leave it out")
_MAX_ANGLE_DEG = 180.0
#: more rain than was ever measured, and more than any link survives
_MAX_RAIN_MM_H, _MAX_RAIN_DB = 2000.0, 100.0
#: least turn of a feed whose ratio has a slope, and what each member of a polarisation record may be
MIN_FEED_DEG = 0.5
_POLARIZATION_LIMITS: dict[str, tuple[float, float]] = {
    "ratio_db": (-60.0, 60.0),
    "co_power_dbm": (-200.0, 60.0),
    "feed_offset_deg": (-80.0, 80.0),
    "noise_db": (1e-4, 20.0),
    "angle_deg": (-90.0, 90.0),
    "sigma_deg": (1e-4, 90.0),
    "tec_tecu": (0.0, 1000.0),
}
#: any wheel and any rate; beyond lies a fault of units or of telemetry, not a spacecraft
_Telemetered = Annotated[float, Field(ge=-1e6, le=1e6)]
Wheels = Annotated[tuple[_Telemetered, ...], Field(min_length=1, max_length=16)]


def _epoch_fault(epoch_us: int) -> Fault | None:
    if epoch_us < EARLIEST_EPOCH_US:
        return "time.too_old", f"nothing before {format_epoch(EARLIEST_EPOCH_US)} is kept"
    if epoch_us > LATEST_EPOCH_US:
        return "time.future", f"the epoch lies after {format_epoch(LATEST_EPOCH_US)}"
    return None


def _angle_fault(angles_deg: Iterable[float | None], sigmas_deg: Iterable[float | None] = ()) -> Fault | None:
    """Return why angles or their sigmas cannot be."""
    stated = [angle for angle in angles_deg if angle is not None]
    if not stated:
        return _NO_ANGLE
    if any(abs(angle) > _MAX_ANGLE_DEG for angle in stated):
        return "value.out_of_range", f"an angle lies outside -{_MAX_ANGLE_DEG:g}..{_MAX_ANGLE_DEG:g} deg"
    if any(sigma is not None and not 0 < sigma <= _MAX_ANGLE_DEG for sigma in sigmas_deg):
        return "value.out_of_range", f"a sigma must lie above 0 and not above {_MAX_ANGLE_DEG:g} deg; null = not stated"
    return None


class ReferenceDocument(Document):
    """Attitude measured by a sensor at one epoch; any angle may be null."""

    epoch: AnyEpoch
    yaw_deg: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None
    sigma_deg: AnglesDocument | None = None
    """One standard deviation of each angle."""

    def fault(self) -> Fault | None:
        """Return why the row is refused, None when it is not."""
        sigma = self.sigma_deg or AnglesDocument()
        angles_deg = (self.yaw_deg, self.roll_deg, self.pitch_deg)
        return _epoch_fault(self.epoch) or _angle_fault(angles_deg, (sigma.yaw, sigma.roll, sigma.pitch))

    def to_record(self, source: str) -> AttitudeReference:
        """Return the record that this row states."""
        sigma_deg = NO_ANGLES if self.sigma_deg is None else self.sigma_deg.to_record()
        return AttitudeReference(source, self.epoch, axes_of(self.yaw_deg, self.roll_deg, self.pitch_deg), sigma_deg)


class ReferenceBatchDocument(Document):
    """References of one sensor."""

    source: Literal["star_tracker", "earth_sensor", "radio_beacon", "other"]
    references: Annotated[list[ReferenceDocument], Field(max_length=MAX_ROWS, fail_fast=True)]


class CorrectionDocument(Document):
    """Attitude change commanded through other channels, total over the interval; an absent angle does not change."""

    start: AnyEpoch
    stop: AnyEpoch
    yaw_deg: float | None = None
    roll_deg: float | None = None
    pitch_deg: float | None = None

    def fault(self) -> Fault | None:
        """Return why the row is refused, None when it is not."""
        fault = _epoch_fault(self.start) or _epoch_fault(self.stop)
        if fault is None and self.start >= self.stop:
            fault = "range.invalid", "start must lie before stop"
        return fault or _angle_fault((self.yaw_deg, self.roll_deg, self.pitch_deg))

    def to_record(self) -> Correction:
        """Return the record that this row states."""
        change_deg = axes_of(self.yaw_deg or 0.0, self.roll_deg or 0.0, self.pitch_deg or 0.0)
        return Correction(self.start, self.stop, change_deg)


class CorrectionBatchDocument(Document):
    """Corrections."""

    corrections: Annotated[list[CorrectionDocument], Field(max_length=MAX_ROWS, fail_fast=True)]


class TelemetryDocument(Document):
    """On-board state at one epoch."""

    epoch: AnyEpoch
    onboard_mode: Text | None = None
    wheel_momentum_n_m_s: Wheels | None = None
    wheel_speed_rpm: Wheels | None = None
    thrusters_active: bool | None = None
    body_rate_deg_s: AnglesDocument | None = None

    @property
    def greatest_n_m_s(self) -> float:
        """Momentum of the fullest wheel; 0 where none is stated."""
        return max(map(abs, self.wheel_momentum_n_m_s or (0.0,)))

    def fault(self) -> Fault | None:
        """Return why the row is refused, None when it is not."""
        fault = _epoch_fault(self.epoch)
        if fault is None and not self.model_dump(exclude={"epoch"}, exclude_none=True):
            fault = "value.absent", "the row states nothing but its epoch; leave it out"
        return fault

    def to_record(self) -> TelemetryRecord:
        """Return the record that this row states."""
        return record_of(TelemetryRecord, self)


class TelemetryBatchDocument(Document):
    """Telemetry records."""

    records: Annotated[list[TelemetryDocument], Field(max_length=MAX_ROWS, fail_fast=True)]


class WeatherDocument(Document):
    """Rain over an uplink station at one epoch, as rain rate, as attenuation of the uplink, or both; 0 = dry."""

    epoch: AnyEpoch
    station: Text
    """Name of the station in the carrier plan."""
    rain_rate_mm_h: float | None = None
    attenuation_db: float | None = None
    """Of the uplink path, by the rain alone."""

    def fault(self) -> Fault | None:
        """Return why the row is refused, None when it is not."""
        fault = _epoch_fault(self.epoch)
        if fault is not None:
            return fault
        if self.rain_rate_mm_h is None and self.attenuation_db is None:
            return "value.absent", "the row states neither rain_rate_mm_h nor attenuation_db; a dry station states 0"
        if not 0.0 <= (self.rain_rate_mm_h or 0.0) <= _MAX_RAIN_MM_H:
            return "value.out_of_range", f"rain_rate_mm_h lies outside 0..{_MAX_RAIN_MM_H:g} mm/h"
        if not 0.0 <= (self.attenuation_db or 0.0) <= _MAX_RAIN_DB:
            return "value.out_of_range", f"attenuation_db lies outside 0..{_MAX_RAIN_DB:g} dB; a loss is positive"
        return None

    def to_record(self, source: str) -> WeatherReport:
        """Return the record that this row states."""
        return WeatherReport(source, self.station, self.epoch, self.rain_rate_mm_h, self.attenuation_db)


class WeatherBatchDocument(Document):
    """Weather reports of one source."""

    source: Name
    """Name of the gauge, radar or service that tells."""
    reports: Annotated[list[WeatherDocument], Field(max_length=MAX_ROWS, fail_fast=True)]


class PolarizationDocument(Document):
    """Polarisation of the downlink at one epoch: the ratio of the two ports, or an angle."""

    epoch: AnyEpoch
    ratio_db: float | None = None
    """Power of the cross-polar port over that of the co-polar port."""
    co_power_dbm: float | None = None
    """Power of the co-polar port; a fade widens the angle."""
    feed_offset_deg: float | None = None
    """Turn of the feed at this record; null: as the catalogue states."""
    noise_db: float | None = None
    """One standard deviation of the ratio; null: as the catalogue states."""
    angle_deg: float | None = None
    """Angle against that at zero attitude, in place of a ratio."""
    sigma_deg: float | None = None
    """One standard deviation of the angle; null: as the catalogue states."""
    tec_tecu: float | None = None
    """Electron content along the path, for the Faraday rotation."""

    def fault(self) -> Fault | None:
        """Return why the row is refused, None when it is not."""
        fault = _epoch_fault(self.epoch)
        if fault is None and (self.ratio_db is None) == (self.angle_deg is None):
            fault = "value.absent", "the row must state one of ratio_db and angle_deg, not both"
        if fault is None and self.feed_offset_deg is not None and abs(self.feed_offset_deg) < MIN_FEED_DEG:
            fault = "value.out_of_range", f"feed_offset_deg lies within {MIN_FEED_DEG:g} deg of 0"
        return fault or next((found for name in _POLARIZATION_LIMITS if (found := self._range_fault(name))), None)

    def _range_fault(self, name: str) -> Fault | None:
        """Return why a member cannot be."""
        value, (least, most) = getattr(self, name), _POLARIZATION_LIMITS[name]
        if value is None or least <= value <= most:
            return None
        return "value.out_of_range", f"{name} lies outside {least:g}..{most:g}"

    def to_record(self, source: str) -> PolarizationRecord:
        """Return the record that this row states."""
        return record_of(PolarizationRecord, self, source=source)


class PolarizationBatchDocument(Document):
    """Polarisation records of one polarimeter."""

    source: Name
    """Name of the polarimeter in the catalogue."""
    records: Annotated[list[PolarizationDocument], Field(max_length=MAX_ROWS, fail_fast=True)]


class InputRefusalAnswer(RefusalAnswer):
    """A refused row."""


class InputReceiptAnswer(Answer):
    """Receipt of committed inputs; received = accepted + duplicates + len(refused)."""

    received: int
    accepted: int
    duplicates: int
    refused: list[InputRefusalAnswer]


class ReferenceAnswer(members_of(AttitudeReference, flat=("attitude_deg",)), Answer):
    """A stored reference."""


class CorrectionAnswer(members_of(Correction, flat=("change_deg",), number=float), Answer):
    """A stored correction."""


class TelemetryAnswer(members_of(TelemetryRecord, number=float), Answer):
    """A stored telemetry record."""


class WeatherAnswer(members_of(WeatherReport), Answer):
    """A stored weather report."""


class PolarizationAnswer(members_of(PolarizationRecord), Answer):
    """A stored polarisation record."""


class ReferencePage(RowPage[ReferenceAnswer]):
    """References in order of epoch."""


class CorrectionPage(RowPage[CorrectionAnswer]):
    """Corrections in order of start."""


class TelemetryPage(RowPage[TelemetryAnswer]):
    """Telemetry in order of epoch."""


class WeatherPage(RowPage[WeatherAnswer]):
    """Weather reports in order of epoch."""


class PolarizationPage(RowPage[PolarizationAnswer]):
    """Polarisation records in order of epoch."""


OperationKind = Literal[
    "station_keeping",
    "momentum_unloading",
    "eclipse",
    "sun_outage",
    "carrier_work",
    "gain_change",
    "receive_chain_work",
    "calibration_turn",
    "other",
]
#: kinds that turn the spacecraft or blind the station: they stop control unless it is said otherwise
INHIBITING_KINDS = frozenset({"station_keeping", "momentum_unloading", "receive_chain_work", "calibration_turn"})
Names = Annotated[tuple[Name, ...], Field(min_length=1, max_length=512)]


class OperationDocument(Document):
    """A declared operation."""

    kind: OperationKind
    start: Epoch
    stop: Epoch | None = None
    """null = open until it is changed."""
    carriers: Names | None = None
    """Carriers that it touches; null = all or none in particular."""
    transponders: Names | None = None
    inhibit_control: bool | None = None
    """null = true for station_keeping, momentum_unloading, receive_chain_work and calibration_turn, else false."""
    attitude_uncertainty_deg: AnglesDocument | None = None
    comment: CommentText = ""

    @model_validator(mode="after")
    def _check_interval(self) -> Self:
        """Refuse an interval that ends before it starts."""
        if self.stop is not None and self.start >= self.stop:
            raise PydanticCustomError("range.invalid", "start must lie before stop")
        return self

    @model_validator(mode="after")
    def _check_uncertainty(self) -> Self:
        """Refuse negative uncertainties."""
        angles = self.attitude_uncertainty_deg or AnglesDocument()
        if any(value is not None and not 0 <= value <= 180 for value in (angles.yaw, angles.roll, angles.pitch)):
            raise PydanticCustomError("value.range", "attitude_uncertainty_deg must lie in 0..180")
        return self

    def to_record(self, operation_id: int) -> Operation:
        """Return the record that this document states."""
        does_inhibit = self.kind in INHIBITING_KINDS if self.inhibit_control is None else self.inhibit_control
        return record_of(Operation, self, id=operation_id, inhibit_control=does_inhibit)


class OperationAnswer(members_of(Operation, first=("id", "revision")), Answer):
    """A stored operation."""


class OperationPage(RowPage[OperationAnswer]):
    """Operations that overlap the range, in order of start."""
