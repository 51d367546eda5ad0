"""Consumer of the journal: entries in, steps of the chain, results stored and published."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, zip_longest
from typing import NamedTuple

from service.pipeline.chain import Chain
from service.pipeline.control.command.control_design import withheld_command
from service.pipeline.control.release.events import StoredRow
from service.pipeline.inputs.knowledge import KEPT_US
from service.pipeline.inputs.polarization import KEPT_US as POLARIZATION_US
from service.ports.archive import Archive, ListPart, Outcome, Results
from service.ports.storage import Catalogue
from service.records.calibration import Alignment, Calibration, Window
from service.records.catalogue import CarrierPlan, Ephemeris
from service.records.epoch import US_PER_S
from service.records.inputs import (
    AlignmentSet,
    AttitudeReference,
    CalibrationActivation,
    Correction,
    JournalEntry,
    PolarizationRecord,
    TelemetryRecord,
    WeatherReport,
)
from service.records.levels.attitude import (
    AppliedCommand,
    AttitudeRow,
    CarrierResults,
    ReleasedCommand,
    ReportedCommand,
    TorqueCommand,
)
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


#: rows that the chain takes at once where nobody looks at it between them
BLOCK_ROWS = 128


class DocumentCache:
    """Immutable documents of one spacecraft by number, each read once."""

    def __init__(self, catalogue: Catalogue, results: Results, spacecraft_id: str) -> None:
        self._catalogue = catalogue
        self._results = results
        self._spacecraft_id = spacecraft_id
        self._plans: dict[int, CarrierPlan] = {}
        self._ephemerides: dict[int, Ephemeris] = {}
        self._calibrations: dict[int, Calibration] = {}
        self._alignments: dict[int, Alignment] = {}

    def plan(self, plan_id: int) -> CarrierPlan:
        """Return a carrier plan."""
        if plan_id not in self._plans:
            self._plans[plan_id] = self._catalogue.plan(self._spacecraft_id, plan_id)
        return self._plans[plan_id]

    def ephemeris(self, ephemeris_id: int) -> Ephemeris:
        """Return an ephemeris."""
        if ephemeris_id not in self._ephemerides:
            self._ephemerides[ephemeris_id] = self._catalogue.ephemeris(self._spacecraft_id, ephemeris_id)
        return self._ephemerides[ephemeris_id]

    def calibration(self, calibration_id: int) -> Calibration:
        """Return a calibration that has its result."""
        if calibration_id not in self._calibrations:
            self._calibrations[calibration_id] = self._results.calibration(self._spacecraft_id, calibration_id)
        return self._calibrations[calibration_id]

    def alignment(self, alignment_id: int) -> Alignment:
        """Return an alignment."""
        if alignment_id not in self._alignments:
            self._alignments[alignment_id] = self._results.alignment(self._spacecraft_id, alignment_id)
        return self._alignments[alignment_id]


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
        outcome = chain.step(content)
        if outcome is not None:
            yield outcome
        return
    chain.update(content)
    if isinstance(content, AlignmentSet) and chain.knowledge.alignment is not None:
        rows = iter(archive.measurements_after(spacecraft_id, chain.knowledge.alignment.epoch_us, entry.number))
        while block := list(islice(rows, BLOCK_ROWS)):
            yield from (each for each in chain.steps(block, is_catch_up=True) if each is not None)


def consume_rows(chain: Chain, rows: Sequence[Measurement]) -> Iterator[tuple[Measurement, Outcome]]:
    """Feed rows that follow one another in the journal to the chain, and yield each that something came of."""
    for row, outcome in zip(rows, chain.steps(rows), strict=True):
        if outcome is not None:
            yield row, outcome


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
            entries += [e for e in _inputs(archive, spacecraft_id, kind, of_kind) if e.number < before_number]
    for entry in sorted(entries, key=lambda entry: entry.number):
        if not isinstance(entry.content, Measurement):
            chain.update(entry.content)


def _inputs(archive: Archive, spacecraft_id: str, kind: str, window: Window) -> Iterator[JournalEntry]:
    """Yield the slow inputs of a kind that overlap a window."""
    after: tuple[int, int] | None = None
    while True:
        page = archive.inputs(spacecraft_id, kind, ListPart(window, _INPUTS_AT_ONCE, after), is_compared=False)
        yield from page
        if len(page) < _INPUTS_AT_ONCE:
            return
        after = (_start_us(page[-1]), page[-1].number)


def _start_us(entry: JournalEntry) -> int:
    """Return where a commanded motion starts or a record of a sensor stands, by which pages are ordered."""
    content = entry.content
    if isinstance(content, TelemetryRecord | WeatherReport | PolarizationRecord):
        return content.epoch_us
    if isinstance(content, Correction):
        return content.start_us
    if isinstance(content, AppliedCommand):
        return content.command.epoch_us
    if isinstance(content, ReleasedCommand):
        return content.released_us
    if isinstance(content, ReportedCommand):
        return content.reported_us
    message = f"journal entry {entry.number} is no commanded motion, telemetry, weather or polarisation"
    raise TypeError(message)


#: what makes results of another kind than those before
_RESTARTING = (AlignmentSet, CalibrationActivation)


@dataclass(slots=True)
class StepResults:
    """Results of some entries of the journal."""

    outcomes: list[Outcome] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    released: list[StoredRow] = field(default_factory=list)

    @property
    def has_applied(self) -> bool:
        """Return whether the newest command counts as applied."""
        return bool(self.outcomes) and self.outcomes[-1].applied is not None

    def withhold(self, trips: Sequence[Trip]) -> None:
        """Remove the torque from rows that are later than a trip."""
        self.outcomes = [without_torque_after(trips, outcome) for outcome in self.outcomes]
        self.released = [one._replace(outcome=without_torque_after(trips, one.outcome)) for one in self.released]


def seen_of(chain: Chain, entry: JournalEntry, outcomes: Sequence[Outcome]) -> tuple[Seen, ...]:
    """Return the input of alarms in an entry; late rows, and rows that an alignment recomputed, are none."""
    content = entry.content
    if isinstance(content, AttitudeReference):
        return (content,)
    if not isinstance(content, Measurement) or content.is_late or not content.feeds_estimator:
        return ()
    return (chain.facts(content, outcomes[0] if outcomes else None),)


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
            FeedEvent(_kind(result), Cursor(number, sequence), result, carriers)
            for sequence, (result, carriers) in enumerate(results, start=first + 1)
        ]
    if not is_whole or any(isinstance(entry.content, _RESTARTING) for entry in entries):
        events.append(FeedEvent("status", Cursor(number, last), None))
    return tuple(events)


def _results(outcome: Outcome) -> Iterator[tuple[AttitudeRow | TorqueCommand, CarrierResults | None]]:
    """Yield the results of a row in the order in which they are stored, with what is known of the carriers."""
    # nothing is known of the carriers of a late row
    yield from zip_longest(outcome.rows, outcome.carriers)
    if outcome.command is not None:
        yield outcome.command, None


def _kind(result: AttitudeRow | TorqueCommand) -> str:
    """Return the kind of event that tells a result."""
    return "attitude" if isinstance(result, AttitudeRow) else "torque"
