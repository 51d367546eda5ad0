"""Callers who order something, and their comments: optional ones, and those that go to the shift log."""

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends

from service.api.access.auth import CurrentPrincipal, Permission, Principal
from service.api.context import ApiContext, Context, SpacecraftId
from service.api.protocol.requests import accepts, optional_body
from service.api.schemas.shift import RemarkDocument
from service.records.operations.alarms import Note
from service.runtime.control.release_service import ReleaseService

TAG = "control"


def accepts_comment() -> dict[str, Any]:
    """Return the OpenAPI description of an optional comment."""
    return accepts(RemarkDocument, is_required=False)


Said = Annotated[RemarkDocument, optional_body(RemarkDocument)]


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
