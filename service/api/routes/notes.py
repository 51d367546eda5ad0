"""Notes: the shift log. Append only; a correction is a new note that names the old one."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response

from service.api.access.auth import MAY_OPERATE, CurrentPrincipal
from service.api.context.dependencies import SPACECRAFT_ID_PATTERN, Context
from service.api.protocol.bodies import accepts, body_of
from service.api.protocol.paging import Page
from service.api.schemas.notes import NoteAnswer, NoteDocument, NotePage
from service.records.operations.note import Note

router = APIRouter(prefix="/notes", tags=["shift log"])
NoteId = Annotated[int, Path(ge=1, le=2**53)]
SpacecraftParameter = Annotated[
    str | None,
    Query(pattern=SPACECRAFT_ID_PATTERN, description="Only notes about this spacecraft, and those about none"),
]


@router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE], openapi_extra=accepts(NoteDocument))
def write_note(
    body: Annotated[NoteDocument, body_of(NoteDocument)],
    context: Context,
    principal: CurrentPrincipal,
    response: Response,
) -> NoteAnswer:
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
    return NoteAnswer.of(note)


@router.get("")
def list_notes(page: Page, context: Context, spacecraft_id: SpacecraftParameter = None) -> NotePage:
    """List notes about instants of the range."""
    read = context.storage.notes.notes
    found = read(page.window, page.most, page.after, spacecraft_id, newest_first=page.newest_first)
    return page.answer(NotePage, found, lambda note: (note.epoch_us, note.id), NoteAnswer.of)


@router.get("/{note_id}")
def get_note(note_id: NoteId, context: Context) -> NoteAnswer:
    """Return one note."""
    return NoteAnswer.of(context.storage.notes.note(note_id))
