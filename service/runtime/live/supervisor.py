"""Live supervisor: one thread that carries every spacecraft's chain along its journal.

It reads like the diagram: entry <- journal; outcome = chain(entry); results.save(outcome); feed.publish(outcome). What
was accepted is archived before it comes here, so a fault here can delay an answer but lose nothing: after a restart
the chain is brought back from its last checkpoint (`chain_restart`), silently, to where results were stored.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Literal, NamedTuple

from service.errors import NotFoundError, StorageError
from service.pipeline.chain import Chain
from service.pipeline.config import ChainConfig
from service.ports.archive import LIVE, Outcome
from service.ports.storage import Storage, Term
from service.records.catalogue import Method
from service.records.inputs import AlignmentSet, AttitudeReference, Correction, JournalEntry
from service.records.levels.attitude import AppliedCommand, AttitudeRow, CarrierState, ReleasedCommand, TorqueCommand
from service.records.levels.measurement import HeadState, Measurement
from service.records.storage import Checkpoint
from service.runtime.clock import system_now_us
from service.runtime.live.journal_consumer import (
    PERIOD_US,
    ChainRestarts,
    StepResults,
    checkpoint_of,
    consume,
    result_events,
    rows_from,
    trips_after,
)
from service.runtime.live.leadership import always, is_moving
from service.runtime.live.live_feed import CommittedRows, FeedEvent, LiveFeed, Relay, ReleaseWatcher, Watcher

_LOG = logging.getLogger("soo.supervisor")

#: entries read from the journal and outcomes stored in one go
_ENTRIES_AT_ONCE = 256
#: between two looks at the journals for what other services have taken in, s
_POLL_S = 0.5
#: from the end of one round to the begin of the next: where rows stream in, what is taken in one go costs least
_PAUSE_S = 0.005
#: rows that stream in are consumed so long before what came of them is stored, in one go
_STEP_S = 0.02
#: what waits for a spacecraft is consumed so long before the others have their turn
_BLOCK_S = 0.05
#: a question about the newest row waits so long for a step under way, s
_ANSWER_S = 0.5
#: a journal may have grown by anything
_UNKNOWN = math.inf


#: of a failure that comes back with every try: a *step* that ends by an error stores nothing and is tried again, ever
#: later; a *row* whose computation fails is stored without an attitude, and the next row is computed
Kind = Literal["step", "row"]
#: failures one after another that are no accident
LASTING = 3
#: wait before a step is tried again, s: as often as failures are an accident, and at most
_RETRY_S, _LONGEST_RETRY_S = 1.0, 60.0


class StepFailure(NamedTuple):
    """Failures of one spacecraft without a success between them."""

    spacecraft_id: str
    kind: Kind
    #: the first of them
    error: str
    since_us: int
    times: int
    #: when the step is tried again, by the clock of waits
    retry_s: float


class StepFailures:
    """Failures of the spacecraft that a service estimates; safe from any thread.

    Parameters
    ----------
    now_us : callable
        The system's present, microseconds UTC.
    """

    def __init__(self, now_us: Callable[[], int] = system_now_us) -> None:
        self._now_us = now_us
        self._lock = threading.Lock()
        self._found: dict[tuple[str, Kind], StepFailure] = {}

    def note(self, spacecraft_id: str, kind: Kind, error: str, *, is_outage: bool = False) -> None:
        """Note one more failure; an outage of the database never lasts here: it has a readiness of its own."""
        with self._lock:
            first = self._found.get((spacecraft_id, kind))
            times = 1 if first is None or is_outage else first.times + 1
            wait_s = min(_LONGEST_RETRY_S, _RETRY_S * 2.0 ** max(0, times - LASTING))
            error, since_us = (error, self._now_us()) if first is None else (first.error, first.since_us)
            failure = StepFailure(spacecraft_id, kind, error, since_us, times, time.monotonic() + wait_s)
            self._found[spacecraft_id, kind] = failure

    def forget(self, spacecraft_id: str, *kinds: Kind) -> None:
        """Forget failures of a spacecraft: a step or a row has succeeded, or another process estimates it."""
        with self._lock:
            for kind in kinds:
                self._found.pop((spacecraft_id, kind), None)

    def is_waiting(self, spacecraft_id: str) -> bool:
        """Return whether the next step of a spacecraft is to wait."""
        with self._lock:
            failure = self._found.get((spacecraft_id, "step"))
        return failure is not None and time.monotonic() < failure.retry_s

    def lasting(self, spacecraft_id: str | None = None) -> tuple[StepFailure, ...]:
        """Return the failures that are no accident, of one spacecraft or of all."""
        with self._lock:
            found = tuple(self._found.values())
        return tuple(one for one in found if one.times >= LASTING and spacecraft_id in (None, one.spacecraft_id))


#: newest rows of a method that are at hand without the archive
_ROWS_AT_HAND = 24


class NewestResults(NamedTuple):
    """Newest results of a chain, as they were stored last."""

    #: entry of the journal up to which they are, and sequence of the last of them
    consumed_number: int
    sequence: int
    #: of each method some rows without a gap, the newest last
    rows: dict[Method, tuple[AttitudeRow, ...]]
    command: TorqueCommand | None
    #: the newest commanded motion that it knows of, or where it began
    motion_number: int

    def after(
        self, number: int, sequence: int, entries: Sequence[JournalEntry], outcomes: Sequence[Outcome]
    ) -> "NewestResults":
        """Return the newest results after some more entries, up to a number, of which came outcomes."""
        rows, command = dict(self.rows), self.command
        for outcome in outcomes:
            for row in outcome.rows:
                before = rows.get(row.method, ())
                # a late row stands between others
                is_next = not before or (row.epoch_us, row.number) > (before[-1].epoch_us, before[-1].number)
                rows[row.method] = (*before[1 - _ROWS_AT_HAND :], row) if is_next else before[-1:]
            if outcome.command is not None and (command is None or outcome.command.epoch_us >= command.epoch_us):
                command = outcome.command
        moving = (entry.number for entry in entries if isinstance(entry.content, Correction | ReleasedCommand))
        return NewestResults(number, sequence, rows, command, max(moving, default=self.motion_number))


@dataclass
class _Follower:
    """One spacecraft's chain and how far it is."""

    spacecraft_id: str
    chain: Chain
    #: in which turn of leading the chain was brought back
    turn: int
    consumed_number: int
    consumed_epoch_us: int | None
    #: as of the last stored ones
    newest: NewestResults
    #: newest epoch of the last checkpoint
    kept_us: int | None
    #: entries taken from the journal, or from memory, that no step has consumed; whether more may follow them
    left: list[JournalEntry] = field(default_factory=list)
    has_more: bool = False
    #: alignment under way, and what comes of the rows after it
    alignment: tuple[JournalEntry, Iterator[Outcome]] | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)


@dataclass
class _Block:
    """Entries of one spacecraft that were consumed, and what came of them on its way into the archive."""

    follower: _Follower
    entries: list[JournalEntry]
    step: StepResults
    #: keeps control as it is until the results are handled
    steady: ExitStack
    checkpoint: Checkpoint | None
    #: sequence of the last result
    stored: Future[int]


class Supervisor:
    """Carries the chains of all spacecraft along their journals.

    Parameters
    ----------
    storage : Storage
        Journal to read, results to write.
    feed : LiveFeed
        Where outcomes are published after they are stored.
    config : ChainConfig
        Configuration of every chain.
    watcher : Watcher, optional
        Who looks at the rows.
    turn : Term, optional
        Tells which spacecraft this process leads; of the others the feed gets what their leaders have stored.
    release : ReleaseWatcher, optional
        Who releases torques.
    failures : StepFailures, optional
        Where failures are noted.
    """

    def __init__(
        self,
        storage: Storage,
        feed: LiveFeed,
        config: ChainConfig,
        watcher: Watcher | None = None,
        turn: Term = always,
        release: ReleaseWatcher | None = None,
        failures: StepFailures | None = None,
    ) -> None:
        self.failures = failures or StepFailures()
        self._storage = storage
        self._release = release
        self._turn = turn
        self._relay = Relay(storage, feed)
        self._committed = CommittedRows(feed)
        self.restarts = ChainRestarts(storage, config, lambda: self._is_stopping)
        self._watcher = watcher
        self._feed = feed
        self._config = config
        self._followers: dict[str, _Follower] = {}
        #: on their way into the archive
        self._blocks: list[_Block] = []
        self._wake = threading.Condition()
        #: up to which number a journal is known to have grown
        self._due: dict[str, float] = {}
        self._is_stopping = False
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Bring every chain back to where it was and follow the journals from there."""
        self._due.update((spacecraft.id, _UNKNOWN) for spacecraft in self._storage.catalogue.all_spacecraft())
        self._storage.archive.listen(self._committed.stored)
        self._thread = threading.Thread(target=self._run, name="soo-supervisor", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Finish the batch in hand and end the thread."""
        self._storage.archive.listen(None)
        with self._wake:
            self._is_stopping = True
            self._wake.notify()
        if self._thread is not None:
            self._thread.join()

    @property
    def is_running(self) -> bool:
        """Return whether the thread follows journals."""
        return self._thread is not None and self._thread.is_alive()

    def notify(self, spacecraft_id: str, up_to: float = _UNKNOWN) -> None:
        """Notify the supervisor that a journal has grown, up to a number if known; safe from any thread."""
        with self._wake:
            self._due[spacecraft_id] = max(up_to, self._due.get(spacecraft_id, 0))
            self._wake.notify()

    def on_announced(self, spacecraft_id: str) -> None:
        """Follow a spacecraft that another process has changed, where it is led or listened to here."""
        if self._turn(spacecraft_id) or self._feed.has_subscribers(spacecraft_id):
            self.notify(spacecraft_id)

    def is_catching_up(self, spacecraft_id: str) -> bool:
        """Return whether this service leads and the chain is still brought back to where results were stored."""
        turn, follower = self._turn(spacecraft_id), self._followers.get(spacecraft_id)
        if turn == 0 or not self.is_running or (follower is not None and follower.turn == turn):
            return False
        return self._storage.archive.head(spacecraft_id).consumed_number > 0

    def carrier_states(self, spacecraft_id: str) -> tuple[Measurement, tuple[CarrierState, ...]] | None:
        """Return the newest consumed row and the state of its carriers; None before the first, and in a long step."""
        follower = self._followers.get(spacecraft_id)
        # the first row after an installation compiles the filter: nobody waits for it
        if follower is None or not follower.lock.acquire(timeout=_ANSWER_S):
            return None
        try:
            return follower.chain.carrier_states()
        finally:
            follower.lock.release()

    def newest_results(self, spacecraft_id: str, head: HeadState) -> NewestResults | None:
        """Return the newest results if a chain of this process has made them up to a head; None: the archive knows."""
        follower = self._followers.get(spacecraft_id)
        newest = None if follower is None else follower.newest
        place = (head.consumed_number, head.result_sequence)
        return newest if newest is not None and (newest.consumed_number, newest.sequence) == place else None

    def rows_by_kind(self, spacecraft_id: str) -> dict[bool, int]:
        """Return how many rows the robust method has taken since the start, by whether they were ordinary."""
        follower = self._followers.get(spacecraft_id)
        return {} if follower is None else follower.chain.rows_by_kind()

    def is_disagreeing(self, spacecraft_id: str) -> bool:
        """Return whether the methods have told different roll or pitch angles for long."""
        follower = self._followers.get(spacecraft_id)
        return follower is not None and follower.chain.is_disagreeing

    def _run(self) -> None:
        """Follow journals until stopped."""
        polled_s = -math.inf
        while True:
            with self._wake:
                if not self._due and not self._is_stopping:
                    self._wake.wait(_POLL_S)
                if self._is_stopping:
                    break
                due, self._due = self._due, {}
            if time.monotonic() - polled_s >= _POLL_S:
                # what nobody has announced, also while others keep this thread busy
                due = dict.fromkeys(self._grown(), _UNKNOWN) | due
                polled_s = time.monotonic()
            began_s = time.monotonic()
            for spacecraft_id, up_to in sorted(due.items()):
                self._guarded(spacecraft_id, partial(self._follow, spacecraft_id, up_to))
                if time.monotonic() - began_s > _BLOCK_S:
                    # commits of several spacecraft go on together while the next ones are computed
                    self._conclude_blocks()
                    began_s = time.monotonic()
            self._conclude_blocks()
            if not self._due:
                time.sleep(_PAUSE_S)
        self._keep_states()

    def _grown(self) -> tuple[str, ...]:
        """Return the spacecraft of which another service may have taken something in."""
        try:
            heads = self._storage.archive.heads()
            led = {each for each in heads if self._turn(each)}
            others = {each: head for each, head in heads.items() if each not in led}
            grown = {each for each in led if self._is_to_be_consumed(each, heads[each].newest_number)}
            return (*grown, *(self._relay.behind(others) if others else ()))
        except StorageError:
            # the users of the archive report the error
            return ()

    def _is_to_be_consumed(self, spacecraft_id: str, newest_number: int) -> bool:
        """Return whether there are entries that the chain of this term has not consumed."""
        follower = self._followers.get(spacecraft_id)
        is_present = follower is not None and follower.turn == self._turn(spacecraft_id)
        return not is_present or follower is None or newest_number > follower.consumed_number

    def _guarded(self, spacecraft_id: str, step: Callable[[], None]) -> None:
        """Do a step of one spacecraft; a fault is logged, the state is rebuilt and the journal tried again."""
        if self.failures.is_waiting(spacecraft_id):
            # the poll finds it again
            return
        try:
            step()
        except Exception as fault:  # noqa: BLE001 the supervisor outlives every fault; the chain is rebuilt from the archive
            if isinstance(fault, NotFoundError) and fault.code == "spacecraft.unknown":
                # deleted
                self.failures.forget(spacecraft_id, "step", "row")
            elif is_moving(fault):
                _LOG.warning("another process leads %s now: %s", spacecraft_id, fault)
            else:
                _LOG.exception(
                    "computing new rows of %s failed; its state is rebuilt from the archive and the step retried",
                    spacecraft_id,
                )
                is_outage = isinstance(fault, StorageError) and fault.code != "storage.corrupt"
                self.failures.note(spacecraft_id, "step", f"{type(fault).__name__}: {fault}", is_outage=is_outage)
            self._followers.pop(spacecraft_id, None)

    def _follow(self, spacecraft_id: str, up_to: float) -> None:
        """Take the next block of one journal, up to a number or to its end, and let what comes of it be stored."""
        turn = self._turn(spacecraft_id)
        if turn == 0:
            self._followers.pop(spacecraft_id, None)
            self.failures.forget(spacecraft_id, "row", "step")
            self._relay.poll(spacecraft_id)
            return
        self._relay.forget(spacecraft_id)
        follower = self._followers.get(spacecraft_id)
        if follower is None or follower.turn != turn:
            follower = self._rebuild(spacecraft_id, turn)
        if follower is None or self._is_stopping:
            return
        if follower.alignment is None and not follower.left and not self._take(follower, up_to):
            self.failures.forget(spacecraft_id, "step")
            return
        with follower.lock:
            entries, step = self._block(follower)
        self._submit(follower, entries, step)
        is_behind = follower.has_more and bool(entries) and entries[-1].number < up_to
        if follower.left or follower.alignment is not None or is_behind:
            # the others have their turn
            self.notify(spacecraft_id, up_to)

    def _take(self, follower: _Follower, up_to: float) -> bool:
        """Take the next entries; return whether there are any."""
        if follower.consumed_number >= up_to:
            return False
        index = (follower.spacecraft_id, follower.consumed_number, _ENTRIES_AT_ONCE)
        fresh = self._committed.after(*index)
        follower.left = fresh or self._storage.archive.journal(*index)
        # nothing unconsumed is ever dropped, so less than asked for was all; what came since has notified
        follower.has_more = bool(fresh) or len(follower.left) >= _ENTRIES_AT_ONCE
        if follower.left:
            # rows were stored before they were accepted: listeners need not wait for what is computed from them
            self._committed.followed(follower.spacecraft_id, follower.left)
        return bool(follower.left)

    def _block(self, follower: _Follower) -> tuple[list[JournalEntry], StepResults]:
        """Consume for some time, and return the entries that were consumed with what came of them.

        A block ends behind a command that counts as applied: control must have seen it, and may have tripped by it,
        before the next row is computed. Of an alignment with many rows after it there are blocks without an entry.
        """
        until_s = time.monotonic() + _BLOCK_S
        if follower.alignment is None and isinstance(follower.left[0].content, AlignmentSet):
            entry = follower.left.pop(0)
            rows = consume(follower.chain, entry, self._storage.archive, follower.spacecraft_id)
            follower.alignment = entry, rows
        if follower.alignment is not None:
            return self._realigned(follower, *follower.alignment, until_s)
        step, entries = StepResults(), follower.left
        follower.left = self._consume(follower, entries, step, until_s)
        stream_s = until_s - _BLOCK_S + _STEP_S
        # waiting for a commit after every few rows would never catch up with fast front ends
        while not (follower.left or step.has_applied or time.monotonic() >= stream_s or self._is_stopping):
            more = self._committed.after(follower.spacecraft_id, entries[-1].number, _ENTRIES_AT_ONCE)
            if not more:
                break
            self._committed.followed(follower.spacecraft_id, more)
            follower.left = self._consume(follower, more, step, until_s)
            entries = entries + more
        return entries[: len(entries) - len(follower.left)], step

    def _realigned(
        self, follower: _Follower, entry: JournalEntry, rows: Iterator[Outcome], until_s: float
    ) -> tuple[list[JournalEntry], StepResults]:
        """Run rows after an alignment; they are stored in blocks: of a year they would not fit into memory.

        The head stays before the alignment until all are stored, so a restart runs them again and adds what lacks.
        """
        outcomes: list[Outcome] = []
        for outcome in rows:
            outcomes.append(outcome)
            if len(outcomes) >= _ENTRIES_AT_ONCE or time.monotonic() >= until_s:
                return [], StepResults(outcomes)
        follower.alignment = None
        return [entry], StepResults(outcomes)

    def _submit(self, follower: _Follower, entries: list[JournalEntry], step: StepResults) -> None:
        """Let what came of entries be stored; no entries: one is not at its end yet."""
        spacecraft_id = follower.spacecraft_id
        rows = [entry.content for entry in entries if isinstance(entry.content, Measurement)]
        epochs_us = [row.epoch_us for row in rows if row.feeds_estimator]
        if epochs_us:
            follower.consumed_epoch_us = max(follower.consumed_epoch_us or epochs_us[0], *epochs_us)
        number = entries[-1].number if entries else follower.consumed_number
        with ExitStack() as steady:
            if self._release is not None and steady.enter_context(self._release.steady(spacecraft_id)):
                step.withhold(trips_after(self._storage.archive, spacecraft_id, follower.consumed_number))
            checkpoint = self._checkpoint(follower, number, PERIOD_US) if entries else None
            stored = self._storage.results.submit_outcomes(
                spacecraft_id, step.outcomes, number, follower.consumed_epoch_us, checkpoint
            )
            self._blocks.append(_Block(follower, entries, step, steady.pop_all(), checkpoint, stored))

    def _conclude_blocks(self) -> None:
        """Wait until the blocks are stored, and hand what came of them to those who look at it."""
        blocks, self._blocks = self._blocks, []
        for block in blocks:
            with block.steady:
                self._guarded(block.follower.spacecraft_id, partial(self._conclude, block))

    def _conclude(self, block: _Block) -> None:
        """Hand on what came of a block, once it is stored."""
        follower, entries, step = block.follower, block.entries, block.step
        spacecraft_id = follower.spacecraft_id
        sequence = block.stored.result()
        number = entries[-1].number if entries else follower.consumed_number
        for outcome in step.outcomes:
            self._note_row(spacecraft_id, outcome)
        follower.consumed_number = number
        before = follower.newest
        newest = before.after(number, sequence, entries, step.outcomes)
        if sequence - before.sequence != sum(len(each.rows) + (each.command is not None) for each in step.outcomes):
            # some were stored before, by a run under a former alignment, and stay as they are
            newest = newest._replace(rows={}, command=self._storage.results.newest_command(spacecraft_id, LIVE))
        follower.newest = newest
        if block.checkpoint is not None:
            follower.kept_us = follower.consumed_epoch_us
        if entries or sequence > before.sequence:
            self._publish(spacecraft_id, result_events(number, entries, step.outcomes, before.sequence, sequence))
        if any(outcome.applied is not None for outcome in step.outcomes):
            self.notify(spacecraft_id)
        if self._release is not None:
            others = (entry.content for entry in entries if not isinstance(entry.content, Measurement))
            has_inputs = any(not isinstance(content, AppliedCommand) for content in others)
            self._release.on_rows(spacecraft_id, step.released, has_inputs=has_inputs)
        if self._watcher is not None and step.seen:
            self._watcher.on_rows(spacecraft_id, step.seen)
        self.failures.forget(spacecraft_id, "step")

    def _consume(
        self, follower: _Follower, entries: list[JournalEntry], step: StepResults, until_s: float
    ) -> list[JournalEntry]:
        """Feed entries to the chain until an instant and note what came of them; at least one is fed.

        Return those behind that instant, behind the first applied command, or from an alignment on.
        """
        chain, index = follower.chain, 0
        while index < len(entries):
            content = entries[index].content
            if isinstance(content, AlignmentSet):
                break
            if isinstance(content, Measurement):
                rows = chain.rows(rows_from(entries, index, chain))
                step.note(chain, rows, is_watched=self._watcher is not None)
                index += len(rows)
            else:
                chain.update(content)
                step.seen += (content,) if isinstance(content, AttitudeReference) else ()
                index += 1
            if step.has_applied or time.monotonic() >= until_s:
                break
        return entries[index:]

    def _note_row(self, spacecraft_id: str, outcome: Outcome) -> None:
        """Note whether a row could be computed by every method."""
        failing = [row.method for row in outcome.rows if "internal_error" in row.inhibitions]
        if failing:
            self.failures.note(spacecraft_id, "row", f"rows of method {failing[0]} fail, the service log says where")
        else:
            self.failures.forget(spacecraft_id, "row")

    def _publish(self, spacecraft_id: str, events: tuple[FeedEvent, ...]) -> None:
        """Publish stored events if the spacecraft has subscribers."""
        # asked after it was stored: a later subscriber finds it in the archive
        if events and self._feed.has_subscribers(spacecraft_id):
            self._feed.publish(spacecraft_id, events)

    def _rebuild(self, spacecraft_id: str, turn: int) -> _Follower | None:
        """Bring a chain to where its results were stored; None if the service is stopped meanwhile."""
        head = self._storage.archive.head(spacecraft_id)
        back = self.restarts.chain(spacecraft_id, head.consumed_number)
        if back is None:
            return None
        chain, kept_us = back
        number, command = head.consumed_number, self._storage.results.newest_command(spacecraft_id, LIVE)
        newest = NewestResults(number, head.result_sequence, {}, command, number)
        follower = _Follower(spacecraft_id, chain, turn, number, head.consumed_epoch_us, newest, kept_us)
        self._followers[spacecraft_id] = follower
        self._committed.begin(spacecraft_id, follower.consumed_number)
        return follower

    def _checkpoint(self, follower: _Follower, number: int, after_us: int) -> Checkpoint | None:
        """Return the state of a chain after an entry if the last checkpoint is so much older."""
        epoch_us = follower.consumed_epoch_us
        if epoch_us is None or epoch_us - (follower.kept_us or 0) < after_us:
            return None
        return checkpoint_of(follower.chain, self._config, number, epoch_us)

    def _keep_states(self) -> None:
        """Store the state of every chain that has moved on since its last checkpoint, at a clean stop."""
        for spacecraft_id, follower in self._followers.items():
            turn, number = self._turn(spacecraft_id), follower.consumed_number
            # a chain within an entry is no state to go on from
            is_whole = bool(turn) and follower.turn == turn and follower.alignment is None
            checkpoint = self._checkpoint(follower, number, 1) if is_whole else None
            if checkpoint is None:
                continue
            try:
                self._storage.results.save_outcomes(
                    spacecraft_id, LIVE, [], number, follower.consumed_epoch_us, checkpoint
                )
            except Exception:  # noqa: BLE001 a stop goes on; the next start takes an older checkpoint
                _LOG.warning("the state of %s was not stored at the stop", spacecraft_id, exc_info=True)
