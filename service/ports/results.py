"""The port of everything the service computed."""

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, Protocol, get_args

from service.core.rows.state_runs import History
from service.core.rows.summaries import Summaries
from service.ports.archive import Intervals
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    Window,
)
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow
from service.records.levels.carrier_results import CarrierResults
from service.records.levels.command import AppliedCommand, TorqueCommand
from service.records.levels.disturbance import Disturbance
from service.records.operations.job import Job, JobState, Replay, ReplayVersion
from service.records.storage.archive_maintenance import SealedResults
from service.records.storage.checkpoint import Checkpoint

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
    ) -> Calibration:
        """Store a draft without a result and return it with its id."""

    def finish_calibration(
        self, spacecraft_id: str, calibration_id: int, result: CalibrationResult | None, error: str | None
    ) -> Calibration:
        """Store the result of a draft, or why it failed."""

    def activate_calibration(self, spacecraft_id: str, calibration_id: int) -> Calibration:
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

    def checkpoints(
        self, spacecraft_id: str, fingerprint: str, until_number: int, before_us: int | None = None
    ) -> Iterator[Checkpoint]:
        """Yield the sound checkpoints of a fingerprint up to a journal number, before an epoch, newest first."""

    def attitude_rows(
        self,
        spacecraft_id: str,
        version: str,
        method: Method,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[AttitudeRow]:
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

    def complete_summaries(self, spacecraft_id: str, before_us: int) -> Iterator[int]:
        """Summarise live attitude and commands of days that ended by an epoch and have no summary, a day a step."""

    def newest_attitude(self, spacecraft_id: str, version: str, method: Method) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""

    def commands(
        self,
        spacecraft_id: str,
        version: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[TorqueCommand]:
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

    def mark_complete(self, spacecraft_id: str, methods: Sequence[Method]) -> None:
        """Store up to where no row is pending, so that the first count after a start need not look at all rows."""

    def rows_after(self, spacecraft_id: str, alignment: Alignment) -> tuple[int, int]:
        """Return of the rows later than an alignment and stored before it how many it computes, and how many stay.

        It computes the rows that had no angles of one of its methods; what an earlier alignment computed stays.
        """

    def seal(self, spacecraft_id: str, before_us: int) -> Iterator[SealedResults]:
        """Pack the results of days that ended by an epoch into segments, a short transaction a step.

        Every version is packed. Nothing that any method answers changes.
        """

    def add_job(self, job: Job) -> None:
        """Store a new job."""

    def update_job(self, job_id: str, state: JobState, progress: float, error: str | None = None) -> None:
        """Store how far a job is."""

    def job(self, job_id: str) -> Job:
        """Return one job."""

    def newest_jobs(self, limit: int) -> list[Job]:
        """Return the jobs that were made last, newest first."""

    def fail_unfinished_jobs(self, error: str, but: Collection[str] = ()) -> int:
        """Mark jobs that a former process left unfinished as failed, and their drafts; return how many jobs.

        Those of replays stay: they go on from where they are. So do those named, and those of processes that live.
        """

    def acquire_job(self, job_id: str) -> bool:
        """Make an unfinished job that of this process; False where it is another's that lives."""

    def add_replay(self, spacecraft_id: str, replay: Replay) -> Replay:
        """Store a replay (its id is ignored) and return it with its id."""

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
