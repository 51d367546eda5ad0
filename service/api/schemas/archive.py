"""Documents of spans of the archive: manifests, gaps, samples, timeline."""

from typing import Literal, NamedTuple, Self

import numpy as np

from service.api.schemas.base import Answer, EpochAnswer, WindowAnswer, members_of
from service.api.schemas.inputs import CorrectionAnswer, OperationAnswer
from service.api.schemas.shift import AlarmAnswer, NoteAnswer
from service.core.arrays import IntArray
from service.core.rows import Summaries
from service.ports.archive import AttitudeFigure, MeasuredFigure
from service.records.calibration import Alignment
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import BoolArray, FloatArray
from service.records.levels.measurement import SourceState
from service.records.operations.release import Command, CommandState


class PartAnswer(Answer):
    """One UTC day of an export, a file of its own."""

    start: EpochAnswer
    stop: EpochAnswer
    rows: int
    """Rows of the archive; messages of CCSDS leave out those without a value."""
    bytes: int
    sha256: str
    closed: bool
    """True: the day is over; only late rows change the file of a closed day."""
    href: str
    """Where the file is, relative to the service; takes Range and If-Range."""


class ManifestAnswer(Answer):
    """Files of an export day by day, days without rows left out."""

    range: WindowAnswer
    series: str
    format: Literal["csv", "ndjson", "parquet", "aem", "tdm"]
    method: Method | None
    """Of attitude."""
    version: str | None
    """Of attitude and torques."""
    parts: list[PartAnswer]
    next: str | None


class GapAnswer(Answer):
    """Instants without a row: start inclusive, stop exclusive."""

    start: EpochAnswer
    stop: EpochAnswer
    rows_missing: int
    """By the usual distance of rows."""


class SourceRowsAnswer(members_of(SourceState, without=("newest_epoch_us",)), Answer):
    """Rows and missing rows of a source over all time."""


class GapsAnswer(Answer):
    """Gaps in the rows of a source, or in those that feed the estimator."""

    range: WindowAnswer
    source: str | None
    """Null = rows that fed the estimator, whichever source they came from."""
    gaps: list[GapAnswer]
    sources: list[SourceRowsAnswer]


ImpulseFigure = Literal["yaw_impulse_n_m_s", "roll_impulse_n_m_s", "pitch_impulse_n_m_s"]
CarrierFigure = Literal["deviation_db", "residual_db"]
Quantity = AttitudeFigure | ImpulseFigure | CarrierFigure | MeasuredFigure | Literal["expected_dbm"]


class SeriesName(NamedTuple):
    """Name of a sampled series."""

    quantity: Quantity
    #: of what a method made
    method: Method | None = None
    #: of what belongs to a carrier
    carrier: str | None = None


class SampledSeries(Answer):
    """One quantity; each list has one entry for each of the `epochs`."""

    quantity: Quantity
    method: Method | None
    """Null of powers, C/N0 and commands."""
    carrier: str | None
    n: list[int]
    """Rows that hold a value."""
    avg: list[float | None]
    min: list[float | None]
    max: list[float | None]
    min_epoch: list[str | None]
    """First row that holds the least value; empty where `extreme_epochs` is false."""
    max_epoch: list[str | None]

    @classmethod
    def of_column(cls, name: SeriesName, found: Summaries, *, has_epochs: bool) -> Self:
        """Return the answer for the one column of some intervals."""
        counts = found.counts[:, 0]
        is_held = counts > 0
        # the name is known and the arrays are ours: a validation of each number would cost more than all the rest
        return cls.model_construct(
            **name._asdict(),
            n=counts.tolist(),
            avg=_where(is_held, found.sums[:, 0] / np.maximum(counts, 1)),
            min=_where(is_held, found.minima[:, 0]),
            max=_where(is_held, found.maxima[:, 0]),
            min_epoch=_epochs_where(is_held, found.minimum_us[:, 0]) if has_epochs else [],
            max_epoch=_epochs_where(is_held, found.maximum_us[:, 0]) if has_epochs else [],
        )


class SampledQuantities(Answer):
    """Samples of several quantities in the same intervals, column by column; empty intervals are left out."""

    range: WindowAnswer
    """As asked, widened to whole intervals."""
    interval_s: int
    """Length of each: whole seconds, minutes, hours or days of UTC."""
    version: str
    """Of what was computed."""
    source: str | None
    """Source of the rows of powers and C/N0; null = of every source."""
    epochs: list[EpochAnswer]
    """Begins of the intervals in which any of the quantities has a value."""
    series: list[SampledSeries]


def _where(is_held: BoolArray, values: FloatArray) -> list[float | None]:
    return [value if held else None for held, value in zip(is_held.tolist(), values.tolist(), strict=True)]


def _epochs_where(is_held: BoolArray, epochs_us: IntArray) -> list[str | None]:
    pairs = zip(is_held.tolist(), epochs_us.tolist(), strict=True)
    return [format_epoch(epoch_us) if held else None for held, epoch_us in pairs]


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
