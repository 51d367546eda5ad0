"""Control: the interlock's state, and orders of persons to it."""

from typing import Annotated

from fastapi import APIRouter, Request

from service.api.access.auth import MAY_APPROVE, MAY_OPERATE
from service.api.context.dependencies import ApiContext, Context, SpacecraftId
from service.api.problems.problems import invalid_request
from service.api.protocol.bodies import accepts, optional_body
from service.api.routes.comments import Caller, CurrentCaller
from service.api.schemas.control import ControlAnswer, OrderDocument, SignCheckDocument
from service.api.views.present import present_of
from service.errors import FieldError, ForbiddenError
from service.pipeline.control.control_conditions import control_conditions
from service.pipeline.control.release.control_verdict import ControlView
from service.pipeline.control.release.events import OrderKind
from service.runtime.control.automatic_release import AutomaticRelease

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["control"])
Ordered = Annotated[OrderDocument, optional_body(OrderDocument)]
SignChecked = Annotated[SignCheckDocument, optional_body(SignCheckDocument)]
_ACCEPTS_ORDER = accepts(OrderDocument, is_required=False)
_ACCEPTS_SIGN_CHECK = accepts(SignCheckDocument, is_required=False)
#: order in which signs are checked where none is named: yaw turns by the roll that it causes, so it comes last
_CHECK_ORDER = ("roll", "pitch", "yaw")


@router.get("/control")
def get_control(spacecraft_id: SpacecraftId, context: Context) -> ControlAnswer:
    """Return the state of the interlock, all active reasons, and every condition with its value and limit."""
    return _answer(context, spacecraft_id, context.release_service.control(spacecraft_id))


@router.post("/control:arm", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def arm_control(caller: CurrentCaller, body: Ordered, request: Request) -> ControlAnswer:
    """Arm: commands may be prepared and confirmed unless a reason is active; two approvers set release automatic."""
    if body.release is None:
        return _order(caller, OrderKind.ARM, body)
    if not caller.is_approver:
        raise ForbiddenError("key.forbidden", "release automatic is asked for by approvers")
    spacecraft_id, release = caller.spacecraft_id, caller.release
    if not release.control(spacecraft_id).is_armed:
        release.order(spacecraft_id, OrderKind.ARM, caller.name)
    automatic: AutomaticRelease = request.app.state.automatic_release
    first = automatic.ask(spacecraft_id, caller.name, caller.context.clock.system_us())
    text = "release automatic asked for" if first is None else f"release automatic set, asked for by {first} before"
    caller.log(text, body.comment or "control:arm")
    caller.context.on_accepted(spacecraft_id)
    return _answer(caller.context, spacecraft_id, release.control(spacecraft_id))


@router.post("/control:disengage", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def disengage_control(caller: CurrentCaller, body: Ordered) -> ControlAnswer:
    """Take the standing authorisation back; where there is none, the arming."""
    return _order(caller, OrderKind.DISENGAGE, body)


@router.post("/control:reset", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def reset_control(caller: CurrentCaller, body: Ordered) -> ControlAnswer:
    """Reset a trip once what tripped is over; ten good minutes and an arming follow."""
    return _order(caller, OrderKind.RESET, body)


@router.post("/control:stop", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_ORDER)
def stop_control(caller: CurrentCaller, body: Ordered) -> ControlAnswer:
    """Trip: no torque is sent until a reset; commands already sent cannot be stopped."""
    return _order(caller, OrderKind.STOP, body)


@router.post("/control:engage", dependencies=[MAY_APPROVE], openapi_extra=accepts(OrderDocument))
def engage_control(caller: CurrentCaller, body: Ordered) -> ControlAnswer:
    """Request standing authorisation within an envelope, or second the equal request of another person."""
    if body.until is None:
        detail = "say until when the authorisation holds, at most 12 h ahead"
        raise invalid_request([FieldError("/until", "field.missing", detail)])
    spacecraft_id, release, envelope = caller.spacecraft_id, caller.release, None
    if body.envelope is not None:
        envelope = body.envelope.within(release.control(spacecraft_id).envelope)
    view = release.engage(
        spacecraft_id, caller.name, is_approver=caller.is_approver, until_us=body.until, envelope=envelope
    )
    caller.log("engage", body.comment)
    return _answer(caller.context, spacecraft_id, view)


@router.post("/control:sign-check", dependencies=[MAY_OPERATE], openapi_extra=_ACCEPTS_SIGN_CHECK)
def check_sign(caller: CurrentCaller, body: SignChecked) -> ControlAnswer:
    """Begin to prove the sign of an axis: small turns are prepared one by one, each to be confirmed and reported."""
    axis: str | None = body.axis
    if axis is None:
        proven = caller.release.control(caller.spacecraft_id).proven_axes
        axis = next((each for each in _CHECK_ORDER if each not in proven), _CHECK_ORDER[0])
    view = caller.release.sign_check(caller.spacecraft_id, axis, caller.name)
    caller.log(f"sign check of {axis}", body.comment)
    return _answer(caller.context, caller.spacecraft_id, view)


def _order(caller: Caller, kind: OrderKind, body: OrderDocument) -> ControlAnswer:
    """Return the state of the interlock after an order."""
    view = caller.release.order(caller.spacecraft_id, kind, caller.name)
    caller.log(kind.value, body.comment)
    return _answer(caller.context, caller.spacecraft_id, view)


def _answer(context: ApiContext, spacecraft_id: str, view: ControlView) -> ControlAnswer:
    """Return the answer of a view of the interlock, with the verdict."""
    present = present_of(context, context.storage.catalogue.spacecraft(spacecraft_id), view)
    conditions = control_conditions(view, present.row, present.verdict, context.interlock)
    return ControlAnswer.of(view, present.verdict, conditions)
