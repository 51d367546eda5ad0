"""Hand-over: what the next shift must know."""

from service.api.schemas.alarms import AlarmAnswer
from service.api.schemas.base import Answer, EpochAnswer
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.links import LinkAnswer
from service.api.schemas.notes import NoteAnswer
from service.api.schemas.operations import OperationAnswer
from service.api.schemas.status import StatusAnswer


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
