"""Documents of attitude rows: the newest, the history and the live stream give the same document."""

from typing import Any, Self

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.record_answers import RecordMembers
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow, Status, row_without_attitude


class ExclusionAnswer(Answer):
    """A carrier left out of the fix, and why."""

    carrier: str
    reason: str
    """uplink_fade, step, absent, frozen, interference, group or manual."""


_MEMBERS = RecordMembers(
    AttitudeRow,
    first=("epoch_us", "received_at_us", "method", "attitude_deg", "rates_deg_s"),
    without=("number",),
    flat=("attitude_deg",),
    types={"epoch_us": EpochAnswer | None, "received_at_us": EpochAnswer | None, "excluded": ExclusionAnswer},
    descriptions={"epoch": "Instant measured; null before the first row."},
)


class AttitudeAnswer(_MEMBERS.model("AttitudeMembers")):
    """Attitude estimate of one method at one measurement."""

    version: str
    """`live`, or the replay that made the row."""

    @classmethod
    def of(cls, row: AttitudeRow, version: str, **others: Any) -> Self:
        """Return the answer for a row; ``others`` are members in place of those of the row."""
        members = _MEMBERS.values(row)
        members["version"] = version
        members.update(others)
        answer: Self = cls.model_validate(members)
        return answer

    @classmethod
    def not_received(cls, method: Method, version: str, **others: Any) -> Self:
        """Return the answer before the first row."""
        nothing = row_without_attitude(0, 0, 0, method, ("no_attitude",))
        return cls.of(nothing, version, epoch=None, received_at=None, status=Status.NOT_RECEIVED, **others)


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
