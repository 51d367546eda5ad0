"""State of one spacecraft in the service, as one document."""

from typing import Literal

from service.api.schemas.base import Answer, EpochAnswer


class LinkAnswer(Answer):
    """A front end that sends measurements, and how far it is."""

    source: str
    role: str
    newest_epoch: EpochAnswer | None
    rows: int


class InterlockAnswer(Answer):
    """Whether computed torques are given to the spacecraft, and why not."""

    state: Literal["INHIBITED", "ENGAGED"]
    """ENGAGED: release is automatic and the newest command may be applied."""
    reasons: list[str]


class StatusAnswer(Answer):
    """What is newest, what is pending, what is in force."""

    newest_measurement: EpochAnswer | None
    newest_attitude: EpochAnswer | None
    """Of the method that drives control."""
    pending: int
    """Rows after the alignment's epoch without a result of every method that can run; 0 when not aligned."""
    aligned: bool
    realignment_advised: bool
    methods_disagree: bool
    """Whether both methods have told different roll or pitch angles for a quarter of an hour."""
    clock: Literal["system", "data"]
    now: EpochAnswer | None
    """Present of the spacecraft; null before its first row under the data clock."""
    links: list[LinkAnswer]
    interlock: InterlockAnswer
    method: str
    """Method that drives control."""
    calibration_id: int | None
    """Newest active calibration."""
    alignment_id: int | None
    """Alignment in force."""
