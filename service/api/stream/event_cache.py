"""Texts of events: what every client of a stream gets in the same words is written once.

Two hundred clients of a stream get the same measurement; writing it costs more than sending it. The newest texts are
kept, no more than a bound. Used inside the server's event loop only.
"""

import asyncio
from collections import OrderedDict, defaultdict

from starlette.concurrency import run_in_threadpool

from service.api.context.carrier_names import CarrierNameCache
from service.api.context.dependencies import ApiContext
from service.api.schemas.alarms import AlarmChangeAnswer
from service.api.schemas.attitude import AttitudeAnswer
from service.api.schemas.base import Answer
from service.api.schemas.measurement_rows import MeasurementAnswer
from service.api.schemas.status import StatusAnswer
from service.api.schemas.torques import TorqueAnswer
from service.api.stream.event_ids import PART_MOVED
from service.api.views.status import status_of
from service.ports import LIVE
from service.records.levels.attitude import AttitudeRow
from service.records.levels.command import TorqueCommand
from service.records.levels.measurement import Measurement
from service.records.operations.alarm import AlarmChange
from service.runtime.live.live_feed import FeedEvent

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
        """Return the document that the REST interface tells for the same thing."""
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
                return AttitudeAnswer.of(row, LIVE)
            case TorqueCommand() as command:
                return TorqueAnswer.of(command)
            case AlarmChange() as change:
                return AlarmChangeAnswer.of(change)
            case content:
                message = f"an event {event.kind} tells {type(content).__name__}"
                raise TypeError(message)


class StatusTexts:
    """State of each spacecraft, looked up once for all streams that ask together.

    Parameters
    ----------
    context : ApiContext
        Where to look.
    """

    def __init__(self, context: ApiContext) -> None:
        self._context = context
        self._locks: defaultdict[str, asyncio.Lock] = defaultdict(asyncio.Lock)
        self._known: dict[str, tuple[float, StatusAnswer]] = {}

    async def since(self, spacecraft_id: str, at_s: float) -> StatusAnswer:
        """Return a state that was looked up at an instant of the loop's clock or later."""
        async with self._locks[spacecraft_id]:
            known = self._known.get(spacecraft_id)
            if known is None or known[0] < at_s:
                began_s = asyncio.get_running_loop().time()
                known = (began_s, await run_in_threadpool(status_of, self._context, spacecraft_id))
                self._known[spacecraft_id] = known
        return known[1]


def _position(event: FeedEvent) -> int:
    """Return what tells an event from all others of its kind."""
    # several results stand under one journal number, several rows under one result sequence
    return event.cursor[PART_MOVED[event.kind]]
