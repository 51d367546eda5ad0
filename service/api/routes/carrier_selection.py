"""Carrier selection: which carriers a rule recommends, and why."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query

from service.api.deps import Context, SpacecraftId
from service.api.schemas.inspection import CarrierSelectionAnswer
from service.errors import InvalidInputError
from service.runtime.inspection import recommend_carriers

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carrier-selection", tags=["calibration"])


@router.get("")
def get_carrier_selection(
    spacecraft_id: SpacecraftId,
    context: Context,
    count: Annotated[int, Query(ge=3, le=1000, description="Carriers wanted")] = 16,
    rule: Literal["paper", "optimal"] = "paper",
) -> CarrierSelectionAnswer:
    """Recommend carriers by the newest calibration that has figures; nothing is stored."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    if rule != "paper":
        raise InvalidInputError("selection.rule", "this version has the rule paper only; ask for it or name none")
    recommendation = recommend_carriers(context.storage, spacecraft_id, count, context.calibration)
    return CarrierSelectionAnswer.of(rule, count, recommendation)
