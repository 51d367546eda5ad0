"""A stretch of the archive onto the disk: day by day, each day verified, going on where it was interrupted.

Examples
--------
::

    with ServiceClient("http://127.0.0.1:8000", key) as client:
        order = DownloadOrder("yamal-202", "measurements", "parquet", start, stop)
        report = download_archive(client, order, Path("november.parquet"))
    print(report["rows"], report["sha256"])

Law of this file: what stands under a final name is whole and verified. A day is taken under another name, compared with
the manifest's SHA-256 and then renamed; so is the file that is made of the days.

Files of single days made one file, format by format.
"""

import hashlib
import importlib
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

from service.client.backoff import Backoff
from service.client.problem import ClientError, ServiceUnavailableError
from service.client.service_client import ServiceClient

_COPIED_BYTES = 1 << 20


def joined(file_format: str, paths: Sequence[Path], output: Path) -> None:
    """Write the files of days, in their order, as one file that is on the disk when this returns.

    Parameters
    ----------
    file_format : str
        ``csv``, ``ndjson``, ``parquet``, ``aem`` or ``tdm``.
    paths : sequence of Path
        At least one.
    output : Path
        Written again.
    """
    if file_format == "parquet":
        _join_parquet(paths, output)
    else:
        pass_head = _HEADS[file_format]
        with output.open("wb") as target:
            for number, path in enumerate(paths):
                with path.open("rb") as day:
                    if number:
                        pass_head(day)
                    shutil.copyfileobj(day, target, _COPIED_BYTES)
    with output.open("rb") as file:
        os.fsync(file.fileno())


def _pass_line(day: IO[bytes]) -> None:
    """Pass over the header line."""
    day.readline()


def _pass_header(day: IO[bytes]) -> None:
    """Pass over what stands before the first segment of a message."""
    while line := day.readline():
        if line.strip() == b"META_START":
            day.seek(-len(line), os.SEEK_CUR)
            return


def _pass_nothing(_: IO[bytes]) -> None:
    """Begin at the beginning."""


_HEADS: dict[str, Callable[[IO[bytes]], None]] = {
    "csv": _pass_line,
    "ndjson": _pass_nothing,
    "aem": _pass_header,
    "tdm": _pass_header,
}


def _join_parquet(paths: Sequence[Path], output: Path) -> None:
    """Write the groups of rows of every file, one in memory at a time."""
    # tens of megabytes that only this format needs
    parquet: Any = importlib.import_module("pyarrow.parquet")
    schema = parquet.read_schema(paths[0])
    with parquet.ParquetWriter(output, schema, compression="zstd") as writer:
        for path in paths:
            with parquet.ParquetFile(path) as day:
                for group in range(day.num_row_groups):
                    writer.write_table(day.read_row_group(group).cast(schema))


#: days of one page of the manifest
_PAGE_DAYS = 7


class DownloadError(ClientError):
    """The files cannot be downloaded as the manifest lists them."""


@dataclass(frozen=True, slots=True)
class DownloadOrder:
    """Order of a download: spacecraft, series, format and window."""

    spacecraft_id: str
    series: str
    file_format: str
    #: RFC 3339
    start: str
    stop: str
    method: str | None = None
    version: str | None = None
    #: longest wait for a service that does not answer, s
    patience_s: float = 600.0

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters of the query."""
        return {
            "format": self.file_format,
            "start": self.start,
            "stop": self.stop,
            "method": self.method,
            "version": self.version,
        }


class DownloadProgress(NamedTuple):
    """Progress of a download."""

    #: end of the newest day that is there, RFC 3339
    until: str
    rows: int
    size: int


class _Day(NamedTuple):
    """One day of the manifest."""

    path: Path
    href: str
    rows: int
    size: int
    sha256: str
    until: str


def download_archive(
    client: ServiceClient,
    order: DownloadOrder,
    output: Path,
    *,
    keeps_days: bool = False,
    on_progress: Callable[[DownloadProgress], None] = lambda _: None,
) -> dict[str, Any]:
    """Write a stretch of the archive to a file, or its days to a folder, and return what there is.

    Parameters
    ----------
    client : ServiceClient
        To the service.
    order : DownloadOrder
        What is wanted.
    output : Path
        File, or with ``keeps_days`` folder.
    keeps_days : bool
        Keep one file a day instead of joining them.
    on_progress : callable
        Told after every day.

    Raises
    ------
    DownloadError
        The archive changes faster than it can be read.
    ServiceUnavailableError
        The service did not answer for longer than the patience; the next call goes on.
    ProblemError
        The service refuses.
    """
    folder = output if keeps_days else output.with_name(output.name + ".days")
    folder.mkdir(parents=True, exist_ok=True)
    download = _Download(client, order, folder)
    days: list[_Day] = []
    for day in download.days():
        download.fetch(day)
        days.append(day)
        on_progress(DownloadProgress(day.until, sum(each.rows for each in days), sum(each.size for each in days)))
    report: dict[str, Any] = {"rows": sum(day.rows for day in days), "days": len(days)}
    if keeps_days:
        return report | {"folder": str(output), "bytes": sum(day.size for day in days)}
    new = output.with_name(output.name + ".new")
    if days:
        joined(order.file_format, [day.path for day in days], new)
    else:
        download.stream(new)
    digest = sha256_of(new)
    new.replace(output)
    shutil.rmtree(folder)
    return report | {"file": str(output), "bytes": output.stat().st_size, "sha256": digest}


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class _Download:
    """Takes the days of one order; see `download_archive`."""

    def __init__(self, client: ServiceClient, order: DownloadOrder, folder: Path) -> None:
        self._client = client
        self._order = order
        self._folder = folder
        self._path = f"/spacecraft/{order.spacecraft_id}/archive/{order.series}"

    def days(self) -> Iterator[_Day]:
        """Yield the days of the manifest, page by page."""
        params: dict[str, Any] = {**self._order.parameters, "limit": _PAGE_DAYS}
        while True:
            page = self._patiently(lambda: self._client.request("GET", f"{self._path}:manifest", params=params))
            yield from map(self._day, page["parts"])
            if page["next"] is None:
                return
            params["cursor"] = page["next"]

    def fetch(self, day: _Day) -> None:
        """Take the file of a day unless it is there already."""
        if day.path.exists() and sha256_of(day.path) == day.sha256:
            return
        part = day.path.with_name(day.path.name + ".part")
        for _ in range(2):
            self._patiently(lambda: self._go_on(day, part))
            if sha256_of(part) == day.sha256:
                part.replace(day.path)
                return
            # what was there before is of other content: once more from the beginning
            part.unlink()
        raise DownloadError(f"{day.path.name} is not what the manifest says: rows of that day came late; run again")

    def stream(self, path: Path) -> None:
        """Take the whole as it streams: a span without rows, whose file is only its head."""
        with path.open("wb") as file:
            file.writelines(self._client.download(f"{self._path}:export", self._order.parameters))

    def _go_on(self, day: _Day, part: Path) -> None:
        """Download the missing part of a day's file."""
        there = part.stat().st_size if part.exists() else 0
        if 0 < day.size <= there:
            return
        headers = {"Accept-Encoding": "identity"}
        if there:
            headers |= {"Range": f"bytes={there}-", "If-Range": f'"{day.sha256}"'}
        with part.open("ab") as file:

            def begin(status: int) -> None:
                # the whole instead of the range: what is there is of no use
                if status != 206:
                    file.truncate(0)

            file.writelines(self._client.download(day.href, headers=headers, on_status=begin))
            file.flush()
            os.fsync(file.fileno())

    def _patiently(self, attempt: Callable[[], Any]) -> Any:
        """Return the result of an attempt, retried while the service does not answer."""
        backoff, deadline_s = Backoff(), time.monotonic() + self._order.patience_s
        while True:
            try:
                return attempt()
            except ServiceUnavailableError as error:
                wait_s = max(backoff.next_s(), error.retry_after_s or 0.0)
                if time.monotonic() + wait_s > deadline_s:
                    raise
                time.sleep(wait_s)

    def _day(self, part: dict[str, Any]) -> _Day:
        name = f"{self._order.series}_{part['start'][:10]}.{self._order.file_format}"
        href = self._path + part["href"].rpartition(f"/archive/{self._order.series}")[2]
        return _Day(self._folder / name, href, part["rows"], part["bytes"], part["sha256"], part["stop"])
