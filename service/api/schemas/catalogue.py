"""Documents of the catalogue: spacecraft, carrier plans, ephemerides."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from hashlib import sha256
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, PlainSerializer, StringConstraints, TypeAdapter, model_validator
from pydantic.config import JsonDict
from pydantic_core import PydanticCustomError

from service.api.schemas.base import (
    Answer,
    CatalogueWarning,
    Document,
    Epoch,
    LatitudeDeg,
    LiveMethod,
    LongitudeDeg,
    Name,
    Text,
    WindowAnswer,
    members_of,
)
from service.api.schemas.inputs import MIN_FEED_DEG
from service.core.control.quaternion_law import loop_gains
from service.formats.ephemeris import MAX_PERIOD_S, MAX_POINTS, MIN_PERIOD_S, ephemeris_from_nodes, read_oem, read_tle
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.control_design import gyro_design
from service.records import catalogue as records
from service.records.calibration import Window
from service.records.epoch import format_epoch

MAX_CARRIERS = 512
#: fields of the document are those of the record
_CARRIER = TypeAdapter(records.Carrier)
FrequencyHz = Annotated[float, Field(gt=0, le=1e12)]


class StationDocument(Document):
    """Earth station that radiates a carrier."""

    name: Text = ""
    latitude_deg: LatitudeDeg
    longitude_deg: LongitudeDeg


class CarrierDocument(Document):
    """One signal of one earth station through one transponder."""

    id: Name
    name: Text = ""
    station: StationDocument | None = None
    """null only for a beacon."""
    band: Name
    transponder: Name
    polarization: Text | None = None
    uplink_hz: FrequencyHz | None = None
    """null only for a beacon."""
    downlink_hz: FrequencyHz
    intermediate_hz: FrequencyHz | None = None
    bandwidth_hz: FrequencyHz
    kind: Literal["traffic", "beacon", "pilot"] = "traffic"
    uplink_power_control: Literal["none", "auto", "unknown"] = "unknown"
    """A carrier with auto is never used for attitude: its station would compensate what is measured."""
    transponder_mode: Literal["fixed_gain", "alc", "unknown"] = "unknown"
    enabled: bool = True

    @model_validator(mode="after")
    def _check_uplink(self) -> Self:
        """Refuse a carrier without an uplink station."""
        if self.kind != "beacon" and self.station is None:
            raise PydanticCustomError("carrier.station_missing", "a carrier that is no beacon needs its station")
        if self.kind != "beacon" and self.uplink_hz is None:
            raise PydanticCustomError("carrier.uplink_missing", "a carrier that is no beacon needs its uplink_hz")
        return self

    def to_record(self) -> records.Carrier:
        """Return the record that this document states."""
        return _CARRIER.validate_python(self.model_dump())


def _check_ids(carriers: tuple[CarrierDocument, ...]) -> None:
    """Refuse a plan in which two carriers have one id."""
    seen: set[str] = set()
    for carrier in carriers:
        if carrier.id in seen:
            message = "two carriers have the id {id}; ids are unique within a plan"
            raise PydanticCustomError("carrier.duplicate", message, {"id": carrier.id})
        seen.add(carrier.id)


class CarrierPlanDocument(Document):
    """The carriers of a plan; their order is the order of the powers of a measurement."""

    carriers: Annotated[tuple[CarrierDocument, ...], Field(min_length=1, max_length=MAX_CARRIERS)]

    @model_validator(mode="after")
    def _check(self) -> Self:
        """Refuse repeated ids."""
        _check_ids(self.carriers)
        return self

    def to_records(self) -> tuple[records.Carrier, ...]:
        """Return the records that this document states."""
        return tuple(carrier.to_record() for carrier in self.carriers)


CARRIER_PLAN_ADAPTER = TypeAdapter(CarrierPlanDocument)


class PlanReceiptAnswer(Answer):
    """A stored plan."""

    plan_id: int
    sha256: str
    carriers: int
    warnings: list[CatalogueWarning]
    """Stations that have the satellite below 5 deg elevation."""


class CarrierPlanAnswer(Answer):
    """A plan with its carriers."""

    plan_id: int
    sha256: str
    carriers: list[CarrierDocument]

    @classmethod
    def of(cls, plan: records.CarrierPlan) -> Self:
        """Return the answer for a plan."""
        carriers = [CarrierDocument.model_validate(asdict(carrier), strict=False) for carrier in plan.carriers]
        return cls(plan_id=plan.id, sha256=plan.sha256, carriers=carriers)


def content_digest(carriers: Sequence[records.Carrier]) -> str:
    """Return the SHA-256 of a plan's canonical content: every field, sorted keys, no white space, UTF-8.

    Parameters
    ----------
    carriers : sequence of Carrier
        In the order of the plan; another order is another plan.
    """
    content = [asdict(carrier) for carrier in carriers]
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return sha256(text.encode()).hexdigest()


_FORMS = ("ascending_nodes", "tle", "oem")
_ONE_FORM: JsonDict = {"oneOf": [{"required": [form]} for form in _FORMS]}


class TrackDocument(Document):
    """Predicted sub-satellite point; longitude absolute, latitude of the radius vector (geocentric)."""

    epochs: Annotated[tuple[Epoch, ...], Field(min_length=2, max_length=MAX_POINTS, fail_fast=True)]
    latitude_deg: Annotated[tuple[LatitudeDeg, ...], Field(max_length=MAX_POINTS, fail_fast=True)]
    longitude_deg: Annotated[tuple[LongitudeDeg, ...], Field(max_length=MAX_POINTS, fail_fast=True)]

    def to_record(self) -> records.Track:
        """Return the record that this document states."""
        return records.Track(self.epochs, self.latitude_deg, self.longitude_deg)


class EphemerisDocument(Document):
    """An orbit as node passages, as two-line elements or as a CCSDS OEM; exactly one of the three."""

    model_config = ConfigDict(json_schema_extra=_ONE_FORM)

    ascending_nodes: Annotated[tuple[Epoch, ...], Field(min_length=1, max_length=MAX_POINTS, fail_fast=True)] | None = (
        None
    )
    """Northward crossings of the equator, strictly ascending."""
    nodal_period_s: Annotated[float, Field(ge=MIN_PERIOD_S, le=MAX_PERIOD_S)] | None = None
    """Found from the nodes when left out."""
    track: TrackDocument | None = None
    """Without it the dish law is not available."""
    tle: tuple[Annotated[str, Field(max_length=100)], Annotated[str, Field(max_length=100)]] | None = None
    """Two-line elements."""
    oem: str | None = None
    """CCSDS Orbit Ephemeris Message, keyword = value notation."""
    relocating: bool = False
    """The spacecraft leaves its place: an orbit that contradicts the catalogue is stored. Stands in the audit log."""

    @model_validator(mode="after")
    def _check_form(self) -> Self:
        """Refuse anything but one form."""
        stated = [form for form in _FORMS if getattr(self, form) is not None]
        if len(stated) != 1:
            raise PydanticCustomError("ephemeris.form", "not exactly one of ascending_nodes, tle and oem is given")
        if self.ascending_nodes is None and (self.nodal_period_s is not None or self.track is not None):
            raise PydanticCustomError("ephemeris.form", "nodal_period_s and track belong to ascending_nodes only")
        return self

    def to_record(self) -> records.Ephemeris:
        """Return the ephemeris of whichever form was given; InvalidInputError where it cannot be read."""
        if self.tle is not None:
            return read_tle(self.tle)
        if self.oem is not None:
            return read_oem(self.oem)
        track = None if self.track is None else self.track.to_record()
        return ephemeris_from_nodes(self.ascending_nodes or (), self.nodal_period_s, track)


class TrackAnswer(members_of(records.Track, number=float), Answer):
    """Predicted sub-satellite point."""


_WITHOUT = ("id", "valid_start_us", "valid_stop_us", "track")


class EphemerisReceiptAnswer(members_of(records.Ephemeris, without=_WITHOUT, number=float), Answer):
    """Receipt of a stored ephemeris: ascending nodes, nodal period and validity."""

    ephemeris_id: int
    valid: WindowAnswer

    @classmethod
    def of(cls, ephemeris: records.Ephemeris) -> Self:
        """Return the answer for a record."""
        valid = Window(ephemeris.valid_start_us, ephemeris.valid_stop_us)
        return super().of(ephemeris, ephemeris_id=ephemeris.id, valid=valid)


class EphemerisAnswer(EphemerisReceiptAnswer):
    """A stored ephemeris with its track."""

    track: TrackAnswer | None


Vector3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, le=1e6)]
#: allowed difference of mirrored tensor elements, and excess of a principal moment over the sum of the others
_RELATIVE_TOLERANCE = 1e-9
#: least singular value of the wheel axes: below it one direction would need more than twenty times the torque
_MIN_SPAN = 0.05


def _check_inertia(inertia_kg_m2: records.Matrix3) -> records.Matrix3:
    """Refuse a tensor that no body can have."""
    tensor = np.array(inertia_kg_m2)
    scale = float(np.max(np.abs(tensor)))
    if np.any(np.abs(tensor - tensor.T) > _RELATIVE_TOLERANCE * scale):
        raise PydanticCustomError("inertia.not_symmetric", "the inertia tensor must be symmetric")
    moments = np.linalg.eigvalsh(tensor)
    if moments[0] <= _RELATIVE_TOLERANCE * scale:
        raise PydanticCustomError("inertia.not_positive", "the principal moments of inertia must be positive")
    if moments[2] > (moments[0] + moments[1]) * (1 + _RELATIVE_TOLERANCE):
        message = "no principal moment of inertia can exceed the sum of the other two"
        raise PydanticCustomError("inertia.triangle", message)
    return inertia_kg_m2


def _unit_axes(axes: tuple[Vector3, ...]) -> tuple[Vector3, ...]:
    """Return the wheel axes as unit vectors; refuse axes that leave a direction without torque."""
    array = np.array(axes)
    lengths = np.linalg.norm(array, axis=1)
    if np.any(lengths < 1e-6):
        raise PydanticCustomError("wheels.axis_zero", "a wheel axis must not be the zero vector")
    # vectors that are unit already stay as they were sent, to the last bit
    scales = np.where(np.abs(lengths - 1) <= _RELATIVE_TOLERANCE, 1.0, lengths)
    array = array / scales[:, None]
    if np.linalg.svd(array, compute_uv=False)[-1] < _MIN_SPAN:
        raise PydanticCustomError("wheels.axes_span", "the wheel axes must span all three directions")
    return tuple((float(x), float(y), float(z)) for x, y, z in array)


#: an instant that is told as it was stated
StoredEpoch = Annotated[Epoch, PlainSerializer(format_epoch, return_type=str, when_used="json")]
#: of the light of the Sun, of the air, of the magnetic field: none is greater
TorqueNm = Annotated[float, Field(ge=-1e-2, le=1e-2)]
#: bounds keep the checks from overflowing
InertiaElement = Annotated[float, Field(ge=-1e8, le=1e8)]
InertiaRow = tuple[InertiaElement, InertiaElement, InertiaElement]
#: elements of the tensor of a body that can be, kg m^2
InertiaTensor = Annotated[tuple[InertiaRow, InertiaRow, InertiaRow], AfterValidator(_check_inertia)]
AxisElement = Annotated[float, Field(ge=-1e3, le=1e3)]
WheelAxis = tuple[AxisElement, AxisElement, AxisElement]


#: fields of the documents are those of the records, but for the epoch of a torque that is fed forward
_RECORDS = TypeAdapter(records.Spacecraft)


class SiteDocument(Document):
    """The receiving site."""

    name: Text = ""
    latitude_deg: LatitudeDeg
    longitude_deg: LongitudeDeg
    height_m: Annotated[float, Field(ge=-500, le=9000)] = 0.0


class WheelsDocument(Document):
    """Reaction wheels; one wheel an axis by default."""

    axes: Annotated[tuple[WheelAxis, ...], Field(min_length=3, max_length=16), AfterValidator(_unit_axes)] = (
        records.WheelSet().axes
    )
    """Directions of the spin axes in body axes; made unit vectors."""
    torque_limit_n_m: Positive = 0.05
    momentum_limit_n_m_s: Positive = 20.0
    torque_quantum_n_m: Annotated[float, Field(ge=0)] = 0.002

    @model_validator(mode="after")
    def _check_quantum(self) -> Self:
        """Refuse a step that no torque within the limit can make."""
        if self.torque_quantum_n_m > self.torque_limit_n_m:
            raise PydanticCustomError("wheels.quantum", "torque_quantum_n_m must not exceed torque_limit_n_m")
        return self


class FlexibleModeDocument(Document):
    """One flexible mode, for the schedule check."""

    axis: Literal["roll", "pitch", "yaw"]
    omega_rad_s: Annotated[float, Field(gt=0, le=1e4)]
    damping_ratio: Annotated[float, Field(ge=0, lt=1)]
    coupling: Annotated[float, Field(ge=0, lt=1)]
    """Share of the mode in the inertia of its axis."""


class AxisTorquesDocument(Document):
    """A torque on the body about each axis, N m."""

    yaw: TorqueNm = 0.0
    roll: TorqueNm = 0.0
    pitch: TorqueNm = 0.0


class FedForwardDocument(Document):
    """Known torque that the loop on board takes away: constant + cosine cos(p) + sine sin(p), p zero at the epoch."""

    epoch: StoredEpoch
    """Where the phase of the wave is zero."""
    period_s: Annotated[float, Field(ge=3600, le=1e8)] = 86_400.0
    constant_n_m: AxisTorquesDocument = AxisTorquesDocument()
    cosine_n_m: AxisTorquesDocument = AxisTorquesDocument()
    sine_n_m: AxisTorquesDocument = AxisTorquesDocument()
    relative_error: Annotated[float, Field(ge=0, le=1)] = 0.06
    """One standard deviation of the share of the profile that all axes have wrong together."""
    axis_relative_error: Annotated[float, Field(ge=0, le=1)] = 0.01
    """One standard deviation of the share that each axis has wrong by itself."""


class WheelMomentumDocument(Document):
    """Telemetry of the momentum of the wheels as a measurement of attitude."""

    sigma_n_m_s: Annotated[float, Field(gt=0, le=10)] = 0.01
    """Noise of a record along an axis."""
    scale_error: Annotated[float, Field(ge=0, le=0.2)] = 0.005
    """One standard deviation of the scale, relative."""
    misalignment_deg: Annotated[float, Field(ge=0, le=5)] = 0.05
    """One standard deviation of the axes."""
    pitch_bias_n_m_s: Annotated[float, Field(ge=-1e4, le=1e4)] | None = None
    """Momentum along pitch that unloadings restore. A calibration refuses telemetry whose mean differs by more than a
    tenth; null: a unit or a sign that all axes share stays unproven."""
    used: bool = True
    """Use by the filter; false: the record is stored alone."""
    torque: FedForwardDocument | None = None
    """Torque from outside that gathers in the wheels and moves nothing else, with the error of its profile; null: that
    of `fed_forward_torque`, whose error also moves the body; neither stated: 2e-5 N m of unknown constant and wave.
    What the quiet days of a calibration tell takes the place of this profile and of an unknown one."""


class BodyRateSensorDocument(Document):
    """Rates of the body in telemetry as a measurement of its motion."""

    in_loop: bool
    """True: the loop on board closes on this sensor and holds its rates still, so that the filter does not use them."""
    bias_deg_h: Annotated[float, Field(gt=0, le=10)] | None = None
    """One standard deviation of the bias about an axis. The filter learns the bias."""
    bias_tau_h: Annotated[float, Field(ge=0.1, le=1e5)] | None = None
    """Correlation time of the bias."""
    noise_deg_sqrt_h: Annotated[float, Field(ge=0, le=1)] | None = None
    """Angle random walk, deg/sqrt(h)."""

    @model_validator(mode="after")
    def _check_figures(self) -> Self:
        """Refuse a sensor beside the loop of which not all is stated."""
        if not self.in_loop and None in (self.bias_deg_h, self.bias_tau_h, self.noise_deg_sqrt_h):
            raise PydanticCustomError(
                "onboard.rate_sensor_figures",
                "a rate sensor with in_loop false needs bias_deg_h, bias_tau_h and noise_deg_sqrt_h",
            )
        return self


class OnboardDocument(Document):
    """On-board control of the spacecraft: fast loop, forecast mode, roll-yaw coupling and known torques."""

    fast_loop: bool = False
    forecast_mode: bool = False
    roll_yaw_coupling: bool | None = None
    """Exchange of roll and yaw once a day because the on-board mode holds a fixed inertial rate; under `false` it
    turns with the orbit. Decides yaw: under `true` roll tells it; `null`: unknown, powers alone tell it."""
    residual_torque_n_m: Annotated[float, Field(ge=0, le=1e-3)] | None = None
    """Size of the disturbance torque an axis that is not fed forward on board, for the filter to learn; 0 = none.
    `null`: unknown, the filter begins with the prior `SOO_ROBUST__UNKNOWN_TORQUE_N_M`; yaw is known worse for it."""
    fed_forward_torque: FedForwardDocument | None = None
    """Torque profile fed forward on board, whose error the filter estimates; null = unknown."""
    momentum: WheelMomentumDocument | None = None
    """Momentum of the wheels as a measurement of yaw; null: the filter does not use it."""
    rate_sensor: BodyRateSensorDocument | None = None
    """Rates of the body, `body_rate_deg_s` in telemetry, as a measurement of its motion; null: not used."""

    @model_validator(mode="after")
    def _check_torque(self) -> Self:
        """Refuse two statements about one torque."""
        is_alone = self.residual_torque_n_m == 0.0 and self.fed_forward_torque is None
        if self.momentum is not None and self.momentum.torque is not None and not is_alone:
            raise PydanticCustomError(
                "onboard.momentum_torque",
                "momentum.torque needs residual_torque_n_m 0 and no fed_forward_torque",
            )
        return self


class GyroOrbitantDocument(Document):
    """Gains of the law `gyro_orbitant`: N m a unit of half-angle (half a radian), and N m s."""

    roll_stiffness_n_m: Positive
    roll_damping_n_m_s: Positive
    pitch_stiffness_n_m: Positive
    pitch_damping_n_m_s: Positive
    yaw_stiffness_n_m: Positive
    yaw_damping_n_m_s: Positive


class ControlDocument(Document):
    """Attitude control."""

    method: LiveMethod = records.Method.ROBUST
    mode: records.ControlMode = records.ControlMode.GROUND
    release: records.Release = records.Release.TWO_STEP
    period_s: Annotated[float, Field(ge=60, le=1e6)] = 7200.0
    damping: Annotated[float, Field(gt=0, le=5)] = 0.9
    command_period_s: Annotated[float, Field(ge=60, le=7200)] = 900.0
    """Time between commands under release `two_step`; under `automatic` it is the time between rows."""
    forecast_horizon_s: Annotated[float, Field(ge=60, le=7200)] = 3600.0
    """How far the pulses against a known torque of a released command reach at most; the envelope may shorten it."""
    law: records.ControlLaw = records.ControlLaw.PROPORTIONAL_DERIVATIVE
    """`gyro_orbitant`: yaw follows from the roll rate; needs inertial `body_rate_deg_s` in telemetry."""
    gyro_orbitant: GyroOrbitantDocument | None = None


class PolarimeterDocument(Document):
    """Polarimeter on the ground as a measurement of yaw: its feed, its place, what its angle has wrong."""

    source: Name
    """As its records name it."""
    feed_offset_deg: Annotated[float, Field(ge=-80, le=80)]
    """Turn of the two ports against the polarisation at zero attitude; the sign is that of a positive yaw. Not 0."""
    frequency_hz: Annotated[float, Field(ge=1e8, le=6e10)]
    """Of the beacon or carrier measured."""
    site: SiteDocument | None = None
    """Place of the polarimeter; null: the receiving site."""
    field_t: Annotated[float, Field(ge=-1e-4, le=1e-4)] = 0.0
    """Component of the Earth's magnetic field along the downlink, for the Faraday rotation of a reported electron
    content; 0: it is not corrected."""
    white_deg: Annotated[float, Field(gt=0, le=10)] = 0.07
    """One standard deviation of the white noise of a record that states none."""
    daily_deg: Annotated[float, Field(gt=0, le=10)] = 0.05
    """One standard deviation of the amplitude of the daily wave."""
    wander_deg: Annotated[float, Field(gt=0, le=10)] = 0.05
    """One standard deviation of the wander of some hours."""
    wander_h: Annotated[float, Field(ge=0.1, le=100)] = 4.0
    """Correlation time of the wander."""
    offset_walk_deg_sqrt_h: Annotated[float, Field(ge=0, le=1)] = 0.003
    """Walk of the offset in one hour."""
    used: bool = True
    """Use by the filter; false: the record is stored alone."""

    @model_validator(mode="after")
    def _check_feed(self) -> Self:
        """Refuse a feed whose ratio has no slope."""
        if abs(self.feed_offset_deg) < MIN_FEED_DEG:
            raise PydanticCustomError("polarimeter.feed_offset", "feed_offset_deg lies within 0.5 deg of 0")
        return self


def _check_sources(polarimeters: tuple[PolarimeterDocument, ...]) -> tuple[PolarimeterDocument, ...]:
    """Refuse two polarimeters of one name."""
    if len({each.source for each in polarimeters}) < len(polarimeters):
        raise PydanticCustomError("polarimeter.duplicate", "two polarimeters have one source")
    return polarimeters


def _torques(values: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the torque profiles that a spacecraft states."""
    onboard = values["onboard"]
    stated = onboard["fed_forward_torque"], (onboard["momentum"] or {}).get("torque")
    return [torque for torque in stated if torque is not None]


class SpacecraftDocument(Document):
    """A spacecraft."""

    id: Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9-]{0,63}$")]
    name: Annotated[Text, StringConstraints(min_length=1)]
    cospar_id: Annotated[str, StringConstraints(pattern=r"^\d{4}-\d{3}[A-Z]{1,3}$")] | None = None
    longitude_deg: LongitudeDeg
    """Degrees East of the nominal sub-satellite point."""
    simulated: bool = False
    """Lives under the data clock; never commanded by mistake for a real one."""
    receiving_site: SiteDocument
    inertia_kg_m2: Annotated[InertiaTensor, Field(description="Tensor elements; x roll, y pitch, z yaw")]
    torque_limit_n_m: Positive
    """Greatest torque on the body an axis."""
    wheels: WheelsDocument = WheelsDocument()
    modes: Annotated[tuple[FlexibleModeDocument, ...], Field(max_length=64)] = ()
    onboard: OnboardDocument = OnboardDocument()
    control: ControlDocument = ControlDocument()
    polarimeters: Annotated[tuple[PolarimeterDocument, ...], Field(max_length=8), AfterValidator(_check_sources)] = ()
    """Each measures yaw by polarisation; its records come by `polarization:batch`."""

    @classmethod
    def of(cls, spacecraft: records.Spacecraft) -> Self:
        """Return the document of a record."""
        values = asdict(spacecraft)
        for torque in _torques(values):
            torque["epoch"] = format_epoch(torque.pop("epoch_us"))
        return cls.model_validate(values, strict=False)

    def to_record(self) -> records.Spacecraft:
        """Return the record that this document states."""
        values = self.model_dump()
        for torque in _torques(values):
            torque["epoch_us"] = torque.pop("epoch")
        return _RECORDS.validate_python(values)

    @property
    def fault_of_gains(self) -> str | None:
        """Why period, damping, inertia and torque limit make no control law; None where they make one."""
        try:
            loop_gains(
                np.array(self.inertia_kg_m2),
                period_s=self.control.period_s,
                damping=self.control.damping,
                torque_limit_n_m=self.torque_limit_n_m,
                command_period_s=None,
            )
        except ValueError as error:
            return str(error)
        return None

    @property
    def fault_of_gyro_orbitant(self) -> str | None:
        """Why the gains of the law `gyro_orbitant` make no loop that settles; None where they do, or none is chosen."""
        if self.control.law is not records.ControlLaw.GYRO_ORBITANT and self.control.gyro_orbitant is None:
            return None
        try:
            gyro_design(self.to_record(), TorqueConfig())
        except ValueError as error:
            return str(error)
        return None

    @property
    def is_released_unattended(self) -> bool:
        """Return whether torques go to a real spacecraft without a person."""
        return self.control.release is records.Release.AUTOMATIC and not self.simulated

    @property
    def lacks_fast_loop(self) -> bool:
        """Return whether ground control is requested of a spacecraft that would drift between two commands."""
        can_follow = self.onboard.fast_loop and self.onboard.forecast_mode
        return self.control.mode is records.ControlMode.GROUND and not can_follow


class SpacecraftAnswer(SpacecraftDocument):
    """A spacecraft that was stored, with all defaults filled in."""

    warnings: tuple[CatalogueWarning, ...]
    """The receiving site has the satellite below 5 deg elevation."""


SPACECRAFT_ADAPTER = TypeAdapter(SpacecraftDocument)
