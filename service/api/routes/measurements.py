"""Measurements on their way out: the newest row carrier by carrier, and the archive."""

from typing import Annotated

from fastapi import APIRouter, Query

from service.api.context.dependencies import ApiContext, Context, Names, SpacecraftId
from service.api.protocol.paging import Page, by_epoch
from service.api.schemas.measurement_rows import CarrierStateAnswer, MeasurementAnswer, MeasurementPage
from service.records.levels.attitude import CarrierState
from service.records.levels.measurement import Measurement

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/measurements", tags=["measurements"])


@router.get("")
def get_measurements(spacecraft_id: SpacecraftId, context: Context, names: Names) -> list[CarrierStateAnswer]:
    """Return the newest row carrier by carrier; empty before the first."""
    known = context.supervisor.carrier_states(spacecraft_id) or _archived(spacecraft_id, context, names)
    if known is None:
        return []
    measurement, states = known
    return [CarrierStateAnswer.of(measurement, k, state) for k, state in enumerate(states)]


@router.get("/history")
def list_measurements(
    spacecraft_id: SpacecraftId,
    page: Page,
    context: Context,
    names: Names,
    source: Annotated[str | None, Query(max_length=64, description="Only rows of this source")] = None,
    carrier: Annotated[list[str] | None, Query(max_length=1000, description="Only these carriers")] = None,
) -> MeasurementPage:
    """List rows of carrier powers of every source in order of epoch."""
    read = context.storage.archive.measurements
    found = read(spacecraft_id, page.window, page.most, page.after, source, newest_first=page.newest_first)
    wanted = None if carrier is None else frozenset(carrier)

    def of(row: Measurement) -> MeasurementAnswer:
        return MeasurementAnswer.of(row, names.of(spacecraft_id, row.plan_id), wanted)

    return page.answer(MeasurementPage, found, by_epoch, of)


def _archived(
    spacecraft_id: str, context: ApiContext, names: Names
) -> tuple[Measurement, tuple[CarrierState, ...]] | None:
    """Return the newest row of the archive before the chain has consumed any since the start."""
    row = context.storage.archive.newest_measurement(spacecraft_id)
    if row is None:
        return None
    nan = float("nan")
    states = []
    for k, name in enumerate(names.of(spacecraft_id, row.plan_id)):
        power_dbm = float(row.power_dbm[k])
        flags = 0 if row.flags is None else int(row.flags[k])
        word = "absent" if power_dbm != power_dbm else "uncalibrated"
        states.append(CarrierState(name, power_dbm, nan, nan, nan, nan, flags, word))
    return row, tuple(states)
