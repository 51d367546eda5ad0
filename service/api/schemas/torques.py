"""Torque commands as they go out. Torque is the torque on the body; every element of a schedule ends by itself."""

from typing import Annotated, Literal, Self

from pydantic import Field

from service.api.schemas.base import AnglesAnswer, Answer, EpochAnswer, Figure, WindowAnswer
from service.api.schemas.control import VerdictAnswer
from service.records.catalogue import ControlMode
from service.records.levels.attitude import NO_ANGLES
from service.records.levels.command import TorqueCommand


class PulseAnswer(Answer):
    """One element of a schedule."""

    start: EpochAnswer
    duration_s: float
    roll_n_m: float
    pitch_n_m: float
    yaw_n_m: float


class PredictedAnswer(Answer):
    """Predicted effect of the schedule at the end of the command period."""

    angle_change_deg: Annotated[AnglesAnswer, Field(validation_alias="predicted_angle_change_deg")]
    rate_change_deg_s: Annotated[AnglesAnswer, Field(validation_alias="predicted_rate_change_deg_s")]
    wheel_momentum_n_m_s: Annotated[list[Figure], Field(validation_alias="predicted_wheel_momentum_n_m_s")]
    """Change of the stored momentum of each wheel."""


class ScheduleCheckAnswer(Answer):
    """Check of a schedule against the flexible modes, the worst of the axes."""

    verdict: Literal["accept", "warn", "reject"]
    """A rejected schedule is not released."""
    peak_deg: float
    """Peak angle that the panels add to the hub, over +-15 % of each frequency."""
    residual_deg: float
    """Amplitude of the oscillation after the last pulse."""
    margin: float
    """Share of the allowed peak that is left; negative: exceeded."""
    worst_mode: int
    """Place among the modes of the catalogue, from 0."""
    suggestion: str | None
    """What would be better; null where nothing is wrong or nothing helps."""


class TorqueAnswer(Answer):
    """A computed command; null torques before the first."""

    epoch: EpochAnswer | None
    attitude_epoch: EpochAnswer | None
    """Epoch of the attitude row that it follows from; advances with every row."""
    mode: ControlMode
    roll_n_m: Figure
    """Impulse over command period."""
    pitch_n_m: Figure
    yaw_n_m: Figure
    wheels_n_m: list[Figure] | None
    """Mean command to each wheel."""
    saturated: bool
    command_period_s: Figure
    """Expected time to the next command."""
    valid_until: EpochAnswer | None
    schedule: list[PulseAnswer]
    """Elements inside [epoch, epoch + command_period_s); after the last the torque is zero."""
    impulse_n_m_s: AnglesAnswer
    predicted: PredictedAnswer | None
    control_allowed: bool
    inhibitions: list[str]
    schedule_check: ScheduleCheckAnswer | None = None
    """Verdict of the flexible modes; null where the catalogue knows none, or nothing is commanded."""

    @classmethod
    def of(cls, command: TorqueCommand) -> Self:
        """Return the answer for a command."""
        return super().of(command, predicted=command)

    @classmethod
    def before_the_first(cls, mode: ControlMode, attitude_epoch_us: int | None) -> Self:
        """Return the answer while no command was ever computed."""
        return cls.model_validate(
            {
                "epoch": None,
                "attitude_epoch": attitude_epoch_us,
                "mode": mode,
                "roll_n_m": None,
                "pitch_n_m": None,
                "yaw_n_m": None,
                "wheels_n_m": None,
                "saturated": False,
                "command_period_s": None,
                "valid_until": None,
                "schedule": [],
                "impulse_n_m_s": NO_ANGLES,
                "predicted": None,
                "control_allowed": False,
                "inhibitions": ["no_attitude"],
            }
        )


class NewestTorqueAnswer(TorqueAnswer):
    """The newest command, with the verdict on control."""

    control: VerdictAnswer


class TorquePage(Answer):
    """Commands in order of epoch."""

    range: WindowAnswer
    version: str
    rows: list[TorqueAnswer]
    next: str | None
