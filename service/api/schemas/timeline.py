"""Timeline of a span: states of rows as intervals, and what was declared, commanded, found and written down."""

from typing import Literal

from service.api.schemas.alarms import AlarmAnswer
from service.api.schemas.archive import GapAnswer
from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer
from service.api.schemas.inputs import CorrectionAnswer
from service.api.schemas.notes import NoteAnswer
from service.api.schemas.operations import OperationAnswer
from service.api.schemas.record_answers import members_of
from service.records.calibration import Alignment
from service.records.catalogue import Method
from service.records.operations.release import Command, CommandState

StateKind = Literal["status", "control", "inhibition", "advice", "fade", "exclusion"]
Cut = Literal["operations", "corrections", "commands", "calibrations", "alarms", "notes"]


class StateRunAnswer(Answer):
    """Consecutive rows of a method that have one state."""

    method: Method
    kind: StateKind
    name: str
    """Status, reason or advice; `allowed` of control, `downlink` of fade."""
    carrier: str | None
    """Of exclusions."""
    start: EpochAnswer
    """First row."""
    stop: EpochAnswer
    """Last row; the state may have lasted until just before the next one."""
    rows: int
    """Rows with the state."""


class TimelineCommandAnswer(
    members_of(
        Command,
        only=("state", "purpose", "reason", "prepared_us", "start_us", "stop_us", "prepared_by", "confirmed_by"),
        types={"state": CommandState},
        others={"id": ("state", int, "Its counter.")},
    ),
    Answer,
):
    """A command."""


class ActivationAnswer(Answer):
    """A calibration became the active one of its method."""

    calibration_id: int
    method: str
    at: EpochAnswer
    """Newest row of that moment."""


class TimelineAlignmentAnswer(members_of(Alignment, only=("id", "epoch_us", "source", "created_by")), Answer):
    """An alignment."""


class TimelineAnswer(Answer):
    """Intervals and marks of a span, each list in order of start."""

    range: WindowAnswer
    joined_s: int
    """0: every run of rows stands alone. Else runs of one state no farther apart than this stand as one."""
    states: list[StateRunAnswer]
    """Runs of one state that reach into the span; a run of closed days is whole within the first and the last day."""
    gaps: list[GapAnswer]
    """Where rows of the estimator are missing, by the usual distance of the rows of the day."""
    states_left_out: list[WindowAnswer]
    """Whose states and gaps of a method are not here: of rows without a summary the newest 25000 are read.

    What is here is exact; ask for these spans by themselves.
    """
    operations: list[OperationAnswer]
    corrections: list[CorrectionAnswer]
    commands: list[TimelineCommandAnswer]
    """Whose pulses reach into the span, prepared in it or on the day before."""
    calibrations: list[ActivationAnswer]
    alignments: list[TimelineAlignmentAnswer]
    alarms: list[AlarmAnswer]
    """Active within the span, or raised in it; those closed since are sought among the newest 1000 raised before."""
    notes: list[NoteAnswer]
    cut: list[Cut]
    """Lists of which only the first 1000 are here: ask for a shorter span."""
