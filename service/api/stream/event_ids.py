"""Places in a stream: the ids of events, and what a stream says when it cannot go on from one without a hole.

The id ``yamal-202:1042.2084.17`` says: of this spacecraft, all measurements up to journal number 1042, all results up
to sequence 2084 and all changes of alarms up to sequence 17 were sent.
"""

import re
from collections.abc import Collection
from typing import Literal, get_args

from service.api.problems.problems import invalid_request
from service.api.schemas.base import Answer
from service.errors import FieldError
from service.records.epoch import format_epoch
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
