"""Carrier selection: which carriers a rule recommends, and why; what they see beside the other sets."""

from typing import Annotated

from fastapi import APIRouter, Query

from service.api.context.dependencies import Context, SpacecraftId
from service.api.schemas.carrier_selection import CarrierSelectionAnswer, Turns
from service.pipeline.planning.momentum_gain import WHEEL_PERIOD_S, stated_wheels
from service.pipeline.planning.planning import Rule
from service.runtime.jobs.archive_analysis import MIN_COUNT, recommend_carriers

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carrier-selection", tags=["calibration"])


@router.get("")
def get_carrier_selection(
    spacecraft_id: SpacecraftId,
    context: Context,
    count: Annotated[
        int | None, Query(ge=MIN_COUNT, le=1000, description="Carriers wanted; default 16, or all when there are fewer")
    ] = None,
    rule: Annotated[Rule, Query(description="The publication's rule, or the weighted A-optimal choice")] = Rule.PAPER,
    turns: Annotated[Turns, Query(description="Add the recommended calibration turns")] = Turns.NONE,
    wheels_n_m_s: Annotated[
        float | None,
        Query(ge=-1e4, le=1e4, description="Momentum along pitch; default: onboard.momentum.pitch_bias_n_m_s"),
    ] = None,
    wheel_sigma_n_m_s: Annotated[
        float | None, Query(gt=0, le=10, description="Noise of a record; default: that of onboard.momentum, else 0.01")
    ] = None,
    wheel_period_s: Annotated[float, Query(ge=60, le=86_400, description="Time between two records")] = WHEEL_PERIOD_S,
) -> CarrierSelectionAnswer:
    """Recommend carriers by the active calibration by geometry, else by the newest with figures; nothing is stored."""
    spacecraft = context.storage.catalogue.spacecraft(spacecraft_id)
    wheels = stated_wheels(spacecraft.onboard.momentum, wheels_n_m_s, wheel_sigma_n_m_s, wheel_period_s)
    found = recommend_carriers(context.storage, spacecraft_id, count, rule, context.calibration)
    return CarrierSelectionAnswer.of(found.with_motion(spacecraft, wheels), turns)
