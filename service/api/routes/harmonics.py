"""Harmonics: the fit of any window of the archive, on demand."""

from typing import Annotated

from fastapi import APIRouter, Query

from service.api.context.dependencies import Context, SpacecraftId
from service.api.protocol.paging import EVERYTHING, window_of
from service.api.schemas.inspection import WindowHarmonicsAnswer
from service.api.schemas.live_method import LiveMethod
from service.records.catalogue import Method
from service.runtime.jobs.archive_analysis import window_harmonics

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/harmonics", tags=["calibration"])


@router.get("")
def get_harmonics(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: Annotated[str, Query(max_length=64, description="RFC 3339, inclusive")],
    stop: Annotated[str, Query(max_length=64, description="RFC 3339, exclusive")],
    carrier: Annotated[str | None, Query(max_length=64, description="Default: all carriers of the newest plan")] = None,
    method: LiveMethod = Method.PAPER,
) -> WindowHarmonicsAnswer:
    """Fit the daily change of a window; nothing is stored.

    `paper`: one harmonic, 3 sigma. `robust`: trimmed start and Tukey's estimate of the dish law where the ephemeris has
    a track over the window, else of two harmonics.
    """
    window = window_of(start, stop, EVERYTHING)
    context.storage.catalogue.spacecraft(spacecraft_id)
    harmonics = window_harmonics(context.storage, spacecraft_id, window, carrier, method, context.calibration)
    return WindowHarmonicsAnswer.of(window, method, harmonics)
