"""Results of one carrier, row by row: its state, and why it was left out."""

from typing import Annotated

from fastapi import APIRouter, Path

from service.api.context.dependencies import Context, Names, SpacecraftId
from service.api.context.method_parameters import StoredMethod, WantedVersion
from service.api.protocol.paging import Page, by_epoch
from service.api.schemas.carrier_results import CarrierResultAnswer, CarrierResultPage
from service.errors import NotFoundError
from service.records.calibration import Window
from service.records.levels.attitude import AttitudeRow

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/carriers/{carrier}/results", tags=["attitude"])


@router.get("")
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
    found = results.attitude_rows(
        spacecraft_id, version, method, page.window, page.most, page.after, newest_first=page.newest_first
    )
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
