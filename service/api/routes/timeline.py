"""Timeline: intervals and marks of a span in one answer."""

from fastapi import APIRouter

from service.api.context.dependencies import Context, SpacecraftId
from service.api.context.method_parameters import check_method
from service.api.protocol.paging import EVERYTHING, StartParameter, StopParameter, window_of
from service.api.routes.samples import MethodsParameter
from service.api.schemas.timeline import TimelineAnswer
from service.api.views.timeline import Timeline
from service.ports import LIVE
from service.records.catalogue import LIVE_METHODS

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["archive"])


@router.get("/timeline")
def get_timeline(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: StartParameter = None,
    stop: StopParameter = None,
    method: MethodsParameter = None,
) -> TimelineAnswer:
    """Return states of the live rows as intervals, with gaps, operations, corrections, commands, alarms and notes."""
    methods = tuple(dict.fromkeys(method or LIVE_METHODS))
    for each in methods:
        check_method(each, LIVE)
    return Timeline(context, spacecraft_id, window_of(start, stop, EVERYTHING)).answer(methods)
