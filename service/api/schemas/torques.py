"""Torque commands as they go out. Torque is the torque on the body; every element of a schedule ends by itself."""

from typing import Literal, Self

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
    """What the schedule will have done when the command period ends."""

    angle_change_deg: AnglesAnswer
    rate_change_deg_s: AnglesAnswer
    wheel_momentum_n_m_s: list[Figure]
    """Change of the stored momentum of each wheel."""


class ScheduleCheckAnswer(Answer):
    """What the flexible modes say of a schedule, the worst of the axes."""

    verdict: Literal["accept", "warn", "reject"]
    """A rejected schedule is not released."""
    peak_deg: float
    """What the panels add to the angle of the hub at their greatest, over +-15 % of each frequency."""
    residual_deg: float
    """What still swings after the last pulse."""
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
        """Return the answer that tells a command."""
        return cls.model_validate(
            {
                "epoch": command.epoch_us,
                "attitude_epoch": command.attitude_epoch_us,
                "mode": command.mode,
                "roll_n_m": command.torque_n_m.roll,
                "pitch_n_m": command.torque_n_m.pitch,
                "yaw_n_m": command.torque_n_m.yaw,
                "wheels_n_m": command.wheels_n_m,
                "saturated": command.saturated,
                "command_period_s": command.command_period_s,
                "valid_until": command.valid_until_us,
                "schedule": [
                    {
                        "start": pulse.start_us,
                        "duration_s": pulse.duration_s,
                        "roll_n_m": pulse.torque_n_m.roll,
                        "pitch_n_m": pulse.torque_n_m.pitch,
                        "yaw_n_m": pulse.torque_n_m.yaw,
                    }
                    for pulse in command.schedule
                ],
                "impulse_n_m_s": command.impulse_n_m_s,
                "predicted": {
                    "angle_change_deg": command.predicted_angle_change_deg,
                    "rate_change_deg_s": command.predicted_rate_change_deg_s,
                    "wheel_momentum_n_m_s": command.predicted_wheel_momentum_n_m_s,
                },
                "control_allowed": command.control_allowed,
                "inhibitions": command.inhibitions,
                "schedule_check": command.schedule_check,
            }
        )

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
