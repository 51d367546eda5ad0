"""Consumer of the journal: entries in, steps of the chain, results stored and published; restart of a live chain.

A chain is brought back from its newest checkpoint, or from the last alignment where that is later or none fits. From
either on the journal is consumed again, silently, to where results were stored. Both ways give the same chain, bit
for bit.
"""

import logging
import struct
import time
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import islice, zip_longest
from tokenize import TokenError
from typing import NamedTuple

from service.pipeline.chain import Chain, ChainRow
from service.pipeline.checkpoints import ChainState, fingerprint, pack_state, unpack_state
from service.pipeline.config import ChainConfig
from service.pipeline.control.command.control_design import withheld_command
from service.pipeline.control.release.events import StoredRow
from service.pipeline.inputs.knowledge import KEPT_US
from service.pipeline.inputs.polarization import KEPT_US as POLARIZATION_US
from service.ports.archive import Archive, ListPart, Outcome, Results
from service.ports.storage import Catalogue, Storage
from service.records.calibration import Window
from service.records.catalogue import Release
from service.records.epoch import US_PER_S
from service.records.inputs import AlignmentSet, CalibrationActivation, JournalEntry
from service.records.levels.attitude import AttitudeRow, CarrierResults, TorqueCommand
from service.records.levels.measurement import Measurement
from service.records.operations.release import InterlockHold
from service.records.storage import Checkpoint
from service.runtime.live.live_feed import Cursor, FeedEvent, Seen

#: kinds of slow input that the chain must know from before an alignment; the others concern rows after it
STANDING_KINDS = ("spacecraft", "plan", "ephemeris", "activation", "operation", "interlock")
#: kinds that the chain must know as far as they reach beyond an alignment
MOTION_KINDS = ("correction", "applied_command", "released_command", "reported_command")
#: telemetry of longer ago is too old for any use that the chain makes of it
_TELEMETRY_US = 6 * 3600 * US_PER_S
_INPUTS_AT_ONCE = 1000
_FOR_EVER_US = _EVERY_NUMBER = 1 << 62


#: most rows of a block of a replay, and of a live journal
BLOCK_ROWS, _LIVE_ROWS = 128, 16


class DocumentCache:
    """Immutable documents of one spacecraft by number, each read once: plans, ephemerides, calibrations, alignments."""

    def __init__(self, catalogue: Catalogue, results: Results, spacecraft_id: str) -> None:
        self.plan = cache(partial(catalogue.plan, spacecraft_id))
        self.ephemeris = cache(partial(catalogue.ephemeris, spacecraft_id))
        self.calibration = cache(partial(results.calibration, spacecraft_id))
        self.alignment = cache(partial(results.alignment, spacecraft_id))


class Trip(NamedTuple):
    """Trip of control as it stands in the journal."""

    number: int
    at_us: int


def trips_after(archive: Archive, spacecraft_id: str, number: int) -> tuple[Trip, ...]:
    """Return the trips that the journal tells beyond a number."""
    entries = archive.slow_inputs_before(spacecraft_id, _EVERY_NUMBER, ("interlock",))
    holds = ((entry.number, entry.content) for entry in entries if entry.number > number)
    return tuple(Trip(n, hold.at_us) for n, hold in holds if isinstance(hold, InterlockHold) and hold.is_withheld)


def without_torque_after(trips: Sequence[Trip], outcome: Outcome) -> Outcome:
    """Return an outcome without torque where its row is later than a trip that the journal tells only behind it.

    The chain knows of a trip from its entry on. Rows that were stored before the entry and computed after the trip are
    the same in a live run and in its replay by this rule alone.
    """
    command = outcome.command
    if command is None or not command.control_allowed:
        return outcome
    if not any(trip.number > command.number and trip.at_us < command.attitude_epoch_us for trip in trips):
        return outcome
    return replace(outcome, command=withheld_command(command), applied=None)


def consume(chain: Chain, entry: JournalEntry, archive: Archive, spacecraft_id: str) -> Iterator[Outcome]:
    """Feed one entry to the chain and yield what came of each row."""
    content = entry.content
    if isinstance(content, Measurement):
        yield from (outcome for _, outcome in consume_rows(chain, [content]))
        return
    chain.update(content)
    if isinstance(content, AlignmentSet) and chain.knowledge.alignment is not None:
        rows = iter(archive.measurements_after(spacecraft_id, chain.knowledge.alignment.epoch_us, entry.number))
        while block := list(islice(rows, BLOCK_ROWS)):
            yield from (each.outcome for each in chain.rows(block, is_catch_up=True) if each.outcome is not None)


def consume_rows(chain: Chain, rows: Sequence[Measurement]) -> Iterator[tuple[Measurement, Outcome]]:
    """Feed rows that follow one another in the journal to the chain, and yield each that something came of."""
    yield from ((each.measurement, each.outcome) for each in chain.rows(rows) if each.outcome is not None)


def update_before(chain: Chain, archive: Archive, spacecraft_id: str, before_number: int, since_us: int | None) -> None:
    """Update a chain with the inputs that stand before a journal number.

    Standing inputs are told from the beginning, commanded motion as far as it ends after ``since_us``, the epoch from
    which rows will be run, records of sensors of the hours before it; None when no row will.
    """
    entries = archive.slow_inputs_before(spacecraft_id, before_number, STANDING_KINDS)
    if since_us is not None:
        window = Window(since_us, _FOR_EVER_US)
        windows = {
            **dict.fromkeys(MOTION_KINDS, window),
            "telemetry": Window(since_us - _TELEMETRY_US, _FOR_EVER_US),
            "weather": Window(since_us - KEPT_US, _FOR_EVER_US),
            "polarization": Window(since_us - POLARIZATION_US, _FOR_EVER_US),
        }
        for kind, of_kind in windows.items():
            entries += [e for e in every_input(archive, spacecraft_id, kind, of_kind) if e.number < before_number]
    for entry in sorted(entries, key=lambda entry: entry.number):
        if not isinstance(entry.content, Measurement):
            chain.update(entry.content)


def every_input(
    archive: Archive, spacecraft_id: str, kind: str, window: Window, *, is_compared: bool = False
) -> Iterator[JournalEntry]:
    """Yield the slow inputs of a kind that overlap a window, in order of start and number."""
    after: tuple[int, int] | None = None
    while True:
        page = archive.inputs(spacecraft_id, kind, ListPart(window, _INPUTS_AT_ONCE, after), is_compared=is_compared)
        yield from page
        if len(page) < _INPUTS_AT_ONCE:
            return
        after = page[-1].start_us or 0, page[-1].number


#: what makes results of another kind than those before
_RESTARTING = (AlignmentSet, CalibrationActivation)


@dataclass(slots=True)
class StepResults:
    """Results of some entries of the journal."""

    outcomes: list[Outcome] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    released: list[StoredRow] = field(default_factory=list)

    def note(self, chain: Chain, rows: Sequence[ChainRow], *, is_watched: bool) -> None:
        """Note what came of rows; late ones are no input of alarms, and none is where there are no alarms."""
        for row in rows:
            if row.outcome is not None:
                self.outcomes.append(row.outcome)
                self.released.append(StoredRow(row.outcome, row.command_evidence()))
            if is_watched and row.measurement.feeds_estimator and not row.measurement.is_late:
                self.seen.append(chain.facts(row))

    @property
    def has_applied(self) -> bool:
        """Return whether the newest command counts as applied."""
        return bool(self.outcomes) and self.outcomes[-1].applied is not None

    def withhold(self, trips: Sequence[Trip]) -> None:
        """Remove the torque from rows that are later than a trip."""
        self.outcomes = [without_torque_after(trips, outcome) for outcome in self.outcomes]
        self.released = [one._replace(outcome=without_torque_after(trips, one.outcome)) for one in self.released]


def rows_from(entries: Sequence[JournalEntry], first: int, chain: Chain) -> list[Measurement]:
    """Return the rows that stand together from a place on, as many as are consumed in one go."""
    spacecraft, rows = chain.knowledge.spacecraft, []
    is_automatic = spacecraft is not None and spacecraft.control.release is Release.AUTOMATIC
    for entry in entries[first : first + (1 if is_automatic else _LIVE_ROWS)]:
        if not isinstance(entry.content, Measurement):
            break
        rows.append(entry.content)
    return rows


def result_events(
    number: int, entries: Sequence[JournalEntry], outcomes: Sequence[Outcome], first: int, last: int
) -> tuple[FeedEvent, ...]:
    """Return the events of the results of entries up to a journal number, stored under the sequences after ``first``.

    Of rows that an alignment ran again some results may have been stored before. Which ones the archive knows alone, so
    subscribers are told, by a status event without content, to read there; the same says that a new alignment or
    calibration holds.
    """
    events: list[FeedEvent] = []
    results = [result for outcome in outcomes for result in _results(outcome)]
    is_whole = len(results) == last - first
    if is_whole:
        events += [
            FeedEvent(kind, Cursor(number, sequence), result, carriers)
            for sequence, (kind, result, carriers) in enumerate(results, start=first + 1)
        ]
    if not is_whole or any(isinstance(entry.content, _RESTARTING) for entry in entries):
        events.append(FeedEvent("status", Cursor(number, last), None))
    return tuple(events)


def _results(outcome: Outcome) -> Iterator[tuple[str, AttitudeRow | TorqueCommand, CarrierResults | None]]:
    """Yield kind and results of a row in the order in which they are stored, with what is known of the carriers."""
    # nothing is known of the carriers of a late row
    yield from (("attitude", row, carriers) for row, carriers in zip_longest(outcome.rows, outcome.carriers))
    if outcome.command is not None:
        yield "torque", outcome.command, None


_LOG = logging.getLogger("soo.restart")

#: of data between two checkpoints, us
PERIOD_US = 3600 * US_PER_S
#: an alignment may reach back so far before a checkpoint, us
KNOWN_US = 7 * 86_400 * US_PER_S
#: between two looks at whether the service stops: a third of a second of the processor at most
_ENTRIES_AT_ONCE = 64
#: what zip, deflate, JSON and numpy say of damaged bytes
_UNREADABLE = (
    *(ArithmeticError, AttributeError, EOFError, LookupError, OSError, RuntimeError, TypeError, ValueError),
    *(SyntaxError, TokenError, struct.error, zipfile.BadZipFile, zlib.error),
)


def checkpoint_of(chain: Chain, config: ChainConfig, number: int, epoch_us: int) -> Checkpoint | None:
    """Return the state of a chain after an entry of the journal; None where it cannot be saved now."""
    state = chain.saved()
    return None if state is None else Checkpoint(number, epoch_us, fingerprint(config), pack_state(state))


class Restarting(NamedTuple):
    """Restart under way."""

    spacecraft_id: str
    #: entries of the journal that are still to be consumed again
    entries_left: int
    #: at the pace so far; None = nothing is consumed yet
    seconds_left: float | None


class ChainRestarts:
    """Restarts of the chains of a service, one at a time.

    Parameters
    ----------
    storage : Storage
        Journal and checkpoints.
    config : ChainConfig
        Configuration of every chain.
    is_stopping : callable
        Whether the service stops: a restart then ends before its time.
    """

    def __init__(self, storage: Storage, config: ChainConfig, is_stopping: Callable[[], bool]) -> None:
        self._storage = storage
        self._config = config
        self._is_stopping = is_stopping
        #: restart that is under way
        self.under_way: Restarting | None = None

    def chain(self, spacecraft_id: str, consumed_number: int) -> tuple[Chain, int | None] | None:
        """Return the chain as it was after a journal number, and the newest epoch of the checkpoint that it began with.

        Microseconds UTC, None where it began at an alignment. None in place of both if the service stops before.
        """
        storage = self._storage
        chain = Chain(DocumentCache(storage.catalogue, storage.results, spacecraft_id), self._config)
        number, aligned_us = _last_alignment(storage, spacecraft_id, consumed_number)
        kept = restored_checkpoint(storage, spacecraft_id, chain, self._config, number or 0, consumed_number)
        if kept is None:
            update_before(chain, storage.archive, spacecraft_id, number or consumed_number + 1, aligned_us)
        position = kept.number if kept is not None else consumed_number if number is None else number - 1
        began_s, first = time.monotonic(), consumed_number - position
        try:
            for left in _entries_left(chain, storage.archive, spacecraft_id, position, consumed_number):
                passed_s = time.monotonic() - began_s
                seconds_left = passed_s * left / (first - left) if left < first else None
                self.under_way = Restarting(spacecraft_id, left, seconds_left)
                if self._is_stopping():
                    return None
        finally:
            self.under_way = None
        return chain, None if kept is None else kept.epoch_us


def _entries_left(
    chain: Chain, archive: Archive, spacecraft_id: str, position: int, consumed_number: int
) -> Iterator[int]:
    """Let a chain consume the entries behind a position, and yield how many are left; nothing is stored."""
    while position < consumed_number:
        yield consumed_number - position
        entries = archive.journal(spacecraft_id, position, _ENTRIES_AT_ONCE)
        for entry in entries:
            if entry.number <= consumed_number:
                for row, _ in enumerate(consume(chain, entry, archive, spacecraft_id), start=1):
                    if row % _ENTRIES_AT_ONCE == 0:
                        # an alignment brings all rows after its epoch
                        yield consumed_number - position
        position = entries[-1].number if entries else consumed_number


def restored_checkpoint(
    storage: Storage,
    spacecraft_id: str,
    chain: Chain,
    config: ChainConfig,
    after_number: int,
    until_number: int,
    before_us: int | None = None,
) -> Checkpoint | None:
    """Restore a new chain from the newest checkpoint that fits and can be read, and return the checkpoint.

    Parameters
    ----------
    storage, spacecraft_id, chain, config
        Where it is kept, and the chain that goes on from it.
    after_number, until_number : int
        It must be later than the first and not later than the second.
    before_us : int, optional
        Its newest epoch must be earlier, microseconds UTC.
    """
    for found in storage.results.checkpoints(spacecraft_id, fingerprint(config), until_number, before_us):
        if found.number <= after_number:
            break
        state = state_of(spacecraft_id, found)
        if state is not None:
            update_before(chain, storage.archive, spacecraft_id, found.number + 1, found.epoch_us - KNOWN_US)
            chain.restore(state)
            return found
    return None


def numbered_alignments(results: Results, spacecraft_id: str) -> list[tuple[int, int]]:
    """Return journal number and epoch of every alignment of a spacecraft."""
    alignments = results.alignments(spacecraft_id)
    return [(results.alignment_number(spacecraft_id, each.id), each.epoch_us) for each in alignments]


def state_of(spacecraft_id: str, found: Checkpoint) -> ChainState | None:
    """Return the state of a checkpoint; None where it cannot be read."""
    try:
        return unpack_state(found.content)
    except _UNREADABLE as fault:
        _LOG.warning("checkpoint %d of %s cannot be read: %s", found.number, spacecraft_id, fault)
        return None


def _last_alignment(storage: Storage, spacecraft_id: str, consumed_number: int) -> tuple[int | None, int | None]:
    """Return journal number and epoch of the newest consumed alignment."""
    entries = storage.archive.slow_inputs_before(spacecraft_id, consumed_number + 1, ("alignment",))
    for entry in reversed(entries):
        if isinstance(entry.content, AlignmentSet):
            alignment = storage.results.alignment(spacecraft_id, entry.content.alignment_id)
            return entry.number, alignment.epoch_us
    return None, None
