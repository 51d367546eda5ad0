"""Parquet tables of other programs: cells as plain values, instants as text with or without their zone."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from service.formats.foreign.layout import ForeignTableError
from service.formats.foreign.text_table import TableRow

#: rows in memory at once
_BATCH_ROWS = 2000


class ParquetTable:
    """A Parquet file.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    ForeignTableError
        No Parquet file, or one that was cut off.
    """

    def __init__(self, path: Path) -> None:
        # tens of megabytes that only this format needs
        import pyarrow as pa
        import pyarrow.parquet as parquet

        self._arrow: Any = pa
        try:
            self._file: Any = parquet.ParquetFile(path)
        except (pa.ArrowInvalid, OSError) as error:
            raise ForeignTableError(f"{path.name} is no Parquet file, or is cut off: {error}") from error
        self.header = [str(name).strip() for name in self._file.schema_arrow.names]
        #: rows read
        self.done = 0
        self.total = int(self._file.metadata.num_rows)

    def rows(self) -> Iterator[TableRow]:
        """Yield the rows."""
        self.done = 0
        for batch in self._file.iter_batches(batch_size=_BATCH_ROWS):
            for cells in zip(*map(self._listed, batch.columns), strict=True):
                self.done += 1
                yield TableRow(self.done, cells)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _listed(self, column: Any) -> list[Any]:
        """Return a column as plain values; a zoned instant ends with Z, one without a zone has no offset."""
        if self._arrow.types.is_timestamp(column.type):
            zone = None if column.type.tz is None else "UTC"
            # nanoseconds beyond the microsecond are cut off
            column = column.cast(self._arrow.timestamp("us", tz=zone), safe=False).cast(self._arrow.string())
        values: list[Any] = column.to_pylist()
        return values
