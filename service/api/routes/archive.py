"""Spans of the archive: samples, gaps, timeline, files."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Annotated, Any, NamedTuple, get_args
from urllib.parse import urlencode

import numpy as np
from fastapi import APIRouter, Depends, Path, Query, Request, Response

from service.api.context import ApiContext, Context, Names, SpacecraftId, WantedVersion, check_method
from service.api.export.export_chunks import DAY_US, Chunk, by_day
from service.api.export.export_files import MEDIA_TYPES, OFFERED, ArchiveFile, FileFormat, FileOrder, archive_file
from service.api.export.export_responses import bounded_answer, span_label, stream_answer, whole_answer
from service.api.problems.problems import invalid_request
from service.api.protocol.paging import EVERYTHING, ForwardPage, PageQuery, StartParameter, StopParameter, window_of
from service.api.schemas.archive import (
    CarrierFigure,
    GapAnswer,
    GapsAnswer,
    ImpulseFigure,
    ManifestAnswer,
    PartAnswer,
    Quantity,
    SampledQuantities,
    SampledSeries,
    SeriesName,
    SourceRowsAnswer,
    TimelineAnswer,
)
from service.api.schemas.base import PlanNumber, WindowAnswer
from service.api.views.timeline import Timeline
from service.core.rows import Gap, GapSearch, SampleBins, Summaries, whole_intervals
from service.errors import FieldError
from service.ports.archive import ATTITUDE_FIGURES, LIVE, ListPart, MeasuredFigure
from service.records.calibration import Window
from service.records.catalogue import LIVE_METHODS, Method
from service.records.epoch import format_epoch
from service.records.levels.measurement import Measurement

export_router = APIRouter(prefix="/spacecraft/{spacecraft_id}/archive", tags=["export"])

_BINARY = {"schema": {"type": "string", "format": "binary"}}
_FILE = {"description": "The file", "content": {kind.partition(";")[0]: _BINARY for kind in MEDIA_TYPES.values()}}
_RESPONSES: dict[int | str, dict[str, Any]] = {200: _FILE, 206: {**_FILE, "description": "A range of the file"}}
Series = Annotated[str, Path(max_length=64, description=", ".join(OFFERED))]


class _Wanted:
    """Query parameters of an export other than series and span."""

    def __init__(
        self,
        format: Annotated[FileFormat, Query(description="aem of attitude, tdm of measurements")] = "csv",  # noqa: A002 the contract's name
        method: Annotated[
            Method | None, Query(description="Of attitude and joined; default: the one that drives control")
        ] = None,
        version: Annotated[str | None, Query(max_length=64, description="Of attitude, torques and joined")] = None,
        plan_id: Annotated[
            list[PlanNumber] | None,
            Query(
                max_length=1000,
                description="Of measurements and joined: columns of these plans come first, in any case",
            ),
        ] = None,
    ) -> None:
        self.format = format
        self.method = method
        self.version = version
        self.plan_ids = tuple(plan_id or ())

    def order(self, spacecraft_id: str, series: str, window: Window) -> FileOrder:
        """Return the order of a file."""
        return FileOrder(spacecraft_id, series, self.format, window, self.method, self.version, self.plan_ids)


@export_router.get("/{series}:export", response_class=Response, responses=_RESPONSES)
def export(
    spacecraft_id: SpacecraftId,
    series: Series,
    wanted: Annotated[_Wanted, Depends()],
    context: Context,
    names: Names,
    request: Request,
    start: StartParameter = None,
    stop: StopParameter = None,
) -> Response:
    """Download a stretch of the archive: a day or less takes byte ranges, more is streamed."""
    window = window_of(start, stop, EVERYTHING)
    file = archive_file(context, names.of, wanted.order(spacecraft_id, series, window))
    parts = file.write(file.read(window), window)
    media_type = MEDIA_TYPES[wanted.format]
    name = f"{spacecraft_id}_{file.label}_{span_label(window)}.{wanted.format}"
    if window.stop_us - window.start_us <= DAY_US:
        return whole_answer(parts, media_type, name, request)
    return stream_answer(parts, media_type, name)


@export_router.get("/{series}:manifest")
def manifest(
    spacecraft_id: SpacecraftId,
    series: Series,
    wanted: Annotated[_Wanted, Depends()],
    page: ForwardPage,
    context: Context,
    names: Names,
    request: Request,
) -> ManifestAnswer:
    """List the files of an export day by day with rows, bytes and SHA-256."""
    # the columns are those of the whole span, whatever page of it is asked for
    file = archive_file(context, names.of, wanted.order(spacecraft_id, series, page.window))
    found: list[_Part] = []
    for day_us, chunks in by_day(file.read(rest)) if (rest := _behind(page)) else ():
        if len(found) == page.limit:
            found.append(found[-1])  # the one too many tells that there is a next page
            break
        window = Window(max(day_us, page.window.start_us), min(day_us + DAY_US, page.window.stop_us))
        found.append(_part_of(file, window, chunks))
    parts, cursor = page.cut(found, lambda part: (part.window.start_us, 0))
    known = dict(file.parameters)
    now_us = context.clock.system_us()
    return ManifestAnswer(
        range=WindowAnswer.of(page.window),
        series=series,
        format=wanted.format,
        method=Method(known["method"]) if "method" in known else None,
        version=known.get("version"),
        parts=[_part_answer(part, request, wanted.format, file, now_us) for part in parts],
        next=cursor,
    )


class _Part(NamedTuple):
    """Rows, size and hash of the file of one day."""

    window: Window
    rows: int
    size: int
    sha256: str


def _behind(page: PageQuery) -> Window | None:
    """Return what is left of the span behind a cursor, which holds the start of the last day given."""
    if page.after is None:
        return page.window
    start_us = max(page.window.start_us, (page.after[0] // DAY_US + 1) * DAY_US)
    return Window(start_us, page.window.stop_us) if start_us < page.window.stop_us else None


def _part_of(file: ArchiveFile, window: Window, chunks: Iterable[Chunk]) -> _Part:
    """Write the file of one day and keep its rows, size and hash."""
    rows = 0

    def counted() -> Iterator[Chunk]:
        nonlocal rows
        for chunk in chunks:
            rows += len(chunk.epochs_us)
            yield chunk

    digest, size = sha256(), 0
    for part in file.write(counted(), window):
        digest.update(part)
        size += len(part)
    return _Part(window, rows, size, digest.hexdigest())


def _part_answer(part: _Part, request: Request, file_format: str, file: ArchiveFile, now_us: int) -> PartAnswer:
    span = [("start", format_epoch(part.window.start_us)), ("stop", format_epoch(part.window.stop_us))]
    query = urlencode([("format", file_format), *span, *file.parameters])
    return PartAnswer.model_validate(
        {
            "start": part.window.start_us,
            "stop": part.window.stop_us,
            "rows": part.rows,
            "bytes": part.size,
            "sha256": part.sha256,
            "closed": part.window.stop_us <= now_us,
            "href": f"{request.url.path.removesuffix(':manifest')}:export?{query}",
        }
    )


samples_router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["archive"])

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


@samples_router.get("/samples", response_model=SampledQuantities)
async def sample_quantities(
    spacecraft_id: SpacecraftId,
    version: WantedVersion,
    context: Context,
    names: Names,
    request: Request,
    quantity: QuantityParameter,
    method: MethodsParameter = None,
    carrier: CarrierParameter = None,
    source: SourceParameter = None,
    start: StartParameter = None,
    stop: StopParameter = None,
    count: CountParameter = 500,
    extreme_epochs: ExtremeEpochsParameter = True,  # noqa: FBT002 - a query parameter
) -> Response:
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

    def parts() -> Iterator[bytes]:
        window = _closed(context, spacecraft_id, version, (start, stop), methods, source)
        grid = _Grid(*whole_intervals(window.start_us, window.stop_us, count))
        wanted = _Request(context, names, spacecraft_id, version, quantities, methods, carrier, source, grid)
        _check_size(wanted)
        yield from _sampled(wanted, has_epochs=extreme_epochs)

    return await bounded_answer(request, request.app.state.sampling, parts, "application/json")


def _sampled(request: _Request, *, has_epochs: bool) -> Iterator[bytes]:
    """Yield the answer series by series: as objects of Python it would take ten times its arrays."""
    columns, grid = [], request.grid
    is_filled = np.zeros(grid.intervals, dtype=np.bool_)
    for family in (_of_attitude, _of_impulse, _of_carriers, _of_expected, _of_measured):
        for name, column in family(request):
            columns.append((name, column))
            is_filled |= column.counts[:, 0] > 0
            # a client that has gone is noticed here
            yield b""
    empty = SampledQuantities(
        range=WindowAnswer.of(request.window),
        interval_s=(grid.stop_us - grid.start_us) // grid.intervals // 1_000_000,
        version=request.version,
        source=request.source,
        epochs=grid.bins(1).all_intervals().first_us[is_filled].tolist(),
        series=[],
    )
    yield empty.model_dump_json().removesuffix("]}").encode()
    for position, (name, column) in enumerate(columns):
        series = SampledSeries.of_column(name, column.at(is_filled), has_epochs=has_epochs)
        yield (b"," if position else b"") + series.model_dump_json().encode()
    yield b"]}"


@samples_router.get("/archive/gaps")
def list_gaps(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: StartParameter = None,
    stop: StopParameter = None,
    source: SourceParameter = None,
) -> GapsAnswer:
    """List where rows are missing: of one source, or of those that feed the estimator."""
    archive, window = context.storage.archive, window_of(start, stop, EVERYTHING)
    first = archive.measurements(spacecraft_id, ListPart(EVERYTHING, 1), source)
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
    if window.start_us < EVERYTHING.start_us or window.stop_us > EVERYTHING.stop_us:
        pointer = "/query/start" if window.start_us < EVERYTHING.start_us else "/query/stop"
        raise invalid_request([FieldError(pointer, "epoch.range", "samples lie between the years 2000 and 2100")])
    if None not in ends:
        return window
    starts_us: list[int] = []
    stops_us: list[int] = []
    if source is None:
        firsts = [storage.results.attitude_rows(spacecraft_id, version, each, ListPart(window, 1)) for each in methods]
        newest = [storage.results.newest_attitude(spacecraft_id, version, each) for each in methods]
        starts_us += [rows[0].epoch_us for rows in firsts if rows]
        stops_us += [row.epoch_us + 1 for row in newest if row is not None]
    if version == LIVE or source is not None:
        starts_us += [row.epoch_us for row in storage.archive.measurements(spacecraft_id, ListPart(window, 1), source)]
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
    while rows := archive.measurements(
        request.spacecraft_id, ListPart(request.window, min(_PAGE_ROWS, left + 1), after)
    ):
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


timeline_router = APIRouter(prefix="/spacecraft/{spacecraft_id}", tags=["archive"])


@timeline_router.get("/timeline")
def get_timeline(
    spacecraft_id: SpacecraftId,
    context: Context,
    start: StartParameter = None,
    stop: StopParameter = None,
    method: MethodsParameter = None,
) -> TimelineAnswer:
    """Return states of the live rows as intervals, with gaps, operations, corrections, commands, alarms and notes."""
    methods = tuple(dict.fromkeys(method or LIVE_METHODS))
    for each in methods:
        check_method(each, LIVE)
    return Timeline(context, spacecraft_id, window_of(start, stop, EVERYTHING)).answer(methods)
