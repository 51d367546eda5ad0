"""State of one spacecraft in the service, as one document."""

from typing import Literal

from service.api.schemas.base import Answer, EpochAnswer
from service.api.schemas.control import ControlState, VerdictAnswer
from service.api.schemas.links import LinkWarningAnswer


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
