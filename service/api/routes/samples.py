"""Samples and gaps: long spans of quantities in a few figures, each row counted once, and where rows are missing."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, get_args

import numpy as np
from fastapi import APIRouter, Query

from service.api.context.dependencies import ApiContext, Context, Names, SpacecraftId
from service.api.context.method_parameters import WantedVersion, check_method
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import EVERYTHING, StartParameter, StopParameter, window_of
from service.api.schemas.archive import GapAnswer, GapsAnswer, SourceRowsAnswer
from service.api.schemas.base import WindowAnswer
from service.api.schemas.samples import (
    CarrierFigure,
    ImpulseFigure,
    Quantity,
    SampledQuantities,
    SampledSeries,
    SeriesName,
)
from service.core.rows.row_gaps import Gap, GapSearch
from service.core.rows.sample_bins import SampleBins, whole_intervals
from service.core.rows.summaries import Summaries
from service.errors import FieldError
from service.ports import ATTITUDE_FIGURES, LIVE, MeasuredFigure
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.levels.measurement import Measurement

router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["archive"])

#: intervals times series of one answer
MAX_CELLS = 500_000
_CARRIER_FIGURES: tuple[CarrierFigure, ...] = get_args(CarrierFigure)
_IMPULSE_FIGURES: tuple[ImpulseFigure, ...] = get_args(ImpulseFigure)
_MEASURED_FIGURES: tuple[MeasuredFigure, ...] = get_args(MeasuredFigure)
#: rows of which expected levels are computed for one answer, and how many are read at once
_EXPECTED_ROWS, _PAGE_ROWS = 20_000, 2000

QuantityParameter = Annotated[list[Quantity], Query(min_length=1, max_length=30, description="Quantities, each once")]
MethodsParameter = Annotated[list[Method] | None, Query(max_length=10, description="Default: every method")]
CarrierParameter = Annotated[list[str] | None, Query(max_length=1000, description="Only these carriers")]
CountParameter = Annotated[int, Query(ge=1, le=10_000, description="Intervals that the range is cut into")]
SourceParameter = Annotated[str | None, Query(max_length=64, description="Only rows of this source")]
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
class _Request:
    """Quantities asked for, and the intervals."""

    context: ApiContext
    names: Names
    spacecraft_id: str
    version: str
    quantities: Sequence[Quantity]
    methods: Sequence[Method]
    #: None = all
    carriers: Sequence[str] | None
    source: str | None
    grid: _Grid

    def carriers_of(self, plan_id: int) -> list[tuple[int, str]]:
        """Return the carriers of a plan that are asked for, with their position in it."""
        ids = self.names.of(self.spacecraft_id, plan_id)
        return [(k, name) for k, name in enumerate(ids) if self.carriers is None or name in self.carriers]

    def columns(self) -> dict[str, int]:
        """Return the carriers that the rows of the span have and that are asked for, with a column for each."""
        plan_ids = self.context.storage.archive.plan_ids(self.spacecraft_id, self.window)
        names = dict.fromkeys(name for plan_id in plan_ids for _, name in self.carriers_of(plan_id))
        return {name: column for column, name in enumerate(names)}

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
    source: SourceParameter = None,
    start: StartParameter = None,
    stop: StopParameter = None,
    count: CountParameter = 500,
    extreme_epochs: ExtremeEpochsParameter = True,  # noqa: FBT002 - a query parameter
) -> SampledQuantities:
    """Return count, mean, least and greatest value of quantities in at most ``count`` intervals, column by column.

    `source` is for `power_dbm` and `c_n0_db_hz`; without it they are of the rows of every source. Results are computed
    from the rows that feed the estimator, so that a source with any other quantity is refused.

    `expected_dbm` is computed from the rows (power less deviation) and of 20000 of them at most: for longer spans take
    the mean of `power_dbm` less that of `deviation_db`, which is its mean wherever both have the same `n`.
    """
    methods, quantities = tuple(dict.fromkeys(method or LIVE_METHODS)), tuple(dict.fromkeys(quantity))
    for each in methods:
        check_method(each, version)
    _check_source(source, quantities)
    window = _closed(context, spacecraft_id, version, (start, stop), methods, source)
    grid = _Grid(*whole_intervals(window.start_us, window.stop_us, count))
    request = _Request(context, names, spacecraft_id, version, quantities, methods, carrier, source, grid)
    _check_size(request)
    columns = [*_of_attitude(request), *_of_impulse(request), *_of_carriers(request), *_of_expected(request)]
    columns += _of_measured(request)
    is_filled = np.zeros(grid.intervals, dtype=np.bool_)
    for _, column in columns:
        is_filled |= column.counts[:, 0] > 0
    begins_us = grid.bins(1).all_intervals().first_us[is_filled]
    return SampledQuantities(
        range=WindowAnswer.of(request.window),
        interval_s=(grid.stop_us - grid.start_us) // grid.intervals // 1_000_000,
        version=version,
        source=source,
        epochs=begins_us.tolist(),
        series=[
            SampledSeries.of_column(name, column.at(is_filled), has_epochs=extreme_epochs) for name, column in columns
        ],
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
    archive, window = context.storage.archive, window_of(start, stop, EVERYTHING)
    first = archive.measurements(spacecraft_id, EVERYTHING, 1, None, source)
    now_us = context.clock.now_us(spacecraft_id)
    # nothing is missing before the first row of all, nor after now
    start_us = max(window.start_us, first[0].epoch_us) if first else window.start_us
    stop_us = window.stop_us if now_us is None else min(window.stop_us, now_us)
    gaps: list[Gap] = []
    if first and start_us < stop_us:
        search = GapSearch(start_us)
        blocks = archive.measurement_blocks(
            spacecraft_id, Window(start_us, window.stop_us), source=source, feeds_estimator_only=source is None
        )
        for block in blocks:
            gaps += search.add(block.epochs_us)
        gaps += search.end(stop_us)
    return GapsAnswer(
        range=WindowAnswer.of(Window(start_us, max(stop_us, start_us + 1))),
        source=source,
        gaps=[GapAnswer.of(gap) for gap in gaps],
        sources=[SourceRowsAnswer.model_validate(each) for each in archive.sources(spacecraft_id)],
    )


def _check_source(source: str | None, quantities: Sequence[Quantity]) -> None:
    """Refuse a source where a quantity is a result: it would be of other rows than those of the source."""
    results = [each for each in quantities if each not in _MEASURED_FIGURES]
    if source is not None and results:
        detail = f"{', '.join(results)}: a result has no source, powers and C/N0 have"
        raise invalid_request([FieldError("/query/source", "samples.source", detail)])


def _closed(
    context: ApiContext,
    spacecraft_id: str,
    version: str,
    ends: tuple[str | None, str | None],
    methods: Sequence[Method],
    source: str | None,
) -> Window:
    """Return the range that was asked for, open ends at the first and behind the last row."""
    storage, window = context.storage, window_of(*ends, EVERYTHING)
    if None not in ends:
        return window
    starts_us: list[int] = []
    stops_us: list[int] = []
    if source is None:
        firsts = [storage.results.attitude_rows(spacecraft_id, version, each, window, 1, None) for each in methods]
        newest = [storage.results.newest_attitude(spacecraft_id, version, each) for each in methods]
        starts_us += [rows[0].epoch_us for rows in firsts if rows]
        stops_us += [row.epoch_us + 1 for row in newest if row is not None]
    if version == LIVE or source is not None:
        starts_us += [row.epoch_us for row in storage.archive.measurements(spacecraft_id, window, 1, None, source)]
        sources = [each for each in storage.archive.sources(spacecraft_id) if source in {None, each.id}]
        stops_us += [each.newest_epoch_us + 1 for each in sources if each.newest_epoch_us is not None]
    start_us = window.start_us if ends[0] is not None else min(starts_us, default=window.start_us)
    stop_us = window.stop_us if ends[1] is not None else max(stops_us, default=start_us + 1)
    return Window(start_us, max(stop_us, start_us + 1))


def _check_size(request: _Request) -> None:
    """Refuse an answer that would be too large."""
    of_carriers = [len(request.methods) for each in request.quantities if each in {*_CARRIER_FIGURES, "expected_dbm"}]
    of_carriers += [1 for each in request.quantities if each in _MEASURED_FIGURES]
    others = len(request.quantities) - len(of_carriers)
    series = sum(of_carriers) * len(request.columns()) + others * len(request.methods)
    if request.grid.intervals * series > MAX_CELLS:
        detail = f"{request.grid.intervals} intervals of {series} series are more than {MAX_CELLS}"
        raise invalid_request([FieldError("/query/count", "samples.count", detail)])


def _of_attitude(request: _Request) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield figures of the attitude rows by method."""
    figures = [(ATTITUDE_FIGURES.index(each), each) for each in request.quantities if each in ATTITUDE_FIGURES]
    results = request.context.storage.results
    width = max((position + 1 for position, _ in figures), default=0)
    for method in request.methods if figures else ():
        bins = request.grid.bins(width)
        of = (request.spacecraft_id, request.version, method, request.window, bins, width)
        for buckets in results.sampled_attitude(*of):
            bins.add_summaries(buckets)
        yield from ((SeriesName(each, method), _column(bins, position)) for position, each in figures)


def _of_impulse(request: _Request) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield impulses of the commands."""
    figures = [(_IMPULSE_FIGURES.index(each), each) for each in request.quantities if each in _IMPULSE_FIGURES]
    if figures:
        bins, results = request.grid.bins(len(_IMPULSE_FIGURES)), request.context.storage.results
        for buckets in results.sampled_impulse(request.spacecraft_id, request.version, request.window, bins):
            bins.add_summaries(buckets)
        yield from ((SeriesName(each), _column(bins, position)) for position, each in figures)


def _of_carriers(request: _Request) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield deviations and residuals by method and carrier."""
    figures = [(_CARRIER_FIGURES.index(each), each) for each in request.quantities if each in _CARRIER_FIGURES]
    results = request.context.storage.results
    for method in request.methods if figures else ():
        of = (request.spacecraft_id, request.version, method, request.window, request.grid.bins(1))
        by_carrier: dict[str, SampleBins] = {}
        for plan_id, buckets in results.sampled_carriers(*of):
            width = buckets.counts.shape[1] // len(_CARRIER_FIGURES)
            for k, name in request.carriers_of(plan_id):
                bins = by_carrier.setdefault(name, request.grid.bins(len(_CARRIER_FIGURES)))
                bins.add_summaries(buckets.columns(np.array([k, width + k])))
        for name, bins in by_carrier.items():
            yield from ((SeriesName(each, method, name), _column(bins, position)) for position, each in figures)


def _of_expected(request: _Request) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield expected levels by method and carrier: of each row its power less its deviation.

    Extremes of a difference do not follow from those of its terms, so rows are read.
    """
    by_series: dict[tuple[Method, str], SampleBins] = {}
    for rows in _measured_pages(request) if "expected_dbm" in request.quantities else ():
        window = Window(rows[0].epoch_us, rows[-1].epoch_us + 1)
        for method in request.methods:
            of = request.context.storage.results.carrier_results(request.spacecraft_id, request.version, method, window)
            for plan_id in {row.plan_id for row in rows}:
                those = [row for row in rows if row.plan_id == plan_id and (row.epoch_us, row.number) in of]
                epochs_us = np.array([row.epoch_us for row in those], dtype=np.int64)
                levels = np.array([row.power_dbm - of[row.epoch_us, row.number].deviation_db for row in those])
                for k, name in request.carriers_of(plan_id) if those else ():
                    by_series.setdefault((method, name), request.grid.bins(1)).add(epochs_us, levels[:, k : k + 1])
    yield from ((SeriesName("expected_dbm", *of), _column(bins, 0)) for of, bins in by_series.items())


def _measured_pages(request: _Request) -> Iterator[list[Measurement]]:
    """Yield the measured rows of the span, some at a time; refuse a span that holds too many of them."""
    after, left = None, _EXPECTED_ROWS
    archive = request.context.storage.archive
    while rows := archive.measurements(request.spacecraft_id, request.window, min(_PAGE_ROWS, left + 1), after):
        left -= len(rows)
        if left < 0:
            detail = f"expected_dbm is computed from the rows, and the range holds more than {_EXPECTED_ROWS}"
            raise invalid_request([FieldError("/query/quantity", "samples.rows", detail)])
        yield rows
        after = rows[-1].epoch_us, rows[-1].number


def _of_measured(request: _Request) -> Iterator[tuple[SeriesName, Summaries]]:
    """Yield powers and C/N0 by carrier."""
    figures = [each for each in request.quantities if each in _MEASURED_FIGURES]
    columns = request.columns() if figures else {}
    for figure in figures:
        bins = request.grid.bins(len(columns))
        of = (request.spacecraft_id, request.window, bins, request.source, figure)
        for plan_id, buckets in request.context.storage.archive.sampled_measurements(*of):
            pairs = [(k, columns[name]) for k, name in request.carriers_of(plan_id) if name in columns]
            positions, into = np.array(pairs, dtype=np.int64).reshape(-1, 2).T
            bins.add_summaries(buckets.columns(positions), into)
        yield from ((SeriesName(figure, carrier=name), _column(bins, column)) for name, column in columns.items())


def _column(bins: SampleBins, position: int) -> Summaries:
    return bins.all_intervals().columns(slice(position, position + 1))
