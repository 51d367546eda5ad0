"""Keys, sessions, audit log; the service itself: health, version, reference page."""

import re
from dataclasses import replace
from http import HTTPStatus
from ipaddress import ip_address
from operator import attrgetter
from platform import python_version
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from fastapi.responses import HTMLResponse
from pydantic import BaseModel
from starlette.concurrency import run_in_threadpool

from service.api.access import auth
from service.api.access.housekeeping import StoredKeys
from service.api.context import Context, of_application
from service.api.monitoring.metrics import MEDIA_TYPE, Metrics, SharedReadiness, require_ready
from service.api.problems.problems import RequestProblemError, invalid_request
from service.api.protocol.openapi import render_page
from service.api.protocol.paging import Page
from service.api.protocol.requests import Body, media_type, unsupported_media
from service.api.schemas.access import (
    AboutAnswer,
    AuditEntryAnswer,
    AuditHeadAnswer,
    AuditPage,
    ClockAnswer,
    KeyAnswer,
    KeyDocument,
    KeyList,
    NewKeyAnswer,
    SessionAnswer,
    SessionDocument,
    SettingAnswer,
    ShippedAnswer,
)
from service.api.views.shipped import program_version, shipped_distributions
from service.errors import ConflictError, FieldError, NotFoundError
from service.records.epoch import US_PER_S
from service.records.operations.access import AccessKey, AuditFilter, Role, StoredKey, digest_of, new_key
from service.runtime.live.journal_consumer import Restarting

about_router = APIRouter(tags=["health"])


@about_router.get("/about")
def get_about(context: Context) -> AboutAnswer:
    """Return version, clock, settings in force without secrets, and the licences of what is installed with it."""
    return AboutAnswer(
        version=program_version(),
        python=python_version(),
        clock=ClockAnswer.model_validate({"now": context.clock.system_us(), "kind": context.clock_kind}),
        settings=[SettingAnswer.model_validate(entry._asdict() | {"unit": entry.unit}) for entry in context.settings],
        shipped=[ShippedAnswer(**each._asdict()) for each in shipped_distributions()],
    )


audit_router = APIRouter(prefix="/audit", tags=["access"], dependencies=[auth.MAY_INSPECT])
_WORDS = r"^[^\x00-\x1f\x7f]*$"


def _exact(description: str) -> object:
    return Query(max_length=200, pattern=_WORDS, description=description)


@audit_router.get("")
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


health_router = APIRouter(tags=["health"])


class HealthAnswer(BaseModel):
    """State of the process."""

    status: Literal["ok"] = "ok"


class PartHealth(BaseModel):
    """One part of the service that is ready."""

    name: str
    detail: str


class CatchingUp(BaseModel):
    """Chain that consumes its journal again after a restart: its newest row grows old meanwhile, rows are kept."""

    spacecraft: str
    rows_left: int
    seconds_left: float | None
    """At the pace so far; null at the beginning."""


class Leader(BaseModel):
    """Process that estimates, alarms and releases a spacecraft."""

    spacecraft: str
    process: str


class ReadinessAnswer(BaseModel):
    """State of a service that is ready; one that is not answers 503 with a problem that names the parts."""

    status: Literal["ready"] = "ready"
    parts: list[PartHealth]
    catching_up: CatchingUp | None = None
    leaders: list[Leader] = []
    """Of the spacecraft of an archive on a server; one that is missing is led by nobody."""


@health_router.get("/healthz")
async def get_health() -> HealthAnswer:
    """Tell that the process lives."""
    return HealthAnswer()


@health_router.get("/readyz")
async def get_readiness(request: Request, context: Context) -> ReadinessAnswer:
    """Tell whether every part is ready: database, disk, consumers; 503 names those that are not.

    A service that catches up after a restart is ready: it keeps what it is sent.
    """
    readiness: SharedReadiness = request.app.state.readiness
    parts = await readiness.parts()
    require_ready(parts)
    restarting = context.supervisor.restarts.under_way
    leaders = await run_in_threadpool(context.leaders)
    return ReadinessAnswer(
        parts=[PartHealth(name=part.name, detail=part.detail) for part in parts],
        catching_up=None if restarting is None else _catching_up(restarting),
        leaders=[Leader(spacecraft=name, process=process) for name, process in sorted(leaders.items()) if name],
    )


def _catching_up(restarting: Restarting) -> CatchingUp:
    """Return what is told of a restart under way."""
    return CatchingUp(
        spacecraft=restarting.spacecraft_id, rows_left=restarting.entries_left, seconds_left=restarting.seconds_left
    )


@health_router.get(
    "/metrics",
    response_class=Response,
    responses={HTTPStatus.OK: {"content": {"text/plain": {"schema": {"type": "string"}}}, "description": "Metrics"}},
)
async def get_metrics(request: Request, context: Context) -> Response:
    """Return the figures of the service in the text form of Prometheus; a key is needed by setting only."""
    # the key first: wrong ones of others behind the same address keep no holder of a valid one out
    await (auth.authenticated if context.monitoring.metrics_need_key else auth.known_or_counted)(request)
    metrics: Metrics = request.app.state.metrics
    return Response(await run_in_threadpool(metrics.render), media_type=MEDIA_TYPE)


@health_router.get("/docs", include_in_schema=False)
def get_reference(request: Request) -> HTMLResponse:
    """Return the reference of this interface as a page."""
    return HTMLResponse(render_page(request.app.openapi()))


keys_router = APIRouter(prefix="/keys", tags=["access"], dependencies=[auth.MAY_ADMINISTER])
_ID = re.compile(r"[a-z0-9]{1,32}", re.ASCII)


Ring = Annotated[StoredKeys, of_application("stored_keys")]


@keys_router.post("", status_code=HTTPStatus.CREATED)
def create_key(
    body: Body[KeyDocument], context: Context, principal: auth.CurrentPrincipal, ring: Ring, response: Response
) -> NewKeyAnswer:
    """Make a key; only this answer contains its secret."""
    now_us = context.clock.system_us()
    if body.expires_at is not None and body.expires_at <= now_us:
        detail = "the key would have expired already"
        raise invalid_request([FieldError("/expires_at", "key.expires_past", detail)])
    key_id, text = new_key()
    station, spacecraft, kinds = _bound(body, context, now_us)
    key = AccessKey(
        id=key_id,
        name=body.name,
        role=body.role,
        created_at_us=now_us,
        created_by=principal.name,
        expires_at_us=body.expires_at,
        station=station,
        spacecraft=spacecraft,
        kinds=kinds,
    )
    context.storage.keys.add(StoredKey(key, digest_of(text.encode("ascii"))))
    ring.forget()
    response.headers["Cache-Control"] = "no-store"
    content = {"id": key.id, "key": text, "name": key.name, "role": key.role, "expires_at": key.expires_at_us}
    return NewKeyAnswer.model_validate(content)


def _bound(body: KeyDocument, context: Context, now_us: int) -> tuple[str | None, tuple[str, ...], tuple[str, ...]]:
    """Return station, spacecraft and kinds of a new key; those of the station's valid keys where it states none."""
    if body.role is not Role.STATION:
        if body.station or body.spacecraft or body.kinds:
            raise invalid_request([FieldError("/station", "key.not_station", "only a key of role station has one")])
        return None, (), ()
    station = body.station or body.name
    stated = tuple(body.spacecraft or ()), tuple(body.kinds or ())
    keys = (each.key for each in context.storage.keys.all())
    valid = next((key for key in keys if key.station == station and key.is_valid(now_us)), None)
    if valid is None:
        return station, *stated
    inherited = valid.spacecraft, valid.kinds
    asked = (body.spacecraft, body.kinds)
    if any(each is not None and set(each) != set(known) for each, known in zip(asked, inherited, strict=True)):
        detail = f"key {valid.id} of station {station!r} is valid and bound otherwise"
        raise ConflictError("key.station_bound", detail)
    return station, *inherited


@keys_router.get("")
def list_keys(
    context: Context,
    ring: Ring,
    revoked: Annotated[bool, Query(description="List revoked keys too")] = False,  # noqa: FBT002 - a query parameter
) -> KeyList:
    """List keys without their secrets."""
    now_us = context.clock.system_us()
    keys = [each.key for each in context.storage.keys.all() if revoked or each.key.revoked_at_us is None]
    return KeyList(rows=[KeyAnswer.of(key, now_us, ring.last_used_us(key.id, key.last_used_us)) for key in keys])


@keys_router.delete("/{key_id}", status_code=HTTPStatus.NO_CONTENT)
def revoke_key(key_id: Annotated[str, Path(description="Id of a key")], context: Context, ring: Ring) -> None:
    """Revoke a key: at once in this process, within seconds in every other."""
    if _ID.fullmatch(key_id) is None:
        # not told back: somebody may have put a whole key here
        raise NotFoundError("key.unknown", "no key has such an id")
    context.storage.keys.revoke(key_id, context.clock.system_us())
    ring.forget()


session_router = APIRouter(prefix="/api/v1/session", tags=["access"])


@session_router.post("")
async def open_browser_session(
    body: Body[SessionDocument], context: Context, ring: Ring, request: Request, response: Response
) -> SessionAnswer:
    """Open a session: the answer sets a cookie that stands for the key for twelve hours, or until the key expires."""
    if not media_type(request):
        # a page of another site may send such a body without asking first
        raise unsupported_media("application/json")
    if "origin" in request.headers:
        auth.require_same_origin(request)
    if not (request.url.scheme == "https" or context.limits.plain_sessions or _is_loopback(request)):
        detail = "a key would cross the network unprotected"
        raise RequestProblemError(HTTPStatus.FORBIDDEN, "session.plain_http", detail)
    principal = await ring.principal(body.key)
    if principal is None:
        raise auth.refusal_of_key("this key is not known, expired or revoked")
    token, session = await run_in_threadpool(ring.open_session, principal)
    auth.set_cookie(request, response, token, (session.ends_at_us - context.clock.system_us()) // US_PER_S)
    response.headers["Cache-Control"] = "no-store"
    return SessionAnswer.of(replace(principal, session=session))


@session_router.get("")
async def get_session(principal: auth.CurrentPrincipal, response: Response) -> SessionAnswer:
    """Return who holds the key of this request, what it may do, and until when."""
    response.headers["Cache-Control"] = "no-store"
    return SessionAnswer.of(principal)


@session_router.delete("", status_code=HTTPStatus.NO_CONTENT)
async def close_browser_session(
    principal: auth.CurrentPrincipal, ring: Ring, request: Request, response: Response
) -> None:
    """End the session of the cookie, which is taken away; the key stays valid."""
    if principal.session is not None:
        await run_in_threadpool(ring.end_session, principal.session)
    auth.set_cookie(request, response, "", 0)


def _is_loopback(request: Request) -> bool:
    try:
        return ip_address(auth.address_of(request.scope)).is_loopback
    except ValueError:
        return False
