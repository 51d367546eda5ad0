"""Documents of the spacecraft catalogue, with the checks that physics allows."""

from dataclasses import asdict
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PlainSerializer, StringConstraints, TypeAdapter, model_validator
from pydantic_core import PydanticCustomError

from service.api.schemas.base import CatalogueWarning, Document, Epoch, LatitudeDeg, LongitudeDeg, Name, Text
from service.api.schemas.inputs import MIN_FEED_DEG
from service.api.schemas.live_method import LiveMethod
from service.core.control.quaternion_law import loop_gains
from service.pipeline.config import TorqueConfig
from service.pipeline.control.command.control_design import gyro_design
from service.records.catalogue import (
    ControlLaw,
    ControlMode,
    Matrix3,
    Method,
    Release,
    Spacecraft,
    WheelSet,
)
from service.records.epoch import format_epoch

Vector3 = tuple[float, float, float]
Positive = Annotated[float, Field(gt=0, le=1e6)]
#: allowed difference of mirrored tensor elements, and excess of a principal moment over the sum of the others
_RELATIVE_TOLERANCE = 1e-9
#: least singular value of the wheel axes: below it one direction would need more than twenty times the torque
_MIN_SPAN = 0.05


def _check_inertia(inertia_kg_m2: Matrix3) -> Matrix3:
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
_RECORDS = TypeAdapter(Spacecraft)


class SiteDocument(Document):
    """The receiving site."""

    name: Text = ""
    latitude_deg: LatitudeDeg
    longitude_deg: LongitudeDeg
    height_m: Annotated[float, Field(ge=-500, le=9000)] = 0.0


class WheelsDocument(Document):
    """Reaction wheels; one wheel an axis by default."""

    axes: Annotated[tuple[WheelAxis, ...], Field(min_length=3, max_length=16), AfterValidator(_unit_axes)] = (
        WheelSet().axes
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

    method: LiveMethod = Method.ROBUST
    mode: ControlMode = ControlMode.GROUND
    release: Release = Release.TWO_STEP
    period_s: Annotated[float, Field(ge=60, le=1e6)] = 7200.0
    damping: Annotated[float, Field(gt=0, le=5)] = 0.9
    command_period_s: Annotated[float, Field(ge=60, le=7200)] = 900.0
    """Time between commands under release `two_step`; under `automatic` it is the time between rows."""
    forecast_horizon_s: Annotated[float, Field(ge=60, le=7200)] = 3600.0
    """How far the pulses against a known torque of a released command reach at most; the envelope may shorten it."""
    law: ControlLaw = ControlLaw.PROPORTIONAL_DERIVATIVE
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
    def of(cls, spacecraft: Spacecraft) -> Self:
        """Return the document of a record."""
        values = asdict(spacecraft)
        for torque in _torques(values):
            torque["epoch"] = format_epoch(torque.pop("epoch_us"))
        return cls.model_validate(values, strict=False)

    def to_record(self) -> Spacecraft:
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
        if self.control.law is not ControlLaw.GYRO_ORBITANT and self.control.gyro_orbitant is None:
            return None
        try:
            gyro_design(self.to_record(), TorqueConfig())
        except ValueError as error:
            return str(error)
        return None

    @property
    def is_released_unattended(self) -> bool:
        """Return whether torques go to a real spacecraft without a person."""
        return self.control.release is Release.AUTOMATIC and not self.simulated

    @property
    def lacks_fast_loop(self) -> bool:
        """Return whether ground control is requested of a spacecraft that would drift between two commands."""
        can_follow = self.onboard.fast_loop and self.onboard.forecast_mode
        return self.control.mode is ControlMode.GROUND and not can_follow


class SpacecraftAnswer(SpacecraftDocument):
    """A spacecraft that was stored, with all defaults filled in."""

    warnings: tuple[CatalogueWarning, ...]
    """The receiving site has the satellite below 5 deg elevation."""


SPACECRAFT_ADAPTER = TypeAdapter(SpacecraftDocument)
