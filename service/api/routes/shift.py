"""The shift: alarms and their limits, links, notes, hand-over.

Callers who order something, and their comments: optional ones, and those that go to the shift log.
"""

import re
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Response

from service.api.access.auth import MAY_OPERATE, MAY_SEND, CurrentPrincipal, Permission, Principal
from service.api.context import SPACECRAFT_ID_PATTERN, ApiContext, Context, SpacecraftId
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import Page
from service.api.protocol.requests import Body, OptionalBody
from service.api.schemas import shift as documents
from service.api.schemas.base import NAME_PATTERN
from service.api.views.present import alarm_answer, handover_of, link_answers
from service.errors import NotFoundError
from service.pipeline.alarms.conditions import faults_of, limits_in_force
from service.records.operations.alarms import Alarm, Note
from service.runtime.control.release_service import ReleaseService

TAG = "control"


Said = OptionalBody[documents.RemarkDocument]


@dataclass(frozen=True, slots=True)
class Caller:
    """Operator who sends an order for a spacecraft."""

    context: ApiContext
    spacecraft_id: str
    principal: Principal

    @property
    def name(self) -> str:
        """Name of the key."""
        return self.principal.name

    @property
    def is_approver(self) -> bool:
        """Return whether the key may approve."""
        return self.principal.may(Permission.APPROVE)

    @property
    def release(self) -> ReleaseService:
        """Interlock and commands of all spacecraft."""
        return self.context.release_service

    def log(self, order: str, comment: str) -> None:
        """Write what the person says to an order into the shift log; nothing where nothing is said."""
        if not comment.strip():
            return
        clock = self.context.clock
        now_us = clock.system_us()
        present_us = clock.now_us(self.spacecraft_id)
        epoch_us = now_us if present_us is None else present_us
        note = Note(0, self.spacecraft_id, epoch_us, now_us, self.name, f"{order}: {comment}", (TAG,))
        self.context.storage.notes.add(note)


async def caller_of(spacecraft_id: SpacecraftId, context: Context, principal: CurrentPrincipal) -> Caller:
    """Return the caller of a request, for a dependency."""
    return Caller(context, spacecraft_id, principal)


CurrentCaller = Annotated[Caller, Depends(caller_of)]


alarm_limits_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/alarm-limits", tags=["alarms"])
Version = Annotated[int | None, Query(ge=0, le=2**31 - 1, description="Default the newest; 0 = the defaults")]


@alarm_limits_router.get("")
def get_alarm_limits(spacecraft_id: SpacecraftId, context: Context, version: Version = None) -> documents.LimitsAnswer:
    """Return what a version states; the answer can be put back, here or for another spacecraft."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    return documents.LimitsAnswer.of(context.storage.alarms.limits(spacecraft_id, version))


@alarm_limits_router.put("", dependencies=[MAY_OPERATE])
def put_alarm_limits(
    spacecraft_id: SpacecraftId, body: Body[documents.LimitsDocument], context: Context, principal: CurrentPrincipal
) -> documents.LimitsAnswer:
    """State limits in place of the newest version; former versions are kept."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    limits = body.to_record(context.clock.system_us(), principal.name)
    faults = faults_of(context.alarms.conditions, limits)
    if faults:
        raise invalid_request(faults)
    return documents.LimitsAnswer.of(context.alarms.put_limits(spacecraft_id, limits))


@alarm_limits_router.get("/in-force")
def get_limits_in_force(spacecraft_id: SpacecraftId, context: Context) -> documents.LimitsInForceAnswer:
    """Return the limits of every condition as they hold now, and the sets that make them."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    stated = context.storage.alarms.limits(spacecraft_id)
    sets = context.alarms.sets_in_force(spacecraft_id)
    limits = limits_in_force(context.alarms.conditions, stated, sets)
    reported = {name: documents.ConditionLimitsAnswer.of(name, each) for name, each in limits.items()}
    return documents.LimitsInForceAnswer(version=stated.version, sets=list(sets), conditions=reported)


#: lists stand below a spacecraft, ids are global
list_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/alarms", tags=["alarms"])
alarms_router = APIRouter(prefix="/alarms", tags=["alarms"])
AlarmId = Annotated[int, Path(ge=1, le=2**53)]


@list_router.get("")
def list_alarms(
    spacecraft_id: SpacecraftId,
    page: Page,
    context: Context,
    state: Annotated[list[documents.StateWord] | None, Query(description="Default open; may be repeated")] = None,
) -> documents.AlarmPage:
    """List alarms of a spacecraft and of the service raised in the range, by default the active ones."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    states = state or ["open"]
    read = context.storage.alarms.alarms
    found = read(spacecraft_id, states, page.part)
    return page.answer(
        documents.AlarmPage, found, lambda alarm: (alarm.raised_at_us, alarm.id), partial(_reported, context)
    )


@alarms_router.get("/{alarm_id}")
def get_alarm(alarm_id: AlarmId, context: Context) -> documents.AlarmHistoryAnswer:
    """Return an alarm and what happened to it."""
    alarm = context.storage.alarms.alarm(alarm_id)
    changes = [documents.AlarmChangeAnswer.of(change) for change in context.storage.alarms.changes(alarm_id)]
    return documents.AlarmHistoryAnswer(alarm=_reported(context, alarm), changes=changes)


@alarms_router.post("/{alarm_id}:acknowledge", dependencies=[MAY_OPERATE])
def acknowledge_alarm(
    alarm_id: AlarmId, body: Said, context: Context, principal: CurrentPrincipal
) -> documents.AlarmAnswer:
    """Acknowledge the alarm; no further notice unless it becomes worse or comes back."""
    return _reported(context, context.alarms.acknowledge(alarm_id, principal.name, body.comment))


@alarms_router.post("/{alarm_id}:shelve", dependencies=[MAY_OPERATE])
def shelve_alarm(
    alarm_id: AlarmId, body: Body[documents.ShelveDocument], context: Context, principal: CurrentPrincipal
) -> documents.AlarmAnswer:
    """Keep the alarm quiet until an instant, at most 24 h ahead."""
    return _reported(context, context.alarms.shelve(alarm_id, principal.name, body.comment, body.until))


@alarms_router.post("/{alarm_id}:unshelve", dependencies=[MAY_OPERATE])
def unshelve_alarm(
    alarm_id: AlarmId, body: Said, context: Context, principal: CurrentPrincipal
) -> documents.AlarmAnswer:
    """End a shelving before its time."""
    return _reported(context, context.alarms.unshelve(alarm_id, principal.name, body.comment))


@alarms_router.post("/{alarm_id}:clear", dependencies=[MAY_OPERATE])
def clear_alarm(alarm_id: AlarmId, body: Said, context: Context, principal: CurrentPrincipal) -> documents.AlarmAnswer:
    """Close the alarm; a condition that still holds alarms again after its delay."""
    return _reported(context, context.alarms.clear(alarm_id, principal.name, body.comment))


def _reported(context: Context, alarm: Alarm) -> documents.AlarmAnswer:
    is_alone = alarm.cause is not None or not alarm.is_open
    return alarm_answer(context, alarm, () if is_alone else context.storage.alarms.open_alarms(alarm.spacecraft_id))


handover_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/handover", tags=["shift log"])


@handover_router.get("")
def get_handover(spacecraft_id: SpacecraftId, context: Context) -> documents.HandoverAnswer:
    """Return alarms, control, ages, links, missing rows and newest notes of a spacecraft."""
    return handover_of(context, spacecraft_id)


links_router = APIRouter(prefix="/links", tags=["links"])
_NAME = re.compile(NAME_PATTERN.strip("^$"), re.ASCII)
LinksOfSpacecraft = Annotated[
    str | None, Query(pattern=SPACECRAFT_ID_PATTERN, description="Only links of this spacecraft")
]


# `links:report` stands beside `links`, not below it
report_router = APIRouter(tags=["links"])


@report_router.post("/links:report", dependencies=[MAY_SEND])
def report_links(body: Body[documents.LinkReportsDocument], context: Context) -> documents.LinkWishesAnswer:
    """Store the reports of a front end and return the requested state of its links."""
    states = context.storage.links.report([each.to_record() for each in body.links], context.clock.system_us())
    requests = [
        documents.LinkWishAnswer(id=state.report.id, enabled=state.enabled, reset=state.resets) for state in states
    ]
    return documents.LinkWishesAnswer(links=requests)


@links_router.get("")
def list_links(context: Context, spacecraft_id: LinksOfSpacecraft = None) -> documents.LinkListAnswer:
    """List the links that have reported."""
    return documents.LinkListAnswer(links=link_answers(context, context.storage.links.links(spacecraft_id)))


async def _link_id(link_id: Annotated[str, Path(description="Id of a link")]) -> str:
    """Return the id of a path; one that cannot exist never reaches the database."""
    if _NAME.fullmatch(link_id) is None:
        raise NotFoundError("link.unknown", f"no link {link_id[:64]!r}")
    return link_id


LinkId = Annotated[str, Depends(_link_id)]


@links_router.get("/{link_id}")
def get_link(link_id: LinkId, context: Context) -> documents.LinkAnswer:
    """Return one link."""
    return link_answers(context, [context.storage.links.link(link_id)])[0]


@links_router.post("/{link_id}:enable", dependencies=[MAY_OPERATE])
def enable_link(link_id: LinkId, context: Context) -> documents.LinkAnswer:
    """Let a link work; it hears of it with its next report."""
    state = context.storage.links.set_enabled(link_id, enabled=True)
    return link_answers(context, [state])[0]


@links_router.post("/{link_id}:disable", dependencies=[MAY_OPERATE])
def disable_link(link_id: LinkId, context: Context) -> documents.LinkAnswer:
    """Let a link rest until it is enabled again, also beyond a restart of either side."""
    state = context.storage.links.set_enabled(link_id, enabled=False)
    return link_answers(context, [state])[0]


@links_router.post("/{link_id}:reset", dependencies=[MAY_OPERATE])
def reset_link(link_id: LinkId, context: Context) -> documents.LinkAnswer:
    """Ask a link to zero its counters and to begin again."""
    state = context.storage.links.request_reset(link_id)
    return link_answers(context, [state])[0]


@links_router.delete("/{link_id}", status_code=HTTPStatus.NO_CONTENT, dependencies=[MAY_OPERATE])
def remove_link(link_id: LinkId, context: Context) -> None:
    """Forget a link that is gone for good."""
    context.storage.links.remove(link_id)


notes_router = APIRouter(prefix="/notes", tags=["shift log"])
NoteId = Annotated[int, Path(ge=1, le=2**53)]
NotesOfSpacecraft = Annotated[
    str | None,
    Query(pattern=SPACECRAFT_ID_PATTERN, description="Only notes about this spacecraft, and those about none"),
]


@notes_router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE])
def write_note(
    body: Body[documents.NoteDocument], context: Context, principal: CurrentPrincipal, response: Response
) -> documents.NoteAnswer:
    """Write a note."""
    now_us = context.clock.system_us()
    if body.spacecraft_id is not None:
        context.storage.catalogue.spacecraft(body.spacecraft_id)
        present_us = context.clock.now_us(body.spacecraft_id)
    else:
        present_us = now_us
    epoch_us = body.epoch if body.epoch is not None else present_us if present_us is not None else now_us
    fresh = Note(0, body.spacecraft_id, epoch_us, now_us, principal.name, body.text, tuple(body.tags), body.corrects)
    note = context.storage.notes.add(fresh)
    response.headers["Location"] = f"/api/v1/notes/{note.id}"
    return documents.NoteAnswer.of(note)


@notes_router.get("")
def list_notes(page: Page, context: Context, spacecraft_id: NotesOfSpacecraft = None) -> documents.NotePage:
    """List notes about instants of the range."""
    read = context.storage.notes.notes
    found = read(page.part, spacecraft_id)
    return page.answer(documents.NotePage, found, lambda note: (note.epoch_us, note.id), documents.NoteAnswer.of)


@notes_router.get("/{note_id}")
def get_note(note_id: NoteId, context: Context) -> documents.NoteAnswer:
    """Return one note."""
    return documents.NoteAnswer.of(context.storage.notes.note(note_id))
