"""Attitude, status, and control: the interlock, computed torques, commands that two persons release."""

from functools import partial
from http import HTTPStatus
from operator import attrgetter
from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from service.api.access.auth import MAY_APPROVE, MAY_OPERATE
from service.api.context import (
    ApiContext,
    Context,
    MethodParameter,
    Names,
    SpacecraftId,
    StoredMethod,
    WantedVersion,
    check_method,
)
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import Page, by_epoch
from service.api.protocol.requests import Body, OptionalBody, accepts
from service.api.routes.shift import Caller, CurrentCaller, Said
from service.api.schemas import control as documents
from service.api.schemas.measurements import CarrierResultAnswer, CarrierResultPage
from service.api.schemas.shift import StatusAnswer
from service.api.views.present import SpacecraftNow, present_of, status_of
from service.errors import FieldError, ForbiddenError, NotFoundError
from service.pipeline.control.release.control_verdict import ControlView, control_conditions
from service.pipeline.control.release.events import OrderKind
from service.ports.archive import LIVE, SMOOTHED
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.levels.attitude import AttitudeRow
from service.records.operations.release import ProductForm
from service.runtime.control.release_service import AutomaticRelease

attitude_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/attitude", tags=["attitude"])


@attitude_router.get("")
def get_attitude(
    spacecraft_id: SpacecraftId, context: Context, method: MethodParameter = None
) -> documents.NewestAttitudeAnswer:
    """Return the newest attitude; status NOT_RECEIVED before the first row, EXPIRED when the newest is too old."""
    now = SpacecraftNow(context, spacecraft_id)
    method = method or now.spacecraft.control.method
    check_method(method, LIVE)
    present = present_of(context, now)
    row, control = present.row, present.control
    if method is not now.spacecraft.control.method:
        row = now.row(method)
    if row is None:
        return documents.NewestAttitudeAnswer.not_received(method, LIVE, control=control)
    return documents.NewestAttitudeAnswer.of(row, LIVE, control=control)


@attitude_router.get("/history")
def list_attitude(
    spacecraft_id: SpacecraftId,
    method: StoredMethod,
    version: WantedVersion,
    page: Page,
    context: Context,
) -> documents.AttitudePage:
    """List attitude rows in order of epoch, exactly one a measurement and method."""
    read = context.storage.results.attitude_rows
    found = read(spacecraft_id, version, method, page.part)
    of = partial(documents.AttitudeAnswer.of, version=version)
    return page.answer(documents.AttitudePage, found, by_epoch, of, method=method, version=version)


@attitude_router.get("/smoothed")
def list_smoothed(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.SmoothedPage:
    """List smoothed rows in order of epoch, one each five minutes, made when the data reach the lag beyond them."""
    read, method = context.storage.results.attitude_rows, Method.ROBUST_SMOOTHED
    found = read(spacecraft_id, SMOOTHED, method, page.part)
    of = partial(documents.AttitudeAnswer.of, version=SMOOTHED)
    return page.answer(documents.SmoothedPage, found, by_epoch, of, method=method, version=SMOOTHED)


carrier_results_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carriers/{carrier}/results", tags=["attitude"])


@carrier_results_router.get("")
def list_carrier_results(
    spacecraft_id: SpacecraftId,
    carrier: Annotated[str, Path(max_length=64, description="Carrier id")],
    method: StoredMethod,
    version: WantedVersion,
    page: Page,
    context: Context,
    names: Names,
) -> CarrierResultPage:
    """List what a method made of one carrier at every measurement, in order of epoch."""
    results = context.storage.results
    found = results.attitude_rows(spacecraft_id, version, method, page.part)
    ends = sorted((found[0].epoch_us, found[-1].epoch_us)) if found else (0, -1)
    window = Window(ends[0], ends[1] + 1)
    stored = results.carrier_results(spacecraft_id, version, method, window)

    plan_ids = {known.plan_id for known in stored.values()}
    is_known = any(carrier in names.of(spacecraft_id, plan_id) for plan_id in plan_ids)
    if not is_known and carrier not in context.storage.catalogue.plan(spacecraft_id).carrier_ids:
        detail = f"Neither the newest carrier plan of {spacecraft_id!r} nor these rows have a carrier {carrier!r}."
        raise NotFoundError("carrier.unknown", detail)

    def of(row: AttitudeRow) -> CarrierResultAnswer:
        known = stored.get((row.epoch_us, row.number))
        ids = () if known is None else names.of(spacecraft_id, known.plan_id)
        return CarrierResultAnswer.of(row, known, ids.index(carrier) if carrier in ids else None, carrier)

    return page.answer(CarrierResultPage, found, by_epoch, of, carrier=carrier, method=method, version=version)


control_router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["control"])
Ordered = OptionalBody[documents.OrderDocument]
SignChecked = OptionalBody[documents.SignCheckDocument]
#: order in which signs are checked where none is named: yaw turns by the roll that it causes, so it comes last
_CHECK_ORDER = ("roll", "pitch", "yaw")


@control_router.get("/control")
def get_control(spacecraft_id: SpacecraftId, context: Context) -> documents.ControlAnswer:
    """Return the state of the interlock, all active reasons, and every condition with its value and limit."""
    return _answer(context, spacecraft_id, context.release_service.control(spacecraft_id))


@control_router.post("/control:arm", dependencies=[MAY_OPERATE])
def arm_control(caller: CurrentCaller, body: Ordered, request: Request) -> documents.ControlAnswer:
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


@control_router.post("/control:disengage", dependencies=[MAY_OPERATE])
def disengage_control(caller: CurrentCaller, body: Ordered) -> documents.ControlAnswer:
    """Take the standing authorisation back; where there is none, the arming."""
    return _order(caller, OrderKind.DISENGAGE, body)


@control_router.post("/control:reset", dependencies=[MAY_OPERATE])
def reset_control(caller: CurrentCaller, body: Ordered) -> documents.ControlAnswer:
    """Reset a trip once what tripped is over; ten good minutes and an arming follow."""
    return _order(caller, OrderKind.RESET, body)


@control_router.post("/control:stop", dependencies=[MAY_OPERATE])
def stop_control(caller: CurrentCaller, body: Ordered) -> documents.ControlAnswer:
    """Trip: no torque is sent until a reset; commands already sent cannot be stopped."""
    return _order(caller, OrderKind.STOP, body)


@control_router.post("/control:engage", dependencies=[MAY_APPROVE], openapi_extra=accepts(documents.OrderDocument))
def engage_control(caller: CurrentCaller, body: Ordered) -> documents.ControlAnswer:
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


@control_router.post("/control:sign-check", dependencies=[MAY_OPERATE])
def check_sign(caller: CurrentCaller, body: SignChecked) -> documents.ControlAnswer:
    """Begin to prove the sign of an axis: small turns are prepared one by one, each to be confirmed and reported."""
    axis: str | None = body.axis
    if axis is None:
        proven = caller.release.control(caller.spacecraft_id).proven_axes
        axis = next((each for each in _CHECK_ORDER if each not in proven), _CHECK_ORDER[0])
    view = caller.release.sign_check(caller.spacecraft_id, axis, caller.name)
    caller.log(f"sign check of {axis}", body.comment)
    return _answer(caller.context, caller.spacecraft_id, view)


def _order(caller: Caller, kind: OrderKind, body: documents.OrderDocument) -> documents.ControlAnswer:
    """Return the state of the interlock after an order."""
    view = caller.release.order(caller.spacecraft_id, kind, caller.name)
    caller.log(kind.value, body.comment)
    return _answer(caller.context, caller.spacecraft_id, view)


def _answer(context: ApiContext, spacecraft_id: str, view: ControlView) -> documents.ControlAnswer:
    """Return the answer of a view of the interlock, with the verdict."""
    present = present_of(context, SpacecraftNow(context, spacecraft_id), view)
    conditions = control_conditions(view, present.row, present.verdict, context.interlock)
    return documents.ControlAnswer.of(view, present.control, conditions, context.interlock.validity_limit_deg)


status_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/status", tags=["status"])


@status_router.get("")
def get_status(spacecraft_id: SpacecraftId, context: Context) -> StatusAnswer:
    """Return the state of a spacecraft."""
    return status_of(context, spacecraft_id)


torque_commands_router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["release of torques"])
#: its counter
CommandId = Annotated[int, Path(ge=1, le=2**53)]
ReportBody = OptionalBody[documents.ReportDocument]


@torque_commands_router.post(
    "/torques:prepare",
    status_code=HTTPStatus.CREATED,
    dependencies=[MAY_OPERATE],
    responses={HTTPStatus.OK: {"model": documents.CommandAnswer, "description": "Of a dry run: nothing is stored"}},
)
def prepare_torques(
    caller: CurrentCaller, body: Body[documents.PrepareDocument], response: Response
) -> documents.CommandAnswer:
    """Compute and check a command that waits for another person; a dry run only shows it."""
    command = caller.release.prepare(caller.spacecraft_id, caller.name, body.to_request(), dry_run=body.dry_run)
    if command.is_dry_run:
        response.status_code = HTTPStatus.OK
    else:
        response.headers["Location"] = f"/api/v1/spacecraft/{caller.spacecraft_id}/torques/{command.counter}"
    return documents.CommandAnswer.of(command, caller.context.storage.catalogue.spacecraft(caller.spacecraft_id))


@torque_commands_router.get("/torques/commands")
def list_commands(spacecraft_id: SpacecraftId, page: Page, context: Context) -> documents.CommandPage:
    """List commands that were prepared in the range, in order of their preparation."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    found = context.storage.releases.commands(spacecraft_id, page.part)
    return page.answer(documents.CommandPage, found, attrgetter("prepared_us", "counter"), documents.CommandAnswer.of)


@torque_commands_router.get("/torques/{command_id}")
def get_command(spacecraft_id: SpacecraftId, command_id: CommandId, context: Context) -> documents.CommandAnswer:
    """Return one command as it stands, with the angles that it is predicted to bring about."""
    command = context.release_service.command(spacecraft_id, command_id)
    return documents.CommandAnswer.of(command, context.storage.catalogue.spacecraft(spacecraft_id))


@torque_commands_router.get("/torques/{command_id}/uplink")
def get_uplink(spacecraft_id: SpacecraftId, command_id: CommandId, context: Context) -> documents.UplinkAnswer:
    """Return what goes up of a released command."""
    return documents.UplinkAnswer.of(context.storage.releases.product(spacecraft_id, ProductForm.TORQUES, command_id))


@torque_commands_router.get("/attitude/uplink")
def get_attitude_uplink(spacecraft_id: SpacecraftId, context: Context) -> documents.UplinkAnswer:
    """Return the newest angles for a spacecraft in mode onboard, with their counter and how long they hold."""
    return documents.UplinkAnswer.of(context.release_service.attitude_uplink(spacecraft_id))


@torque_commands_router.post("/torques/{command_id}:confirm", dependencies=[MAY_APPROVE])
def confirm_torques(
    caller: CurrentCaller, command_id: CommandId, body: Body[documents.ConfirmDocument]
) -> documents.CommandAnswer:
    """Confirm a command that another person prepared; it is released at once, or refused with the reason."""
    command = caller.release.confirm(
        caller.spacecraft_id, command_id, caller.name, body.digest, is_approver=caller.is_approver, comment=body.comment
    )
    return documents.CommandAnswer.of(command)


@torque_commands_router.post("/torques/{command_id}:cancel", dependencies=[MAY_OPERATE])
def cancel_torques(caller: CurrentCaller, command_id: CommandId, body: Said) -> documents.CommandAnswer:
    """Take a prepared command back; what has been released cannot be called back."""
    command = caller.release.cancel(caller.spacecraft_id, command_id, caller.name)
    caller.log(f"cancel command {command_id}", body.comment)
    return documents.CommandAnswer.of(command)


@torque_commands_router.post("/torques/{command_id}:sent", dependencies=[MAY_OPERATE])
def report_sent(caller: CurrentCaller, command_id: CommandId, body: ReportBody) -> documents.CommandAnswer:
    """Report that a released command was uplinked."""
    return _reported(caller, command_id, "sent", body)


@torque_commands_router.post("/torques/{command_id}:executed", dependencies=[MAY_OPERATE])
def report_executed(caller: CurrentCaller, command_id: CommandId, body: ReportBody) -> documents.CommandAnswer:
    """Report that a command was executed, whole or between two instants; it becomes known input of the filter."""
    return _reported(caller, command_id, "executed", body)


@torque_commands_router.post("/torques/{command_id}:failed", dependencies=[MAY_OPERATE])
def report_failed(caller: CurrentCaller, command_id: CommandId, body: ReportBody) -> documents.CommandAnswer:
    """Report that a command was not executed, or only between two instants."""
    return _reported(caller, command_id, "failed", body)


def _reported(caller: Caller, command_id: int, turn: str, body: documents.ReportDocument) -> documents.CommandAnswer:
    command = caller.release.report(
        caller.spacecraft_id,
        command_id,
        turn,
        by=caller.name,
        at_us=body.at,
        executed_from_us=body.executed_from,
        executed_until_us=body.executed_until,
    )
    return documents.CommandAnswer.of(command)


torques_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/torques", tags=["torques"])


@torques_router.get("")
def get_torques(spacecraft_id: SpacecraftId, context: Context) -> documents.NewestTorqueAnswer:
    """Return the newest command: zero with its reasons while control is inhibited, null before the first."""
    now = SpacecraftNow(context, spacecraft_id)
    present = present_of(context, now)
    row, command = present.row, present.command
    if command is None:
        answer = documents.TorqueAnswer.before_the_first(
            now.spacecraft.control.mode, None if row is None else row.epoch_us
        )
    else:
        answer = documents.TorqueAnswer.of(command)
    return documents.NewestTorqueAnswer(**dict(answer), control=present.control)


@torques_router.get("/history")
def list_torques(
    spacecraft_id: SpacecraftId, version: WantedVersion, page: Page, context: Context
) -> documents.TorquePage:
    """List computed commands in order of epoch."""
    read = context.storage.results.commands
    found = read(spacecraft_id, version, page.part)
    return page.answer(documents.TorquePage, found, by_epoch, documents.TorqueAnswer.of, version=version)
