"""Audit log: who did what, for administrators and approvers."""

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from service.api.access.auth import MAY_INSPECT
from service.api.context.dependencies import Context
from service.api.protocol.paging import Page, cut_page
from service.api.schemas.audit import AuditEntryAnswer, AuditHeadAnswer, AuditPage
from service.api.schemas.base import WindowAnswer
from service.records.operations.audit import AuditFilter

router = APIRouter(prefix="/audit", tags=["access"], dependencies=[MAY_INSPECT])
_WORDS = r"^[^\x00-\x1f\x7f]*$"


def _exact(description: str) -> object:
    return Query(max_length=200, pattern=_WORDS, description=description)


@router.get("")
def list_audit(
    page: Page,
    context: Context,
    request: Request,
    response: Response,
    who: Annotated[str | None, _exact("Only of keys of this name")] = None,
    role: Annotated[str | None, _exact("Only of keys of this role")] = None,
    action: Annotated[str | None, _exact("Only this operation")] = None,
    outcome: Annotated[str | None, _exact("done, or a status")] = None,
    target: Annotated[str | None, _exact("Only below this path")] = None,
) -> AuditPage:
    """List entries in order of number; the head gives the present end of the chain."""
    wanted = AuditFilter(
        start_us=page.window.start_us,
        stop_us=page.window.stop_us,
        who=who,
        role=role,
        action=action,
        outcome=outcome,
        target_prefix=target,
    )
    audit = context.storage.audit
    found = audit.entries(wanted, page.limit + 1, None if page.after is None else page.after[1])
    rows, cursor = cut_page(found, page.limit, lambda entry: (entry.number, entry.number), request, response)
    return AuditPage(
        range=WindowAnswer.of(page.window),
        head=AuditHeadAnswer.of(audit.head()),
        rows=[AuditEntryAnswer.of(entry) for entry in rows],
        next=cursor,
    )
