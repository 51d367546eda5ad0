"""Events of a stream: ids, texts that are written once, backlog of the archive, records without a number."""

import asyncio
import re
from collections import OrderedDict, defaultdict
from collections.abc import Callable, Collection, Mapping
from typing import Any, Literal, NamedTuple, get_args

from starlette.concurrency import run_in_threadpool

from service.api.context import ApiContext, CarrierNameCache
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import EVERYTHING
from service.api.schemas.access import JobAnswer
from service.api.schemas.base import Answer
from service.api.schemas.control import (
    AttitudeAnswer,
    AttitudeEventAnswer,
    CommandAnswer,
    RowCarriersAnswer,
    TorqueAnswer,
)
from service.api.schemas.measurements import MeasurementAnswer
from service.api.schemas.shift import AlarmChangeAnswer, NoteAnswer, StatusAnswer
from service.api.views.present import link_answers, status_of
from service.errors import FieldError
from service.ports.archive import LIVE, SMOOTHED, ListPart
from service.ports.storage import Storage
from service.records.catalogue import Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import AttitudeRow, CarrierResults, TorqueCommand
from service.records.levels.measurement import Measurement
from service.records.operations.alarms import AlarmChange
from service.runtime.live.live_feed import Cursor, DroppedRows, FeedEvent

#: longest id: the longest name of a spacecraft and three numbers
MAX_ID_LENGTH = 128
_EVENT_ID = re.compile(r"([a-z0-9][a-z0-9-]{0,63}):(\d{1,18})\.(\d{1,18})\.(\d{1,18})", re.ASCII)
_POINTER = "/header/Last-Event-ID"
#: kinds of events that a client may choose; `dropped` comes in any case
EventName = Literal[
    "measurement", "attitude", "torque", "alarm", "status", "command", "job", "link", "note", "smoothed"
]
EVENT_NAMES: tuple[EventName, ...] = get_args(EventName)
#: part of the place that a kind of event moves; others move none
PART_MOVED = {"measurement": 0, "attitude": 1, "torque": 1, "alarm": 2}
#: histories by kind of event
_HISTORIES = {
    "measurement": "measurements/history",
    "attitude": "attitude/history",
    "torque": "torques/history",
    "alarm": "alarms",
}


class DroppedAnswer(Answer):
    """Some events did not come when they should have."""

    reason: Literal["slow_client", "retention", "archive_restored"]
    """The client did not keep up; the rows are no longer kept; the archive is older than the id."""
    counts: dict[str, int]
    """Events by kind; `result` = attitudes and torques that cannot be told apart any more; empty = not known."""
    follows: bool
    """True: they come next, read from the archive; otherwise this stream will not tell them."""
    history: list[str]
    """Paths that tell what is kept of them."""
    detail: str


def event_id(spacecraft_id: str, position: Cursor) -> str:
    """Return the id of a place."""
    return f"{spacecraft_id}:{position.number}.{position.sequence}.{position.alarm}"


def cursor_of(spacecraft_id: str, text: str | None) -> Cursor | None:
    """Return the place after which a client goes on, None without an id; 422 for what is no id of this stream."""
    if not text:
        return None
    match = _EVENT_ID.fullmatch(text)
    if match is None:
        detail = "this is no event id of a stream"
        raise invalid_request([FieldError(_POINTER, "cursor.invalid", detail)])
    if match.group(1) != spacecraft_id:
        detail = f"this id is of the stream of {match.group(1)}"
        raise invalid_request([FieldError(_POINTER, "cursor.spacecraft", detail)])
    return Cursor(*map(int, match.groups()[1:]))


def advanced(position: Cursor, event: FeedEvent) -> Cursor | None:
    """Return the place beyond an event, None when it lies behind the place already."""
    part = PART_MOVED.get(event.kind)
    if part is None or event.cursor[part] <= position[part]:
        return None
    if part == 1:
        # results are told with the newest row that they were computed from
        return Cursor(max(position.number, event.cursor.number), event.cursor.sequence, position.alarm)
    return position._replace(number=event.cursor.number) if part == 0 else position._replace(alarm=event.cursor.alarm)


def missed_by_slowness(spacecraft_id: str, dropped: DroppedRows, wanted: Collection[str]) -> DroppedAnswer:
    """Return what a client is told whose queue was full; of kinds that it did not choose nothing."""
    span = ""
    if dropped.first_us is not None and dropped.last_us is not None:
        span = f"?start={format_epoch(dropped.first_us)}&stop={format_epoch(dropped.last_us + 1)}"
    kinds = [kind for kind in _HISTORIES if dropped.counts[kind] and kind in wanted]
    return DroppedAnswer(
        reason="slow_client",
        counts={kind: dropped.counts[kind] for kind in kinds},
        follows=True,
        history=[f"/api/v1/spacecraft/{spacecraft_id}/{_HISTORIES[kind]}{span}" for kind in kinds],
        detail="events came faster than they were read; they follow from the archive, later than they could have been",
    )


def lost_to_retention(rows: int, results: int) -> DroppedAnswer:
    """Return what a client is told whose id is older than what is kept."""
    counts = {kind: count for kind, count in (("measurement", rows), ("result", results)) if count}
    detail = "the archive no longer keeps what came after the id that was sent; the stream goes on with what it keeps"
    return DroppedAnswer(reason="retention", counts=counts, follows=False, history=[], detail=detail)


def beyond_the_archive() -> DroppedAnswer:
    """Return what a client is told whose id lies ahead of the archive."""
    detail = (
        "the id lies ahead of the archive, which was set back, to a backup perhaps; the stream goes on with the "
        "present, and rows that came again may be told a second time"
    )
    return DroppedAnswer(reason="archive_restored", counts={}, follows=False, history=[], detail=detail)


#: journal entries and results read in one go
_AT_ONCE = 200
#: sequences looked through in one go where nothing is kept
_MOST_AT_ONCE = 10_000


class Page(NamedTuple):
    """The next events beyond a place."""

    events: list[FeedEvent]
    #: where the page ends
    position: Cursor
    #: what is no longer kept of what the page spans
    lost: DroppedAnswer | None


class ArchiveReader:
    """Reads one spacecraft's events; called outside the event loop.

    Parameters
    ----------
    storage : Storage
        Archive and results.
    names : CarrierNameCache
        Learns the plans of rows that are read.
    spacecraft_id : str
        An existing spacecraft.
    """

    def __init__(self, storage: Storage, names: CarrierNameCache, spacecraft_id: str) -> None:
        self._storage = storage
        self._names = names
        self._spacecraft_id = spacecraft_id
        self._results_at_once = _AT_ONCE

    def present_and_end(self) -> tuple[Cursor, Cursor]:
        """Return the place of the present, and the greatest place that an id can name."""
        head = self._storage.archive.head(self._spacecraft_id)
        alarm = self._storage.alarms.newest_sequence()
        present = Cursor(head.consumed_number, head.result_sequence, alarm)
        return present, present._replace(number=head.newest_number)

    def next_page(self, position: Cursor) -> Page:
        """Return the next measurements, results and changes of alarms beyond a place, in this order."""
        head = self._storage.archive.head(self._spacecraft_id)
        rows, number, lost_rows = self._rows(position)
        # no result comes before its row: one that was stored after the rows were read waits for the next page
        last = number if number > position.number else head.newest_number
        results, sequence, lost_results = self._results(position._replace(number=number), head.result_sequence, last)
        lost = lost_to_retention(lost_rows, lost_results) if lost_rows or lost_results else None
        changes = self._changes(position._replace(number=number, sequence=sequence))
        reached = changes[-1].cursor if changes else position._replace(number=number, sequence=sequence)
        return Page([*rows, *results, *changes], reached, lost)

    def _changes(self, position: Cursor) -> list[FeedEvent]:
        """Return the next changes of alarms; their numbers are shared by all spacecraft, so none is missed in a gap."""
        found = self._storage.alarms.changes_after(self._spacecraft_id, position.alarm, _AT_ONCE)
        return [FeedEvent("alarm", position._replace(alarm=change.sequence), change) for change in found]

    def _rows(self, position: Cursor) -> tuple[list[FeedEvent], int, int]:
        """Return the next measurements, the number that they reach to, and how many numbers are missing."""
        events, number, lost = [], position.number, 0
        for entry in self._storage.archive.journal(self._spacecraft_id, number, _AT_ONCE, is_compared=True):
            lost += entry.number - number - 1
            number = entry.number
            if isinstance(entry.content, Measurement):
                self._names.of(self._spacecraft_id, entry.content.plan_id)
                events.append(FeedEvent("measurement", position._replace(number=number), entry.content))
        return events, number, lost

    def _results(self, position: Cursor, newest: int, last_number: int) -> tuple[list[FeedEvent], int, int]:
        """Return the next results of rows up to a number, the sequence that they reach to, and how many are missing."""
        events, sequence, lost = [], position.sequence, 0
        results = self._storage.results
        found = results.results_after(self._spacecraft_id, sequence, self._results_at_once)
        carriers = results.carriers_after(self._spacecraft_id, found[0][0] - 1, found[-1][0]) if found else {}
        for at, result in found:
            if result.number > last_number:
                break
            lost += at - sequence - 1
            sequence = at
            kind = "attitude" if isinstance(result, AttitudeRow) else "torque"
            events.append(FeedEvent(kind, position._replace(sequence=sequence), result, carriers.get(sequence)))
        for plan_id in {each.plan_id for each in carriers.values()}:
            self._names.of(self._spacecraft_id, plan_id)
        if found or sequence >= newest:
            self._results_at_once = _AT_ONCE
            return events, sequence, lost
        # nothing is kept of this stretch: look further each time
        reached = min(newest, sequence + self._results_at_once)
        self._results_at_once = min(2 * self._results_at_once, _MOST_AT_ONCE)
        return events, reached, reached - sequence


#: about 2 MB of texts
_KEPT = 1024


class EventTexts:
    """JSON of events, each written once.

    Parameters
    ----------
    names : CarrierNameCache
        Carriers of the plans.
    """

    def __init__(self, names: CarrierNameCache) -> None:
        self._names = names
        self._texts: OrderedDict[tuple[str, str, int], bytes] = OrderedDict()

    def of(self, spacecraft_id: str, event: FeedEvent) -> bytes:
        """Return the document that the REST interface tells for the same thing; of attitude with the carriers."""
        key = (spacecraft_id, event.kind, _position(event))
        text = self._texts.get(key)
        if text is None:
            text = self._texts[key] = self._answer(spacecraft_id, event).model_dump_json().encode()
            if len(self._texts) > _KEPT:
                self._texts.popitem(last=False)
        return text

    def _answer(self, spacecraft_id: str, event: FeedEvent) -> Answer:
        """Return the document of an event's content."""
        match event.content:
            case Measurement() as row:
                return MeasurementAnswer.of(row, self._names.of(spacecraft_id, row.plan_id))
            case AttitudeRow() as row:
                return AttitudeEventAnswer.of(row, LIVE, carriers=self._carriers(spacecraft_id, event.carriers))
            case TorqueCommand() as command:
                return TorqueAnswer.of(command)
            case AlarmChange() as change:
                return AlarmChangeAnswer.of(change)
            case content:
                message = f"an event {event.kind} tells {type(content).__name__}"
                raise TypeError(message)

    def _carriers(self, spacecraft_id: str, results: CarrierResults | None) -> RowCarriersAnswer | None:
        if results is None:
            return None
        return RowCarriersAnswer.of(results, self._names.of(spacecraft_id, results.plan_id))


def _position(event: FeedEvent) -> int:
    """Return what tells an event from all others of its kind."""
    # several results stand under one journal number, several rows under one result sequence
    return event.cursor[PART_MOVED[event.kind]]


#: of each kind so many are looked at, the newest ones; between two looks fewer change
_NEWEST = 20
#: the same of smoothed rows, of which one comes in five minutes
_NEWEST_SMOOTHED = 4
#: members that grow by themselves
_AGES = {"age_s", "last_good_age_s"}


class Record(NamedTuple):
    """One record as it was looked up."""

    #: differs where anything but an age does
    mark: bytes
    text: bytes


#: records of one kind by id
Records = Mapping[Any, Record]


class PresentRecords:
    """State and records of each spacecraft, looked up once for all streams that ask together.

    Parameters
    ----------
    context : ApiContext
        Where to look.
    """

    def __init__(self, context: ApiContext) -> None:
        self._context = context
        self._locks: defaultdict[tuple[str, str], asyncio.Lock] = defaultdict(asyncio.Lock)
        self._known: dict[tuple[str, str], tuple[float, Any]] = {}

    async def status(self, spacecraft_id: str, at_s: float) -> StatusAnswer:
        """Return a state that was looked up at an instant of the loop's clock or later."""
        status: StatusAnswer = await self._since(spacecraft_id, "status", at_s, status_of)
        return status

    async def records(self, spacecraft_id: str, kind: str, at_s: float) -> Records:
        """Return the newest commands, jobs, links or notes as of an instant of the loop's clock or later."""
        records: Records = await self._since(spacecraft_id, kind, at_s, READERS[kind])
        return records

    async def _since(self, spacecraft_id: str, kind: str, at_s: float, read: Callable[[ApiContext, str], Any]) -> Any:
        key = (spacecraft_id, kind)
        async with self._locks[key]:
            known = self._known.get(key)
            if known is None or known[0] < at_s:
                began_s = asyncio.get_running_loop().time()
                known = self._known[key] = (began_s, await run_in_threadpool(read, self._context, spacecraft_id))
        return known[1]


def _commands(context: ApiContext, spacecraft_id: str) -> Records:
    found = context.storage.releases.commands(spacecraft_id, ListPart(EVERYTHING, _NEWEST, newest_first=True))
    return {command.counter: _record(CommandAnswer.of(command)) for command in found}


def _jobs(context: ApiContext, _spacecraft_id: str) -> Records:
    return {job.id: _record(JobAnswer.of(job)) for job in context.storage.results.newest_jobs(_NEWEST)}


def _links(context: ApiContext, spacecraft_id: str) -> Records:
    answers = link_answers(context, context.storage.links.links(spacecraft_id))
    return {answer.id: _record(answer) for answer in answers}


def _notes(context: ApiContext, spacecraft_id: str) -> Records:
    found = context.storage.notes.last_written(_NEWEST, spacecraft_id)
    # oldest first, as they are sent
    return {note.id: _record(NoteAnswer.of(note)) for note in reversed(found)}


def _smoothed(context: ApiContext, spacecraft_id: str) -> Records:
    read = context.storage.results.attitude_rows
    found = read(
        spacecraft_id, SMOOTHED, Method.ROBUST_SMOOTHED, ListPart(EVERYTHING, _NEWEST_SMOOTHED, newest_first=True)
    )
    # oldest first, as they are sent
    return {row.epoch_us: _record(AttitudeAnswer.of(row, SMOOTHED)) for row in reversed(found)}


def _record(answer: Answer) -> Record:
    return Record(answer.model_dump_json(exclude=_AGES).encode(), answer.model_dump_json().encode())


#: by kind of event
READERS: Mapping[str, Callable[[ApiContext, str], Records]] = {
    "command": _commands,
    "job": _jobs,
    "link": _links,
    "note": _notes,
    "smoothed": _smoothed,
}
