"""Documents of released commands: requests, prepared commands, reports, uplink products."""

from typing import Annotated, Literal, Self

from pydantic import Field

from service.api.schemas.base import Answer, CommentText, Document, Epoch, RowPage, Text
from service.api.schemas.record_answers import members_of
from service.api.schemas.torques import PulseAnswer, ScheduleCheckAnswer
from service.records.operations.release import Command, CommandCheck, CommandRequest, UplinkProduct

#: a reason is asked for, so one must stand there
Reason = Annotated[CommentText, Field(min_length=1)]
CommandState = Literal[
    "PREPARED", "CONFIRMED", "RELEASED", "SENT", "EXECUTED", "FAILED", "EXPIRED", "CANCELLED", "REJECTED"
]


class PrepareDocument(Document):
    """Request to prepare a command."""

    reason: Reason
    """Reason of the command, kept with it."""
    attitude_epoch: Epoch | None = None
    """Epoch of the estimate to use; null: the newest."""
    start: Epoch | None = None
    """Start of the schedule; null: as soon as the uplink allows."""
    duration_s: Annotated[float, Field(gt=0, le=86_400)] | None = None
    """From the first pulse to the end of the last; null: the forecast horizon of the spacecraft's control."""
    max_torque_n_m: Annotated[float, Field(gt=0, le=1e3)] | None = None
    """No pulse is stronger; null: the limit of the spacecraft and its wheels."""
    dry_run: bool = False
    """True: nothing is stored, and checks that fail are told instead of refused."""

    def to_request(self) -> CommandRequest:
        """Return the request as the release service takes it."""
        return CommandRequest(self.reason, self.attitude_epoch, self.start, self.duration_s, self.max_torque_n_m)


class ConfirmDocument(Document):
    """Confirmation of a prepared command by a second person."""

    digest: Annotated[Text, Field(min_length=1)]
    """Of the command as it was prepared."""
    comment: CommentText = ""


class ReportDocument(Document):
    """Report of the centre on a released command; the same report again changes nothing."""

    at: Epoch | None = None
    """Instant of the event; null: now."""
    executed_from: Epoch | None = None
    """Start of the executed part; null: the beginning."""
    executed_until: Epoch | None = None
    """Null: to the end (executed), or nothing at all (failed, with a null `executed_from`)."""


class CheckAnswer(members_of(CommandCheck, without=("code",)), Answer):
    """One check of a command."""


_PREDICTED = ("angle_change_deg", "rate_change_deg_s", "peak_angle_deg", "peak_rate_deg_s", "wheel_momentum_n_m_s")


class PredictedCommandAnswer(members_of(Command, only=_PREDICTED, number=float), Answer):
    """Predicted effect of a command at the end of its last pulse, against no command."""


class CommandAnswer(
    members_of(
        Command,
        without=(*_PREDICTED, "schedule_verdict", "computed", "told_executed_us"),
        types={"state": CommandState, "schedule": PulseAnswer, "checks": CheckAnswer, "executed": PulseAnswer},
        others={
            "id": ("state", int, "Its counter, which stands in paths and in the uplink product."),
            "needs_approver": ("attitude_epoch_us", bool, "It waits for a second person, an approver."),
            "predicted": ("checks", PredictedCommandAnswer, ""),
            "schedule_check": ("prepared_by", ScheduleCheckAnswer | None, ""),
        },
    ),
    Answer,
):
    """A command that was prepared, as it stands."""

    @classmethod
    def of(cls, command: Command) -> Self:
        """Return the answer for a command."""
        return super().of(
            command,
            id=command.counter,
            needs_approver=command.state == "PREPARED",
            predicted=command,
            schedule_check=None if command.computed is None else command.computed.schedule_check,
        )


class CommandPage(RowPage):
    """Commands in order of their preparation."""

    rows: list[CommandAnswer]


class UplinkAnswer(members_of(UplinkProduct, types={"digest": str | None, "schedule": PulseAnswer}), Answer):
    """Uplink product for the centre's own channels; it never changes."""

    @classmethod
    def of(cls, product: UplinkProduct) -> Self:
        """Return the answer for an uplink product."""
        return super().of(product, digest=product.digest or None)
