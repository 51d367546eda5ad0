"""Requests: ids, bodies that are read raw and validated in one pass, merge patches, byte ranges."""

import itertools
import json
import logging
import re
import secrets
from collections.abc import Callable, Iterator, Mapping
from difflib import get_close_matches
from functools import cached_property, partial
from http import HTTPStatus
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

from fastapi import APIRouter, Depends, Request, params
from fastapi.dependencies.utils import get_flat_params
from fastapi.routing import APIRoute
from pydantic import BaseModel, RootModel, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.access.auth import digest_body
from service.api.problems import problems
from service.errors import FieldError
from service.records.field_faults import fault_sentence
from service.records.operations.access import without_secrets
from service.runtime.log_format import REQUEST_ID

M = TypeVar("M", bound=BaseModel)
#: values of one body: a full batch of 10 000 rows has 32 carriers with three figures each; a value takes 80 bytes
MOST_VALUES = 1_000_000
#: decoding less takes some milliseconds
_LARGE_BYTES = 256 * 1024
_NUMBERS_LIST = re.compile(rb"\[[-+0-9.eE,\snul]*\]")
_REF_TEMPLATE = "#/components/schemas/{model}Input"


def decode(adapter: TypeAdapter[M], raw: bytes, prefix: str = "") -> M:
    """Return a validated document.

    Parameters
    ----------
    adapter : TypeAdapter
        Of the document's model.
    raw : bytes
        JSON.
    prefix : str
        Put before the pointers of faults.

    Raises
    ------
    RequestProblemError
        400 for text that is no JSON or has a key twice, 413 for more values than are decoded, 422 for JSON that does
        not fit the model.
    """
    if len(raw) > MOST_VALUES and sum(raw.count(mark) for mark in (b",", b"[", b"{")) > MOST_VALUES:
        detail = f"the body holds more than {MOST_VALUES} values"
        raise problems.RequestProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body.too_many_values", detail)
    try:
        document = adapter.validate_json(raw)
        _refuse_duplicate_keys(raw)
    except ValidationError as error:
        faults = error.errors(include_url=False, include_input=False)
    else:
        return document
    if faults[0]["type"] == "json_invalid":
        raise problems.RequestProblemError(
            HTTPStatus.BAD_REQUEST, "json.malformed", f"the body {fault_sentence(faults[0])[:200]}"
        )
    raise problems.invalid_request(problems.faults_of(faults, prefix))


def _refuse_duplicate_keys(raw: bytes) -> None:
    """Raise for an object with a key twice, of which one parser believes the first and another the last."""
    twice: list[str] = []
    # without lists of numbers, which are nearly all of a batch; what that makes equal is looked at as it was sent
    for text in (_NUMBERS_LIST.sub(b"0", raw), raw):
        twice.clear()
        json.JSONDecoder(object_pairs_hook=partial(_note_duplicate, twice)).decode(text.decode())
        if not twice:
            return
    detail = f"an object of the body has the key {twice[0][:64]!r} twice"
    raise problems.RequestProblemError(HTTPStatus.BAD_REQUEST, "json.duplicate_key", detail)


def _note_duplicate(twice: list[str], pairs: list[tuple[str, Any]]) -> None:
    names = [name for name, _ in pairs]
    if len(set(names)) < len(names):
        twice += [name for position, name in enumerate(names) if name in names[:position]]


async def refuse_unknown_parameters(request: Request) -> None:
    """Raise 422 ``query.unknown`` for each query parameter that the route does not have, with the nearest name."""
    if not request.scope["query_string"]:
        return
    fields = get_flat_params(request.scope["route"].dependant)
    names = sorted(field.alias for field in fields if isinstance(field.field_info, params.Query))
    unknown = sorted(set(request.query_params) - set(names))[: problems.MAX_FAULTS]
    if unknown:
        raise problems.invalid_request([_unknown_parameter(name, names) for name in unknown])


def _unknown_parameter(name: str, names: list[str]) -> FieldError:
    nearest = get_close_matches(name.lower(), names, n=1)
    detail = f"this path takes no such parameter; it takes {', '.join(names) or 'none'}"
    if nearest:
        detail = f"this path takes no such parameter; the nearest that it takes is {nearest[0]}"
    return FieldError(problems.pointer_of(("query", without_secrets(name))), "query.unknown", detail)


#: on every route
KNOWN_PARAMETERS = Depends(refuse_unknown_parameters)


def media_type(request: Request) -> str:
    """Return the media type of a body, lower case and without parameters; empty when none is stated."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def is_json(media: str) -> bool:
    """Return whether a media type is JSON; a body without a type is taken for JSON."""
    return media in {"", "application/json"} or (media.startswith("application/") and media.endswith("+json"))


def unsupported_media(accepted: str) -> problems.RequestProblemError:
    """Return the 415 that names what is accepted."""
    detail = f"this path accepts a body as {accepted}"
    return problems.RequestProblemError(
        HTTPStatus.UNSUPPORTED_MEDIA_TYPE, "media_type.unsupported", detail, headers={"Accept": accepted}
    )


async def read_body(request: Request, adapter: TypeAdapter[M]) -> M:
    """Return the validated JSON body of a request."""
    if not is_json(media_type(request)):
        raise unsupported_media("application/json")
    raw = await raw_body(request)
    if len(raw) < _LARGE_BYTES:
        return decode(adapter, raw)
    async with request.app.state.large_body:
        return await run_in_threadpool(decode, adapter, raw)


async def raw_body(request: Request) -> bytes:
    """Return the body of a request; what is audited gets its digest."""
    body = await request.body()
    digest_body(request.scope, body)
    return body


class _LateDescription(Mapping[str, Any]):
    """Part of the OpenAPI document that is made when the document is: those of all bodies take 40 ms of a start."""

    def __init__(self, make: Callable[[], dict[str, Any]]) -> None:
        self._make = make

    @cached_property
    def _made(self) -> dict[str, Any]:
        return self._make()

    def __getitem__(self, name: str) -> Any:
        return self._made[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._made)

    def __len__(self) -> int:
        return len(self._made)


def accepts(model: type[BaseModel], *, is_csv: bool = False, is_required: bool = True) -> Any:
    """Return the OpenAPI description of a body; ``openapi.py`` lifts the definitions out of it."""
    return _LateDescription(partial(_description, model, is_csv=is_csv, is_required=is_required))


def _description(model: type[BaseModel], *, is_csv: bool, is_required: bool) -> dict[str, Any]:
    schema = model.model_json_schema(ref_template=_REF_TEMPLATE)
    content: dict[str, Any] = {"application/json": {"schema": schema}}
    if is_csv:
        content["text/csv"] = {"schema": {"type": "string"}}
    return {"requestBody": {"required": is_required, "content": content}}


class BodyReader:
    """Dependency that reads a body as a model; where it is optional, no body is the model without any field.

    Parameters
    ----------
    model : type
        Of the document.
    is_required : bool
        Whether there must be a body.
    """

    def __init__(self, model: type[BaseModel], *, is_required: bool) -> None:
        self._model, self._is_required = model, is_required
        self._adapter = TypeAdapter(model)

    async def __call__(self, request: Request) -> BaseModel:
        """Return the document of a request."""
        is_read = self._is_required or await request.body()
        return await read_body(request, self._adapter) if is_read else self._model()

    def describe(self, route: APIRoute) -> None:
        """State the body in the OpenAPI description of a route, unless the route states it itself."""
        if route.openapi_extra is None:
            route.openapi_extra = accepts(self._model, is_required=self._is_required)


def describe_bodies(router: APIRouter) -> None:
    """State the bodies of the routes in their OpenAPI description."""
    for route in (each for each in router.routes if isinstance(each, APIRoute)):
        for dependency in route.dependant.dependencies:
            if isinstance(dependency.call, BodyReader):
                dependency.call.describe(route)


if TYPE_CHECKING:
    Body = Annotated[M, ...]
    OptionalBody = Annotated[M, ...]
else:

    class Body:
        """`Body[Document]`: parameter of a route that is the body, read as a document."""

        def __class_getitem__(cls, model: type[M]) -> Any:
            """Return the type of the parameter."""
            return Annotated[model, Depends(BodyReader(model, is_required=True))]

    class OptionalBody:
        """`OptionalBody[Document]`: the same of a body that may be absent."""

        def __class_getitem__(cls, model: type[M]) -> Any:
            """Return the type of the parameter."""
            return Annotated[model, Depends(BodyReader(model, is_required=False))]


_ONE_RANGE = re.compile(r"bytes\s*=\s*(\d{0,19})-(\d{0,19})\s*", re.ASCII | re.IGNORECASE)


class UnsatisfiableRangeError(Exception):
    """The range lies behind the end of the file."""


def wanted_range(header: str | None, size: int) -> tuple[int, int] | None:
    """Return first and last byte that are wanted, None for the whole file.

    Parameters
    ----------
    header : str or None
        Value of ``Range``. Several ranges, other units and what cannot be read mean the whole file, as RFC 9110 allows.
    size : int
        Bytes of the file.

    Raises
    ------
    UnsatisfiableRangeError
        A readable range that holds no byte of the file.

    Examples
    --------
    >>> wanted_range("bytes=10-", 100), wanted_range("bytes=-10", 100), wanted_range("bytes=0-1,5-6", 100)
    ((10, 99), (90, 99), None)
    """
    match = _ONE_RANGE.fullmatch(header or "")
    if match is None or match.groups() == ("", ""):
        return None
    first_text, last_text = match.groups()
    if not first_text:
        first, last = max(0, size - int(last_text)), size - 1
    else:
        first, last = int(first_text), min(int(last_text or size - 1), size - 1)
        if last_text and int(last_text) < first:
            return None
    if first > last or first >= size:
        raise UnsatisfiableRangeError
    return first, last


class MergePatch(RootModel[dict[str, Any]]):
    """Fields to change; objects are merged at every depth, null restores a default (RFC 7396)."""


def patched(adapter: TypeAdapter[M], document: dict[str, Any], patch: MergePatch) -> M:
    """Return a document with a patch applied.

    Parameters
    ----------
    adapter : TypeAdapter
        Validates the result.
    document : dict
        What is stored, as JSON.
    patch : MergePatch
        What changes.
    """
    # a NaN passes through as the token NaN, so that the check of the result names its field
    merged = json.dumps(merge(document, patch.root))
    return decode(adapter, merged.encode())


def merge(target: Any, patch: Any) -> Any:
    """Return a JSON value with a merge patch applied; the target stays as it is.

    Examples
    --------
    >>> merge({"a": {"b": 1, "c": 2}}, {"a": {"b": None, "d": 3}})
    {'a': {'c': 2, 'd': 3}}
    """
    if not isinstance(patch, dict):
        return patch
    result = dict(target) if isinstance(target, dict) else {}
    for key, value in patch.items():
        if value is None:
            result.pop(key, None)
        else:
            result[key] = merge(result.get(key), value)
    return result


_HEADER = "X-Request-ID"
_HARMLESS = re.compile(r"[A-Za-z0-9._:-]{1,64}", re.ASCII)
_LOG = logging.getLogger(__name__)
#: fresh ids count up behind a start of their own: they need to differ, and asking the system for noise costs a request
#: the interpreter's lock, which beside a busy writer takes milliseconds to come back
_START = secrets.token_hex(4)
_NUMBERS = itertools.count(1)


class RequestIds:
    """Give each request an id and answer what nobody else answered.

    Parameters
    ----------
    app : ASGIApp
        What lies inside.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request_id = _request_id(scope)
        scope.setdefault("state", {})["request_id"] = request_id
        token = REQUEST_ID.set(request_id)
        is_answered = False

        async def send_with_id(message: Message) -> None:
            nonlocal is_answered
            if message["type"] == "http.response.start":
                is_answered = True
                MutableHeaders(scope=message)[_HEADER] = request_id
            await send(message)

        try:
            await self._app(scope, receive, send_with_id)
        except Exception:
            # the last layer catches all: it logs and answers, or lets the server cut the connection
            _LOG.exception("request %s %s %s failed", request_id, scope["method"], without_secrets(scope["path"]))
            if is_answered:
                raise
            detail = f"the service failed; its log has the reason under request id {request_id}"
            problem = problems.RequestProblemError(HTTPStatus.INTERNAL_SERVER_ERROR, "service.failed", detail)
            await problems.render(HTTPConnection(scope), problem)(scope, receive, send_with_id)
        finally:
            REQUEST_ID.reset(token)


def _request_id(scope: Scope) -> str:
    """Return the id that came with a request when it is harmless, otherwise a fresh one."""
    offered = Headers(scope=scope).get(_HEADER, "")
    return offered if _HARMLESS.fullmatch(offered) else f"{_START}{next(_NUMBERS):08x}"
