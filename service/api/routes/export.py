"""Export: a stretch of the archive as a file, or as files day by day with a manifest."""

from collections.abc import Iterable, Iterator
from hashlib import sha256
from typing import Annotated, Any, NamedTuple
from urllib.parse import urlencode

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from service.api.context.dependencies import Context, Names, SpacecraftId
from service.api.export.export_chunks import DAY_US, Chunk, by_day
from service.api.export.export_files import MEDIA_TYPES, OFFERED, ArchiveFile, FileFormat, FileOrder, archive_file
from service.api.export.export_responses import span_label, stream_answer, whole_answer
from service.api.protocol.paging import EVERYTHING, ForwardPage, PageQuery, StartParameter, StopParameter, window_of
from service.api.schemas.archive import ManifestAnswer, PartAnswer
from service.api.schemas.base import PlanNumber, WindowAnswer
from service.records.calibration import Window
from service.records.catalogue import Method
from service.records.epoch import format_epoch

router = APIRouter(prefix="/spacecraft/{spacecraft_id}/archive", tags=["export"])

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


@router.get("/{series}:export", response_class=Response, responses=_RESPONSES)
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


@router.get("/{series}:manifest")
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
    """Return the manifest entry of a part."""
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
