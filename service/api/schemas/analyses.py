"""Analyses: parameters of pure computations and what they give. Angles of the flexible spacecraft are in radians."""

import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field
from pydantic_core import PydanticCustomError

from service.api.schemas.base import OF_ARRAY, Answer, Document, Figure, members_of
from service.api.schemas.catalogue import InertiaTensor
from service.core.dynamics.orbital_frame_analysis import (
    LONGEST_S,
    BeyondOrbitalRate,
    ClosedLoop,
    SettlingRequest,
    Start,
)
from service.core.dynamics.orbital_frame_model import (
    AS_PRINTED,
    DOWN,
    MAX_GAINS,
    NEAREST,
    NOMINAL_INERTIA,
    ORBITAL_RATE_RAD_S,
    TILT_FIRST,
    TO_ZERO,
    YAW_FIRST,
    AxisWheels,
    Computer,
    Inertia,
    Law,
    OrbitalFrameGains,
    OrbitalFrameSpacecraft,
    RateSensor,
    Tones,
    Triple,
    VerticalSensor,
)
from service.core.flexible.capture import CaptureAnalysis, StableBand
from service.core.flexible.limit_cycle import LimitCycleAnalysis, SinglePulseForms
from service.core.flexible.schedule import ScheduleCheck, Suggestion
from service.records.catalogue import Matrix3

#: keeps every sum and product of the analyses inside a double
_LARGEST = 1e9
Quantity = Annotated[float, Field(ge=-_LARGEST, le=_LARGEST)]


def _finite_or_none(value: Any) -> Any:
    """Return None for what is not finite: there is none, or it is unbounded."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


Finding = Annotated[float | None, BeforeValidator(_finite_or_none)]


class LimitCycleDocument(Document):
    """One axis with a wheel and a position relay of pulses."""

    inertia_kg_m2: Quantity
    motor_torque_n_m: Quantity
    dry_friction_n_m: Quantity
    viscous_loss_n_m: Quantity = 0.0
    """At the momentum limit."""
    momentum_limit_n_m_s: Quantity = 20.0
    momentum_n_m_s: Quantity
    """Of the rotor while the body is at rest."""
    alpha_rad: Quantity
    """Line of release."""
    beta_rad: Quantity
    """First line of switching on."""
    pulse_s: Quantity
    pulse_count: Annotated[int, Field(ge=1, le=64)] = 1
    line_step_rad: Quantity = 0.0
    external_torque_n_m: Quantity = 0.0
    start_speed_rad_s: Quantity | None = None
    """First arrival of the ladder; default: near half the speed of a pulse."""
    returns: Annotated[int, Field(ge=1, le=500)] = 50
    map_points: Annotated[int, Field(ge=2, le=1000)] = 200


class LimitCycleFoundAnswer(Answer):
    """One periodic motion."""

    speed_rad_s: float
    """At the first line."""
    period_s: float
    inner_rad: float
    outer_rad: float
    rate_rad_s: float
    pulses: int
    multiplier: Finding
    is_stable: bool
    momentum_n_m_s: tuple[float, float]
    """Least and greatest."""
    is_momentum_consistent: bool
    """False: the rotor would stop or saturate, and the figures do not belong to this drive."""


class CycleOverBothLinesAnswer(Answer):
    """One periodic motion that visits both lines, equation (24)."""

    speed_rad_s: float
    """At the first line of the side to which friction turns the body, coming from the other side."""
    period_s: float
    pulses: tuple[int, int]
    """On that side, on the other side."""
    outer_rad: float
    rate_rad_s: float
    multiplier: Finding
    is_stable: bool


class SinglePulseAnswer(members_of(SinglePulseForms, number=Finding), Answer):
    """Closed forms of the cycle of one pulse."""


class LimitCycleAnswer(Answer):
    """Cycles, closed forms, succession function and ladder of one axis."""

    cycles: list[LimitCycleFoundAnswer]
    """On one side."""
    cycles_over_both_lines: list[CycleOverBothLinesAnswer]
    reason: str
    """For which `cycles` is empty; empty where it is not."""
    forms: SinglePulseAnswer
    passive_rad_s2: float
    pulse_rad_s2: float
    speeds_rad_s: Annotated[list[float], OF_ARRAY]
    next_speeds_rad_s: Annotated[list[Finding], OF_ARRAY]
    ladder_rad_s: Annotated[list[tuple[float, float]], OF_ARRAY]
    """Corners of the Koenigs-Lamerey diagram from the chosen start."""

    @classmethod
    def of(cls, found: LimitCycleAnalysis) -> Self:
        """Return the answer for an analysis."""
        over_both = [
            {**cycle.motion._asdict(), "multiplier": cycle.multiplier, "is_stable": cycle.is_stable}
            for cycle in found.cycles_over_both_lines
        ]
        return super().of(found, cycles_over_both_lines=over_both)


class CaptureDocument(Document):
    """One switching of a regulator while a flexible mode swings."""

    omega_rad_s: Quantity
    damping_ratio: Quantity
    """Below 1; 0: as in the derivation of the boundary."""
    coupling: Quantity
    inertia_kg_m2: Quantity
    motor_torque_n_m: Quantity
    friction_torque_n_m: Quantity = 0.0
    alpha_rad: Quantity
    beta_rad: Quantity
    pulse_s: Quantity | None = None
    """Length of a pulse; null: a relay."""
    rate_rad_s: Quantity = 0.0
    amplitude_rad: Quantity = 0.0
    """Swing of the mode at the hub before the switching."""
    is_friction_outward: bool = True


class StableBandAnswer(members_of(StableBand, number=Finding), Answer):
    """Frequencies of the mode without capture; both null: none, upper null: unbounded."""


class CaptureAnswer(
    members_of(
        CaptureAnalysis,
        number=Finding,
        types={"band": StableBandAnswer},
        descriptions={
            "verdict": "captured, free, or always: any switching is captured.",
            "p_inf_rad": "Null: unbounded, a relay on a mode without damping.",
            "perpetual_capture": "none, irregular or possible.",
        },
    ),
    Answer,
):
    """Limit of capture and the verdict on the oscillation."""


class PulseDocument(Document):
    """Torque on the body, constant for a while."""

    start_s: Quantity
    duration_s: Quantity
    torque_n_m: Quantity


class HubModeDocument(Document):
    """One flexible mode that the axis feels."""

    omega_rad_s: Quantity
    damping_ratio: Quantity
    coupling: Quantity


class PhasorDocument(Document):
    """Swing of a mode at time zero, rad: real and imaginary part."""

    re: Quantity
    im: Quantity


class ScheduleDocument(Document):
    """A torque schedule of one axis, and what it meets."""

    pulses: Annotated[list[PulseDocument], Field(min_length=1, max_length=500)]
    inertia_kg_m2: Quantity
    modes: Annotated[list[HubModeDocument], Field(min_length=1, max_length=16)]
    peak_allowed_rad: Quantity
    alpha_rad: Quantity | None = None
    beta_rad: Quantity | None = None
    pulse_s: Quantity | None = None
    """Length of a pulse of the regulator on board; null: a relay."""
    motor_torque_n_m: Quantity | None = None
    friction_torque_n_m: Quantity = 0.0
    rate_rad_s: Quantity = 0.0
    momentum_n_m_s: Quantity = 0.0
    momentum_limit_n_m_s: Quantity | None = None
    carried: Annotated[list[PhasorDocument], Field(max_length=16)] | None = None
    """Swing that the schedule before left, one a mode; null: at rest."""


class PhasorAnswer(Answer):
    """Swing of a mode, rad: real and imaginary part."""

    re: float
    im: float


class SuggestionAnswer(
    members_of(Suggestion, number=float, descriptions={"kind": "split, width, interval or wait."}), Answer
):
    """One change of the schedule and what it would give."""


class ScheduleAnswer(Answer):
    """Verdict on a torque schedule."""

    verdict: str
    """accept, warn or reject."""
    reasons: list[str]
    peak_rad: float
    """Worst over +-15 % of each frequency, summed over the modes."""
    residual_rad: float
    swing_rad: float
    p_cr_rad: Finding
    margin_rad: Finding
    p_inf_rad: Finding
    worst_mode: int
    worst_omega_rad_s: float
    momentum_n_m_s: tuple[float, float]
    suggestions: list[SuggestionAnswer]
    nominal_peak_rad: list[float]
    phasors: list[PhasorAnswer]
    """At `end_s`, to be carried to the next schedule."""
    end_s: float

    @classmethod
    def of(cls, found: ScheduleCheck) -> Self:
        """Return the answer for a check."""
        return super().of(found, phasors=[{"re": phasor.real, "im": phasor.imag} for phasor in found.phasor_rad])


_PRODUCTS = {"tilt_first": TILT_FIRST, "as_printed": AS_PRINTED, "yaw_first": YAW_FIRST}
_ROUNDINGS = {"nearest": NEAREST, "to_zero": TO_ZERO, "down": DOWN}
#: bounds keep every step inside a double; none of them lies near a real spacecraft
Gain = Annotated[float, Field(ge=0, le=1e6)]
Size = Annotated[float, Field(gt=0, le=1e6)]
NotNegative = Annotated[float, Field(ge=0, le=1e6)]
Small = Annotated[float, Field(ge=-1, le=1)]
Frequency = Annotated[float, Field(gt=0, le=4)]


class AxesDocument(Document):
    """One value an axis."""

    roll: Small = 0.0
    pitch: Small = 0.0
    yaw: Small = 0.0

    def to_triple(self) -> Triple:
        """Return roll, pitch, yaw."""
        return (self.roll, self.pitch, self.yaw)


class GainsDocument(Document):
    """Gains of the law: N m a unit of half-angle, and N m s."""

    roll_stiffness_n_m: Gain = MAX_GAINS.roll_stiffness
    roll_damping_n_m_s: Gain = MAX_GAINS.roll_damping
    pitch_stiffness_n_m: Gain = MAX_GAINS.pitch_stiffness
    pitch_damping_n_m_s: Gain = MAX_GAINS.pitch_damping
    yaw_stiffness_n_m: Gain = MAX_GAINS.yaw_stiffness
    yaw_damping_n_m_s: Gain = MAX_GAINS.yaw_damping

    def to_gains(self) -> OrbitalFrameGains:
        """Return the gains of the law."""
        return OrbitalFrameGains(*self.model_dump().values())


class LawDocument(Document):
    """The gyro-orbitant law: tilt is measured, yaw comes from the roll rate."""

    gains: GainsDocument = GainsDocument()
    orbital_rate_rad_s: Annotated[float, Field(ge=1e-5, le=2e-3)] = ORBITAL_RATE_RAD_S
    slope: Annotated[float, Field(gt=0, le=1)] = 1.0 / math.sqrt(2.0)
    """Share of roll rate over orbital rate in the yaw quaternion."""
    product: Literal["tilt_first", "as_printed", "yaw_first"] = "tilt_first"
    """Which product of tilt and yaw the law takes."""
    beyond_orbital_rate: Literal["refuse", "second_branch", "as_printed"] = "refuse"
    """Behaviour where the roll rate exceeds the orbital rate: nothing is clipped."""

    def to_law(self) -> Law:
        """Return the law."""
        return Law(self.gains.to_gains(), self.orbital_rate_rad_s, self.slope, _PRODUCTS[self.product])


class ComputerDocument(Document):
    """On-board computer: samples, computes, rounds, holds."""

    is_continuous: bool = False
    """True: no period and no quantum; sensors and wheels must be ideal."""
    period_s: Annotated[float, Field(ge=0.01, le=10)] = Computer().period_s
    torque_limit_n_m: Annotated[float, Field(gt=0, le=100)] = Computer().torque_limit_n_m
    torque_quantum_n_m: Annotated[float, Field(gt=0, le=100)] = Computer().torque_quantum_n_m
    rounding: Literal["nearest", "to_zero", "down"] = "nearest"
    yaw_rate_correction_rad_s: Small = 0.0

    def to_computer(self) -> Computer:
        """Return the computer."""
        return Computer(
            not self.is_continuous,
            self.period_s,
            self.torque_limit_n_m,
            self.torque_quantum_n_m,
            _ROUNDINGS[self.rounding],
            self.yaw_rate_correction_rad_s,
        )


class VerticalSensorDocument(Document):
    """Sensor of the local vertical: roll and pitch."""

    limit_rad: Size = VerticalSensor().limit_rad
    lag_s: Size = VerticalSensor().lag_s
    quantum_rad: Size = VerticalSensor().quantum_rad
    noise_rad: NotNegative = VerticalSensor().noise_rad
    noise_time_s: Size = VerticalSensor().noise_time_s
    roll_bias_rad: Small = 0.0
    pitch_bias_rad: Small = 0.0


class RateSensorDocument(Document):
    """Sensors of the three rates."""

    limit_rad_s: Size = RateSensor().limit_rad_s
    quantum_rad_s: Size = RateSensor().quantum_rad_s
    null_rad_s: AxesDocument = AxesDocument(roll=RateSensor().null_rad_s[0])
    noise_rad_s: NotNegative = RateSensor().noise_rad_s
    delay_periods: Annotated[int, Field(ge=0, le=1)] = 1

    def to_sensor(self) -> RateSensor:
        """Return the sensor."""
        return RateSensor(**{**self.model_dump(), "null_rad_s": self.null_rad_s.to_triple()})


class FlownWheelsDocument(Document):
    """One reaction wheel an axis."""

    slope: Annotated[float, Field(gt=0, le=10)] = AxisWheels().slope
    """Torque given over torque commanded, at rest."""
    no_load_rad_s: Size = AxisWheels().no_load_rad_s
    inertia_kg_m2: Annotated[float, Field(ge=1e-4, le=1e3)] = AxisWheels().inertia_kg_m2
    momentum_limit_n_m_s: Size = AxisWheels().momentum_limit_n_m_s
    dry_friction_n_m: NotNegative = AxisWheels().dry_friction_n_m
    viscous_friction_n_m_s: Annotated[float, Field(ge=0, le=1e-2)] = AxisWheels().viscous_friction_n_m_s
    cogging_n_m: NotNegative = AxisWheels().cogging_n_m
    cogging_periods: Annotated[float, Field(ge=0, le=1000)] = AxisWheels().cogging_periods


class TonesDocument(Document):
    """Three flexible tones of roll and three of yaw, which the sensors see."""

    roll_hz: tuple[Frequency, Frequency, Frequency] = Tones().roll_hz
    yaw_hz: tuple[Frequency, Frequency, Frequency] = Tones().yaw_hz
    damping_ratio: Annotated[float, Field(gt=0, lt=1)] = Tones().damping_ratio
    gains: tuple[Gain, Gain, Gain] = Tones().gains


class FlightStartDocument(Document):
    """Attitude and rate at the start."""

    roll_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    pitch_deg: Annotated[float, Field(gt=-90, lt=90)] = 0.0
    yaw_deg: Annotated[float, Field(ge=-180, le=180)] = 0.0
    is_literal: bool = True
    """The orbital rate along the body's own y, as the paper has it; false: turned with the attitude."""
    rate_rad_s: AxesDocument | None = None
    """Inertial rate of the body in place of the orbital one."""

    def to_start(self) -> Start:
        """Return the start."""
        rate = None if self.rate_rad_s is None else self.rate_rad_s.to_triple()
        return Start(self.roll_deg, self.pitch_deg, self.yaw_deg, self.is_literal, rate)


def _bounded(tensor: Matrix3) -> Matrix3:
    """Refuse moments of inertia far from those of spacecraft, which would leave the numbers."""
    if not all(1.0 <= tensor[k][k] <= 1e8 for k in range(3)):
        raise PydanticCustomError("value.range", "moments of inertia of a flight lie between 1 and 1e8 kg m2")
    return tensor


_J = NOMINAL_INERTIA
_NOMINAL_TENSOR = ((_J.xx, _J.xy, _J.xz), (_J.xy, _J.yy, _J.yz), (_J.xz, _J.yz, _J.zz))


class ClosedLoopDocument(Document):
    """A spacecraft in a circular orbit, its control, and how it starts."""

    inertia_kg_m2: Annotated[InertiaTensor, AfterValidator(_bounded)] = _NOMINAL_TENSOR
    """Tensor elements; x roll, y pitch, z yaw of the model."""
    law: LawDocument = LawDocument()
    computer: ComputerDocument = ComputerDocument()
    vertical_sensor: VerticalSensorDocument | None = VerticalSensorDocument()
    """Null: shows the truth."""
    rate_sensor: RateSensorDocument | None = RateSensorDocument()
    """Null: shows the truth."""
    wheels: FlownWheelsDocument | None = FlownWheelsDocument()
    """Null: the wheels give the commanded torque."""
    tones: TonesDocument | None = TonesDocument()
    """Null: a rigid spacecraft."""
    has_gravity_torque: bool = True
    steps: Annotated[int, Field(ge=1, le=16)] = 1
    """Runge-Kutta steps a period of the computer."""
    start: FlightStartDocument = FlightStartDocument()
    duration_s: Annotated[float, Field(gt=0, le=LONGEST_S)] = 15_000.0
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = 1
    """Of the sensors' noise; the same seed gives the same flight."""
    settled_after_s: Annotated[float, Field(ge=0, le=LONGEST_S)] = 1500.0
    """From then on figures of the settled loop count."""
    bound_deg: Annotated[float, Field(gt=0, le=90)] = 0.1
    """Within it an axis counts as settled."""
    points: Annotated[int, Field(ge=2, le=5000)] = 1000
    """Rows of the time series at most; figures are those of every period."""

    def to_request(self) -> SettlingRequest:
        """Return the settling request."""
        return SettlingRequest(
            self._spacecraft(),
            self.start.to_start(),
            self.duration_s,
            self.seed,
            BeyondOrbitalRate(self.law.beyond_orbital_rate),
            self.settled_after_s,
            self.bound_deg,
        )

    def _spacecraft(self) -> OrbitalFrameSpacecraft:
        t = self.inertia_kg_m2
        sensor, rates, wheels, tones = self.vertical_sensor, self.rate_sensor, self.wheels, self.tones
        return OrbitalFrameSpacecraft(
            inertia=Inertia(t[0][0], t[1][1], t[2][2], t[0][1], t[0][2], t[1][2]),
            law=self.law.to_law(),
            computer=self.computer.to_computer(),
            vertical_sensor=VerticalSensor(False) if sensor is None else VerticalSensor(**sensor.model_dump()),
            rate_sensor=RateSensor(False) if rates is None else rates.to_sensor(),
            wheels=AxisWheels(False) if wheels is None else AxisWheels(**wheels.model_dump()),
            tones=Tones(False) if tones is None else Tones(**tones.model_dump()),
            has_gravity_torque=self.has_gravity_torque,
            steps=self.steps,
        )


def _by_axis(values: Any) -> Any:
    """Return figures or columns in the order roll, pitch, yaw by name."""
    named = zip(("roll", "pitch", "yaw"), values.T.tolist() if isinstance(values, np.ndarray) else values, strict=True)
    return dict(named)


class AxisFiguresAnswer(Answer):
    """One figure an axis; null: the flight is too short for it."""

    roll: Figure
    pitch: Figure
    yaw: Figure


class AxisSeriesAnswer(Answer):
    """One column an axis."""

    roll: list[float]
    pitch: list[float]
    yaw: list[float]


AxisFigures = Annotated[AxisFiguresAnswer, BeforeValidator(_by_axis)]
AxisSeries = Annotated[AxisSeriesAnswer, BeforeValidator(_by_axis)]
Column = Annotated[list[float], OF_ARRAY]


class MeritAnswer(Answer):
    """Figures of merit, from every period of the computer."""

    peak_deg: AxisFigures
    settled_peak_deg: AxisFigures
    settled_rms_deg: AxisFigures
    time_within_bound_s: AxisFigures
    """From when on the angle stays within `bound_deg`; null: not at the end."""
    mean_yaw_deg: Figure
    """Over the last two whole orbits, or the last one."""
    harmonic_deg: AxisFigures
    """Amplitude at the orbital frequency over the last orbit."""
    largest_torque_n_m: AxisFigures
    saturated_share: AxisFigures
    """Of the flight during which the torque is at its limit."""
    largest_momentum_n_m_s: AxisFigures
    largest_rate_ratio: float
    """Measured roll rate over orbital rate."""


class FlightWarningAnswer(Answer):
    """Something to beware of."""

    code: str
    detail: str


class FlightSeriesAnswer(Answer):
    """Record of the flight, thinned."""

    time_s: Column
    roll_deg: Column
    pitch_deg: Column
    yaw_deg: Column
    torque_n_m: AxisSeries
    """Of the wheels on the body."""
    momentum_n_m_s: AxisSeries
    """Of the wheels."""
    rate_ratio: Column


class ClosedLoopAnswer(Answer):
    """Result of a simulated flight; axes of the model."""

    job: str
    merit: MeritAnswer
    warnings: list[FlightWarningAnswer]
    series: FlightSeriesAnswer

    @classmethod
    def of(cls, job_id: str, found: ClosedLoop) -> Self:
        """Return the answer for a flight."""
        warnings = [{"code": code, "detail": detail} for code, detail in found.warnings]
        return super().of(found, job=job_id, warnings=warnings, series=found.flight)


class ClosedLoopStartedAnswer(Answer):
    """A flight that was queued."""

    job: str
    result: str
    """Path of the result, once the job is done."""
