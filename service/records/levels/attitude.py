"""Levels L2 to L5: results of each carrier, attitude row, disturbance torque, torque command."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from service.records.catalogue import Method
from service.records.epoch import US_PER_S

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class Axes(NamedTuple):
    """One value for each axis, always by name; the unit stands in the name of the field that holds it."""

    yaw: float
    roll: float
    pitch: float


def named_axes(values: FloatArray) -> Axes:
    """Return an array (3,) in the order yaw, roll, pitch by name."""
    return Axes._make(values.tolist())


NO_ANGLES = Axes(math.nan, math.nan, math.nan)
#: permission for no axis; yaw, roll, pitch
NO_AXES = (False, False, False)


class Status(StrEnum):
    """Validity of a row, the four words of the mission-control world."""

    ACQUIRED = "ACQUIRED"
    NOT_RECEIVED = "NOT_RECEIVED"
    INVALID = "INVALID"
    EXPIRED = "EXPIRED"


class Exclusion(NamedTuple):
    """One carrier left out of a fix, and why."""

    carrier: str
    #: uplink_fade, step, absent, frozen, interference, group or manual
    reason: str


@dataclass(frozen=True, slots=True)
class AttitudeRow:
    """L4: attitude estimate of one method at one measurement.

    Tables, exports and answers derive from these fields (`service.records.record_fields`); a text beside a type is the
    description in the interface. A new field stands at the end; a method that does not compute it leaves
    its default (a number: ``math.nan``).
    """

    epoch_us: int
    received_at_us: int
    #: journal number of the measurement
    number: int
    method: Method
    attitude_deg: Axes
    sigma_deg: Annotated[Axes, "One standard deviation."]
    rates_deg_s: Annotated[Axes | None, "Null where the method knows no rate."]
    status: Status
    control_allowed: Annotated[
        bool,
        "Permission of this estimate for control, yaw apart; it does not change. For now read `control.allowed`.",
    ]
    #: yaw, roll, pitch
    control_allowed_axes: tuple[bool, bool, bool]
    inhibitions: tuple[str, ...]
    carriers_used: int
    excluded: tuple[Exclusion, ...]
    downlink_fade: bool
    downlink_fade_db: float
    common_db: float
    residual_rms_db: float
    calibration_id: int | None
    alignment_id: int | None
    advice: Annotated[tuple[str, ...], "Advice to the operator while control goes on, such as `realign`."] = ()
    protection_deg: Annotated[
        Axes, "Protection level: the error of the angle passes it with a probability of 1e-4 a row; null = not known."
    ] = NO_ANGLES
    lag_s: Annotated[
        float, "Smoothed rows: time from the row to the last one by which it was smoothed; null for other methods."
    ] = math.nan
    nominal_protection_deg: Annotated[Axes, "Protection level if nothing were wrong with any carrier."] = NO_ANGLES
    waiting_loss_deg: Annotated[
        Axes, "Loss by two hours without control: turn by the torque, or an angle that is certain, the greater one."
    ] = NO_ANGLES
    steering_deg: Annotated[
        Axes, "Angles that control steers by: of paper its fixes carried on by the dynamics; null: those of the row."
    ] = NO_ANGLES

    steering_sigma_deg: Annotated[Axes, "One standard deviation of these angles."] = NO_ANGLES

    @property
    def steered_deg(self) -> Axes:
        """Angles that control steers by, which are the row's own where no others are told."""
        return self.attitude_deg if any(map(math.isnan, self.steering_deg)) else self.steering_deg

    @property
    def steered_sigma_deg(self) -> Axes:
        """One standard deviation of the angles that control steers by."""
        return self.sigma_deg if any(map(math.isnan, self.steering_deg)) else self.steering_sigma_deg


def fit_angles_deg(row: AttitudeRow) -> Axes:
    """Return the angles of a row that a loop on board may use, NaN about a withheld axis."""
    angles = zip(row.steered_deg, row.control_allowed_axes, strict=True)
    return Axes(*(angle if is_allowed else math.nan for angle, is_allowed in angles))


def row_without_attitude(
    epoch_us: int, received_at_us: int, number: int, method: Method, inhibitions: tuple[str, ...]
) -> AttitudeRow:
    """Return the row of a measurement from which a method could compute nothing, and why."""
    return AttitudeRow(
        epoch_us=epoch_us,
        received_at_us=received_at_us,
        number=number,
        method=method,
        attitude_deg=NO_ANGLES,
        sigma_deg=NO_ANGLES,
        rates_deg_s=None,
        status=Status.INVALID,
        control_allowed=False,
        control_allowed_axes=NO_AXES,
        inhibitions=inhibitions,
        carriers_used=0,
        excluded=(),
        downlink_fade=False,
        downlink_fade_db=math.nan,
        common_db=math.nan,
        residual_rms_db=math.nan,
        calibration_id=None,
        alignment_id=None,
    )


@dataclass(frozen=True, slots=True)
class CarrierState:
    """State of one carrier in the chain after the newest measurement; NaN = not known."""

    carrier: str
    power_dbm: float
    expected_dbm: Annotated[float, "Reference power and daily harmonic."]
    deviation_db: Annotated[float, "Measured minus expected."]
    residual_db: Annotated[float, "Deviation minus what the attitude explains."]
    sigma_db: Annotated[float, "Scatter of one row, one sigma, in the model of the method that gives these values."]
    flags: int
    state: Annotated[str, "used, absent, excluded, unselected or uncalibrated."]
    hypothesis: Annotated[
        str | None,
        "State of the carrier by the references of the alignment: dry, wet, level_changed or level_learned.",
    ] = None
    hypothesis_probability: float = math.nan
    hypothesis_since_us: int | None = None


#: dB, in which levels are stored and published; half of it is the error of rounding
STEP_DB = 0.004
#: stored as their positions, so a new state or hypothesis stands at the end
CARRIER_STATES = ("used", "absent", "excluded", "unselected", "uncalibrated")
CARRIER_HYPOTHESES = (None, "dry", "wet", "level_changed", "level_learned")


@dataclass(frozen=True, slots=True, eq=False)
class CarrierResults:
    """Results of the N carriers of a plan at one row, in the order of the plan; arrays are (N,)."""

    plan_id: int
    #: dB, measured minus expected; NaN = absent or not used
    deviation_db: FloatArray
    #: dB, deviation minus what the attitude explains; NaN = not known
    residual_db: FloatArray
    #: positions in `CARRIER_STATES`
    state: IntArray
    #: positions in `CARRIER_HYPOTHESES`
    hypothesis: IntArray


@dataclass(frozen=True, slots=True)
class Pulse:
    """One element of a schedule; it ends by itself."""

    start_us: int
    duration_s: float
    #: N m on the body
    torque_n_m: Axes

    @property
    def stop_us(self) -> int:
        """When it ends."""
        return self.start_us + round(self.duration_s * US_PER_S)


@dataclass(frozen=True, slots=True)
class ScheduleVerdict:
    """Verdict of the flexible modes on a schedule, the worst of the axes."""

    #: accept or reject
    verdict: Annotated[str, "A rejected schedule is not released."]
    peak_deg: Annotated[float, "Peak angle that the panels add to the hub, over +-15 % of each frequency."]
    residual_deg: Annotated[float, "Amplitude of the oscillation after the last pulse."]
    margin: Annotated[float, "Share of the allowed peak that is left; negative: exceeded."]
    worst_mode: Annotated[int, "Place among the modes of the catalogue, from 0."]
    suggestion: Annotated[str | None, "Better schedule; null where nothing is wrong or nothing helps."]


@dataclass(frozen=True, slots=True)
class TorqueCommand:
    """Torque command of the chain for the wheels from ``epoch_us`` on, for one command period."""

    epoch_us: int
    #: journal number of the measurement it was computed from
    number: int
    attitude_epoch_us: Annotated[int, "Epoch of the attitude row that it follows from; advances with every row."]
    #: ground, onboard or off
    mode: str
    #: N m, impulse over command period
    torque_n_m: Axes
    #: (W,) N m, mean command to each wheel
    wheels_n_m: tuple[float, ...]
    saturated: bool
    command_period_s: Annotated[float, "Expected time to the next command."]
    valid_until_us: int
    schedule: Annotated[
        tuple[Pulse, ...],
        "Elements inside [epoch, epoch + command_period_s); after the last the torque is zero.",
    ]
    impulse_n_m_s: Axes
    predicted_angle_change_deg: Axes
    predicted_rate_change_deg_s: Axes
    #: (W,) N m s, change of stored momentum of each wheel
    predicted_wheel_momentum_n_m_s: tuple[float, ...]
    control_allowed: bool
    inhibitions: tuple[str, ...]
    #: None: the catalogue knows no flexible mode, or nothing is commanded
    schedule_check: ScheduleVerdict | None = None
    balance_allowed_axes: Annotated[
        tuple[bool, bool, bool],
        "While control is not allowed: axes whose known torque and rate the schedule balances, without a correction of "
        "the angle.",
    ] = NO_AXES

    @property
    def is_permitted(self) -> bool:
        """Return whether the schedule may be executed, as control or as balance."""
        return self.control_allowed or any(self.balance_allowed_axes)


@dataclass(frozen=True, slots=True)
class AppliedCommand:
    """A command that counts as applied; known input of the filter."""

    command: TorqueCommand

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.command.number)


@dataclass(frozen=True, slots=True)
class ReleasedCommand:
    """A command that persons released: until it is reported its whole effect is uncertain."""

    #: rises by one with each command of a spacecraft; the uplink product carries it
    counter: int
    released_us: int
    schedule: tuple[Pulse, ...]

    @property
    def stop_us(self) -> int:
        """When its last pulse ends."""
        return max((pulse.stop_us for pulse in self.schedule), default=self.released_us)

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.counter)


@dataclass(frozen=True, slots=True)
class ReportedCommand:
    """Report of the centre on a released command: known input of the filter from now on."""

    counter: int
    reported_us: int
    #: executed pulses; empty = none
    executed: tuple[Pulse, ...]

    @property
    def key(self) -> str:
        """Natural key within a spacecraft."""
        return str(self.counter)


@dataclass(frozen=True, slots=True)
class Disturbance:
    """A constant torque on the body and one that goes round once a period, by yaw, roll and pitch."""

    #: where the phase of the periodic part is zero
    epoch_us: int
    period_s: float
    constant_n_m: Axes
    cosine_n_m: Axes
    sine_n_m: Axes
    #: one standard deviation of the torque at the epoch
    sigma_n_m: Axes

    def torque_n_m(self, at_us: int) -> Axes:
        """Return the torque expected at an instant."""
        phase = 2.0 * math.pi * (at_us - self.epoch_us) / (self.period_s * US_PER_S)
        cosine, sine = math.cos(phase), math.sin(phase)
        parts = zip(self.constant_n_m, self.cosine_n_m, self.sine_n_m, strict=True)
        return Axes(*(constant + cosine * c + sine * s for constant, c, s in parts))


@dataclass(frozen=True, slots=True)
class BalanceBasis:
    """The newest row that control could use, and what is known of the motion since: yaw, roll, pitch."""

    epoch_us: int
    #: which control could turn
    axes: tuple[bool, bool, bool]
    attitude_deg: Axes
    sigma_deg: Axes
    rates_deg_s: Axes
    #: as it was known then; None: none is
    disturbance: Disturbance | None
    #: pulses that the row did not know
    executed: tuple[Pulse, ...] = ()
