"""Beams: boresight of the antennas against the body, and uplink beams at the stations."""

from typing import Annotated

from fastapi import APIRouter, Query

from service.api.context.dependencies import Context, SpacecraftId
from service.api.protocol.paging import EVERYTHING, StartParameter, StopParameter, window_of
from service.api.schemas.beams import BeamsAnswer
from service.pipeline.carrier_model.beam_report import Group
from service.ports import LIVE, Storage
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.runtime.jobs.beam_analysis import analyse_beams

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/beams", tags=["calibration"])

#: span that is judged when no start is asked for
_DEFAULT_SPAN_US = 7 * 86_400 * US_PER_S


@router.get("")
def get_beams(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: StartParameter = None,
    stop: StopParameter = None,
    group: Annotated[Group, Query(description="Carriers that share an antenna")] = Group.BAND,
) -> BeamsAnswer:
    """Tell the boresight of each antenna by the hour, from powers and the readings of a working sensor.

    Default: the last seven days of attitude rows. Boresights are changes since the active calibration by geometry;
    the sensors are those that it was made with. Of more than 62 days, every second, third, ... day is read. Nothing is
    stored.
    """
    context.storage.catalogue.spacecraft(spacecraft_id)
    window = _closed(context.storage, spacecraft_id, start, stop)
    return BeamsAnswer.of_analysis(analyse_beams(context.storage, spacecraft_id, window, group), group)


def _closed(storage: Storage, spacecraft_id: str, start: str | None, stop: str | None) -> Window:
    """Return the span asked for, an open end at the newest row and seven days before the other."""
    window = window_of(start, stop, EVERYTHING)
    if start is not None and stop is not None:
        return window
    newest = storage.results.newest_attitude(spacecraft_id, LIVE, Method.ROBUST)
    newest_us = newest.epoch_us + 1 if newest is not None else window.start_us + 1
    stop_us = window.stop_us if stop is not None else max(newest_us, window.start_us + 1)
    start_us = window.start_us if start is not None else max(window.start_us, stop_us - _DEFAULT_SPAN_US)
    return Window(start_us, stop_us)
