"""Operations declared by the control centre."""

from http import HTTPStatus
from typing import Annotated

from fastapi import APIRouter, Path, Response
from pydantic import TypeAdapter

from service.api.access.auth import MAY_OPERATE
from service.api.context.dependencies import Context, SpacecraftId
from service.api.protocol.bodies import accepts, body_of
from service.api.protocol.merge_patch import MergePatch, patched
from service.api.protocol.paging import Page
from service.api.routes.inputs import input_page
from service.api.schemas.operations import OperationAnswer, OperationDocument, OperationPage

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/operations", tags=["inputs"])
_ADAPTER = TypeAdapter(OperationDocument)
OperationId = Annotated[int, Path(ge=1, le=2**31 - 1)]


@router.post("", status_code=HTTPStatus.CREATED, dependencies=[MAY_OPERATE], openapi_extra=accepts(OperationDocument))
def declare_operation(
    spacecraft_id: SpacecraftId,
    body: Annotated[OperationDocument, body_of(OperationDocument)],
    context: Context,
    response: Response,
) -> OperationAnswer:
    """Declare an operation, past, present or future."""
    stored = context.storage.archive.add_operation(spacecraft_id, body.to_record(0))
    context.on_accepted(spacecraft_id)
    response.headers["Location"] = f"/api/v1/spacecraft/{spacecraft_id}/operations/{stored.id}"
    return OperationAnswer.of(stored)


@router.get("")
def list_operations(spacecraft_id: SpacecraftId, page: Page, context: Context) -> OperationPage:
    """List the newest revision of operations that overlap the range."""
    return input_page(spacecraft_id, "operation", page, context, OperationPage, OperationAnswer)


@router.get("/{operation_id}")
def get_operation(spacecraft_id: SpacecraftId, operation_id: OperationId, context: Context) -> OperationAnswer:
    """Return the newest revision of an operation."""
    return OperationAnswer.of(context.storage.archive.operation(spacecraft_id, operation_id))


@router.patch("/{operation_id}", dependencies=[MAY_OPERATE], openapi_extra=accepts(MergePatch))
def change_operation(
    spacecraft_id: SpacecraftId,
    operation_id: OperationId,
    body: Annotated[MergePatch, body_of(MergePatch)],
    context: Context,
) -> OperationAnswer:
    """Change fields of an operation; the change is a new revision, the former ones stay in the journal."""
    stored = OperationAnswer.of(context.storage.archive.operation(spacecraft_id, operation_id))
    changed = patched(_ADAPTER, stored.model_dump(mode="json", exclude={"id", "revision"}), body)
    result = context.storage.archive.replace_operation(spacecraft_id, changed.to_record(operation_id))
    context.on_accepted(spacecraft_id)
    return OperationAnswer.of(result)
