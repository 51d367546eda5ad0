"""An archive's file, read row by row: CSV and NDJSON with the standard library, Parquet with pyarrow.

Memory holds one row of a text file or one piece of a Parquet file, however long the file is.
"""

import csv
import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from service.frontend.backfill.columns import ArchiveError
from service.records.csv_guard import unguarded

#: rows of a Parquet file in memory at once
_PARQUET_ROWS = 2000


class FileRow(NamedTuple):
    """One row as the file has it."""

    #: line of a text file, row of a Parquet file; the first line is 1
    line: int
    cells: list[Any]
    #: why the reader cannot understand the row, equal for all rows of the same fault, and in full; None: it can
    fault: str | None = None
    detail: str = ""


class ArchiveFileReader(Protocol):
    """A file that is read once from its beginning."""

    header: list[str]
    #: bytes or rows that there are
    total: int

    @property
    def done(self) -> int:
        """Bytes or rows that were read."""

    def rows(self) -> Iterator[FileRow]:
        """Yield the rows in the order of the file."""

    def close(self) -> None:
        """Close the file."""


def open_archive(path: Path) -> ArchiveFileReader:
    """Return a file by the ending of its name; ArchiveError when it cannot be read as that."""
    try:
        return _ARCHIVES.get(path.suffix.lower(), CsvArchive)(path)
    except OSError as error:
        raise ArchiveError(f"{path}: {error.strerror or error}") from error


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class CsvArchive:
    """A CSV file, RFC 4180, UTF-8; separated by semicolons when its header has them and no comma.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.done = 0
        self.total = path.stat().st_size
        self._line = 0
        self._file = path.open("rb")
        try:
            first = next(self._texts(), "").removeprefix("\ufeff")
        except BaseException:
            self._file.close()
            raise
        self._separator = ";" if ";" in first and "," not in first else ","
        self.header = list(map(unguarded, next(csv.reader([first], delimiter=self._separator), [])))

    def rows(self) -> Iterator[FileRow]:
        """Yield the rows; empty lines are none."""
        reader = csv.reader(self._texts(), delimiter=self._separator)
        try:
            for cells in reader:
                if cells:
                    has_guard = "'" in "".join(cells)
                    yield FileRow(self._line, list(map(unguarded, cells)) if has_guard else cells)
        except csv.Error as error:
            raise ArchiveError(f"line {self._line}: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _texts(self) -> Iterator[str]:
        """Yield lines as text and count what was read."""
        for raw in self._file:
            self.done += len(raw)
            self._line += 1
            try:
                yield raw.decode()
            except UnicodeDecodeError as error:
                raise ArchiveError(f"line {self._line} is not UTF-8: {error.reason}") from error


class NdjsonArchive:
    """One JSON object a line, all with the names of the first.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self.done = 0
        self.total = path.stat().st_size
        self._path = path
        with path.open("rb") as file:
            first = next((line for line in file if line.strip()), b"{}")
        self.header = list(_json_row(first, 1))

    def rows(self) -> Iterator[FileRow]:
        """Yield the rows; empty lines are none."""
        names = set(self.header)
        with self._path.open("rb") as file:
            for number, line in enumerate(file, start=1):
                self.done += len(line)
                if not line.strip():
                    continue
                row = _json_row(line, number)
                if set(row) != names:
                    odd = ", ".join(sorted(names ^ set(row))[:5])
                    raise ArchiveError(f"line {number} has other names than the first: {odd}")
                yield FileRow(number, [row[name] for name in self.header])

    def close(self) -> None:
        """Nothing stays open."""


def _json_row(line: bytes, number: int) -> dict[str, Any]:
    """Return the object of a line."""
    try:
        row = json.loads(line)
    except ValueError as error:
        raise ArchiveError(f"line {number} is no JSON: {error}") from error
    if not isinstance(row, dict):
        raise ArchiveError(f"line {number} is no JSON object")
    return row


class ParquetArchive:
    """A Parquet file; epochs as text, as int64 microseconds, or as instants with a time zone.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    ArchiveError
        No Parquet, or instants without a time zone.
    """

    def __init__(self, path: Path) -> None:
        # a second to import, tens of megabytes; only this format needs it
        import pyarrow as pa
        import pyarrow.parquet as parquet

        self._arrow: Any = pa
        try:
            self._file: Any = parquet.ParquetFile(path)
        except pa.ArrowInvalid as error:
            raise ArchiveError(f"{path} is no Parquet file: {error}") from error
        self.header = list(self._file.schema_arrow.names)
        self.done = 0
        self.total = int(self._file.metadata.num_rows)

    def rows(self) -> Iterator[FileRow]:
        """Yield the rows."""
        for chunk in self._file.iter_batches(batch_size=_PARQUET_ROWS):
            columns = [self._listed(name, column) for name, column in zip(self.header, chunk.columns, strict=True)]
            for cells in zip(*columns, strict=True):
                self.done += 1
                yield FileRow(self.done, list(cells))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _listed(self, name: str, column: Any) -> list[Any]:
        """Return a column as plain values; instants as microseconds."""
        if self._arrow.types.is_timestamp(column.type):
            if column.type.tz is None:
                raise ArchiveError(f"column {name} has instants without a time zone; write them as UTC, or state --tz")
            # nanoseconds beyond the microsecond are cut off
            column = column.cast(self._arrow.timestamp("us", tz="UTC"), safe=False).cast("int64")
        values: list[Any] = column.to_pylist()
        return values


#: ending of a name -> what reads it; CSV any other
_ARCHIVES: dict[str, Callable[[Path], ArchiveFileReader]] = {
    ".parquet": ParquetArchive,
    ".ndjson": NdjsonArchive,
    ".jsonl": NdjsonArchive,
}
