"""Alarms: the active ones, their history, and the actions of operators."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Path, Query

from service.api.access.auth import MAY_OPERATE, CurrentPrincipal
from service.api.context.dependencies import Context, SpacecraftId
from service.api.protocol.bodies import accepts, body_of
from service.api.protocol.paging import Page
from service.api.routes.comments import Said, accepts_comment
from service.api.schemas.alarms import (
    AlarmAnswer,
    AlarmChangeAnswer,
    AlarmHistoryAnswer,
    AlarmPage,
    ShelveDocument,
    StateWord,
)
from service.records.operations.alarm import Alarm

#: lists stand below a spacecraft, ids are global
list_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/alarms", tags=["alarms"])
router = APIRouter(prefix="/alarms", tags=["alarms"])
AlarmId = Annotated[int, Path(ge=1, le=2**53)]


@list_router.get("")
def list_alarms(
    spacecraft_id: SpacecraftId,
    page: Page,
    context: Context,
    state: Annotated[list[StateWord] | None, Query(description="Default open; may be repeated")] = None,
) -> AlarmPage:
    """List alarms of a spacecraft and of the service raised in the range, by default the active ones."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    states = state or ["open"]
    read = context.storage.alarms.alarms
    found = read(spacecraft_id, states, page.window, page.most, page.after, newest_first=page.newest_first)
    return page.answer(AlarmPage, found, lambda alarm: (alarm.raised_at_us, alarm.id), partial(_reported, context))


@router.get("/{alarm_id}")
def get_alarm(alarm_id: AlarmId, context: Context) -> AlarmHistoryAnswer:
    """Return an alarm and what happened to it."""
    alarm = context.storage.alarms.alarm(alarm_id)
    changes = [AlarmChangeAnswer.of(change) for change in context.storage.alarms.changes(alarm_id)]
    return AlarmHistoryAnswer(alarm=_reported(context, alarm), changes=changes)


@router.post("/{alarm_id}:acknowledge", dependencies=[MAY_OPERATE], openapi_extra=accepts_comment())
def acknowledge_alarm(alarm_id: AlarmId, body: Said, context: Context, principal: CurrentPrincipal) -> AlarmAnswer:
    """Acknowledge the alarm; no further notice unless it becomes worse or comes back."""
    return _reported(context, context.alarms.acknowledge(alarm_id, principal.name, body.comment))


@router.post("/{alarm_id}:shelve", dependencies=[MAY_OPERATE], openapi_extra=accepts(ShelveDocument))
def shelve_alarm(
    alarm_id: AlarmId,
    body: Annotated[ShelveDocument, body_of(ShelveDocument)],
    context: Context,
    principal: CurrentPrincipal,
) -> AlarmAnswer:
    """Keep the alarm quiet until an instant, at most 24 h ahead."""
    return _reported(context, context.alarms.shelve(alarm_id, principal.name, body.comment, body.until))


@router.post("/{alarm_id}:unshelve", dependencies=[MAY_OPERATE], openapi_extra=accepts_comment())
def unshelve_alarm(alarm_id: AlarmId, body: Said, context: Context, principal: CurrentPrincipal) -> AlarmAnswer:
    """End a shelving before its time."""
    return _reported(context, context.alarms.unshelve(alarm_id, principal.name, body.comment))


@router.post("/{alarm_id}:clear", dependencies=[MAY_OPERATE], openapi_extra=accepts_comment())
def clear_alarm(alarm_id: AlarmId, body: Said, context: Context, principal: CurrentPrincipal) -> AlarmAnswer:
    """Close the alarm; a condition that still holds alarms again after its delay."""
    return _reported(context, context.alarms.clear(alarm_id, principal.name, body.comment))


def _reported(context: Context, alarm: Alarm) -> AlarmAnswer:
    """Return an alarm."""
    return AlarmAnswer.of(alarm, context.alarms.present_value(alarm))
