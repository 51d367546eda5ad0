"""A table of another program as an archive to send, under a layout that was stated or proven."""

import sqlite3
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, Protocol

from service.formats.foreign.layout import ForeignCellError, ForeignTableError, LevelCell, TableLayout, TableRowReader
from service.formats.foreign.parquet_table import ParquetTable
from service.formats.foreign.proposal import Sample
from service.formats.foreign.text_table import SAMPLE_LINES, TableRow, TextTable
from service.frontend.backfill.columns import ArchiveError
from service.frontend.backfill.reader import FileRow


class ForeignTable(Protocol):
    """A table that can be read again from its beginning."""

    header: list[str]
    #: read so far: bytes of a text file, rows of a Parquet file
    done: int

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows from the first."""


class _OpenTable:
    """A foreign file that is open."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO | None = None
        self._parquet: ParquetTable | None = None
        try:
            if path.suffix.lower() == ".parquet":
                self._parquet = ParquetTable(path)
                self.table: ForeignTable = self._parquet
                self.total = self._parquet.total
            else:
                self.total = path.stat().st_size
                self._file = path.open("rb")
                self.table = TextTable(self._file)
        except ForeignTableError as error:
            self.close()
            raise ArchiveError(f"{path}: {error}") from error
        except OSError as error:
            self.close()
            raise ArchiveError(f"{path}: {error.strerror or error}") from error

    def close(self) -> None:
        """Close the file."""
        for each in (self._file, self._parquet):
            if each is not None:
                each.close()


def sample_of(path: Path) -> Sample:
    """Return the header and the first rows of a foreign file; ArchiveError when it is no table."""
    opened = _OpenTable(path)
    try:
        rows = islice(opened.table.rows(), SAMPLE_LINES)
        return Sample(opened.table.header, [row.cells for row in rows if row.fault is None])
    except ForeignTableError as error:
        raise ArchiveError(f"{path}: {error}") from error
    finally:
        opened.close()


def table_rows(path: Path) -> Iterator[TableRow]:
    """Yield the rows of a foreign file; ArchiveError when it is no table."""
    opened = _OpenTable(path)
    try:
        yield from opened.table.rows()
    except ForeignTableError as error:
        raise ArchiveError(f"{path}: {error}") from error
    finally:
        opened.close()


class ForeignArchive:
    """A foreign file under a layout; rows come with microseconds UTC and levels in dBm.

    A long table is put together by epoch in a temporary database on disk; other tables are read row by row.

    Parameters
    ----------
    path : Path
        The file.
    layout : TableLayout
        What its columns hold.

    Raises
    ------
    ArchiveError
        The file cannot be read as a table.
    """

    def __init__(self, path: Path, layout: TableLayout) -> None:
        self._path = path
        self._opened = _OpenTable(path)
        self._is_long = layout.carrier_column is not None
        try:
            self._reader = TableRowReader(self._opened.table.header, layout)
        except ForeignTableError as error:
            self.close()
            raise ArchiveError(f"{path}: {error}") from error
        self._carriers = list(dict.fromkeys(layout.carriers.values()))
        used = {*layout.time_columns, *layout.units, layout.carrier_column, "epoch", "source"}
        # what the layout leaves out stands in the header, so that the report names it
        self._left_out = [k for k, name in enumerate(self._opened.table.header) if name not in used]
        left_out = [self._opened.table.header[k] for k in self._left_out]
        self.header = ["epoch", *(f"{carrier}_dbm" for carrier in self._carriers), *left_out]
        self.total = self._opened.total

    @property
    def done(self) -> int:
        """Bytes of a text file, or rows of a Parquet file, that were read."""
        return self._opened.table.done

    def rows(self) -> Iterator[FileRow]:
        """Yield the rows: of a wide table in its order, of a long one in order of epoch, unreadable lines first."""
        try:
            yield from self._long_rows() if self._is_long else map(self._wide_row, self._opened.table.rows())
        except ForeignTableError as error:
            raise ArchiveError(f"{self._path}: {error}") from error

    def close(self) -> None:
        """Close the file."""
        self._opened.close()

    def _wide_row(self, row: TableRow) -> FileRow:
        """Return one row of a wide table."""
        if row.fault is not None:
            return self._unreadable(row, row.fault)
        try:
            epoch_us = self._reader.epoch_us(row.cells)
            levels = [self._reader.level_dbm(row.cells, column) for column in self._reader.levels]
        except ForeignCellError as error:
            return self._unreadable(row, error.kind, str(error))
        return FileRow(row.line, [epoch_us, *levels, *(row.cells[k] for k in self._left_out)])

    def _long_rows(self) -> Iterator[FileRow]:
        """Yield the rows of a long table."""
        with TemporaryDirectory(prefix="soo-send-") as folder:
            database = sqlite3.connect(Path(folder) / "levels.db")
            try:
                yield from self._loaded(database)
                yield from self._gathered(database)
            finally:
                database.close()

    def _loaded(self, database: sqlite3.Connection) -> Iterator[FileRow]:
        """Write all levels into the database; yield the lines that cannot be read."""
        database.executescript("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")
        database.execute(
            "CREATE TABLE level (epoch_us INTEGER, carrier TEXT, dbm REAL, line INTEGER,"
            " PRIMARY KEY (epoch_us, carrier)) WITHOUT ROWID"
        )
        column = self._reader.levels[0]
        for row in self._opened.table.rows():
            if row.fault is not None:
                yield self._unreadable(row, row.fault)
                continue
            try:
                self._load(database, row, column)
            except ForeignCellError as error:
                yield self._unreadable(row, error.kind, str(error))

    def _load(self, database: sqlite3.Connection, row: TableRow, column: LevelCell) -> None:
        """Write one level; a carrier that is not of the layout is left out."""
        carrier = self._reader.carrier(row.cells)
        if carrier is None:
            return
        level = (self._reader.epoch_us(row.cells), carrier, self._reader.level_dbm(row.cells, column), row.line)
        if database.execute("INSERT OR IGNORE INTO level VALUES (?, ?, ?, ?)", level).rowcount == 0:
            raise ForeignCellError("second level of one carrier at one epoch", carrier)

    def _gathered(self, database: sqlite3.Connection) -> Iterator[FileRow]:
        """Yield a row for each epoch."""
        epoch_us, line, levels = None, 0, dict[str, float | None]()
        for found_us, carrier, dbm, number in database.execute("SELECT * FROM level ORDER BY epoch_us"):
            if epoch_us is not None and found_us != epoch_us:
                yield self._row_of(epoch_us, line, levels)
                levels = {}
            epoch_us, line = found_us, number
            levels[carrier] = dbm
        if epoch_us is not None:
            yield self._row_of(epoch_us, line, levels)

    def _row_of(self, epoch_us: int, line: int, levels: Mapping[str, float | None]) -> FileRow:
        """Return the row of one epoch."""
        return FileRow(line, [epoch_us, *map(levels.get, self._carriers), *([None] * len(self._left_out))])

    def _unreadable(self, row: TableRow, kind: str, detail: str | None = None) -> FileRow:
        """Return a row that cannot be read, its cells under our header as far as they are understood."""
        cells: list[Any] = list(row.cells)
        if len(cells) == len(self._opened.table.header):
            carrier = self._reader.carrier(cells) if self._is_long else None
            levels = [self._level_or_text(cells, column) for column in self._reader.levels]
            named = [levels[0] if name == carrier else None for name in self._carriers] if self._is_long else levels
            cells = [self._reader.epoch_text(cells), *named, *(cells[k] for k in self._left_out)]
        return FileRow(row.line, cells, kind, detail or kind)

    def _level_or_text(self, cells: list[Any], column: LevelCell) -> Any:
        """Return a level in dBm, or the cell itself where it is none."""
        try:
            return self._reader.level_dbm(cells, column)
        except ForeignCellError:
            return cells[column.position]
