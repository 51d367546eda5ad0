"""Ports: what the inside of the service asks of the outside. Adapters implement them; nothing here imports one.

``Archive`` holds the promise of the product: when an append returns a receipt, what it counts as accepted is durable,
visible and counted once. Every call may raise StorageError, for example ``storage.corrupt`` when a sealed day that it
needs is damaged. Unknown names raise NotFoundError with the codes
``spacecraft.unknown``, ``plan.unknown``, ``ephemeris.unknown``, ``calibration.unknown``, ``alignment.unknown``,
``operation.unknown``, ``source.unknown``, ``job.unknown``, ``replay.unknown``, ``link.unknown``, ``key.unknown``.

While a request has an audit note (``service.records.audit.CURRENT_NOTE``), the first write that it waits for commits
its audit entry together with the change.
"""

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol

from service.records.access_key import AccessKey, StoredKey
from service.records.alarm import Alarm, AlarmChange
from service.records.alarm_limits import AlarmLimits
from service.records.alarm_memory import BookMemory
from service.records.archive_upkeep import Dropped, SealedPart, SegmentState
from service.records.attitude import AttitudeRow
from service.records.audit import AuditEntry, AuditFilter, AuditHead, Deed
from service.records.calibration import (
    Alignment,
    Calibration,
    CalibrationRequest,
    CalibrationResult,
    CalibrationState,
    Window,
)
from service.records.catalogue import Carrier, CarrierPlan, Ephemeris, Method, Spacecraft
from service.records.command import AppliedCommand, TorqueCommand
from service.records.inputs import Operation
from service.records.job import Job, JobState, Replay
from service.records.journal import JournalEntry, SlowInput
from service.records.link import LinkReport, LinkState
from service.records.measurement import BatchReceipt, Measurement, MeasurementBatch
from service.records.measurement_block import MeasurementBlock
from service.records.note import Note
from service.records.series import HeadState, InputReceipt, MeasurementSeries, ReferenceSeries, SourceState
from service.records.storage_state import StorageState
from service.records.trace import KeptTrace, Ring, Trace, TraceHead, TraceReceipt

#: version under which the live chain writes
LIVE = "live"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What the chain made of one consumed measurement."""

    rows: tuple[AttitudeRow, ...]
    command: TorqueCommand | None
    #: set when the command counts as applied: it enters the journal with the outcome
    applied: AppliedCommand | None = None


class Clock(Protocol):
    """The only source of time."""

    def now_us(self, spacecraft_id: str) -> int | None:
        """Return the present of a spacecraft, microseconds UTC; None before its first row under the data clock."""
        ...

    def is_data(self, spacecraft_id: str) -> bool:
        """Whether a spacecraft lives under the data clock, where its present is the newest epoch it sent."""
        ...

    def system_us(self) -> int:
        """Return the system's present, microseconds UTC, for receipt and creation times."""
        ...


class Catalogue(Protocol):
    """Spacecraft, carrier plans, ephemerides."""

    def add_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a new spacecraft; ConflictError ``spacecraft.exists``."""
        ...

    def replace_spacecraft(self, spacecraft: Spacecraft) -> None:
        """Store and journal a changed spacecraft under its id."""
        ...

    def spacecraft(self, spacecraft_id: str) -> Spacecraft:
        """Return one spacecraft."""
        ...

    def all_spacecraft(self) -> tuple[Spacecraft, ...]:
        """Return all spacecraft in order of id."""
        ...

    def put_plan(self, spacecraft_id: str, carriers: Sequence[Carrier], sha256: str) -> CarrierPlan:
        """Return the plan with this content, storing and journaling it when it is new or no longer the newest."""
        ...

    def plan(self, spacecraft_id: str, plan_id: int | None = None) -> CarrierPlan:
        """Return one plan, or the one put last; NotFoundError ``plan.unknown`` or ``plan.none``."""
        ...

    def put_ephemeris(self, spacecraft_id: str, ephemeris: Ephemeris) -> Ephemeris:
        """Store and journal an ephemeris (its id is ignored) and return it with its id."""
        ...

    def ephemeris(self, spacecraft_id: str, ephemeris_id: int | None = None) -> Ephemeris:
        """Return one ephemeris, or the newest; NotFoundError ``ephemeris.unknown`` or ``ephemeris.none``."""
        ...


class Archive(Protocol):
    """Inputs of the chain and the journal that orders them."""

    def append_measurements(self, batch: MeasurementBatch) -> Future[BatchReceipt]:
        """Store and journal the rows of a batch; the future resolves after the commit that made them durable.

        Same key and content: duplicate. Same key, other content: refused ``measurement.conflict``. A row is late when
        it is stale or below the newest epoch that the live chain has consumed.
        """
        ...

    def append_inputs(self, spacecraft_id: str, records: Sequence[SlowInput]) -> InputReceipt:
        """Store and journal slow inputs; same key, other content: refused ``input.conflict``."""
        ...

    def add_operation(self, spacecraft_id: str, operation: Operation) -> Operation:
        """Store and journal an operation (its id is ignored) and return it with its id."""
        ...

    def replace_operation(self, spacecraft_id: str, operation: Operation) -> Operation:
        """Store and journal a changed operation under the next revision."""
        ...

    def operation(self, spacecraft_id: str, operation_id: int) -> Operation:
        """Return the newest revision of one operation."""
        ...

    def sources(self, spacecraft_id: str) -> tuple[SourceState, ...]:
        """Return all measurement sources."""
        ...

    def select_source(self, spacecraft_id: str, source: str) -> SourceState:
        """Make a source the prime one, journaled; rows stored from then on feed the estimator."""
        ...

    def head(self, spacecraft_id: str) -> HeadState:
        """Return where journal and consumer stand."""
        ...

    def journal(self, spacecraft_id: str, after: int, limit: int) -> list[JournalEntry]:
        """Return at most ``limit`` entries with a number above ``after``, in order.

        Numbers have no gap but where retention has taken rows away; empty only when nothing follows.
        """
        ...

    def slow_inputs_before(self, spacecraft_id: str, number: int, kinds: Sequence[str]) -> list[JournalEntry]:
        """Return all slow inputs of some kinds with a number below the given one, in order."""
        ...

    def inputs(
        self, spacecraft_id: str, kind: str, window: Window, limit: int, after: tuple[int, int] | None
    ) -> list[JournalEntry]:
        """Return slow inputs of a kind that overlap a window, in order of (start, number), beyond a cursor.

        Of operations only the newest revision is returned.
        """
        ...

    def newest_measurement(self, spacecraft_id: str) -> Measurement | None:
        """Return the newest row of the prime source."""
        ...

    def measurements(
        self, spacecraft_id: str, window: Window, limit: int, after: tuple[int, int] | None, source: str | None = None
    ) -> list[Measurement]:
        """Return rows in order of (epoch, number) beyond a cursor; every source unless one is named."""
        ...

    def measurement_blocks(
        self, spacecraft_id: str, window: Window, *, source: str | None = None, feeds_estimator_only: bool = False
    ) -> Iterator[MeasurementBlock]:
        """Yield the rows of a window as blocks, in order of (epoch, number) within and across blocks.

        A block holds rows of one source under one plan; interleaved sources make short blocks. What is held at once
        does not grow with the window. Rows stored while blocks are read may be missed or told, never told twice.
        """
        ...

    def plan_ids(self, spacecraft_id: str, window: Window) -> tuple[int, ...]:
        """Return the numbers of the carrier plans under which the rows of a window were stored, ascending."""
        ...

    def measurements_after(self, spacecraft_id: str, epoch_us: int, before_number: int) -> list[Measurement]:
        """Return rows that feed the estimator, later than an epoch, stored before a journal number, by epoch."""
        ...

    def measurement_series(self, spacecraft_id: str, window: Window, carrier_ids: Sequence[str]) -> MeasurementSeries:
        """Return the rows that feed the estimator as arrays, columns matched by carrier id across plans."""
        ...

    def reference_series(self, spacecraft_id: str, window: Window) -> tuple[ReferenceSeries, ...]:
        """Return the attitude references of every sensor in a window."""
        ...

    def seal(self, spacecraft_id: str, before_us: int, received_before_us: int) -> Iterator[SealedPart]:
        """Pack the rows of days that ended by an epoch into segments, a short transaction a step.

        Days of a source with a row received at or after ``received_before_us`` wait: more may be coming. Nothing that
        any method answers changes.
        """
        ...

    def segments(self, spacecraft_id: str) -> Iterator[SegmentState]:
        """Read every sealed segment and yield whether it can be read; nothing is raised for one that cannot."""
        ...

    def drop_before(self, spacecraft_id: str, series: str, before_us: int) -> Iterator[Dropped]:
        """Drop the rows of a series of whole days before an epoch, a short transaction a step.

        Series: ``measurements``, ``attitude``, ``torques``, ``traces``. What the live chain has not consumed stays.
        """
        ...

    def fitting_us(self, spacecraft_id: str, series: str, size_bytes: int) -> int | None:
        """Return the midnight from which on the days of a series fit a size; None when all of them do."""
        ...

    def kept_from_us(self, spacecraft_id: str, series: str) -> int:
        """Return the epoch below which rows of a series were dropped; far below every epoch when none were."""
        ...


class Results(Protocol):
    """Everything the service computed: calibrations, alignments, attitude, commands, jobs, replays."""

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
        ...

    def finish_calibration(
        self, spacecraft_id: str, calibration_id: int, result: CalibrationResult | None, error: str | None
    ) -> Calibration:
        """Store the result of a draft, or why it failed."""
        ...

    def activate_calibration(self, spacecraft_id: str, calibration_id: int) -> Calibration:
        """Make a calibration the active one of its method, journaled; the former becomes superseded."""
        ...

    def calibration(self, spacecraft_id: str, calibration_id: int) -> Calibration:
        """Return one calibration."""
        ...

    def calibrations(self, spacecraft_id: str, state: CalibrationState | None = None) -> tuple[Calibration, ...]:
        """Return calibrations, newest first."""
        ...

    def add_alignment(self, spacecraft_id: str, alignment: Alignment) -> Alignment:
        """Store and journal an alignment (its id is ignored) and return it with its id."""
        ...

    def alignment(self, spacecraft_id: str, alignment_id: int) -> Alignment:
        """Return one alignment."""
        ...

    def alignments(self, spacecraft_id: str) -> tuple[Alignment, ...]:
        """Return alignments, newest first."""
        ...

    def alignment_number(self, spacecraft_id: str, alignment_id: int) -> int:
        """Return the journal number of an alignment."""
        ...

    def save_outcomes(
        self,
        spacecraft_id: str,
        version: str,
        outcomes: Sequence[Outcome],
        consumed_number: int,
        consumed_epoch_us: int | None,
    ) -> int:
        """Store outcomes in one transaction and return the last result sequence.

        Attitude rows that exist already under (version, method, measurement) stay as they are. For the live version
        applied commands enter the journal and the consumer's head moves to ``consumed_number``.
        """
        ...

    def attitude_rows(
        self,
        spacecraft_id: str,
        version: str,
        method: Method,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
    ) -> list[AttitudeRow]:
        """Return rows in order of (epoch, number of the measurement) beyond a cursor.

        Of the live version exactly one row a consumed measurement: where nothing was computed, the row has null angles,
        status INVALID and the inhibition ``no_calibration`` or ``not_aligned`` that held when it was consumed.
        """
        ...

    def newest_attitude(self, spacecraft_id: str, version: str, method: Method) -> AttitudeRow | None:
        """Return the row with the greatest epoch."""
        ...

    def commands(
        self, spacecraft_id: str, version: str, window: Window, limit: int, after: tuple[int, int] | None
    ) -> list[TorqueCommand]:
        """Return computed commands in order of (epoch, number) beyond a cursor."""
        ...

    def newest_command(self, spacecraft_id: str, version: str) -> TorqueCommand | None:
        """Return the newest computed command."""
        ...

    def results_after(
        self, spacecraft_id: str, sequence: int, limit: int
    ) -> list[tuple[int, AttitudeRow | TorqueCommand]]:
        """Return live results with a sequence above the given one, in order: what a resumed stream missed."""
        ...

    def pending(self, spacecraft_id: str, methods: Sequence[Method]) -> int:
        """Return how many rows that feed the estimator, later than the alignment's epoch, lack a result of a method."""
        ...

    def add_job(self, job: Job) -> None:
        """Store a new job."""
        ...

    def update_job(self, job_id: str, state: JobState, progress: float, error: str | None = None) -> None:
        """Store how far a job is."""
        ...

    def job(self, job_id: str) -> Job:
        """Return one job."""
        ...

    def fail_unfinished_jobs(self, error: str) -> int:
        """Mark jobs that a former process left queued or running as failed; return how many."""
        ...

    def add_replay(self, spacecraft_id: str, replay: Replay) -> Replay:
        """Store a replay (its id is ignored) and return it with its id."""
        ...

    def replay(self, spacecraft_id: str, version: str) -> Replay:
        """Return the replay that wrote a version."""
        ...


class Links(Protocol):
    """What front ends report of themselves, and what operators want of them."""

    def report(self, reports: Sequence[LinkReport], at_us: int) -> tuple[LinkState, ...]:
        """Store the newest reports in one transaction and return the state of each link; a new link is enabled.

        ConflictError ``link.too_many``: a thousand links are known already.
        """
        ...

    def links(self, spacecraft_id: str | None = None) -> tuple[LinkState, ...]:
        """Return all links, or those of one spacecraft, in order of id."""
        ...

    def link(self, link_id: str) -> LinkState:
        """Return one link; NotFoundError ``link.unknown``."""
        ...

    def set_enabled(self, link_id: str, *, enabled: bool) -> LinkState:
        """Say whether a link shall work; it stays so until it is said otherwise."""
        ...

    def request_reset(self, link_id: str) -> LinkState:
        """Count one more reset that is wanted of a link."""
        ...

    def remove(self, link_id: str) -> None:
        """Forget a link; it comes back with its next report, enabled."""
        ...


class Traces(Protocol):
    """Evidence traces: a ring of sweeps a source."""

    def append(
        self, spacecraft_id: str, source: str, traces: Sequence[Trace], received_at_us: int, ring: Ring
    ) -> TraceReceipt:
        """Store traces of one source and drop, oldest epoch first, what its ring has no place for, as one.

        Same source, sweep and epoch: duplicate, the first one stays.
        """
        ...

    def heads(
        self,
        spacecraft_id: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        source: str | None = None,
        sweep: str | None = None,
    ) -> list[TraceHead]:
        """Return kept traces without their points in order of (epoch, number) beyond a cursor."""
        ...

    def trace(
        self, spacecraft_id: str, epoch_us: int, source: str | None = None, sweep: str | None = None
    ) -> KeptTrace:
        """Return the trace of an epoch; NotFoundError ``trace.unknown``, ConflictError ``trace.ambiguous``."""
        ...


class Keys(Protocol):
    """Access keys; only digests of them are ever stored."""

    def add(self, stored: StoredKey) -> AccessKey:
        """Store a new key."""
        ...

    def all(self) -> tuple[StoredKey, ...]:
        """Return every key, revoked ones too, in order of creation."""
        ...

    def revoke(self, key_id: str, at_us: int) -> AccessKey:
        """Make a key worthless from now on; NotFoundError ``key.unknown`` also when it was revoked before."""
        ...

    def note_used(self, used_us: Mapping[str, int]) -> None:
        """Store when keys were last used, by id."""
        ...

    def add_first_administrator(self, stored: StoredKey, deed: Deed) -> bool:
        """Store an administrator's key with its audit entry unless one is in force; return whether it was stored."""
        ...


class Audit(Protocol):
    """The audit log: entries are added, never changed."""

    def append(self, deed: Deed) -> AuditEntry:
        """Add a deed and wait for its commit."""
        ...

    def entries(self, wanted: AuditFilter, limit: int, after: int | None) -> list[AuditEntry]:
        """Return entries with numbers above ``after``, in order."""
        ...

    def head(self) -> AuditHead:
        """Return the newest entry's number and hash as they stand beside the entries."""
        ...

    def chain(self) -> Iterator[AuditEntry]:
        """Yield every entry in order of number."""
        ...


class Alarms(Protocol):
    """Alarms, what happened to them, their limits, and what is about to alarm."""

    def save(self, changes: Sequence[AlarmChange]) -> tuple[AlarmChange, ...]:
        """Store changes in one transaction and return them with their numbers, alarms that are new with their ids.

        One process saves; numbers rise in the order of commits.
        """
        ...

    def alarm(self, alarm_id: int) -> Alarm:
        """Return one alarm; NotFoundError ``alarm.unknown``."""
        ...

    def open_alarms(self, spacecraft_id: str | None) -> tuple[Alarm, ...]:
        """Return the alarms of a spacecraft, or of the service (None), that stand, those under a cover too."""
        ...

    def alarms(
        self, spacecraft_id: str, states: Sequence[str], window: Window, limit: int, after: tuple[int, int] | None
    ) -> list[Alarm]:
        """Return alarms of a spacecraft and of the service raised in a window, in order of (raised, id).

        States are told ones; ``open`` stands for all that are not covered, ``closed`` for normal; none = all.
        """
        ...

    def changes(self, alarm_id: int) -> list[AlarmChange]:
        """Return what happened to one alarm, in order."""
        ...

    def changes_after(self, spacecraft_id: str, sequence: int, limit: int) -> list[AlarmChange]:
        """Return what happened to alarms of a spacecraft and of the service after a number: what a stream missed."""
        ...

    def newest_sequence(self) -> int:
        """Return the number of the newest change, 0 before the first."""
        ...

    def memory(self, spacecraft_id: str | None) -> BookMemory:
        """Return what the alarms of a spacecraft, or of the service, remember."""
        ...

    def save_memory(self, spacecraft_id: str | None, memory: BookMemory) -> None:
        """Store what they remember in place of what they did."""
        ...

    def limits(self, spacecraft_id: str, version: int | None = None) -> AlarmLimits:
        """Return a version of the limits, or the newest, 0 = the defaults; NotFoundError ``alarm_limits.unknown``."""
        ...

    def put_limits(self, spacecraft_id: str, limits: AlarmLimits) -> AlarmLimits:
        """Store limits as the next version and return it; the version that they state is ignored."""
        ...


class Notes(Protocol):
    """The shift log: notes are added, never changed."""

    def add(self, note: Note) -> Note:
        """Store a note (its id is ignored) and return it with its id; NotFoundError ``note.unknown``."""
        ...

    def note(self, note_id: int) -> Note:
        """Return one note; NotFoundError ``note.unknown``."""
        ...

    def notes(
        self, window: Window, limit: int, after: tuple[int, int] | None, spacecraft_id: str | None = None
    ) -> list[Note]:
        """Return notes about instants of a window in order of (epoch, id), also those about no spacecraft."""
        ...

    def newest(self, limit: int, spacecraft_id: str | None = None) -> list[Note]:
        """Return the notes with the greatest epochs, newest first."""
        ...


class Storage(Protocol):
    """One database seen as a whole."""

    catalogue: Catalogue
    archive: Archive
    results: Results
    links: Links
    alarms: Alarms
    notes: Notes
    traces: Traces
    keys: Keys
    audit: Audit

    def migrate(self) -> None:
        """Bring the schema to the present version."""
        ...

    def check(self) -> None:
        """Raise StorageError unless the database answers."""
        ...

    def state(self) -> StorageState:
        """Return what the storage says of itself; StorageError unless the database answers."""
        ...

    def close(self) -> None:
        """Commit what is queued and let go of the database."""
        ...
