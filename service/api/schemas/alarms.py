"""Alarms, what happens to them, and their limits."""

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field

from service.api.schemas.base import Answer, CommentText, Document, Epoch, EpochAnswer, Name, RowPage, Text
from service.api.schemas.record_answers import members_of
from service.pipeline.alarms.conditions import condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations.alarm import Alarm, AlarmChange, Handling
from service.records.operations.alarm_limits import AlarmLimits, ConditionLimits, Statement

StateWord = Literal["open", "unacknowledged", "acknowledged", "returned", "latched", "shelved", "suppressed", "closed"]
SetName = Literal["normal", "rain", "eclipse", "manoeuvre"]
SeverityWord = Literal["watch", "warning", "distress", "critical", "severe"]
ConditionName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Threshold = Annotated[float | None, Field(ge=-1e9, le=1e9)]
Seconds = Annotated[float, Field(ge=0, le=604_800)]

#: the words of a condition do not depend on its limits
_CONDITIONS = condition_table(AlarmConfig(), RobustConfig())


def _finite(value: Any) -> Any:
    """Return None for a number that JSON cannot hold."""
    return value if isinstance(value, float) and abs(value) < float("inf") else None


FiniteFigure = Annotated[float | None, BeforeValidator(_finite)]


class RemarkDocument(Document):
    """Optional comment of an operator on an action."""

    comment: CommentText = ""


class ShelveDocument(RemarkDocument):
    """Until when an alarm is to be quiet."""

    until: Epoch
    """By the spacecraft's clock, at most 24 h ahead."""


class HandlingAnswer(members_of(Handling), Answer):
    """Action of an operator on an alarm: name, time and comment."""


_FINITE = ("value", "limit")
_HANDLINGS = ("acknowledged", "shelved", "cleared")


class AlarmAnswer(
    members_of(
        Alarm,
        without=("process", "cover"),
        types={
            "severity": SeverityWord,
            **dict.fromkeys(_FINITE, FiniteFigure),
            **dict.fromkeys(_HANDLINGS, HandlingAnswer),
        },
    ),
    Answer,
):
    """One alarm."""

    state: Literal["normal", "unacknowledged", "acknowledged", "returned", "latched", "shelved", "suppressed"]
    """That of the cover where there is one; normal = closed."""
    is_active: bool
    """True: the condition holds."""
    present_value: FiniteFigure
    """Newest value; null where none is known."""
    next_step: str

    @classmethod
    def of(cls, alarm: Alarm, present_value: float = float("nan")) -> Self:
        """Return the answer for an alarm."""
        condition = _CONDITIONS.get(alarm.condition)
        next_step = "" if condition is None else condition.next_step
        return super().of(alarm, severity=alarm.severity.word, present_value=present_value, next_step=next_step)


class AlarmChangeAnswer(Answer):
    """One change of an alarm, as in events `alarm` of the stream."""

    sequence: int
    change: str
    """raised, escalated, returned, repeated, acknowledged, shelved, unshelved, suppressed, released or cleared."""
    at: EpochAnswer
    is_told: bool
    """True: notices are sent outside; never while it is shelved or suppressed."""
    by: str | None
    comment: str | None
    alarm: AlarmAnswer
    """The alarm after it."""

    @classmethod
    def of(cls, change: AlarmChange) -> Self:
        """Return the answer for a change."""
        handling = change.handling
        return super().of(
            change,
            change=change.kind.value,
            by=None if handling is None else handling.by,
            comment=None if handling is None else handling.comment,
            alarm=AlarmAnswer.of(change.alarm),
        )


class AlarmPage(RowPage):
    """One page of alarms."""

    rows: list[AlarmAnswer]


class AlarmHistoryAnswer(Answer):
    """One alarm and all that happened to it."""

    alarm: AlarmAnswer
    changes: list[AlarmChangeAnswer]


class StatementDocument(Document):
    """Limits of one condition in a set; an omitted field keeps its default, a threshold of null is switched off."""

    watch: Threshold = None
    warning: Threshold = None
    distress: Threshold = None
    critical: Threshold = None
    severe: Threshold = None
    deadband: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    on_s: Seconds = 0.0
    off_s: Seconds = 0.0
    repeat_s: Annotated[float | None, Field(ge=10, le=604_800)] = None
    latching: bool = False
    suppressed: bool = False
    enabled: bool = True

    def to_record(self) -> Statement:
        """Return the stated fields alone."""
        return self.model_dump(exclude_unset=True)


class LimitsDocument(Document):
    """Limits of a spacecraft; what GET gives can be PUT, for this or another spacecraft."""

    sets: dict[SetName, dict[ConditionName, StatementDocument]] = Field(default_factory=dict)
    nominal_dbm: dict[Name, Annotated[float, Field(ge=-250, le=50)]] = Field(default_factory=dict, max_length=1000)
    """Levels of carriers of which nothing better is expected."""
    comment: CommentText = ""
    version: Annotated[int, Field(ge=0)] | None = None
    """As exported; not looked at."""
    created_at: Epoch | None = None
    """As exported; not looked at."""
    created_by: Text | None = None
    """As exported; not looked at."""

    def to_record(self, created_at_us: int, created_by: str) -> AlarmLimits:
        """Return the limits that this document states."""
        sets: dict[str, dict[str, Statement]] = {
            chosen: {name: statement.to_record() for name, statement in statements.items()}
            for chosen, statements in self.sets.items()
        }
        return AlarmLimits(0, created_at_us, created_by, self.comment, sets, dict(self.nominal_dbm))


class LimitsAnswer(
    members_of(AlarmLimits, number=float, types={"created_at_us": EpochAnswer | None, "created_by": str | None}),
    Answer,
):
    """One version of the limits of a spacecraft: what it states beyond the defaults."""

    @classmethod
    def of(cls, limits: AlarmLimits) -> Self:
        """Return the answer for a version."""
        if limits.version:
            return super().of(limits)
        return super().of(limits, created_at=None, created_by=None)


class ConditionLimitsAnswer(members_of(ConditionLimits, number=float), Answer):
    """Limits of one condition as they are in force."""

    kind: str
    """above, below or lasting."""
    unit: str

    @classmethod
    def of(cls, name: str, limits: ConditionLimits) -> Self:
        """Return the answer for the limits of a condition."""
        return super().of(limits, kind=_CONDITIONS[name].kind.value, unit=_CONDITIONS[name].unit)


class LimitsInForceAnswer(Answer):
    """Limits as they are in force now."""

    version: int
    sets: list[str]
    """Sets in force, the later ones prevail."""
    conditions: dict[str, ConditionLimitsAnswer]
