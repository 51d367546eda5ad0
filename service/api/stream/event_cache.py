"""Texts of events: what every client of a stream gets in the same words is written once.

Two hundred clients of a stream get the same measurement; writing it costs more than sending it. The newest texts are
kept, no more than a bound. Used inside the server's event loop only.
"""

from collections import OrderedDict

from service.api.context.carrier_names import CarrierNameCache
from service.api.schemas.alarms import AlarmChangeAnswer
from service.api.schemas.attitude import AttitudeEventAnswer, RowCarriersAnswer
from service.api.schemas.base import Answer
from service.api.schemas.measurement_rows import MeasurementAnswer
from service.api.schemas.torques import TorqueAnswer
from service.api.stream.event_ids import PART_MOVED
from service.ports import LIVE
from service.records.levels.attitude import AttitudeRow
from service.records.levels.carrier_results import CarrierResults
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
        """Return the carriers of a row."""
        if results is None:
            return None
        return RowCarriersAnswer.of(results, self._names.of(spacecraft_id, results.plan_id))


def _position(event: FeedEvent) -> int:
    """Return what tells an event from all others of its kind."""
    # several results stand under one journal number, several rows under one result sequence
    return event.cursor[PART_MOVED[event.kind]]
