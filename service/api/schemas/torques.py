"""Torque commands as they go out. Torque is the torque on the body; every element of a schedule ends by itself."""

from typing import Annotated, Literal, Self

from pydantic import Field

from service.api.schemas.base import AnglesAnswer, Answer, EpochAnswer, Figure, WindowAnswer
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.record_answers import members_of
from service.records.catalogue import ControlMode
from service.records.levels.attitude import NO_ANGLES
from service.records.levels.command import Pulse, ScheduleVerdict, TorqueCommand


class PulseAnswer(members_of(Pulse, flat=("torque_n_m",), number=float), Answer):
    """One element of a schedule."""


class PredictedAnswer(Answer):
    """Predicted effect of the schedule at the end of the command period."""

    angle_change_deg: Annotated[AnglesAnswer, Field(validation_alias="predicted_angle_change_deg")]
    rate_change_deg_s: Annotated[AnglesAnswer, Field(validation_alias="predicted_rate_change_deg_s")]
    wheel_momentum_n_m_s: Annotated[list[Figure], Field(validation_alias="predicted_wheel_momentum_n_m_s")]
    """Change of the stored momentum of each wheel."""


_VERDICTS = {"verdict": Literal["accept", "warn", "reject"]}


class ScheduleCheckAnswer(members_of(ScheduleVerdict, number=float, types=_VERDICTS), Answer):
    """Check of a schedule against the flexible modes, the worst of the axes."""


_PREDICTED = tuple(name for name in TorqueCommand.__dataclass_fields__ if name.startswith("predicted_"))


class TorqueAnswer(
    members_of(
        TorqueCommand,
        without=("number", "schedule_check", *_PREDICTED),
        flat=("torque_n_m",),
        types={
            **dict.fromkeys(("epoch_us", "attitude_epoch_us", "valid_until_us"), EpochAnswer | None),
            "mode": ControlMode,
            "schedule": PulseAnswer,
        },
        descriptions={"roll_n_m": "Impulse over command period."},
    ),
    Answer,
):
    """A computed command; null torques before the first."""

    wheels_n_m: list[Figure] | None
    """Mean command to each wheel."""
    predicted: PredictedAnswer | None
    schedule_check: ScheduleCheckAnswer | None = None
    """Verdict of the flexible modes; null where the catalogue knows none, or nothing is commanded."""

    @classmethod
    def of(cls, command: TorqueCommand) -> Self:
        """Return the answer for a command."""
        return super().of(command, predicted=command)

    @classmethod
    def before_the_first(cls, mode: ControlMode, attitude_epoch_us: int | None) -> Self:
        """Return the answer while no command was ever computed."""
        nothing = {"saturated": False, "schedule": [], "impulse_n_m_s": NO_ANGLES, "control_allowed": False}
        known = {"mode": mode, "attitude_epoch": attitude_epoch_us, "inhibitions": ["no_attitude"]}
        return cls.model_validate(dict.fromkeys(cls.model_fields) | nothing | known)


class NewestTorqueAnswer(TorqueAnswer):
    """The newest command, with the verdict on control."""

    control: VerdictAnswer


class TorquePage(Answer):
    """Commands in order of epoch."""

    range: WindowAnswer
    version: str
    rows: list[TorqueAnswer]
    next: str | None
