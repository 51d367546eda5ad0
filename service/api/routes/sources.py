"""Sources: the front ends that send measurements of a spacecraft."""

from typing import Annotated

from fastapi import APIRouter, Path

from service.api.auth import MAY_OPERATE
from service.api.deps import Context, SpacecraftId
from service.api.schemas.measurements import SourceAnswer, SourceListAnswer
from service.records.series import SourceState

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/sources", tags=["measurements"])


@router.get("")
def list_sources(spacecraft_id: SpacecraftId, context: Context) -> SourceListAnswer:
    """List the sources seen so far."""
    return SourceListAnswer(rows=[_answer(state) for state in context.storage.archive.sources(spacecraft_id)])


@router.post("/{source}:select", dependencies=[MAY_OPERATE])
def select_source(
    spacecraft_id: SpacecraftId, source: Annotated[str, Path(max_length=64)], context: Context
) -> SourceAnswer:
    """Make a source the prime one; its rows feed the estimator from now on."""
    state = context.storage.archive.select_source(spacecraft_id, source)
    context.on_accepted(spacecraft_id)
    return _answer(state)


def _answer(state: SourceState) -> SourceAnswer:
    """Return a source as it is told."""
    role = "prime" if state.role == "prime" else "backup"
    return SourceAnswer.model_validate(
        {"id": state.id, "role": role, "newest_epoch": state.newest_epoch_us, "rows": state.rows}
    )
