"""Documents of control: state of the interlock, and orders of operators."""

from typing import Annotated, Literal, Self

from pydantic import Field

from service.api.schemas.base import AnglesAnswer, Answer, CommentText, Document, Epoch, EpochAnswer
from service.records.catalogue import ControlMode, Release
from service.records.operations.release import ControlVerdict, ControlView, EnvelopeLimits

ControlState = Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "TRIPPED"]
Limit = Annotated[float, Field(gt=0, le=1e3)]


class EnvelopeDocument(Document):
    """Largest change of a command about each axis; null: as wide as the settings allow."""

    angle_change_deg: Limit | None = None
    rate_change_deg_s: Limit | None = None
    impulse_n_m_s: Limit | None = None
    """Sum of the sizes of a command's pulses."""
    impulse_an_hour_n_m_s: Limit | None = None
    """The same over everything that was sent within an hour."""

    def to_limits(self, widest: EnvelopeLimits) -> EnvelopeLimits:
        """Return the limits, those that are not given from the widest allowed."""

        def chosen(given: float | None, otherwise: float) -> float:
            return otherwise if given is None else given

        return EnvelopeLimits(
            chosen(self.angle_change_deg, widest.angle_change_deg),
            chosen(self.rate_change_deg_s, widest.rate_change_deg_s),
            chosen(self.impulse_n_m_s, widest.impulse_n_m_s),
            chosen(self.impulse_an_hour_n_m_s, widest.impulse_an_hour_n_m_s),
        )


class OrderDocument(Document):
    """An order to the interlock; a comment goes to the shift log."""

    until: Epoch | None = None
    """End of a standing authorisation; engaging needs it, every other order leaves it unread."""
    envelope: EnvelopeDocument | None = None
    """Of a standing authorisation; null: that of the settings."""
    release: Literal["automatic"] | None = None
    """Of `control:arm`: ask for release automatic, which is set once a second approver asks for it within 15 min."""
    comment: CommentText = ""


class SignCheckDocument(Document):
    """Which axis is to be checked."""

    axis: Literal["yaw", "roll", "pitch"] | None = None
    """Null: the first of roll, pitch and yaw whose sign is not proven."""
    comment: CommentText = ""


class ControlReasonAnswer(Answer):
    """A reason why no torque may go, or why yaw is withheld."""

    code: str
    text: str
    since: EpochAnswer | None
    """Since when it has stood without a break; null: not known."""
    next_step: str


class VerdictAnswer(Answer):
    """Permission to apply a torque now; the same object in every answer about the present."""

    allowed: bool
    """False whenever the interlock or the newest attitude forbids; read this one for a decision."""
    state: ControlState
    """ENGAGED under release automatic: computed commands count as applied."""
    reasons: list[ControlReasonAnswer]
    """All active reasons; while allowed, those that withhold yaw alone."""


class EnvelopeAnswer(Answer):
    """Largest change of a command about each axis."""

    angle_change_deg: float
    rate_change_deg_s: float
    impulse_n_m_s: float
    """Sum of the sizes of a command's pulses."""
    impulse_an_hour_n_m_s: float
    """The same over everything that was sent within an hour."""


class SignCheckAnswer(Answer):
    """The newest sign check, or the one that is under way."""

    axis: Literal["yaw", "roll", "pitch"]
    state: str
    """running, plus (proven), minus, nothing, open, contradicted or interrupted."""
    started_at: EpochAnswer
    started_by: str
    until: EpochAnswer
    """It ends undecided then."""
    legs: int
    legs_done: int
    """Reported executed."""
    log_ratio: AnglesAnswer | None
    wheels: str | None
    """Yaw: the same word by wheel telemetry."""
    detail: str


class ControlAnswer(Answer):
    """State of the control interlock of a spacecraft."""

    control: VerdictAnswer
    state: ControlState
    """That of `control`."""
    since: EpochAnswer | None
    reasons: list[str]
    """Codes of the reasons of `control`."""
    trips: list[str]
    """Latched until reset, a part of the reasons."""
    armed: bool
    withheld: bool
    """Computed commands are zeroed: from a trip until ten good minutes after its reset."""
    release: Release
    mode: ControlMode
    envelope: EnvelopeAnswer
    """That of the standing authorisation, else that of the settings."""
    authorised_by: list[str]
    authorised_until: EpochAnswer | None
    requested_by: str | None
    """Who waits for a second person to engage."""
    requested_until: EpochAnswer | None
    proven_axes: list[Literal["yaw", "roll", "pitch"]]
    open_commands: list[int]
    """Wait for a confirmation."""
    unreported_commands: list[int]
    """Wait for a report."""
    sent_impulse_n_m_s: AnglesAnswer
    """Sum of the sizes of what was sent within the hour."""
    sign_check: SignCheckAnswer | None

    @classmethod
    def of(cls, view: ControlView, verdict: ControlVerdict) -> Self:
        """Return the answer for the state of the interlock."""
        return super().of(
            view,
            control=VerdictAnswer.of(verdict),
            state=verdict.state,
            # before anything ever happened there is no instant
            since=view.since_us or None,
            reasons=[reason.code for reason in verdict.reasons],
        )
