"""Bodies: JSON read raw and validated in one pass.

Strict, finite numbers only, no unknown fields. A body that is no JSON at all (broken text, invalid UTF-8, nested deeper
than 200) is a 400; JSON that says the wrong thing is a 422. Large bodies are decoded one at a time, off the event loop.
"""

from http import HTTPStatus
from typing import Any, TypeVar

from fastapi import Depends, Request
from pydantic import BaseModel, TypeAdapter, ValidationError
from starlette.concurrency import run_in_threadpool

from service.api.access.audit_context import digest_body
from service.api.problems.problems import RequestProblemError, invalid_request
from service.api.problems.validation_errors import faults_of
from service.records.field_faults import fault_sentence

M = TypeVar("M", bound=BaseModel)
#: values of one body: a full batch of 10 000 rows has 32 carriers with three figures each; a value takes 80 bytes
MOST_VALUES = 1_000_000
#: decoding less takes some milliseconds
_LARGE_BYTES = 256 * 1024
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
        400 for text that is no JSON, 413 for more values than are decoded, 422 for JSON that does not fit the model.
    """
    if len(raw) > MOST_VALUES and sum(raw.count(mark) for mark in (b",", b"[", b"{")) > MOST_VALUES:
        detail = f"the body holds more than {MOST_VALUES} values"
        raise RequestProblemError(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "body.too_many_values", detail)
    try:
        return adapter.validate_json(raw)
    except ValidationError as error:
        faults = error.errors(include_url=False, include_input=False)
    if faults[0]["type"] == "json_invalid":
        raise RequestProblemError(
            HTTPStatus.BAD_REQUEST, "json.malformed", f"the body {fault_sentence(faults[0])[:200]}"
        )
    raise invalid_request(faults_of(faults, prefix))


def media_type(request: Request) -> str:
    """Return the media type of a body, lower case and without parameters; empty when none is stated."""
    return request.headers.get("content-type", "").partition(";")[0].strip().lower()


def is_json(media: str) -> bool:
    """Return whether a media type is JSON; a body without a type is taken for JSON."""
    return media in {"", "application/json"} or (media.startswith("application/") and media.endswith("+json"))


def unsupported_media(accepted: str) -> RequestProblemError:
    """Return the 415 that names what is accepted."""
    detail = f"this path accepts a body as {accepted}"
    return RequestProblemError(
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


def body_of(model: type[M]) -> Any:
    """Return the dependency that reads the body as a model."""
    adapter = TypeAdapter(model)

    async def read(request: Request) -> M:
        return await read_body(request, adapter)

    return Depends(read)


def optional_body(model: type[M]) -> Any:
    """Return the dependency that reads a body as a model; no body is the model without any field."""
    adapter = TypeAdapter(model)

    async def read(request: Request) -> M:
        return await read_body(request, adapter) if await request.body() else model()

    return Depends(read)


def accepts(model: type[BaseModel], *, is_csv: bool = False, is_required: bool = True) -> dict[str, Any]:
    """Return the OpenAPI description of a body; ``openapi.py`` lifts the definitions out of it."""
    schema = model.model_json_schema(ref_template=_REF_TEMPLATE)
    content: dict[str, Any] = {"application/json": {"schema": schema}}
    if is_csv:
        content["text/csv"] = {"schema": {"type": "string"}}
    return {"requestBody": {"required": is_required, "content": content}}
