"""Reports of links, and links as operators see them."""

import json
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, StringConstraints, model_validator
from pydantic_core import PydanticCustomError

from service.api.context.dependencies import SPACECRAFT_ID_PATTERN
from service.api.schemas.base import Answer, Document, Epoch, EpochAnswer, Name, record_of
from service.api.schemas.record_answers import members_of
from service.records.operations.link import LinkReport, LinkWarning

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
