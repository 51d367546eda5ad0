"""Commands to be released: what a person wants, what was prepared, what became of it, what goes up."""

from typing import Annotated, Literal, Self

from pydantic import Field

from service.api.schemas.base import AnglesAnswer, Answer, CommentText, Document, Epoch, EpochAnswer, RowPage, Text
from service.api.schemas.torques import PulseAnswer, ScheduleCheckAnswer
from service.records.operations.release import Command, CommandRequest, ProductForm, Purpose, UplinkProduct

#: a reason is asked for, so one must stand there
Reason = Annotated[CommentText, Field(min_length=1)]
CommandState = Literal[
    "PREPARED", "CONFIRMED", "RELEASED", "SENT", "EXECUTED", "FAILED", "EXPIRED", "CANCELLED", "REJECTED"
]


class PrepareDocument(Document):
    """What a person wants to have prepared."""

    reason: Reason
    """Why; it stands with the command for ever."""
    attitude_epoch: Epoch | None = None
    """Estimate that the person has looked at; null: the newest."""
    start: Epoch | None = None
    """When the schedule begins; null: as soon as the uplink allows."""
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
    """What a second person confirms."""

    digest: Annotated[Text, Field(min_length=1)]
    """Of the command as it was prepared."""
    comment: CommentText = ""


class ReportDocument(Document):
    """What the centre tells of a released command; the same report again changes nothing."""

    at: Epoch | None = None
    """When it happened; null: now."""
    executed_from: Epoch | None = None
    """Part that was carried out; null: from the beginning."""
    executed_until: Epoch | None = None
    """Null: to the end (executed), or nothing at all (failed, with a null `executed_from`)."""


class CheckAnswer(Answer):
    """One check of a command."""

    name: str
    ok: bool
    detail: str
    """What is wrong; empty where nothing is."""


class PredictedCommandAnswer(Answer):
    """What a command will have done when its last pulse has ended, against no command."""

    angle_change_deg: AnglesAnswer
    rate_change_deg_s: AnglesAnswer
    peak_angle_deg: AnglesAnswer
    """Greatest on the way, with sign."""
    peak_rate_deg_s: AnglesAnswer
    wheel_momentum_n_m_s: list[float]
    """Change of the stored momentum of each wheel."""


class CommandAnswer(Answer):
    """A command that was prepared, as it stands."""

    id: int
    """Its counter, which stands in paths and in the uplink product."""
    state: CommandState
    digest: str
    """What a second person confirms: SHA-256 of counter, estimate, start and pulses to the last bit."""
    counter: int
    expires_at: EpochAnswer
    """It cannot be confirmed from then on."""
    purpose: Purpose
    reason: str
    dry_run: bool
    simulated: bool
    automatic: bool
    """Released by standing authorisation."""
    needs_approver: bool
    """It waits for a second person, an approver."""
    attitude_epoch: EpochAnswer
    start: EpochAnswer
    stop: EpochAnswer
    schedule: list[PulseAnswer]
    impulse_n_m_s: AnglesAnswer
    gross_impulse_n_m_s: AnglesAnswer
    """Sum of the sizes of the pulses: what the envelope counts."""
    predicted: PredictedCommandAnswer
    checks: list[CheckAnswer]
    """As they were when it was prepared; all are made again when it is confirmed."""
    schedule_check: ScheduleCheckAnswer | None
    prepared_by: str
    prepared_at: EpochAnswer
    confirmed_by: str | None
    comment: str
    released_at: EpochAnswer | None
    sent_at: EpochAnswer | None
    reported_at: EpochAnswer | None
    reported_by: str | None
    executed: list[PulseAnswer]
    """What of the schedule was carried out, by report."""

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


class UplinkAnswer(Answer):
    """What goes up through the centre's own channels; it never changes."""

    form: ProductForm
    counter: int
    """Torques: that of the command; angles: rises by one with each product. A receiver takes none twice."""
    created_at: EpochAnswer
    valid_from: EpochAnswer
    valid_until: EpochAnswer
    """Not to be used from then on."""
    attitude_epoch: EpochAnswer
    simulated: bool
    """Of a simulated spacecraft: never to be sent to a real one."""
    digest: str | None
    schedule: list[PulseAnswer]
    """Torque on the body; every element ends by itself."""
    attitude_deg: AnglesAnswer | None
    sigma_deg: AnglesAnswer | None

    @classmethod
    def of(cls, product: UplinkProduct) -> Self:
        """Return the answer for an uplink product."""
        return super().of(product, digest=product.digest or None)
