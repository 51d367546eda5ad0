"""The port of inputs: measurements, slow inputs, and the journal that orders them."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Literal, NamedTuple, Protocol

from service.core.rows.summaries import Summaries
from service.records.calibration import Window
from service.records.inputs import Operation
from service.records.journal import JournalEntry, JournalHead, SlowInput
from service.records.levels.attitude import BoolArray, IntArray
from service.records.levels.measurement import BatchReceipt, Measurement, MeasurementBatch
from service.records.levels.measurement_block import MeasurementBlock
from service.records.levels.series import HeadState, InputReceipt, MeasurementSeries, ReferenceSeries, SourceState
from service.records.storage.archive_maintenance import RetiredRows, SealedPart, SegmentState


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

    def select_source(self, spacecraft_id: str, source: str) -> SourceState:
        """Make a source the prime one, journaled; rows stored from then on feed the estimator."""

    def head(self, spacecraft_id: str) -> HeadState:
        """Return where journal and consumer stand."""

    def heads(self) -> dict[str, HeadState]:
        """Return where journal and consumer of every spacecraft stand."""

    def journal_heads(self) -> list[JournalHead]:
        """Return number and digest of the newest entry of every journal; one that is empty has none."""

    def journal(self, spacecraft_id: str, after: int, limit: int) -> list[JournalEntry]:
        """Return at most ``limit`` entries with a number above ``after``, in order.

        Numbers have no gap but where retention has taken rows away; empty only when nothing follows.
        """

    def slow_inputs_before(self, spacecraft_id: str, number: int, kinds: Sequence[str]) -> list[JournalEntry]:
        """Return all slow inputs of some kinds with a number below the given one, in order."""

    def inputs(
        self,
        spacecraft_id: str,
        kind: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        *,
        newest_first: bool = False,
    ) -> list[JournalEntry]:
        """Return slow inputs of a kind that overlap a window, in order of (start, number), beyond a cursor.

        Of operations only the newest revision is returned.
        """

    def newest_measurement(self, spacecraft_id: str) -> Measurement | None:
        """Return the newest row of the prime source."""

    def measurements(
        self,
        spacecraft_id: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        source: str | None = None,
        *,
        newest_first: bool = False,
    ) -> list[Measurement]:
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

    def segments(self, spacecraft_id: str) -> Iterator[SegmentState]:
        """Read every sealed segment and yield whether it can be read; nothing is raised for one that cannot."""

    def drop_before(self, spacecraft_id: str, series: str, before_us: int) -> Iterator[RetiredRows]:
        """Drop the rows of a series of whole days before an epoch, a short transaction a step.

        Series: ``measurements``, ``attitude``, ``torques``, ``traces``. What the live chain has not consumed stays.
        """

    def fitting_us(self, spacecraft_id: str, series: str, size_bytes: int) -> int | None:
        """Return the midnight from which on the days of a series fit a size; None when all of them do."""

    def kept_from_us(self, spacecraft_id: str, series: str) -> int:
        """Return the epoch below which rows of a series were dropped; far below every epoch when none were."""
