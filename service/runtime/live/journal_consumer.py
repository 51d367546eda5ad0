"""Consumer of the journal: entries in, steps of the chain, results stored and published."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import islice, zip_longest
from typing import NamedTuple

from service.pipeline.chain import Chain, ChainRow
from service.pipeline.control.command.control_design import withheld_command
from service.pipeline.control.release.events import StoredRow
from service.pipeline.inputs.knowledge import KEPT_US
from service.pipeline.inputs.polarization import KEPT_US as POLARIZATION_US
from service.ports.archive import Archive, ListPart, Outcome, Results
from service.ports.storage import Catalogue
from service.records.calibration import Window
from service.records.catalogue import Release
from service.records.epoch import US_PER_S
from service.records.inputs import AlignmentSet, CalibrationActivation, JournalEntry
from service.records.levels.attitude import AttitudeRow, CarrierResults, TorqueCommand
from service.records.levels.measurement import Measurement
from service.records.operations.release import InterlockHold
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
