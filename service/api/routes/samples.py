"""Samples and gaps: long spans in a few figures, every row counted once."""

from typing import Annotated, NamedTuple

import numpy as np
from fastapi import APIRouter, Query

from service.api.context.dependencies import ApiContext, Context, Names, SpacecraftId
from service.api.context.method_parameters import StoredMethod, WantedVersion
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import EVERYTHING, StartParameter, StopParameter, window_of
from service.api.schemas.archive import (
    AttitudeSamples,
    GapAnswer,
    GapsAnswer,
    MeasurementSamples,
    SampleAnswer,
    SourceRowsAnswer,
)
from service.api.schemas.base import WindowAnswer
from service.core.rows.row_gaps import Gap, GapSearch
from service.core.rows.sample_bins import SampleBins
from service.errors import FieldError
from service.records.calibration import Window

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["archive"])

#: intervals times columns of one answer
MAX_CELLS = 500_000

CountParameter = Annotated[int, Query(ge=1, le=10_000, description="Intervals that the range is cut into")]
SourceParameter = Annotated[str | None, Query(max_length=64, description="Only rows of this source")]
CarrierParameter = Annotated[list[str] | None, Query(max_length=1000, description="Only these carriers")]


class _Asked(NamedTuple):
    """Ends of a range as they were stated."""

    start: str | None
    stop: str | None

    @property
    def window(self) -> Window:
        """The range, everything where nothing is stated."""
        return window_of(self.start, self.stop, EVERYTHING)

    def closed(self, first_us: int | None, last_us: int | None) -> Window:
        """Return the range with open ends at the first and behind the last row."""
        window = self.window
        start_us = first_us if self.start is None and first_us is not None else window.start_us
        stop_us = last_us + 1 if self.stop is None and last_us is not None else window.stop_us
        return Window(start_us, max(stop_us, start_us + 1))


@router.get("/measurements/samples")
def sample_measurements(
    spacecraft_id: SpacecraftId,
    context: Context,
    names: Names,
    start: StartParameter = None,
    stop: StopParameter = None,
    count: CountParameter = 500,
    carrier: CarrierParameter = None,
    source: SourceParameter = None,
) -> MeasurementSamples:
    """Return count, mean, least and greatest level of each carrier in intervals of equal length."""
    asked = _Asked(start, stop)
    window = asked.closed(*_measured_span(spacecraft_id, context, asked.window, source))
    archive = context.storage.archive
    plans = {plan_id: names.of(spacecraft_id, plan_id) for plan_id in archive.plan_ids(spacecraft_id, window)}
    known = dict.fromkeys(name for plan in plans.values() for name in plan)
    wanted = {name: k for k, name in enumerate(name for name in known if carrier is None or name in carrier)}
    _check_size(count, len(wanted))
    bins = SampleBins(window.start_us, window.stop_us, count, len(wanted))
    for plan_id, buckets in archive.sampled_measurements(spacecraft_id, window, bins, source):
        held = [k for k, name in enumerate(names.of(spacecraft_id, plan_id)) if name in wanted]
        columns = [wanted[names.of(spacecraft_id, plan_id)[k]] for k in held]
        bins.add_summaries(buckets.columns(np.array(held, dtype=np.int64)), np.array(columns, dtype=np.int64))
    by_carrier = {name: SampleAnswer.all_of(bins.samples(position)) for name, position in wanted.items()}
    return MeasurementSamples(range=WindowAnswer.of(window), source=source, power_dbm=by_carrier)


@router.get("/attitude/samples")
def sample_attitude(
    spacecraft_id: SpacecraftId,
    method: StoredMethod,
    version: WantedVersion,
    context: Context,
    start: StartParameter = None,
    stop: StopParameter = None,
    count: CountParameter = 500,
) -> AttitudeSamples:
    """Return count, mean, least and greatest angle of each axis in intervals of equal length."""
    asked, results = _Asked(start, stop), context.storage.results
    first = results.attitude_rows(spacecraft_id, version, method, asked.window, 1, None)
    newest = results.newest_attitude(spacecraft_id, version, method)
    window = asked.closed(first[0].epoch_us if first else None, newest.epoch_us if newest else None)
    bins = SampleBins(window.start_us, window.stop_us, count, 3)
    for buckets in results.sampled_attitude(spacecraft_id, version, method, window, bins):
        bins.add_summaries(buckets)
    yaw, roll, pitch = (SampleAnswer.all_of(bins.samples(axis)) for axis in range(3))
    return AttitudeSamples(
        range=WindowAnswer.of(window), method=method, version=version, yaw_deg=yaw, roll_deg=roll, pitch_deg=pitch
    )


@router.get("/archive/gaps")
def list_gaps(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: StartParameter = None,
    stop: StopParameter = None,
    source: SourceParameter = None,
) -> GapsAnswer:
    """List where rows are missing: of one source, or of those that feed the estimator."""
    asked, archive = _Asked(start, stop), context.storage.archive
    first_us, _ = _measured_span(spacecraft_id, context, EVERYTHING, source)
    now_us = context.clock.now_us(spacecraft_id)
    window = asked.window
    # nothing is missing before the first row of all, nor after now
    start_us = max(window.start_us, first_us or window.start_us)
    stop_us = min(window.stop_us, now_us if now_us is not None else window.stop_us)
    found: list[Gap] = []
    if first_us is not None and start_us < stop_us:
        search = GapSearch(start_us)
        blocks = archive.measurement_blocks(
            spacecraft_id, Window(start_us, window.stop_us), source=source, feeds_estimator_only=source is None
        )
        for block in blocks:
            found += search.add(block.epochs_us)
        found += search.end(stop_us)
    sources = archive.sources(spacecraft_id)
    return GapsAnswer(
        range=WindowAnswer.of(Window(start_us, max(stop_us, start_us + 1))),
        source=source,
        gaps=[GapAnswer.of(gap) for gap in found],
        sources=[SourceRowsAnswer.model_validate(each) for each in sources],
    )


def _measured_span(
    spacecraft_id: str, context: ApiContext, window: Window, source: str | None
) -> tuple[int | None, int | None]:
    """Return the epochs of the first row of a window and of the newest row of all."""
    archive = context.storage.archive
    first = archive.measurements(spacecraft_id, window, 1, None, source)
    newest = [each.newest_epoch_us for each in archive.sources(spacecraft_id) if source in {None, each.id}]
    return first[0].epoch_us if first else None, max((each for each in newest if each is not None), default=None)


def _check_size(count: int, columns: int) -> None:
    """Refuse an answer that would be too large."""
    if count * columns > MAX_CELLS:
        detail = f"{count} intervals of {columns} carriers are more than {MAX_CELLS}"
        raise invalid_request([FieldError("/query/count", "samples.count", detail)])
