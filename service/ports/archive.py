"""The ports of inputs and results: measurements, slow inputs, their journal, and everything the service computed."""

import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol, get_args

from service.core.rows import History, Summaries
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    Window,
)
from service.records.catalogue import Method
from service.records.inputs import JournalEntry, JournalHead, Operation, SlowInput
from service.records.levels.attitude import (
    AppliedCommand,
    AttitudeRow,
    BoolArray,
    CarrierResults,
    Disturbance,
    IntArray,
    TorqueCommand,
)
from service.records.levels.measurement import (
    BatchReceipt,
    HeadState,
    InputReceipt,
    Measurement,
    MeasurementBatch,
    MeasurementBlock,
    MeasurementSeries,
    ReferenceSeries,
    SourceState,
)
from service.records.operations.work import Job, JobKind, Replay, ReplayVersion
from service.records.storage import Checkpoint, RetiredRows, SealedPart, SealedResults

#: place of a row in a list: its instant, microseconds UTC, and its number
Cursor = tuple[int, int]


class ListPart(NamedTuple):
    """Part of a list that is ordered by an instant and a number."""

    window: Window
    #: most rows
    limit: int
    #: the rows beyond this place; from the newest row backwards those below it
    after: Cursor | None = None
    newest_first: bool = False


class Intervals(Protocol):
    """Intervals of an answer."""

    def hold(self, first_us: IntArray, last_us: IntArray) -> BoolArray:
        """Return which of some stretches lie within one interval each, or outside all of them."""


#: what is sampled of the carriers of a row as it was measured
MeasuredFigure = Literal["power_dbm", "c_n0_db_hz"]


class SampledPowers(NamedTuple):
    """Buckets of rows of one plan, powers or C/N0 in the order of the plan."""

    plan_id: int
    buckets: Summaries


class Archive(Protocol):
    """Inputs of the chain and the journal that orders them."""

    def append_measurements(self, batch: MeasurementBatch) -> Future[BatchReceipt]:
        """Store and journal the rows of a batch; the future resolves after the commit that made them durable.

        Same key and content: duplicate. Same key, other content: refused ``measurement.conflict``. A row is late when
        it is stale or below the newest epoch that the live chain has consumed.
        """

    def listen(self, listener: Callable[[MeasurementBatch, BatchReceipt], None] | None) -> None:
        """Notify a listener of every batch right after its commit, before its future resolves; None removes it.

        Batches are told in the order of their commits. The listener holds up all writing, so it must be quick.
        """

    def append_inputs(self, spacecraft_id: str, records: Sequence[SlowInput]) -> InputReceipt:
        """Store and journal slow inputs; same key, other content: refused ``input.conflict``."""

    def add_operation(self, spacecraft_id: str, operation: Operation) -> Operation:
        """Store and journal an operation (its id is ignored) and return it with its id."""

    def replace_operation(self, spacecraft_id: str, operation: Operation) -> Operation:
        """Store and journal a changed operation under the next revision."""

    def operation(self, spacecraft_id: str, operation_id: int) -> Operation:
        """Return the newest revision of one operation."""

    def sources(self, spacecraft_id: str) -> tuple[SourceState, ...]:
        """Return all measurement sources."""

    def every_source(self) -> dict[str, list[SourceState]]:
        """Return the measurement sources of each spacecraft that has one."""

    def select_source(self, spacecraft_id: str, source: str) -> SourceState:
        """Make a source the prime one, journaled; rows stored from then on feed the estimator."""

    def head(self, spacecraft_id: str) -> HeadState:
        """Return where journal and consumer stand."""

    def heads(self) -> dict[str, HeadState]:
        """Return where journal and consumer of every spacecraft stand."""

    def journal_heads(self) -> list[JournalHead]:
        """Return number and digest of the newest entry of every journal; one that is empty has none."""

    def journal(self, spacecraft_id: str, after: int, limit: int, *, is_compared: bool = False) -> list[JournalEntry]:
        """Return at most ``limit`` entries with a number above ``after``, in order.

        Numbers have no gap but where retention has taken rows away; empty only when nothing follows. The chain takes
        entries as they are stored; compared with their checksums they may leave the archive.
        """

    def slow_inputs_before(self, spacecraft_id: str, number: int, kinds: Sequence[str]) -> list[JournalEntry]:
        """Return all slow inputs of some kinds with a number below the given one, in order."""

    def inputs(self, spacecraft_id: str, kind: str, part: ListPart, *, is_compared: bool = True) -> list[JournalEntry]:
        """Return slow inputs of a kind that overlap a window, in order of (start, number), beyond a cursor.

        Of operations only the newest revision is returned. Chain and interlock take them without comparison with their
        checksums.
        """

    def newest_measurement(self, spacecraft_id: str) -> Measurement | None:
        """Return the newest row of the prime source."""

    def measurements(self, spacecraft_id: str, part: ListPart, source: str | None = None) -> list[Measurement]:
        """Return rows in order of (epoch, number) beyond a cursor; every source unless one is named."""

    def measurement_blocks(
        self, spacecraft_id: str, window: Window, *, source: str | None = None, feeds_estimator_only: bool = False
    ) -> Iterator[MeasurementBlock]:
        """Yield the rows of a window as blocks, in order of (epoch, number) within and across blocks.

        A block holds rows of one source under one plan; interleaved sources make short blocks. What is held at once
        does not grow with the window. Rows stored while blocks are read may be missed or told, never told twice.
        """

    def sampled_measurements(
        self,
        spacecraft_id: str,
        window: Window,
        intervals: Intervals,
        source: str | None = None,
        figure: MeasuredFigure = "power_dbm",
    ) -> Iterator[SampledPowers]:
        """Yield the rows of a window in buckets that lie within one interval each; every row is in one of them.

        Sealed days are read as their summaries, where those have buckets that fit, and as rows where not. Buckets may
        also hold rows outside all intervals.
        """

    def plan_ids(self, spacecraft_id: str, window: Window) -> tuple[int, ...]:
        """Return the numbers of the carrier plans under which the rows of a window were stored, ascending."""

    def measurements_after(self, spacecraft_id: str, epoch_us: int, before_number: int) -> Iterator[Measurement]:
        """Yield rows that feed the estimator, later than an epoch, stored before a journal number, by epoch.

        What is held at once does not grow with the number of rows.
        """

    def last_number(self, spacecraft_id: str, window: Window) -> int:
        """Return a journal number behind which no row lies in a window; 0 where none does at all."""

    def measurement_parts(
        self, spacecraft_id: str, window: Window, carrier_ids: Sequence[str]
    ) -> Iterator[MeasurementSeries]:
        """Yield the rows that feed the estimator as arrays, in order of epoch, as `measurement_series` returns them.

        What is held at once does not grow with the window.
        """

    def measurement_series(self, spacecraft_id: str, window: Window, carrier_ids: Sequence[str]) -> MeasurementSeries:
        """Return the rows that feed the estimator as arrays, columns matched by carrier id across plans."""

    def reference_series(self, spacecraft_id: str, window: Window) -> tuple[ReferenceSeries, ...]:
        """Return the attitude references of every sensor in a window."""

    def seal(self, spacecraft_id: str, before_us: int, received_before_us: int) -> Iterator[SealedPart]:
        """Pack the rows of days that ended by an epoch into segments, a short transaction a step.

        Days of a source with a row received at or after ``received_before_us`` wait: more may be coming. Nothing that
        any method answers changes.
        """

    def drop_before(self, spacecraft_id: str, series: str, before_us: int) -> Iterator[RetiredRows]:
        """Drop the rows of a series of whole days before an epoch, a short transaction a step.

        Series: ``measurements``, ``attitude``, ``torques``, ``traces``. What the live chain has not consumed stays.
        """

    def fitting_us(self, spacecraft_id: str, series: str, size_bytes: int) -> int | None:
        """Return the midnight from which on the days of a series fit a size; None when all of them do."""

    def kept_from_us(self, spacecraft_id: str, series: str) -> int:
        """Return the epoch below which rows of a series were dropped; far below every epoch when none were."""


#: version under which the live chain writes
LIVE = "live"
#: version of the live series of smoothed rows
SMOOTHED = "smoothed"
AttitudeFigure = Literal[
    "yaw_deg",
    "roll_deg",
    "pitch_deg",
    "yaw_sigma_deg",
    "roll_sigma_deg",
    "pitch_sigma_deg",
    "yaw_protection_deg",
    "roll_protection_deg",
    "pitch_protection_deg",
    "residual_rms_db",
    "common_db",
    "downlink_fade_db",
    "carriers_used",
    "control_allowed",
]
#: figures of an attitude row that are sampled, in the order of their columns
ATTITUDE_FIGURES: tuple[AttitudeFigure, ...] = get_args(AttitudeFigure)


class SampledCarriers(NamedTuple):
    """Buckets of rows of one plan: deviations of its N carriers, then their residuals, (B, 2 N)."""

    plan_id: int
    buckets: Summaries


@dataclass(frozen=True, slots=True)
class Outcome:
    """Results of the chain for one consumed measurement."""

    rows: tuple[AttitudeRow, ...]
    command: TorqueCommand | None
    #: set when the command counts as applied: it enters the journal with the outcome
    applied: AppliedCommand | None = None
    #: known torque of the method that drives control; a command for a later start is computed with it
    disturbance: Disturbance | None = None
    #: by how much the methods differ in roll or pitch while they disagree, 0 while they agree; NaN: not compared
    disagreement_deg: float = math.nan
    #: of each row what its method makes of the carriers, None = nothing; empty where none was computed, as of late rows
    carriers: tuple[CarrierResults | None, ...] = field(default=(), compare=False)


class Results(Protocol):
    """Results of the service: calibrations, alignments, attitude, commands, jobs, replays."""

    def add_calibration(
        self,
        spacecraft_id: str,
        request: CalibrationRequest,
        plan_id: int,
        ephemeris_id: int,
        created_at_us: int,
        created_by: str,
        job: Job | None = None,
        most: int | None = None,
    ) -> Calibration:
        """Store a draft without a result, with its job, and return it with its id; BusyError ``analysis.busy``."""

    def finish_calibration(
        self, spacecraft_id: str, calibration_id: int, result: CalibrationResult | None, error: str | None
    ) -> Calibration:
        """Store the result of a draft, or why it failed."""

    def activate_calibration(
        self, spacecraft_id: str, calibration_id: int, override_reason: str | None = None
    ) -> Calibration:
        """Make a calibration the active one of its method, journaled; the former becomes superseded."""

    def delete_calibration(self, spacecraft_id: str, calibration_id: int) -> None:
        """Delete a draft or a failed calibration; its number is not given again.

        NotFoundError ``calibration.unknown``; ConflictError ``calibration.not_draft``, ``calibration.unfinished``.
        """

    def calibration(self, spacecraft_id: str, calibration_id: int) -> Calibration:
        """Return one calibration."""

    def calibrations(self, spacecraft_id: str, state: CalibrationState | None = None) -> tuple[Calibration, ...]:
        """Return calibrations, newest first."""

    def add_alignment(self, spacecraft_id: str, alignment: Alignment) -> Alignment:
        """Store and journal an alignment (its id is ignored) and return it with its id."""

    def alignment(self, spacecraft_id: str, alignment_id: int) -> Alignment:
        """Return one alignment."""

    def alignments(self, spacecraft_id: str) -> tuple[Alignment, ...]:
        """Return alignments, newest first."""

    def alignment_number(self, spacecraft_id: str, alignment_id: int) -> int:
        """Return the journal number of an alignment."""

    def save_outcomes(
        self,
        spacecraft_id: str,
        version: str,
        outcomes: Sequence[Outcome],
        consumed_number: int,
        consumed_epoch_us: int | None,
        checkpoint: Checkpoint | None = None,
    ) -> int:
        """Store outcomes, and the state after them, in one transaction and return the last result sequence.

        Attitude rows that exist already under (version, method, measurement) stay as they are. For the live version
        applied commands enter the journal and the consumer's head moves to ``consumed_number``; a replay's checkpoint
        takes the place of the one before.
        """

    def submit_outcomes(
        self,
        spacecraft_id: str,
        outcomes: Sequence[Outcome],
        consumed_number: int,
        consumed_epoch_us: int | None,
        checkpoint: Checkpoint | None = None,
    ) -> "Future[int]":
        """Queue live outcomes as `save_outcomes` stores them; the future gives the last sequence after the commit."""

    def checkpoints(
        self, spacecraft_id: str, fingerprint: str, until_number: int, before_us: int | None = None
    ) -> Iterator[Checkpoint]:
        """Yield the sound checkpoints of a fingerprint up to a journal number, before an epoch, newest first."""

    def attitude_rows(self, spacecraft_id: str, version: str, method: Method, part: ListPart) -> list[AttitudeRow]:
        """Return rows in order of (epoch, number of the measurement) beyond a cursor.

        Of the live version exactly one row a consumed measurement: where nothing was computed, the row has null angles,
        status INVALID and the inhibition ``no_calibration`` or ``not_aligned`` that held when it was consumed.
        """

    def carrier_results(
        self, spacecraft_id: str, version: str, method: Method, window: Window
    ) -> dict[tuple[int, int], CarrierResults]:
        """Return what a method made of the carriers at the rows of a window, by (epoch, number), where it is stored."""

    def sampled_attitude(
        self, spacecraft_id: str, version: str, method: Method, window: Window, intervals: Intervals, figures: int = 3
    ) -> Iterator[Summaries]:
        """Yield figures of a window, (B, figures), in buckets that lie within one interval each; no row is in two.

        The figures are the first of `ATTITUDE_FIGURES`, of rows that were computed. Closed days of the live version are
        read as their summaries, where those have buckets that fit; angles have such buckets for all intervals.
        """

    def sampled_carriers(
        self, spacecraft_id: str, version: str, method: Method, window: Window, intervals: Intervals
    ) -> Iterator[SampledCarriers]:
        """Yield what a method made of the carriers in a window, in buckets as `sampled_attitude` does."""

    def sampled_impulse(
        self, spacecraft_id: str, version: str, window: Window, intervals: Intervals
    ) -> Iterator[Summaries]:
        """Yield the impulses of the commands of a window, (B, 3) N m s, in buckets as `sampled_attitude` does."""

    def state_history(self, spacecraft_id: str, method: Method, window: Window) -> History:
        """Return from when until when the live rows of a method had which states, and where rows are missing.

        States are status, control allowed, inhibitions, advice, downlink fade and exclusions by carrier. Closed days
        are read as their summaries; a run or gap that reaches over an end is whole up to the days at the ends. Of the
        others the newest rows are read, and the spans before them are said to be left out.
        """

    def newest_attitude(self, spacecraft_id: str, version: str, method: Method) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""

    def commands(self, spacecraft_id: str, version: str, part: ListPart) -> list[TorqueCommand]:
        """Return computed commands in order of (epoch, number) beyond a cursor."""

    def newest_command(self, spacecraft_id: str, version: str) -> TorqueCommand | None:
        """Return the newest computed command."""

    def results_after(
        self, spacecraft_id: str, sequence: int, limit: int
    ) -> list[tuple[int, AttitudeRow | TorqueCommand]]:
        """Return live results with a sequence above the given one, in order: what a resumed stream missed."""

    def carriers_after(self, spacecraft_id: str, sequence: int, until: int) -> dict[int, CarrierResults]:
        """Return what is stored of the carriers with the live results of sequences in (sequence, until]."""

    def pending(self, spacecraft_id: str, methods: Sequence[Method]) -> int:
        """Return how many rows that feed the estimator, later than the alignment's epoch, lack a result of a method."""

    def rows_after(self, spacecraft_id: str, alignment: Alignment) -> tuple[int, int]:
        """Return of the rows later than an alignment and stored before it how many it computes, and how many stay.

        It computes the rows that had no angles of one of its methods; what an earlier alignment computed stays.
        """

    def seal(self, spacecraft_id: str, before_us: int) -> Iterator[SealedResults]:
        """Pack the results of days that ended by an epoch into segments, a short transaction a step.

        Every version is packed. Nothing that any method answers changes.
        """

    def add_job(self, job: Job, holder: str | None = None) -> None:
        """Store a new job, in the hands of a holder where one runs it already; ConflictError ``job.exists``."""

    def queue_job(self, job: Job) -> None:
        """Store a job that comes again and again, or queue it once more where it has ended."""

    def open_jobs(self, holder: str) -> list[Job]:
        """Return the unfinished jobs that are a holder's or nobody's, in the order in which they are to be done.

        Those of a process on a server that has ended are nobody's.
        """

    def hold_job(self, job_id: str, holder: str) -> bool:
        """Make an open job run in the hands of a holder; False where another has it, or it has ended."""

    def report_job(self, job_id: str, holder: str, progress: float) -> bool:
        """Store how far a job is; False where it has ended meanwhile, or is another holder's."""

    def let_go_of_job(self, job_id: str, holder: str) -> None:
        """Let others go on with a job."""

    def free_jobs(self, holder: str) -> int:
        """Let the jobs of processes that have ended go on, and return how many; called where one begins to lead."""

    def end_job(self, job_id: str, error: str | None = None) -> None:
        """Store that a job is done, or why it failed; a calibration without a result fails with it."""

    def job(self, job_id: str) -> Job:
        """Return one job."""

    def unfinished_job_of(self, spacecraft_id: str, kind: JobKind, subject: str) -> str | None:
        """Return the id of the unfinished job of a subject, None where there is none."""

    def newest_jobs(self, limit: int) -> list[Job]:
        """Return the jobs that persons made last, newest first."""

    def add_replay(
        self,
        spacecraft_id: str,
        replay: Replay,
        job: Job | None = None,
        most: int | None = None,
        holder: str | None = None,
    ) -> Replay:
        """Store a replay (its id is ignored), with its job, and return it with its id; BusyError ``replay.busy``."""

    def replay(self, spacecraft_id: str, version: str) -> ReplayVersion:
        """Return the replay that wrote a version, and what became of it; NotFoundError ``replay.unknown``."""

    def replays(
        self, spacecraft_id: str, window: Window, limit: int, after_id: int | None, *, newest_first: bool = False
    ) -> list[ReplayVersion]:
        """Return the replays whose span overlaps a window, beyond an id in order of id, or in the reverse order."""

    def replay_checkpoint(self, spacecraft_id: str, version: str, fingerprint: str) -> Checkpoint | None:
        """Return the state from which a replay goes on; None when there is none that fits and is sound."""

    def delete_replay(self, spacecraft_id: str, version: str) -> None:
        """Delete a version; nothing reads it from now on, and its number is not given again.

        A job that still writes it ends with ConflictError ``replay.deleted`` at its next rows.
        """

    def drop_replays(self, spacecraft_id: str, created_before_us: int | None) -> Iterator[int]:
        """Delete finished replays made before an epoch; drop the rows of deleted ones and yield how many a step."""
