"""Documents of attitude rows, of the interlock, of torques and of released commands."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field

from service.api.schemas.base import (
    AnglesAnswer,
    Answer,
    CommentText,
    Document,
    Epoch,
    EpochAnswer,
    Figure,
    RecordMembers,
    RowPage,
    Text,
    WindowAnswer,
    members_of,
)
from service.core.control.slew_schedule import Envelope
from service.pipeline.control.release.control_verdict import (
    ControlCondition,
    ControlReason,
    ControlVerdict,
    ControlView,
    GoodMinutes,
)
from service.pipeline.control.release.release_checks import angles_of
from service.pipeline.control.situation import SITUATIONS, AxisMotion, SpacecraftSituation
from service.records.catalogue import ControlMode, Method, Spacecraft
from service.records.levels import attitude
from service.records.operations.release import Command, CommandCheck, CommandRequest, SignCheck, UplinkProduct

ControlState = Literal["INHIBITED", "ARMED", "ENGAGED", "RECOVERY", "BALANCE", "TRIPPED"]
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


class AxisMotionAnswer(members_of(AxisMotion, types={"axis": _Axis}), Answer):
    """An axis and its way to the limit; rate and time of a row that is old or lost are null."""


class SpacecraftSituationAnswer(
    members_of(
        SpacecraftSituation,
        types={
            "code": Literal[*SITUATIONS],
            "severity": Literal["critical", "serious", "caution", "normal"],
            "axis": _Axis | None,
            "axes": AxisMotionAnswer,
        },
    ),
    Answer,
):
    """The worst that is true of a spacecraft now, which every view says first."""


class VerdictAnswer(
    members_of(
        ControlVerdict,
        types={"state": ControlState, "reasons": ControlReasonAnswer},
        others={"situation": ("reasons", SpacecraftSituationAnswer, "What to say first.")},
    ),
    Answer,
):
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
            "angle_limit_deg": ("is_armed", float, "An angle is to stay within it."),
        },
    ),
    Answer,
):
    """State of the control interlock of a spacecraft."""

    @classmethod
    def of(
        cls,
        view: ControlView,
        verdict: VerdictAnswer,
        conditions: Sequence[ControlCondition],
        angle_limit_deg: float,
    ) -> Self:
        """Return the answer for the state of the interlock."""
        return super().of(
            view,
            control=verdict,
            angle_limit_deg=angle_limit_deg,
            conditions=[ControlConditionAnswer.of(each) for each in conditions],
            state=verdict.state,
            # before anything ever happened there is no instant
            since=view.since_us or None,
            reasons=[reason.code for reason in verdict.reasons],
        )


class ExclusionAnswer(Answer):
    """A carrier left out of the fix, and why."""

    carrier: str
    reason: str
    """uplink_fade, step, absent, frozen, interference, group or manual."""


_MEMBERS = RecordMembers(
    attitude.AttitudeRow,
    first=("epoch_us", "received_at_us", "method", "attitude_deg", "rates_deg_s"),
    without=("number",),
    flat=("attitude_deg",),
    types={"epoch_us": EpochAnswer | None, "received_at_us": EpochAnswer | None, "excluded": ExclusionAnswer},
    descriptions={"epoch": "Instant measured; null before the first row."},
)


class AttitudeAnswer(_MEMBERS.model("AttitudeMembers")):
    """Attitude estimate of one method at one measurement."""

    version: str
    """`live`, `smoothed`, or the replay that made the row."""

    @classmethod
    def of(cls, row: attitude.AttitudeRow, version: str, **others: Any) -> Self:
        """Return the answer for a row; ``others`` are members in place of those of the row."""
        members = _MEMBERS.values(row)
        members["version"] = version
        members.update(others)
        answer: Self = cls.model_validate(members)
        return answer

    @classmethod
    def not_received(cls, method: Method, version: str, **others: Any) -> Self:
        """Return the answer before the first row."""
        nothing = attitude.row_without_attitude(0, 0, 0, method, ("no_attitude",))
        return cls.of(nothing, version, epoch=None, received_at=None, status=attitude.Status.NOT_RECEIVED, **others)


class RowCarriersAnswer(Answer):
    """Results of the carriers of a plan at one row; lists in the order of `ids`."""

    plan_id: int
    ids: list[str]
    state: list[str]
    """used, absent, excluded, unselected or uncalibrated."""
    deviation_db: list[Figure]
    """Measured minus expected, to 0.002 dB; null = absent or not used."""
    residual_db: list[Figure]
    """Deviation minus what the attitude explains, to 0.002 dB."""

    @classmethod
    def of(cls, results: attitude.CarrierResults, ids: Sequence[str]) -> Self:
        """Return the answer for the carriers of a plan."""
        levels_db = np.rint(np.stack((results.deviation_db, results.residual_db)) / attitude.STEP_DB) * attitude.STEP_DB
        deviation_db, residual_db = np.round(levels_db, 3).tolist()
        state = [attitude.CARRIER_STATES[position] for position in results.state]
        members = {"plan_id": results.plan_id, "ids": list(ids), "state": state}
        return cls.model_validate({**members, "deviation_db": deviation_db, "residual_db": residual_db})


class AttitudeEventAnswer(AttitudeAnswer):
    """An attitude row as in events `attitude` of the stream: with what its method makes of the carriers."""

    carriers: RowCarriersAnswer | None
    """Null where nothing was computed of them, as of late rows."""


class NewestAttitudeAnswer(AttitudeAnswer):
    """The newest row of a method, with the verdict on control of the spacecraft."""

    control: VerdictAnswer


class AttitudePage(Answer):
    """Rows in order of epoch, exactly one a measurement and method."""

    range: WindowAnswer
    method: Method
    version: str
    rows: list[AttitudeAnswer]
    next: str | None


class SmoothedPage(AttitudePage):
    """Smoothed rows in order of epoch, one each five minutes at most; `lag_s` tells what each of them knows."""


class PulseAnswer(members_of(attitude.Pulse, flat=("torque_n_m",), number=float), Answer):
    """One element of a schedule."""


class PredictedAnswer(Answer):
    """Predicted effect of the schedule at the end of the command period."""

    angle_change_deg: Annotated[AnglesAnswer, Field(validation_alias="predicted_angle_change_deg")]
    rate_change_deg_s: Annotated[AnglesAnswer, Field(validation_alias="predicted_rate_change_deg_s")]
    wheel_momentum_n_m_s: Annotated[list[Figure], Field(validation_alias="predicted_wheel_momentum_n_m_s")]
    """Change of the stored momentum of each wheel."""


_VERDICTS = {"verdict": Literal["accept", "reject"]}


class ScheduleCheckAnswer(members_of(attitude.ScheduleVerdict, number=float, types=_VERDICTS), Answer):
    """Check of a schedule against the flexible modes, the worst of the axes."""


_PREDICTED = tuple(name for name in attitude.TorqueCommand.__dataclass_fields__ if name.startswith("predicted_"))


class TorqueAnswer(
    members_of(
        attitude.TorqueCommand,
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
    def of(cls, command: attitude.TorqueCommand) -> Self:
        """Return the answer for a command."""
        return super().of(command, predicted=command)

    @classmethod
    def before_the_first(cls, mode: ControlMode, attitude_epoch_us: int | None) -> Self:
        """Return the answer while no command was ever computed."""
        nothing = {"saturated": False, "schedule": [], "impulse_n_m_s": attitude.NO_ANGLES, "control_allowed": False}
        nothing["balance_allowed_axes"] = attitude.NO_AXES
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


_PREDICTED_OF_COMMAND = (
    "angle_change_deg",
    "rate_change_deg_s",
    "peak_angle_deg",
    "peak_rate_deg_s",
    "wheel_momentum_n_m_s",
)


class PredictedCommandAnswer(members_of(Command, only=_PREDICTED_OF_COMMAND, number=float), Answer):
    """Predicted effect of a command at the end of its last pulse, against no command."""


class PredictedAnglesAnswer(Answer):
    """Predicted effect of a command at one instant, against no command."""

    at: EpochAnswer
    """Instant of the prediction."""
    angle_change_deg: AnglesAnswer


class CommandAnswer(
    members_of(
        Command,
        without=(*_PREDICTED_OF_COMMAND, "schedule_verdict", "computed", "told_executed_us"),
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

    predicted_angles: list[PredictedAnglesAnswer] | None
    """From the start to the horizon, where it is that of `predicted`; null in lists, events and answers of orders, and
    where the catalogue has another inertia since."""

    @classmethod
    def of(cls, command: Command, spacecraft: Spacecraft | None = None) -> Self:
        """Return the answer for a command; with the spacecraft it has the predicted angles."""
        angles = None if spacecraft is None else angles_of(command, spacecraft)
        return super().of(
            command,
            predicted_angles=angles and [{"at": at_us, "angle_change_deg": change} for at_us, change in angles],
            id=command.counter,
            needs_approver=command.state == "PREPARED",
            predicted=command,
            schedule_check=None if command.computed is None else command.computed.schedule_check,
        )


class CommandPage(RowPage[CommandAnswer]):
    """Commands in order of their preparation."""


class UplinkAnswer(members_of(UplinkProduct, types={"digest": str | None, "schedule": PulseAnswer}), Answer):
    """Uplink product for the centre's own channels; it never changes."""

    @classmethod
    def of(cls, product: UplinkProduct) -> Self:
        """Return the answer for an uplink product."""
        return super().of(product, digest=product.digest or None)
