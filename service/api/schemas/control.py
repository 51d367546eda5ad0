"""Documents of control: state of the interlock, and orders of operators."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field

from service.api.schemas.base import Answer, CommentText, Document, Epoch, EpochAnswer
from service.api.schemas.record_answers import members_of
from service.core.control.envelope import Envelope
from service.pipeline.control.control_conditions import ControlCondition
from service.pipeline.control.release.control_verdict import ControlReason, ControlVerdict, ControlView, GoodMinutes
from service.records.operations.release import SignCheck

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

    def within(self, widest: Envelope) -> Envelope:
        """Return the envelope, limits that are not given from the widest allowed."""
        return widest._replace(**self.model_dump(exclude_none=True))


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
    """Request for a sign check of one axis."""

    axis: Literal["yaw", "roll", "pitch"] | None = None
    """Null: the first of roll, pitch and yaw whose sign is not proven."""
    comment: CommentText = ""


_Axis = Literal["yaw", "roll", "pitch"]


class ControlReasonAnswer(members_of(ControlReason), Answer):
    """A reason why no torque may go, or why yaw is withheld."""


class VerdictAnswer(members_of(ControlVerdict, types={"state": ControlState, "reasons": ControlReasonAnswer}), Answer):
    """Permission to apply a torque now; the same object in every answer about the present."""


class ControlConditionAnswer(
    members_of(
        ControlCondition,
        types={"consequence": Literal["inhibit", "trip", "yaw"], "bound": Literal["greatest", "least"]},
    ),
    Answer,
):
    """A condition of the verdict, met or not, with its value and limit."""


class GoodMinutesAnswer(members_of(GoodMinutes, number=float), Answer):
    """Progress of the good minutes that arming, and clearing an inhibition, ask for."""


class EnvelopeAnswer(members_of(Envelope, number=float), Answer):
    """Largest change of a command about each axis."""


class SignRatiosAnswer(Answer):
    """Log-likelihood of each answer of a spacecraft against the best of them, by the powers."""

    plus: float
    nothing: float
    minus: float


class SignCheckAnswer(
    members_of(
        SignCheck, without=("leg", "leg_start_us", "flown"), types={"axis": _Axis, "log_ratio": SignRatiosAnswer}
    ),
    Answer,
):
    """The newest sign check, or the one that is under way."""


class ControlAnswer(
    members_of(
        ControlView,
        without=("condition_values", "has_row"),
        types={
            "state": ControlState,
            "since_us": EpochAnswer | None,
            "reasons": str,
            "good_minutes": GoodMinutesAnswer,
            "envelope": EnvelopeAnswer,
            "proven_axes": list[_Axis],
            "sign_check": SignCheckAnswer,
        },
        others={
            "control": ("state", VerdictAnswer, ""),
            "conditions": (
                "good_minutes",
                list[ControlConditionAnswer],
                "All that the verdict is made of; those that are not met are its reasons.",
            ),
        },
    ),
    Answer,
):
    """State of the control interlock of a spacecraft."""

    @classmethod
    def of(cls, view: ControlView, verdict: ControlVerdict, conditions: Sequence[ControlCondition]) -> Self:
        """Return the answer for the state of the interlock."""
        return super().of(
            view,
            control=VerdictAnswer.of(verdict),
            conditions=[ControlConditionAnswer.of(each) for each in conditions],
            state=verdict.state,
            # before anything ever happened there is no instant
            since=view.since_us or None,
            reasons=[reason.code for reason in verdict.reasons],
        )
