"""Files of the archive as answers: a day or less as a whole with length, digest and byte ranges, more as a stream."""

import asyncio
from collections.abc import Callable, Iterable, Iterator
from hashlib import sha256
from http import HTTPStatus
from tempfile import SpooledTemporaryFile
from threading import Event
from typing import IO

from fastapi import Request
from fastapi.responses import Response, StreamingResponse
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from service.api.problems.problems import RequestProblemError
from service.api.protocol.paging import EVERYTHING
from service.api.protocol.requests import UnsatisfiableRangeError, wanted_range
from service.records.calibration import Window
from service.records.epoch import DAY_US, format_epoch

#: a file up to this size waits in memory, a greater one on the disk
_HELD_BYTES = 8 * 1024 * 1024
#: pieces are gathered to this size before they go out
_CHUNK_BYTES = 256 * 1024


def gathered(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """Yield the same bytes in pieces that are worth sending."""
    held: list[bytes] = []
    size = 0
    for chunk in chunks:
        held.append(chunk)
        size += len(chunk)
        if size >= _CHUNK_BYTES:
            yield b"".join(held)
            held, size = [], 0
    if held:
        yield b"".join(held)


def span_label(window: Window) -> str:
    """Return a span as a part of a file's name: its day, or both ends; an open end is `begin` or `end`.

    Examples
    --------
    >>> from service.records.epoch import parse_epoch
    >>> span_label(Window(parse_epoch("2026-11-21T00:00:00Z"), parse_epoch("2026-11-22T00:00:00Z")))
    '2026-11-21'
    >>> span_label(Window(parse_epoch("2026-11-21T03:02:00.5Z"), EVERYTHING.stop_us))
    '20261121T030200.500000Z_end'
    """
    if window.start_us % DAY_US == 0 and window.stop_us - window.start_us == DAY_US:
        return format_epoch(window.start_us)[:10]
    start, stop = (
        format_epoch(end_us).replace("-", "").replace(":", "").replace(".000000", "")
        for end_us in (window.start_us, window.stop_us)
    )
    start = "begin" if window.start_us == EVERYTHING.start_us else start
    return f"{start}_{'end' if window.stop_us == EVERYTHING.stop_us else stop}"


def stream_answer(chunks: Iterable[bytes], media_type: str, name: str) -> Response:
    """Return an answer without a length; its first piece is made before it starts, so that faults are problems."""
    rest = gathered(chunks)
    first = next(rest, b"")

    def body() -> Iterator[bytes]:
        yield first
        yield from rest

    headers = {"Content-Disposition": _disposition(name), "Accept-Ranges": "none"}
    return StreamingResponse(body(), media_type=media_type, headers=headers)


def whole_answer(chunks: Iterable[bytes], media_type: str, name: str, request: Request) -> Response:
    """Return an answer of known length with an entity tag, or the range of it that is wanted.

    Raises
    ------
    RequestProblemError
        416 ``range.unsatisfiable``.
    """
    file: IO[bytes] = SpooledTemporaryFile(max_size=_HELD_BYTES)  # noqa: SIM115 closed when it has been sent
    digest = sha256()
    for chunk in chunks:
        digest.update(chunk)
        file.write(chunk)
    size, tag = file.tell(), f'"{digest.hexdigest()}"'
    try:
        part = _wanted_part(request, tag, size)
    except RequestProblemError:
        file.close()
        raise
    first, last = part or (0, size - 1)
    packs = part is None and "gzip" in request.headers.get("accept-encoding", "")
    headers = {
        "Content-Disposition": _disposition(name),
        "Content-Length": str(last - first + 1),
        "Accept-Ranges": "bytes",
        # what is packed on its way is another representation; only the plain bytes have ranges
        "ETag": f"W/{tag}" if packs else tag,
        "Cache-Control": "no-cache",
    }
    if part is not None:
        headers["Content-Range"] = f"bytes {first}-{last}/{size}"
    status = HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT
    return StreamingResponse(_slice(file, first, last), status, headers, media_type)


async def bounded_answer(
    request: Request, places: asyncio.Semaphore, parts: Callable[[], Iterable[bytes]], media_type: str
) -> Response:
    """Return an answer that is made while it has a place, and sent from a file afterwards, however slowly it is read.

    A client that goes, while it waits or while its answer is made, ends it; what the parts raise is raised.
    """
    is_gone = Event()
    leaving = asyncio.ensure_future(_left(request))
    leaving.add_done_callback(lambda _: is_gone.set())
    try:
        async with places:
            file = await run_in_threadpool(_spooled, parts, is_gone)
    finally:
        leaving.cancel()
    size = file.tell()
    return StreamingResponse(_slice(file, 0, size - 1), headers={"Content-Length": str(size)}, media_type=media_type)


async def _left(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


def _spooled(parts: Callable[[], Iterable[bytes]], is_gone: Event) -> IO[bytes]:
    """Return a file with all parts, on the disk where they are many; ClientDisconnect once the client has gone."""
    file: IO[bytes] = SpooledTemporaryFile(max_size=_CHUNK_BYTES)  # noqa: SIM115 closed when it has been sent
    try:
        _check_present(is_gone)
        for part in parts():
            _check_present(is_gone)
            file.write(part)
    except BaseException:
        file.close()
        raise
    return file


def _check_present(is_gone: Event) -> None:
    if is_gone.is_set():
        raise ClientDisconnect


def _wanted_part(request: Request, tag: str, size: int) -> tuple[int, int] | None:
    """Return the range that is wanted of a file that is still the one the client knows."""
    known = request.headers.get("if-range")
    if known is not None and known != tag:
        return None
    try:
        return wanted_range(request.headers.get("range"), size)
    except UnsatisfiableRangeError:
        raise RequestProblemError(
            HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE,
            "range.unsatisfiable",
            f"the file has {size} bytes",
            headers={"Content-Range": f"bytes */{size}"},
        ) from None


def _slice(file: IO[bytes], first: int, last: int) -> Iterator[bytes]:
    """Yield bytes of a file and close it."""
    with file:
        file.seek(first)
        left = last - first + 1
        while left > 0 and (chunk := file.read(min(_CHUNK_BYTES, left))):
            left -= len(chunk)
            yield chunk


def _disposition(name: str) -> str:
    return f'attachment; filename="{name}"'
