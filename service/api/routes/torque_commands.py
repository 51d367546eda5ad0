"""Commands: prepared by one person, confirmed by another, reported by the centre. A command is never released twice."""

from http import HTTPStatus
from operator import attrgetter
from typing import Annotated

from fastapi import APIRouter, Path, Response

from service.api.access.auth import MAY_APPROVE, MAY_OPERATE, CurrentPrincipal
from service.api.access.principals import Permission
from service.api.context.dependencies import Context, SpacecraftId
from service.api.protocol.bodies import accepts, body_of, optional_body
from service.api.protocol.paging import Page
from service.api.routes.comments import Said, accepts_comment, log_comment
from service.api.schemas.torque_commands import (
    CommandAnswer,
    CommandPage,
    ConfirmDocument,
    PrepareDocument,
    ReportDocument,
    UplinkAnswer,
)
from service.records.operations.release import Command

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["release of torques"])
#: its counter
CommandId = Annotated[int, Path(ge=1, le=2**53)]
ReportBody = Annotated[ReportDocument, optional_body(ReportDocument)]
_ACCEPTS_REPORT = accepts(ReportDocument, is_required=False)


@router.post(
    "/torques:prepare",
    status_code=HTTPStatus.CREATED,
    dependencies=[MAY_OPERATE],
    openapi_extra=accepts(PrepareDocument),
    responses={HTTPStatus.OK: {"model": CommandAnswer, "description": "Of a dry run: nothing is stored"}},
)
def prepare_torques(
    spacecraft_id: SpacecraftId,
    body: Annotated[PrepareDocument, body_of(PrepareDocument)],
    context: Context,
    principal: CurrentPrincipal,
    response: Response,
) -> CommandAnswer:
    """Compute and check a command that waits for another person; a dry run only shows it."""
    command = context.release_service.prepare(spacecraft_id, principal.name, body.to_request(), dry_run=body.dry_run)
    if command.is_dry_run:
        response.status_code = HTTPStatus.OK
    else:
        response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/torques/{command.counter}"
    return CommandAnswer.of(command)


@router.get("/torques/commands")
def list_commands(spacecraft_id: SpacecraftId, page: Page, context: Context) -> CommandPage:
    """List commands that were prepared in the range, in order of their preparation."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    found = context.release_service.commands(spacecraft_id, page.window, page.most, page.after)
    return page.answer(CommandPage, found, attrgetter("prepared_us", "counter"), CommandAnswer.of)


@router.get("/torques/{command_id}")
def get_command(spacecraft_id: SpacecraftId, command_id: CommandId, context: Context) -> CommandAnswer:
    """Return one command as it stands."""
    return CommandAnswer.of(context.release_service.command(spacecraft_id, command_id))


@router.get("/torques/{command_id}/uplink")
def get_uplink(spacecraft_id: SpacecraftId, command_id: CommandId, context: Context) -> UplinkAnswer:
    """Return what goes up of a released command."""
    return UplinkAnswer.of(context.release_service.uplink(spacecraft_id, command_id))


@router.post("/torques/{command_id}:confirm", dependencies=[MAY_APPROVE], openapi_extra=accepts(ConfirmDocument))
def confirm_torques(
    spacecraft_id: SpacecraftId,
    command_id: CommandId,
    body: Annotated[ConfirmDocument, body_of(ConfirmDocument)],
    context: Context,
    principal: CurrentPrincipal,
) -> CommandAnswer:
    """Confirm a command that another person prepared; it is released at once, or refused with the reason."""
    command = context.release_service.confirm(
        spacecraft_id,
        command_id,
        principal.name,
        body.digest,
        is_approver=principal.may(Permission.APPROVE),
        comment=body.comment,
    )
    return CommandAnswer.of(command)


@router.post("/torques/{command_id}:cancel", dependencies=[MAY_OPERATE], openapi_extra=accepts_comment())
def cancel_torques(
    spacecraft_id: SpacecraftId, command_id: CommandId, body: Said, context: Context, principal: CurrentPrincipal
) -> CommandAnswer:
    """Take a prepared command back; what has been released cannot be called back."""
    command = context.release_service.cancel(spacecraft_id, command_id, principal.name)
    log_comment(context, spacecraft_id, principal, f"cancel command {command_id}", body.comment)
    return CommandAnswer.of(command)


@router.post("/torques/{command_id}:sent", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_REPORT)
def report_sent(
    spacecraft_id: SpacecraftId, command_id: CommandId, body: ReportBody, context: Context, principal: CurrentPrincipal
) -> CommandAnswer:
    """Report that a released command was uplinked."""
    return CommandAnswer.of(_reported(context, spacecraft_id, command_id, "sent", body, principal.name))


@router.post("/torques/{command_id}:executed", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_REPORT)
def report_executed(
    spacecraft_id: SpacecraftId, command_id: CommandId, body: ReportBody, context: Context, principal: CurrentPrincipal
) -> CommandAnswer:
    """Report that a command was executed, whole or between two instants; it becomes known input of the filter."""
    return CommandAnswer.of(_reported(context, spacecraft_id, command_id, "executed", body, principal.name))


@router.post("/torques/{command_id}:failed", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_REPORT)
def report_failed(
    spacecraft_id: SpacecraftId, command_id: CommandId, body: ReportBody, context: Context, principal: CurrentPrincipal
) -> CommandAnswer:
    """Report that a command was not executed, or only between two instants."""
    return CommandAnswer.of(_reported(context, spacecraft_id, command_id, "failed", body, principal.name))


def _reported(
    context: Context, spacecraft_id: str, command_id: int, turn: str, body: ReportDocument, by: str
) -> Command:
    """Return a command after a report."""
    return context.release_service.report(
        spacecraft_id,
        command_id,
        turn,
        by=by,
        at_us=body.at,
        executed_from_us=body.executed_from,
        executed_until_us=body.executed_until,
    )
