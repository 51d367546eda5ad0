"""Commands: prepared by one person, confirmed by another, reported by the centre. A command is never released twice."""

from http import HTTPStatus
from operator import attrgetter
from typing import Annotated

from fastapi import APIRouter, Path, Response

from service.api.access.auth import MAY_APPROVE, MAY_OPERATE
from service.api.context.dependencies import Context, SpacecraftId
from service.api.protocol.bodies import accepts, body_of, optional_body
from service.api.protocol.paging import Page
from service.api.routes.comments import Caller, CurrentCaller, Said, accepts_comment
from service.api.schemas.torque_commands import (
    CommandAnswer,
    CommandPage,
    ConfirmDocument,
    PrepareDocument,
    ReportDocument,
    UplinkAnswer,
)

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
    caller: CurrentCaller, body: Annotated[PrepareDocument, body_of(PrepareDocument)], response: Response
) -> CommandAnswer:
    """Compute and check a command that waits for another person; a dry run only shows it."""
    command = caller.release.prepare(caller.spacecraft_id, caller.name, body.to_request(), dry_run=body.dry_run)
    if command.is_dry_run:
        response.status_code = HTTPStatus.OK
    else:
        response.headers["Location"] = f"/api/v1/spacecraft/{caller.spacecraft_id}/torques/{command.counter}"
    return CommandAnswer.of(command)


@router.get("/torques/commands")
def list_commands(spacecraft_id: SpacecraftId, page: Page, context: Context) -> CommandPage:
    """List commands that were prepared in the range, in order of their preparation."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    read = context.release_service.commands
    found = read(spacecraft_id, page.window, page.most, page.after, newest_first=page.newest_first)
    return page.answer(CommandPage, found, attrgetter("prepared_us", "counter"), CommandAnswer.of)


@router.get("/torques/{command_id}")
def get_command(spacecraft_id: SpacecraftId, command_id: CommandId, context: Context) -> CommandAnswer:
    """Return one command as it stands."""
    return CommandAnswer.of(context.release_service.command(spacecraft_id, command_id))


@router.get("/torques/{command_id}/uplink")
def get_uplink(spacecraft_id: SpacecraftId, command_id: CommandId, context: Context) -> UplinkAnswer:
    """Return what goes up of a released command."""
    return UplinkAnswer.of(context.release_service.uplink(spacecraft_id, command_id))


@router.get("/attitude/uplink")
def get_attitude_uplink(spacecraft_id: SpacecraftId, context: Context) -> UplinkAnswer:
    """Return the newest angles for a spacecraft in mode onboard, with their counter and how long they hold."""
    return UplinkAnswer.of(context.release_service.attitude_uplink(spacecraft_id))


@router.post("/torques/{command_id}:confirm", dependencies=[MAY_APPROVE], openapi_extra=accepts(ConfirmDocument))
def confirm_torques(
    caller: CurrentCaller, command_id: CommandId, body: Annotated[ConfirmDocument, body_of(ConfirmDocument)]
) -> CommandAnswer:
    """Confirm a command that another person prepared; it is released at once, or refused with the reason."""
    command = caller.release.confirm(
        caller.spacecraft_id, command_id, caller.name, body.digest, is_approver=caller.is_approver, comment=body.comment
    )
    return CommandAnswer.of(command)


@router.post("/torques/{command_id}:cancel", dependencies=[MAY_OPERATE], openapi_extra=accepts_comment())
def cancel_torques(caller: CurrentCaller, command_id: CommandId, body: Said) -> CommandAnswer:
    """Take a prepared command back; what has been released cannot be called back."""
    command = caller.release.cancel(caller.spacecraft_id, command_id, caller.name)
    caller.log(f"cancel command {command_id}", body.comment)
    return CommandAnswer.of(command)


@router.post("/torques/{command_id}:sent", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_REPORT)
def report_sent(caller: CurrentCaller, command_id: CommandId, body: ReportBody) -> CommandAnswer:
    """Report that a released command was uplinked."""
    return _reported(caller, command_id, "sent", body)


@router.post("/torques/{command_id}:executed", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_REPORT)
def report_executed(caller: CurrentCaller, command_id: CommandId, body: ReportBody) -> CommandAnswer:
    """Report that a command was executed, whole or between two instants; it becomes known input of the filter."""
    return _reported(caller, command_id, "executed", body)


@router.post("/torques/{command_id}:failed", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_REPORT)
def report_failed(caller: CurrentCaller, command_id: CommandId, body: ReportBody) -> CommandAnswer:
    """Report that a command was not executed, or only between two instants."""
    return _reported(caller, command_id, "failed", body)


def _reported(caller: Caller, command_id: int, turn: str, body: ReportDocument) -> CommandAnswer:
    """Return a command after a report."""
    command = caller.release.report(
        caller.spacecraft_id,
        command_id,
        turn,
        by=caller.name,
        at_us=body.at,
        executed_from_us=body.executed_from,
        executed_until_us=body.executed_until,
    )
    return CommandAnswer.of(command)
