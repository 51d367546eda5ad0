"""Records without a number in the stream: state of a spacecraft, its commands, jobs, links and notes.

These change where they are; nobody numbers their changes. A stream looks at them when it beats and when the feed says
that something has changed, and sends those that differ from its last look. Streams that look together share one look.
Used inside the server's event loop only.
"""

import asyncio
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from starlette.concurrency import run_in_threadpool

from service.api.context.dependencies import ApiContext
from service.api.protocol.paging import EVERYTHING
from service.api.schemas.attitude import AttitudeAnswer
from service.api.schemas.base import Answer
from service.api.schemas.notes import NoteAnswer
from service.api.schemas.status import StatusAnswer
from service.api.schemas.torque_commands import CommandAnswer
from service.api.views.jobs import job_answer
from service.api.views.links import link_answers
from service.api.views.status import status_of
from service.ports import SMOOTHED
from service.records.catalogue import Method

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
    found = context.release_service.commands(spacecraft_id, EVERYTHING, _NEWEST, newest_first=True)
    return {command.counter: _record(CommandAnswer.of(command)) for command in found}


def _jobs(context: ApiContext, _spacecraft_id: str) -> Records:
    return {job.id: _record(job_answer(context, job)) for job in context.storage.results.newest_jobs(_NEWEST)}


def _links(context: ApiContext, spacecraft_id: str) -> Records:
    answers = link_answers(context, context.storage.links.links(spacecraft_id))
    return {answer.id: _record(answer) for answer in answers}


def _notes(context: ApiContext, spacecraft_id: str) -> Records:
    found = context.storage.notes.last_written(_NEWEST, spacecraft_id)
    # oldest first, as they are sent
    return {note.id: _record(NoteAnswer.of(note)) for note in reversed(found)}


def _smoothed(context: ApiContext, spacecraft_id: str) -> Records:
    read = context.storage.results.attitude_rows
    found = read(spacecraft_id, SMOOTHED, Method.ROBUST_SMOOTHED, EVERYTHING, _NEWEST_SMOOTHED, None, newest_first=True)
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
