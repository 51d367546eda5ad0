"""Attitude: the newest row and the history of a method."""

from functools import partial

from fastapi import APIRouter

from service.api.context.dependencies import Context, SpacecraftId
from service.api.context.method_parameters import StoredMethod, WantedMethod, WantedVersion, check_method
from service.api.protocol.paging import Page, by_epoch
from service.api.schemas.attitude import AttitudeAnswer, AttitudePage, NewestAttitudeAnswer, SmoothedPage
from service.api.schemas.control import VerdictAnswer
from service.api.views.newest import newest_attitude
from service.api.views.present import present_of
from service.ports import LIVE, SMOOTHED
from service.records.catalogue import Method

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/attitude", tags=["attitude"])


@router.get("")
def get_attitude(spacecraft_id: SpacecraftId, method: WantedMethod, context: Context) -> NewestAttitudeAnswer:
    """Return the newest attitude; status NOT_RECEIVED before the first row, EXPIRED when the newest is too old."""
    check_method(method, LIVE)
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    row, _, verdict = present_of(context, spacecraft)
    if method is not spacecraft.control.method:
        row = newest_attitude(context, spacecraft_id, method)
    control = VerdictAnswer.of(verdict)
    if row is None:
        return NewestAttitudeAnswer.not_received(method, LIVE, control=control)
    return NewestAttitudeAnswer.of(row, LIVE, control=control)


@router.get("/history")
def list_attitude(
    spacecraft_id: SpacecraftId,
    method: StoredMethod,
    version: WantedVersion,
    page: Page,
    context: Context,
) -> AttitudePage:
    """List attitude rows in order of epoch, exactly one a measurement and method."""
    read = context.storage.results.attitude_rows
    found = read(spacecraft_id, version, method, page.window, page.most, page.after, newest_first=page.newest_first)
    of = partial(AttitudeAnswer.of, version=version)
    return page.answer(AttitudePage, found, by_epoch, of, method=method, version=version)


@router.get("/smoothed")
def list_smoothed(spacecraft_id: SpacecraftId, page: Page, context: Context) -> SmoothedPage:
    """List smoothed rows in order of epoch, one each five minutes, made when the data reach the lag beyond them."""
    read, method = context.storage.results.attitude_rows, Method.ROBUST_SMOOTHED
    found = read(spacecraft_id, SMOOTHED, method, page.window, page.most, page.after, newest_first=page.newest_first)
    of = partial(AttitudeAnswer.of, version=SMOOTHED)
    return page.answer(SmoothedPage, found, by_epoch, of, method=method, version=SMOOTHED)
