"""Pages of the console: files in memory, packed once, with the headers that keep foreign code and foreign frames out.

The curves are drawn by uPlot, which a wheel of another author carries. Its two files are served only if they are those
of uPlot 1.6.31 byte for byte, and the wheel is never imported; without them the console shows tables.
"""

import gzip
import json
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from http import HTTPStatus
from importlib import metadata
from pathlib import Path
from typing import Final

from fastapi import APIRouter, FastAPI, Request, Response
from fastapi.responses import RedirectResponse
from starlette.exceptions import HTTPException

BASE_PATH = "/console/"
HEADERS: Final = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "Referrer-Policy": "no-referrer",
    # asked for again each time: after an update of the service no page is made of two versions
    "Cache-Control": "no-cache",
}
_STATIC = Path(__file__).with_name("static")
_MEDIA_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".json": "application/json",
    ".svg": "image/svg+xml",
}
_WHEEL = "youplot"
#: SHA-256 of the files of uPlot 1.6.31, by the names under which they are served
_UPLOT = {
    "uplot.js": ("uplot.iife.min.js", "2d27e8ad3d228164525ce213f9dc716f39b4e3aee0cc773fb3491c96cf4921a2"),
    "uplot.css": ("uplot.min.css", "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04"),
}
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class StaticFile:
    """One file as it is sent."""

    plain: bytes
    media_type: str
    etag: str

    @cached_property
    def packed(self) -> bytes:
        """The file packed, once somebody wants it: to pack them all takes 30 ms of a start."""
        return gzip.compress(self.plain, 9, mtime=0)

    @classmethod
    def of(cls, name: str, content: bytes) -> "StaticFile":
        """Return a file with its tag, the same at each start."""
        etag = f'W/"{sha256(content).hexdigest()[:32]}"'
        return cls(content, _MEDIA_TYPES[Path(name).suffix], etag)


def console_files() -> dict[str, StaticFile]:
    """Return the files of the console by their paths below its address, those of uPlot where they are as they must."""
    own = ((path.relative_to(_STATIC).as_posix(), _content(path)) for path in _STATIC.rglob("*") if path.is_file())
    return {name: StaticFile.of(name, content) for name, content in (*own, *_uplot_files())}


def _content(path: Path) -> bytes:
    """Return what a file is sent as: tables of words go without the blanks of their layout."""
    content = path.read_bytes()
    if path.suffix != ".json":
        return content
    return json.dumps(json.loads(content), ensure_ascii=False, separators=(",", ":")).encode()


def with_console(app: FastAPI) -> FastAPI:
    """Return an application that serves the console too."""
    app.include_router(console_router(console_files()))
    return app


def console_router(files: Mapping[str, StaticFile]) -> APIRouter:
    """Return the routes of the console, which need no key: every figure comes by the REST interface.

    Parameters
    ----------
    files : mapping of str to StaticFile
        By their paths below ``/console/``; ``index.html`` also stands at that address itself.
    """
    router = APIRouter(include_in_schema=False)

    @router.api_route("/", methods=["GET", "HEAD"])
    @router.api_route("/console", methods=["GET", "HEAD"])
    async def go_to_console() -> RedirectResponse:
        return RedirectResponse(BASE_PATH, headers=HEADERS)

    @router.api_route(f"{BASE_PATH}{{name:path}}", methods=["GET", "HEAD"])
    async def get_console_file(name: str, request: Request) -> Response:
        file = files.get(name or "index.html")
        if file is None:
            raise HTTPException(HTTPStatus.NOT_FOUND)
        return _answer(file, request)

    return router


def _answer(file: StaticFile, request: Request) -> Response:
    """Return a file, packed for who can read that, or 304 for who has it."""
    headers = {**HEADERS, "ETag": file.etag, "Vary": "Accept-Encoding"}
    known = {tag.strip() for tag in request.headers.get("if-none-match", "").split(",")}
    if known & {file.etag, "*"}:
        return Response(status_code=HTTPStatus.NOT_MODIFIED, headers=headers)
    if "gzip" not in request.headers.get("accept-encoding", ""):
        return Response(file.plain, headers=headers, media_type=file.media_type)
    return Response(file.packed, headers={**headers, "Content-Encoding": "gzip"}, media_type=file.media_type)


def _uplot_files() -> Iterator[tuple[str, bytes]]:
    """Yield the files of uPlot under the names that the console knows; none where one is missing or another."""
    try:
        listed = {path.name: path for path in metadata.files(_WHEEL) or ()}
        found = [
            (name, Path(str(listed[held].locate())).read_bytes(), digest) for name, (held, digest) in _UPLOT.items()
        ]
    except (metadata.PackageNotFoundError, KeyError, OSError) as error:
        _LOG.warning("the console draws no curves: pip install soo[console] (%s: %s)", type(error).__name__, error)
        return
    for name, content, digest in found:
        if sha256(content).hexdigest() != digest:
            _LOG.warning("the console draws no curves: %s of %s is not that of uPlot 1.6.31", name, _WHEEL)
            return
    yield from ((name, content) for name, content, _ in found)
