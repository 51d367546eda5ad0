"""Samples of several quantities, methods and carriers at once, on intervals for which summaries are kept."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, get_args

import numpy as np
from fastapi import APIRouter, Query

from service.api.context.dependencies import ApiContext, Context, Names, SpacecraftId
from service.api.context.method_parameters import WantedVersion, check_method
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import EVERYTHING, StartParameter, StopParameter, window_of
from service.api.routes.samples import MAX_CELLS, CarrierParameter, CountParameter
from service.api.schemas.base import WindowAnswer
from service.api.schemas.samples import (
    CarrierFigure,
    ImpulseFigure,
    Quantity,
    SampledQuantities,
    SampledSeries,
    SeriesName,
)
from service.core.rows.sample_bins import SampleBins, whole_intervals
from service.core.rows.summaries import Summaries
from service.errors import FieldError
from service.ports import ATTITUDE_FIGURES, LIVE, MeasuredFigure
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.levels.measurement import Measurement

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["archive"])

_CARRIER_FIGURES: tuple[CarrierFigure, ...] = get_args(CarrierFigure)
_IMPULSE_FIGURES: tuple[ImpulseFigure, ...] = get_args(ImpulseFigure)
_MEASURED_FIGURES: tuple[MeasuredFigure, ...] = get_args(MeasuredFigure)
#: rows of which expected levels are computed for one answer, and how many are read at once
_EXPECTED_ROWS, _PAGE_ROWS = 20_000, 2000

QuantityParameter = Annotated[list[Quantity], Query(min_length=1, max_length=30, description="Quantities, each once")]
MethodsParameter = Annotated[list[Method] | None, Query(max_length=10, description="Default: every method")]
ExtremeEpochsParameter = Annotated[
    bool, Query(description="false: do not say when the extremes were; charts need half the bytes and the time")
]


class _Grid(NamedTuple):
    """Intervals of an answer."""

    start_us: int
    stop_us: int
    intervals: int

    def bins(self, columns: int) -> SampleBins:
        """Return empty intervals."""
        return SampleBins(self.start_us, self.stop_us, self.intervals, columns)


@dataclass(frozen=True, slots=True)
class _Asked:
    """Request: what of, and in which intervals."""

    context: ApiContext
    names: Names
    spacecraft_id: str
    version: str
    quantities: Sequence[Quantity]
    methods: Sequence[Method]
    #: None = all
    carriers: Sequence[str] | None
    grid: _Grid

    def carriers_of(self, plan_id: int) -> list[tuple[int, str]]:
        """Return the carriers of a plan that are asked for, with their position in it."""
        ids = self.names.of(self.spacecraft_id, plan_id)
        return [(k, name) for k, name in enumerate(ids) if self.carriers is None or name in self.carriers]

    @property
    def window(self) -> Window:
        """Span of all intervals."""
        return Window(self.grid.start_us, self.grid.stop_us)


@router.get("/samples")
def sample_quantities(
    spacecraft_id: SpacecraftId,
    version: WantedVersion,
    context: Context,
    names: Names,
    quantity: QuantityParameter,
    method: MethodsParameter = None,
    carrier: CarrierParameter = None,
    start: StartParameter = None,
    stop: StopParameter = None,
    count: CountParameter = 500,
    extreme_epochs: ExtremeEpochsParameter = True,  # noqa: FBT002 - a query parameter
) -> SampledQuantities:
    """Return count, mean, least and greatest value of quantities in at most ``count`` intervals, column by column.

    `expected_dbm` is computed from the rows (power less deviation) and of 20000 of them at most: for longer spans take
    the mean of `power_dbm` less that of `deviation_db`, which is its mean wherever both have the same `n`.
    """
    methods = tuple(dict.fromkeys(method or LIVE_METHODS))
    for each in methods:
        check_method(each, version)
    window = _closed(context, spacecraft_id, version, (start, stop), methods)
    grid = _Grid(*whole_intervals(window.start_us, window.stop_us, count))
    asked = _Asked(context, names, spacecraft_id, version, tuple(dict.fromkeys(quantity)), methods, carrier, grid)
    _check_size(asked)
    found = [*_of_attitude(asked), *_of_impulse(asked), *_of_carriers(asked), *_of_expected(asked)]
    found += _of_measured(asked)
    is_filled = np.zeros(grid.intervals, dtype=np.bool_)
    for _, column in found:
        is_filled |= column.counts[:, 0] > 0
    begins_us = grid.bins(1).all_intervals().first_us[is_filled]
    return SampledQuantities(
        range=WindowAnswer.of(asked.window),
        interval_s=(grid.stop_us - grid.start_us) // grid.intervals // 1_000_000,
        version=version,
        epochs=begins_us.tolist(),
        series=[
            SampledSeries.of_column(name, column.at(is_filled), has_epochs=extreme_epochs) for name, column in found
        ],
    )


def _closed(
    context: ApiContext,
    spacecraft_id: str,
    version: str,
    ends: tuple[str | None, str | None],
    methods: Sequence[Method],
) -> Window:
    """Return the range that was asked for, open ends at the first and behind the last row."""
    storage, window = context.storage, window_of(*ends, EVERYTHING)
    if None not in ends:
        return window
    firsts = [storage.results.attitude_rows(spacecraft_id, version, each, window, 1, None) for each in methods]
    newest = [storage.results.newest_attitude(spacecraft_id, version, each) for each in methods]
    starts_us = [rows[0].epoch_us for rows in firsts if rows]
    stops_us = [row.epoch_us + 1 for row in newest if row is not None]
    if version == LIVE:
        starts_us += [row.epoch_us for row in storage.archive.measurements(spacecraft_id, window, 1, None)]
        newest_us = (each.newest_epoch_us for each in storage.archive.sources(spacecraft_id))
        stops_us += [epoch_us + 1 for epoch_us in newest_us if epoch_us is not None]
    start_us = window.start_us if ends[0] is not None else min(starts_us, default=window.start_us)
    stop_us = window.stop_us if ends[1] is not None else max(stops_us, default=start_us + 1)
    return Window(start_us, max(stop_us, start_us + 1))


def _check_size(asked: _Asked) -> None:
    """Refuse an answer that would be too large."""
    plan_ids = asked.context.storage.archive.plan_ids(asked.spacecraft_id, asked.window)
    carriers = {name for plan_id in plan_ids for _, name in asked.carriers_of(plan_id)}
    of_carriers = [len(asked.methods) for each in asked.quantities if each in {*_CARRIER_FIGURES, "expected_dbm"}]
    of_carriers += [1 for each in asked.quantities if each in _MEASURED_FIGURES]
    others = len(asked.quantities) - len(of_carriers)
    series = sum(of_carriers) * len(carriers) + others * len(asked.methods)
    if asked.grid.intervals * series > MAX_CELLS:
        detail = f"{asked.grid.intervals} intervals of {series} series are more than {MAX_CELLS}"
        raise invalid_request([FieldError("/query/count", "samples.count", detail)])


def _of_attitude(asked: _Asked) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield figures of the attitude rows by method."""
    wanted = [(ATTITUDE_FIGURES.index(each), each) for each in asked.quantities if each in ATTITUDE_FIGURES]
    results = asked.context.storage.results
    figures = max((position + 1 for position, _ in wanted), default=0)
    for method in asked.methods if wanted else ():
        bins = asked.grid.bins(figures)
        of = (asked.spacecraft_id, asked.version, method, asked.window, bins, figures)
        for buckets in results.sampled_attitude(*of):
            bins.add_summaries(buckets)
        yield from ((SeriesName(each, method), _column(bins, position)) for position, each in wanted)


def _of_impulse(asked: _Asked) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield impulses of the commands."""
    wanted = [(_IMPULSE_FIGURES.index(each), each) for each in asked.quantities if each in _IMPULSE_FIGURES]
    if wanted:
        bins, results = asked.grid.bins(len(_IMPULSE_FIGURES)), asked.context.storage.results
        for buckets in results.sampled_impulse(asked.spacecraft_id, asked.version, asked.window, bins):
            bins.add_summaries(buckets)
        yield from ((SeriesName(each), _column(bins, position)) for position, each in wanted)


def _of_carriers(asked: _Asked) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield deviations and residuals by method and carrier."""
    wanted = [(_CARRIER_FIGURES.index(each), each) for each in asked.quantities if each in _CARRIER_FIGURES]
    results = asked.context.storage.results
    for method in asked.methods if wanted else ():
        of = (asked.spacecraft_id, asked.version, method, asked.window, asked.grid.bins(1))
        held: dict[str, SampleBins] = {}
        for plan_id, buckets in results.sampled_carriers(*of):
            width = buckets.counts.shape[1] // len(_CARRIER_FIGURES)
            for k, name in asked.carriers_of(plan_id):
                bins = held.setdefault(name, asked.grid.bins(len(_CARRIER_FIGURES)))
                bins.add_summaries(buckets.columns(np.array([k, width + k])))
        for name, bins in held.items():
            yield from ((SeriesName(each, method, name), _column(bins, position)) for position, each in wanted)


def _of_expected(asked: _Asked) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield expected levels by method and carrier: of each row its power less its deviation.

    Extremes of a difference do not follow from those of its terms, so rows are read.
    """
    held: dict[tuple[Method, str], SampleBins] = {}
    for rows in _measured_pages(asked) if "expected_dbm" in asked.quantities else ():
        window = Window(rows[0].epoch_us, rows[-1].epoch_us + 1)
        for method in asked.methods:
            of = asked.context.storage.results.carrier_results(asked.spacecraft_id, asked.version, method, window)
            for plan_id in {row.plan_id for row in rows}:
                those = [row for row in rows if row.plan_id == plan_id and (row.epoch_us, row.number) in of]
                epochs_us = np.array([row.epoch_us for row in those], dtype=np.int64)
                levels = np.array([row.power_dbm - of[row.epoch_us, row.number].deviation_db for row in those])
                for k, name in asked.carriers_of(plan_id) if those else ():
                    held.setdefault((method, name), asked.grid.bins(1)).add(epochs_us, levels[:, k : k + 1])
    yield from ((SeriesName("expected_dbm", *of), _column(bins, 0)) for of, bins in held.items())


def _measured_pages(asked: _Asked) -> Iterator[list[Measurement]]:
    """Yield the measured rows of the span, some at a time; refuse a span that holds too many of them."""
    after, left = None, _EXPECTED_ROWS
    archive = asked.context.storage.archive
    while rows := archive.measurements(asked.spacecraft_id, asked.window, min(_PAGE_ROWS, left + 1), after):
        left -= len(rows)
        if left < 0:
            detail = f"expected_dbm is computed from the rows, and the range holds more than {_EXPECTED_ROWS}"
            raise invalid_request([FieldError("/query/quantity", "samples.rows", detail)])
        yield rows
        after = rows[-1].epoch_us, rows[-1].number


def _of_measured(asked: _Asked) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield powers and C/N0 by carrier."""
    for figure in [each for each in asked.quantities if each in _MEASURED_FIGURES]:
        held: dict[str, SampleBins] = {}
        of = (asked.spacecraft_id, asked.window, asked.grid.bins(1), None, figure)
        for plan_id, buckets in asked.context.storage.archive.sampled_measurements(*of):
            for k, name in asked.carriers_of(plan_id):
                held.setdefault(name, asked.grid.bins(1)).add_summaries(buckets.columns(np.array([k])))
        yield from ((SeriesName(figure, carrier=name), _column(bins, 0)) for name, bins in held.items())


def _column(bins: SampleBins, position: int) -> Summaries:
    return bins.all_intervals().columns(slice(position, position + 1))
