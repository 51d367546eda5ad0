"""Torques: the newest computed command and those before it."""

from fastapi import APIRouter

from service.api.context.dependencies import Context, SpacecraftId
from service.api.context.method_parameters import WantedVersion
from service.api.protocol.paging import Page, by_epoch
from service.api.schemas.control import VerdictAnswer
from service.api.schemas.torques import NewestTorqueAnswer, TorqueAnswer, TorquePage
from service.api.views.present import present_of

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/torques", tags=["torques"])


@router.get("")
def get_torques(spacecraft_id: SpacecraftId, context: Context) -> NewestTorqueAnswer:
    """Return the newest command: zero with its reasons while control is inhibited, null before the first."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    row, command, verdict = present_of(context, spacecraft)
    if command is None:
        answer = TorqueAnswer.before_the_first(spacecraft.control.mode, None if row is None else row.epoch_us)
    else:
        answer = TorqueAnswer.of(command)
    return NewestTorqueAnswer(**dict(answer), control=VerdictAnswer.of(verdict))


@router.get("/history")
def list_torques(spacecraft_id: SpacecraftId, version: WantedVersion, page: Page, context: Context) -> TorquePage:
    """List computed commands in order of epoch."""
    read = context.storage.results.commands
    found = read(spacecraft_id, version, page.window, page.most, page.after, newest_first=page.newest_first)
    return page.answer(TorquePage, found, by_epoch, TorqueAnswer.of, version=version)
