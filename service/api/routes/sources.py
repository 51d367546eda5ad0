"""Sources: the front ends that send measurements of a spacecraft."""

import re
from typing import Annotated

from fastapi import APIRouter, Path

from service.api.access.auth import MAY_OPERATE
from service.api.context.dependencies import Context, SpacecraftId
from service.api.schemas.base import NAME_PATTERN
from service.api.schemas.measurements import SourceAnswer, SourceListAnswer
from service.errors import NotFoundError

_NAME = re.compile(NAME_PATTERN.strip("^$"), re.ASCII)
router = APIRouter(prefix="/spacecraft/{spacecraft_id}/sources", tags=["measurements"])


@router.get("")
def list_sources(spacecraft_id: SpacecraftId, context: Context) -> SourceListAnswer:
    """List the sources seen so far."""
    return SourceListAnswer(rows=[SourceAnswer.of(state) for state in context.storage.archive.sources(spacecraft_id)])


@router.post("/{source}:select", dependencies=[MAY_OPERATE])
def select_source(
    spacecraft_id: SpacecraftId, source: Annotated[str, Path(description="Id of a source")], context: Context
) -> SourceAnswer:
    """Make a source the prime one; its rows feed the estimator from now on."""
    if _NAME.fullmatch(source) is None:  # a name that cannot exist never reaches the database
        raise NotFoundError("source.unknown", f"no source {source[:64]!r}")
    state = context.storage.archive.select_source(spacecraft_id, source)
    context.on_accepted(spacecraft_id)
    return SourceAnswer.of(state)
