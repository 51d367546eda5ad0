"""Audit log: who did what, for administrators and approvers."""

from operator import attrgetter
from typing import Annotated

from fastapi import APIRouter, Query

from service.api.access.auth import MAY_INSPECT
from service.api.context.dependencies import Context
from service.api.protocol.paging import Page
from service.api.schemas.audit import AuditEntryAnswer, AuditHeadAnswer, AuditPage
from service.records.operations.audit import AuditFilter

router = APIRouter(prefix="/audit", tags=["access"], dependencies=[MAY_INSPECT])
_WORDS = r"^[^\x00-\x1f\x7f]*$"


def _exact(description: str) -> object:
    return Query(max_length=200, pattern=_WORDS, description=description)


@router.get("")
def list_audit(
    page: Page,
    context: Context,
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
    after = None if page.after is None else page.after[1]
    found = audit.entries(wanted, page.most, after, newest_first=page.newest_first)
    position = attrgetter("number", "number")
    return page.answer(AuditPage, found, position, AuditEntryAnswer.of, head=AuditHeadAnswer.of(audit.head()))
