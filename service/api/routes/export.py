"""Export: a stretch of the archive as one file, streamed page by page.

The first page is read before the answer starts, so what is wrong is told as a problem; afterwards pages are read and
written one at a time, and memory does not grow with the span.
"""

from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import Annotated, Literal, TypeVar

from fastapi import APIRouter, Depends, Path, Query
from fastapi.responses import StreamingResponse

from service.api.deps import ApiContext, Context, Names, SpacecraftId
from service.api.methods import check_version, wanted_method
from service.api.paging import EVERYTHING, Place, StartParameter, StopParameter, window_of
from service.errors import InvalidInputError, NotFoundError
from service.formats.csv_writer import MeasurementCsv, attitude_header, attitude_lines
from service.ports import LIVE
from service.records.attitude import AttitudeRow
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.measurement import Measurement

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/archive", tags=["export"])
R = TypeVar("R", Measurement, AttitudeRow)

OFFERED_SERIES = ("measurements", "attitude")
OFFERED_FORMATS = ("csv",)
_LATER_SERIES = ("torques", "references", "events")
_ROWS_AT_ONCE = 2000


class _Wanted:
    """What is asked for beside the series."""

    def __init__(
        self,
        start: StartParameter = None,
        stop: StopParameter = None,
        format: Literal["csv", "ndjson", "parquet", "aem", "tdm"] = "csv",  # noqa: A002 the contract's name
        method: Annotated[Method | None, Query(description="Of attitude rows")] = None,
        version: Annotated[str | None, Query(max_length=64, description="Of attitude rows")] = None,
    ) -> None:
        self.window = window_of(start, stop, EVERYTHING)
        self.format = format
        self.method = method
        self.version = version


@router.get(
    "/{series}:export",
    response_class=StreamingResponse,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}, "description": "The file"}},
)
def export(
    spacecraft_id: SpacecraftId,
    series: Annotated[str, Path(max_length=64, description="measurements or attitude")],
    wanted: Annotated[_Wanted, Depends()],
    context: Context,
    names: Names,
) -> StreamingResponse:
    """Download a stretch of the archive as a file."""
    context.storage.catalogue.spacecraft(spacecraft_id)
    _check_offered(series, wanted)
    if series == "measurements":
        label, lines = "measurements", _measurement_lines(spacecraft_id, wanted, context, names)
    else:
        label, lines = _attitude_lines(spacecraft_id, wanted, context)
    first = next(lines)
    headers = {"Content-Disposition": f'attachment; filename="{spacecraft_id}_{label}.csv"'}
    return StreamingResponse(chain((first,), lines), media_type="text/csv; charset=utf-8", headers=headers)


def _check_offered(series: str, wanted: _Wanted) -> None:
    """Refuse what this version does not write."""
    if series not in (*OFFERED_SERIES, *_LATER_SERIES):
        detail = f"no series {series[:64]!r}; this version exports {' and '.join(OFFERED_SERIES)}"
        raise NotFoundError("export.series_unknown", detail)
    if series in _LATER_SERIES:
        raise InvalidInputError("export.series", f"this version exports the series {' and '.join(OFFERED_SERIES)} only")
    if wanted.format not in OFFERED_FORMATS:
        raise InvalidInputError("export.format", f"this version writes the format {' and '.join(OFFERED_FORMATS)} only")
    if series == "measurements" and (wanted.method is not None or wanted.version is not None):
        detail = "measurements have no method and no version; leave both out"
        raise InvalidInputError("export.parameter", detail)


def _measurement_lines(spacecraft_id: str, wanted: _Wanted, context: ApiContext, names: Names) -> Iterator[bytes]:
    """Yield the file of measurements, the header with the first page."""
    archive, window = context.storage.archive, wanted.window
    plan_ids = archive.plan_ids(spacecraft_id, window)
    plans = [names.of(spacecraft_id, plan_id) for plan_id in plan_ids]
    writer = MeasurementCsv(plans, lambda plan_id: names.of(spacecraft_id, plan_id))
    pages = _pages(lambda after: archive.measurements(spacecraft_id, window, _ROWS_AT_ONCE, after))
    yield writer.header() + writer.lines(next(pages, ()))
    for page in pages:
        yield writer.lines(page)


def _attitude_lines(spacecraft_id: str, wanted: _Wanted, context: ApiContext) -> tuple[str, Iterator[bytes]]:
    """Return the name and the file of attitude rows."""
    results = context.storage.results
    method = wanted_method(spacecraft_id, context, wanted.method)
    version = wanted.version or LIVE
    check_version(results, spacecraft_id, version)

    def lines(window: Window) -> Iterator[bytes]:
        pages = _pages(
            lambda after: results.attitude_rows(spacecraft_id, version, method, window, _ROWS_AT_ONCE, after)
        )
        yield attitude_header() + attitude_lines(next(pages, ()))
        for page in pages:
            yield attitude_lines(page)

    return f"attitude_{method.value}_{version}", lines(wanted.window)


def _pages(read: Callable[[Place | None], Sequence[R]]) -> Iterator[Sequence[R]]:
    """Yield pages until one is short."""
    after: Place | None = None
    while True:
        rows = read(after)
        if rows:
            yield rows
        if len(rows) < _ROWS_AT_ONCE:
            return
        after = (rows[-1].epoch_us, rows[-1].number)
