"""Comments of operators on their actions: optional ones, and required ones that go to the shift log."""

from typing import Annotated, Any

from service.api.access.principals import Principal
from service.api.context.dependencies import ApiContext
from service.api.protocol.bodies import accepts, optional_body
from service.api.schemas.alarms import RemarkDocument
from service.records.operations.note import Note

TAG = "control"


def accepts_comment() -> dict[str, Any]:
    """Return the OpenAPI description of an optional comment."""
    return accepts(RemarkDocument, is_required=False)


Said = Annotated[RemarkDocument, optional_body(RemarkDocument)]


def log_comment(context: ApiContext, spacecraft_id: str, principal: Principal, order: str, comment: str) -> None:
    """Write the comment of an operator on an order into the shift log; an empty comment writes nothing."""
    if not comment.strip():
        return
    now_us = context.clock.system_us()
    present_us = context.clock.now_us(spacecraft_id)
    epoch_us = now_us if present_us is None else present_us
    note = Note(0, spacecraft_id, epoch_us, now_us, principal.name, f"{order}: {comment}", (TAG,))
    context.storage.notes.add(note)
