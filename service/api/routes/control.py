"""Control: the interlock's state, and orders of persons to it."""

from typing import Annotated

from fastapi import APIRouter, Request

from service.api.access.auth import MAY_APPROVE, MAY_OPERATE, CurrentPrincipal
from service.api.access.principals import Permission, Principal
from service.api.context.dependencies import ApiContext, Context, SpacecraftId
from service.api.problems.problems import invalid_request
from service.api.protocol.bodies import accepts, optional_body
from service.api.routes.comments import log_comment
from service.api.schemas.control import ControlAnswer, OrderDocument, SignCheckDocument
from service.api.views.present import present_of
from service.errors import FieldError, ForbiddenError
from service.pipeline.control.release.control_verdict import ControlView
from service.pipeline.control.release.events import OrderKind
from service.runtime.control.automatic_release import AutomaticRelease

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["control"])
Ordered = Annotated[OrderDocument, optional_body(OrderDocument)]
_ACCEPTS_ORDER = accepts(OrderDocument, is_required=False)
#: order in which signs are checked where none is named: yaw turns by the roll that it causes, so it comes last
_CHECK_ORDER = ("roll", "pitch", "yaw")


@router.get("/control")
def get_control(spacecraft_id: SpacecraftId, context: Context) -> ControlAnswer:
    """Return the state of the interlock and all active reasons."""
    return _reported(context, spacecraft_id, context.release_service.control(spacecraft_id))


@router.post("/control:arm", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def arm_control(
    spacecraft_id: SpacecraftId, body: Ordered, context: Context, principal: CurrentPrincipal, request: Request
) -> ControlAnswer:
    """Arm: commands may be prepared and confirmed unless a reason is active; two approvers set release automatic."""
    if body.release is None:
        return _order(context, spacecraft_id, OrderKind.ARM, principal, body)
    if not principal.may(Permission.APPROVE):
        raise ForbiddenError("key.forbidden", "release automatic is asked for by approvers")
    if not context.release_service.control(spacecraft_id).is_armed:
        context.release_service.order(spacecraft_id, OrderKind.ARM, principal.name)
    automatic: AutomaticRelease = request.app.state.automatic_release
    first = automatic.ask(spacecraft_id, principal.name, context.clock.system_us())
    text = "release automatic asked for" if first is None else f"release automatic set, asked for by {first} before"
    log_comment(context, spacecraft_id, principal, text, body.comment or "control:arm")
    context.on_accepted(spacecraft_id)
    return _reported(context, spacecraft_id, context.release_service.control(spacecraft_id))


@router.post("/control:disengage", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def disengage_control(
    spacecraft_id: SpacecraftId, body: Ordered, context: Context, principal: CurrentPrincipal
) -> ControlAnswer:
    """Take the standing authorisation back; where there is none, the arming."""
    return _order(context, spacecraft_id, OrderKind.DISENGAGE, principal, body)


@router.post("/control:reset", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def reset_control(
    spacecraft_id: SpacecraftId, body: Ordered, context: Context, principal: CurrentPrincipal
) -> ControlAnswer:
    """Reset a trip once what tripped is over; ten good minutes and an arming follow."""
    return _order(context, spacecraft_id, OrderKind.RESET, principal, body)


@router.post("/control:stop", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def stop_control(
    spacecraft_id: SpacecraftId, body: Ordered, context: Context, principal: CurrentPrincipal
) -> ControlAnswer:
    """Trip: no torque is sent until a reset; commands already sent cannot be stopped."""
    return _order(context, spacecraft_id, OrderKind.STOP, principal, body)


@router.post("/control:engage", dependencies=[MAY_APPROVE], openapi_extra=accepts(OrderDocument))
def engage_control(
    spacecraft_id: SpacecraftId, body: Ordered, context: Context, principal: CurrentPrincipal
) -> ControlAnswer:
    """Request standing authorisation within an envelope, or second the equal request of another person."""
    if body.until is None:
        detail = "say until when the authorisation holds, at most 12 h ahead"
        raise invalid_request([FieldError("/until", "field.missing", detail)])
    limits = None
    if body.envelope is not None:
        limits = body.envelope.within(context.release_service.control(spacecraft_id).envelope)
    engaged = context.release_service.engage(
        spacecraft_id,
        principal.name,
        is_approver=principal.may(Permission.APPROVE),
        until_us=body.until,
        envelope=limits,
    )
    log_comment(context, spacecraft_id, principal, "engage", body.comment)
    return _reported(context, spacecraft_id, engaged)


@router.post(
    "/control:sign-check", dependencies=[MAY_OPERATE], openapi_extra=accepts(SignCheckDocument, is_required=False)
)
def check_sign(
    spacecraft_id: SpacecraftId,
    body: Annotated[SignCheckDocument, optional_body(SignCheckDocument)],
    context: Context,
    principal: CurrentPrincipal,
) -> ControlAnswer:
    """Begin to prove the sign of an axis: small turns are prepared one by one, each to be confirmed and reported."""
    axis: str | None = body.axis
    if axis is None:
        proven = context.release_service.control(spacecraft_id).proven_axes
        axis = next((each for each in _CHECK_ORDER if each not in proven), _CHECK_ORDER[0])
    begun = context.release_service.sign_check(spacecraft_id, axis, principal.name)
    log_comment(context, spacecraft_id, principal, f"sign check of {axis}", body.comment)
    return _reported(context, spacecraft_id, begun)


def _order(
    context: Context, spacecraft_id: str, kind: OrderKind, principal: Principal, body: OrderDocument
) -> ControlAnswer:
    """Return the state of the interlock after an order."""
    view = context.release_service.order(spacecraft_id, kind, principal.name)
    log_comment(context, spacecraft_id, principal, kind.value, body.comment)
    return _reported(context, spacecraft_id, view)


def _reported(context: ApiContext, spacecraft_id: str, view: ControlView) -> ControlAnswer:
    """Return the answer of a view of the interlock, with the verdict."""
    present = present_of(context, context.storage.catalogue.spacecraft(spacecraft_id), view)
    return ControlAnswer.of(view, present.verdict)
