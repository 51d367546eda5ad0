"""Documents of the shift: alarms, links, notes, status, hand-over."""

import json
import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, StringConstraints, model_validator
from pydantic_core import PydanticCustomError

from service.api.context import SPACECRAFT_ID_PATTERN
from service.api.schemas.base import (
    Answer,
    CommentText,
    Document,
    Epoch,
    EpochAnswer,
    Name,
    RowPage,
    Text,
    members_of,
    record_of,
)
from service.api.schemas.control import ControlState, VerdictAnswer
from service.api.schemas.inputs import OperationAnswer
from service.pipeline.alarms.conditions import FOLLOWS, condition_table
from service.pipeline.config import AlarmConfig, RobustConfig
from service.records.operations import alarms as records
from service.records.operations.work import LinkReport, LinkWarning

StateWord = Literal["open", "unacknowledged", "acknowledged", "returned", "latched", "shelved", "suppressed", "closed"]
SetName = Literal["normal", "eclipse", "manoeuvre"]
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


class HandlingAnswer(members_of(records.Handling), Answer):
    """Action of an operator on an alarm: name, time and comment."""


_FINITE = ("value", "limit")
_HANDLINGS = ("acknowledged", "shelved", "cleared")


class AlarmChildAnswer(
    members_of(
        records.Alarm,
        without=("process", "cover"),
        types={
            "severity": SeverityWord,
            **dict.fromkeys(_FINITE, FiniteFigure),
            **dict.fromkeys(_HANDLINGS, HandlingAnswer),
        },
    ),
    Answer,
):
    """One alarm without what follows from it."""

    state: Literal["normal", "unacknowledged", "acknowledged", "returned", "latched", "shelved", "suppressed"]
    """That of the cover where there is one; normal = closed."""
    is_active: bool
    """True: the condition holds."""
    present_value: FiniteFigure
    """Newest value; null where none is known."""
    present_at: EpochAnswer | None
    """Epoch of the newest value."""
    next_step: str

    @classmethod
    def of(
        cls, alarm: records.Alarm, present: tuple[float, int | None] = (math.nan, None), children: Sequence[Any] = ()
    ) -> Self:
        """Return the answer for an alarm, with its newest value, the epoch of that, and what follows from it."""
        condition = _CONDITIONS.get(alarm.condition)
        next_step = "" if condition is None else condition.next_step if alarm.cause is None else FOLLOWS
        value, at_us = present
        others = {"present_value": value, "present_at": at_us, "next_step": next_step, "children": list(children)}
        return super().of(alarm, severity=alarm.severity.word, **others)


class AlarmAnswer(AlarmChildAnswer):
    """One alarm."""

    children: list[AlarmChildAnswer]
    """What follows from this alarm now, worst first; empty in changes."""


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
    def of(cls, change: records.AlarmChange) -> Self:
        """Return the answer for a change."""
        handling = change.handling
        return super().of(
            change,
            change=change.kind.value,
            by=None if handling is None else handling.by,
            comment=None if handling is None else handling.comment,
            alarm=AlarmAnswer.of(change.alarm),
        )


class AlarmPage(RowPage[AlarmAnswer]):
    """One page of alarms."""


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

    def to_record(self) -> records.Statement:
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

    def to_record(self, created_at_us: int, created_by: str) -> records.AlarmLimits:
        """Return the limits that this document states."""
        sets: dict[str, dict[str, records.Statement]] = {
            chosen: {name: statement.to_record() for name, statement in statements.items()}
            for chosen, statements in self.sets.items()
        }
        return records.AlarmLimits(0, created_at_us, created_by, self.comment, sets, dict(self.nominal_dbm))


class LimitsAnswer(
    members_of(
        records.AlarmLimits, number=float, types={"created_at_us": EpochAnswer | None, "created_by": str | None}
    ),
    Answer,
):
    """One version of the limits of a spacecraft: what it states beyond the defaults."""

    @classmethod
    def of(cls, limits: records.AlarmLimits) -> Self:
        """Return the answer for a version."""
        if limits.version:
            return super().of(limits)
        return super().of(limits, created_at=None, created_by=None)


class ConditionLimitsAnswer(members_of(records.ConditionLimits, number=float), Answer):
    """Limits of one condition as they are in force."""

    kind: str
    """above, below or lasting."""
    unit: str

    @classmethod
    def of(cls, name: str, limits: records.ConditionLimits) -> Self:
        """Return the answer for the limits of a condition."""
        return super().of(limits, kind=_CONDITIONS[name].kind.value, unit=_CONDITIONS[name].unit)


class LimitsInForceAnswer(Answer):
    """Limits as they are in force now."""

    version: int
    sets: list[str]
    """Sets in force, the later ones prevail."""
    conditions: dict[str, ConditionLimitsAnswer]


MAX_DETAIL_BYTES = 8192
MAX_LINKS_IN_REPORT = 64
_MAX_COUNTERS = 128
_MAX_WARNINGS = 64


def _bounded(detail: dict[str, Any]) -> dict[str, Any]:
    """Return a detail that can be kept: finite numbers only, and not too long."""
    try:
        size = len(json.dumps(detail, allow_nan=False, ensure_ascii=False).encode())
    except ValueError:
        raise PydanticCustomError("value.not_finite", "NaN and Infinity are not accepted") from None
    if size > MAX_DETAIL_BYTES:
        limits = {"size": size, "limit": MAX_DETAIL_BYTES}
        raise PydanticCustomError("value.length", "the detail has {size} bytes, the limit is {limit}", limits)
    return detail


Word = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
Code = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}$")]
#: whatever an analyzer answered may stand in it; a report that is refused for it would hide the fault
Explanation = Annotated[str, StringConstraints(max_length=1000)]
SpacecraftName = Annotated[str, StringConstraints(pattern=SPACECRAFT_ID_PATTERN)]
Counters = Annotated[dict[Name, Annotated[int, Field(ge=0, le=2**53)]], Field(max_length=_MAX_COUNTERS)]
Detail = Annotated[dict[str, Any], AfterValidator(_bounded)]


class LinkWarningDocument(Document):
    """One thing that is not as it should be."""

    code: Code
    detail: Explanation = ""
    since: Epoch | None = None


class LinkReportDocument(Document):
    """Report of one link on its own state."""

    id: Name
    kind: Literal["analyzer", "front_end"]
    spacecraft_id: SpacecraftName | None = None
    source: Name | None = None
    """Source of the measurements that come over the link."""
    state: Word
    """State of its state machine."""
    detail: Detail = Field(default_factory=dict)
    """Anything that helps a reader, 8 kB at most."""
    counters: Counters = Field(default_factory=dict)
    last_good: Epoch | None = None
    """Epoch of the newest good row."""
    warnings: list[LinkWarningDocument] = Field(default_factory=list, max_length=_MAX_WARNINGS)
    reset_seen: Annotated[int, Field(ge=0, le=2**31 - 1)] = 0
    """How many resets the link has carried out."""
    period_s: Annotated[float, Field(gt=0, le=86_400)] | None = None
    """Time between its reports; learned from them where it is not stated."""

    def to_record(self) -> LinkReport:
        """Return the record that this document states."""
        warnings = tuple(record_of(LinkWarning, each) for each in self.warnings)
        return record_of(LinkReport, self, warnings=warnings)


class LinkReportsDocument(Document):
    """Reports of the links of one front end."""

    links: Annotated[list[LinkReportDocument], Field(min_length=1, max_length=MAX_LINKS_IN_REPORT)]

    @model_validator(mode="after")
    def _check_ids(self) -> Self:
        """Refuse two reports of one link."""
        if len({each.id for each in self.links}) < len(self.links):
            raise PydanticCustomError("link.duplicate", "two reports of one link")
        return self


class LinkWishAnswer(Answer):
    """Requested state of a link: enabled or not, and number of resets."""

    id: str
    enabled: bool
    reset: int
    """Number of resets requested; a link that has carried out fewer begins again."""


class LinkWishesAnswer(Answer):
    """Requested states of the links that reported."""

    links: list[LinkWishAnswer]


class LinkWarningAnswer(members_of(LinkWarning), Answer):
    """One thing that is not as it should be."""


class LinkAnswer(
    members_of(
        LinkReport,
        without=("reset_seen", "period_s"),
        types={"warnings": LinkWarningAnswer},
        descriptions={"state": "As reported; SILENT when the link has not reported for three of its periods."},
    ),
    Answer,
):
    """A link as operators see it."""

    reported_state: str
    enabled: bool
    reported_at: EpochAnswer
    age_s: float
    """Time since the report."""
    period_s: float
    """Time between reports: stated, learned, or 60 s."""
    last_good_age_s: float | None
    reset_pending: bool
    """A reset was requested that the link has not carried out yet."""
    rows_missing: int | None
    """Rows that the source has numbered and the archive does not hold; null where it sends no numbers."""


class LinkListAnswer(Answer):
    """All links in order of id."""

    links: list[LinkAnswer]


MAX_TAGS = 16
NoteText = Annotated[
    str, StringConstraints(min_length=1, max_length=8000, pattern=r"^[^\x00-\x08\x0b\x0c\x0e-\x1f\x7f]*$")
]


class NoteDocument(Document):
    """A note; it cannot be changed, a later one may correct it."""

    text: NoteText
    spacecraft_id: Annotated[str, StringConstraints(pattern=SPACECRAFT_ID_PATTERN)] | None = None
    epoch: Epoch | None = None
    """Instant that it is about; default now, by the spacecraft's clock."""
    tags: list[Name] = Field(default_factory=list, max_length=MAX_TAGS)
    corrects: Annotated[int, Field(ge=1, le=2**53)] | None = None
    """Id of the note that this one corrects."""


class NoteAnswer(members_of(records.Note), Answer):
    """A note."""


class NotePage(RowPage[NoteAnswer]):
    """One page of notes."""


class StatusLinkAnswer(Answer):
    """A source of measurements and the link that carries it; null where one of both is not known."""

    source: str | None
    role: str | None
    newest_epoch: EpochAnswer | None
    rows: int | None
    rows_missing: int | None
    """Rows that the source has numbered and the archive does not hold; null where it sends no numbers."""
    id: str | None
    """Of the link."""
    kind: str | None
    state: str | None
    enabled: bool | None
    age_s: float | None
    """Time since the link reported."""
    last_good_age_s: float | None
    warnings: list[LinkWarningAnswer]


class InterlockAnswer(Answer):
    """State and codes of `control`."""

    state: ControlState
    reasons: list[str]


class AdviceAnswer(Answer):
    """Advice to the operator while control continues."""

    code: str
    text: str


class StatusAnswer(Answer):
    """Status of a spacecraft: newest rows, pending rows, documents in force."""

    newest_measurement: EpochAnswer | None
    newest_attitude: EpochAnswer | None
    """Of the method that drives control."""
    pending: int
    """Rows after the alignment's epoch without a result of every method that can run; 0 when not aligned."""
    aligned: bool
    realignment_advised: bool
    """True: `advice` has `realign`."""
    advice: list[AdviceAnswer]
    """Of the newest row of the robust method."""
    methods_disagree: bool
    """True: the roll or pitch angles of both methods have differed for a quarter of an hour."""
    clock: Literal["system", "data"]
    now: EpochAnswer | None
    """Present of the spacecraft; null before its first row under the data clock."""
    links: list[StatusLinkAnswer]
    control: VerdictAnswer
    interlock: InterlockAnswer
    method: str
    """Method that drives control."""
    calibration_id: int | None
    """Newest active calibration."""
    alignment_id: int | None
    """Alignment in force."""


class HandoverControlAnswer(VerdictAnswer):
    """Mode of control and the verdict of its interlock."""

    mode: str
    release: str
    method: str
    authorised_until: EpochAnswer | None
    """End of the authorisation of control; null: it is not bounded in time."""


class HandoverCalibrationAnswer(Answer):
    """An active calibration."""

    id: int
    method: str
    created_at: EpochAnswer
    data_until: EpochAnswer
    """End of the data that it was made from."""
    age_days: float


class HandoverEphemerisAnswer(Answer):
    """The ephemeris in force."""

    id: int
    valid_start: EpochAnswer
    valid_stop: EpochAnswer
    hours_left: float


class HandoverAlignmentAnswer(Answer):
    """The alignment in force."""

    id: int
    epoch: EpochAnswer
    age_hours: float


class HandoverKeyAnswer(Answer):
    """A key that ends soon."""

    id: str
    name: str
    role: str
    expires_at: EpochAnswer
    days_left: float


class HandoverSourceAnswer(Answer):
    """Rows missing by their sequence numbers."""

    source: str
    role: str
    newest_epoch: EpochAnswer | None
    rows_missing: int | None


class HandoverNoticesAnswer(Answer):
    """Counters of the notices sent over one channel."""

    channel: str
    waiting: int
    sent: int
    failed: int
    dropped: int


class HandoverAnswer(Answer):
    """Handover of a spacecraft to the next shift: alarms, control, status and notes."""

    spacecraft_id: str
    at: EpochAnswer
    """By the spacecraft's clock."""
    alarms: list[AlarmAnswer]
    """Active alarms, worst first."""
    shelved: list[AlarmAnswer]
    """With the instant at which each one comes back."""
    suppressed: list[AlarmAnswer]
    control: HandoverControlAnswer
    status: StatusAnswer
    calibrations: list[HandoverCalibrationAnswer]
    alignment: HandoverAlignmentAnswer | None
    ephemeris: HandoverEphemerisAnswer | None
    keys: list[HandoverKeyAnswer]
    """Those that end within 30 days."""
    links: list[LinkAnswer]
    """Those that do not work, are disabled or warn."""
    sources: list[HandoverSourceAnswer]
    operations: list[OperationAnswer]
    """In force, or beginning within 24 h."""
    notes: list[NoteAnswer]
    """The newest 20, newest first."""
    notices: list[HandoverNoticesAnswer]
