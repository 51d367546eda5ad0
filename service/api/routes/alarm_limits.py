"""Limits of alarms: versions of a spacecraft, and what is in force."""

from typing import Annotated

from fastapi import APIRouter, Query

from service.api.access.auth import MAY_OPERATE, CurrentPrincipal
from service.api.context.dependencies import Context, SpacecraftId
from service.api.problems.problems import invalid_request
from service.api.protocol.bodies import accepts, body_of
from service.api.schemas.alarms import ConditionLimitsAnswer, LimitsAnswer, LimitsDocument, LimitsInForceAnswer
from service.pipeline.alarms.limit_sets import faults_of, limits_in_force

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/alarm-limits", tags=["alarms"])
Version = Annotated[int | None, Query(ge=0, le=2**31 - 1, description="Default the newest; 0 = the defaults")]


@router.get("")
def get_alarm_limits(spacecraft_id: SpacecraftId, context: Context, version: Version = None) -> LimitsAnswer:
    """Return what a version states; the answer can be put back, here or for another spacecraft."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    return LimitsAnswer.of(context.storage.alarms.limits(spacecraft_id, version))


@router.put("", dependencies=[MAY_OPERATE], openapi_extra=accepts(LimitsDocument))
def put_alarm_limits(
    spacecraft_id: SpacecraftId,
    body: Annotated[LimitsDocument, body_of(LimitsDocument)],
    context: Context,
    principal: CurrentPrincipal,
) -> LimitsAnswer:
    """State limits in place of the newest version; former versions are kept."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    limits = body.to_record(context.clock.system_us(), principal.name)
    faults = faults_of(context.alarms.conditions, limits)
    if faults:
        raise invalid_request(faults)
    return LimitsAnswer.of(context.alarms.put_limits(spacecraft_id, limits))


@router.get("/in-force")
def get_limits_in_force(spacecraft_id: SpacecraftId, context: Context) -> LimitsInForceAnswer:
    """Return the limits of every condition as they hold now, and the sets that make them."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    stated = context.storage.alarms.limits(spacecraft_id)
    sets = context.alarms.sets_in_force(spacecraft_id)
    limits = limits_in_force(context.alarms.conditions, stated, sets)
    reported = {name: ConditionLimitsAnswer.of(name, each) for name, each in limits.items()}
    return LimitsInForceAnswer(version=stated.version, sets=list(sets), conditions=reported)
