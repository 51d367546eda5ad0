"""Measurements as files by columns: CSV, NDJSON and Parquet; bytes out, block by block.

Columns: epoch, source, then ``<carrier id>_dbm`` for the carriers of all plans that occur, in the order in which ids
first appear. A carrier that a plan does not hold is absent, as is a level that was not measured. What is written reads
back to the stored float32 bit for bit. Memory is that of one block.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from service.formats.numbers import csv_field
from service.formats.tabular.parquet_stream import GROUP_ROWS, ParquetStream
from service.records.csv_guard import guarded
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Float32Array, MeasurementBlock


class MeasurementColumns:
    """Columns of a file and the position of each plan's levels among them.

    Parameters
    ----------
    plans : sequence of sequences of str
        Carrier ids of every plan that occurs.
    carriers_of : callable
        Gives the carrier ids of a plan by its number.
    """

    def __init__(self, plans: Sequence[Sequence[str]], carriers_of: Callable[[int], Sequence[str]]) -> None:
        self.carriers = tuple(dict.fromkeys(name for plan in plans for name in plan))
        self._carriers_of = carriers_of
        self._positions: dict[int, IntArray | None] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all columns."""
        return ("epoch", "source", *(f"{name}_dbm" for name in self.carriers))

    def values(self, block: MeasurementBlock) -> Float32Array:
        """Return the levels of a block by column, shape (T, columns); NaN = absent."""
        positions = self.positions_of(block.plan_id)
        if positions is None:
            return block.power_dbm
        values = np.full((len(block.epochs_us), len(self.carriers)), np.nan, dtype=np.float32)
        values[:, positions] = block.power_dbm
        return values

    def positions_of(self, plan_id: int) -> IntArray | None:
        """Return the column of each level of a plan; None where the plan is the columns themselves."""
        if plan_id not in self._positions:
            carriers = tuple(self._carriers_of(plan_id))
            column = {name: k for k, name in enumerate(self.carriers)}
            is_whole = carriers == self.carriers
            self._positions[plan_id] = (
                None if is_whole else np.array([column[name] for name in carriers], dtype=np.int64)
            )
        return self._positions[plan_id]


class MeasurementFile(Protocol):
    """Writer of one file."""

    def begin(self) -> bytes:
        """Return what stands before the first row."""

    def rows(self, block: MeasurementBlock) -> bytes:
        """Return what a block adds; may be empty when it is held back."""

    def end(self) -> bytes:
        """Return what stands after the last row."""


def file_bytes(file: MeasurementFile, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
    """Yield a whole file, piece by piece; empty pieces are left out."""
    if start := file.begin():
        yield start
    for block in blocks:
        if chunk := file.rows(block):
            yield chunk
    if end := file.end():
        yield end


class TextFile:
    """Rows as lines of text: epoch, source, levels with the fewest digits that read back, between fixed pieces.

    Parameters
    ----------
    columns : MeasurementColumns
        Columns of the file.
    header : bytes
        Text before the first row.
    before, after : str
        Text before the epoch and behind the last level of a row.
    source_text : callable
        Text between epoch and levels, of the name of a source.
    leads : sequence of str
        Text before each level.
    absent : str
        Text in place of an absent level.
    """

    def __init__(
        self,
        columns: MeasurementColumns,
        header: bytes,
        before: str,
        source_text: Callable[[str], str],
        leads: Sequence[str],
        absent: str,
        after: str,
    ) -> None:
        self._columns = columns
        self._header = header
        self._before, self._after = before, after
        self._source_text, self._leads, self._absent = source_text, leads, absent

    def begin(self) -> bytes:
        """Return the header."""
        return self._header

    def rows(self, block: MeasurementBlock) -> bytes:
        """Return one line a row."""
        # 90 ms that only files need
        import pyarrow as pa
        from pyarrow import compute

        epochs = compute.strftime(pa.array(block.epochs_us).cast(pa.timestamp("us")), format="%Y-%m-%dT%H:%M:%SZ")
        positions = np.zeros(len(epochs), np.int64) if block.source_positions is None else block.source_positions
        pieces = [self._before, epochs, pa.array(map(self._source_text, block.sources)).take(pa.array(positions))]
        for lead, level_dbm in zip(self._leads, self._columns.values(block).T, strict=True):
            pieces += [lead, pa.array(level_dbm, from_pandas=True).cast(pa.string())]
        lines = compute.binary_join_element_wise(
            *pieces, self._after, "", null_handling="replace", null_replacement=self._absent
        )
        _, ends, text = lines.buffers()
        return bytes(memoryview(text)[: np.frombuffer(ends, np.int32)[len(lines)]])

    def end(self) -> bytes:
        """Return nothing."""
        return b""


def csv_file(columns: MeasurementColumns) -> TextFile:
    """Return the writer of CSV by RFC 4180, empty cells for what is absent."""
    header = ",".join(csv_field(guarded(name)) for name in columns.names).encode() + b"\r\n"
    leads = [","] * len(columns.carriers)
    return TextFile(columns, header, "", lambda source: "," + csv_field(guarded(source)), leads, "", "\r\n")


def ndjson_file(columns: MeasurementColumns) -> TextFile:
    """Return the writer of one JSON object a line, null for what is absent."""
    leads = [f",{json.dumps(name)}:" for name in columns.names[2:]]
    return TextFile(columns, b"", '{"epoch":"', lambda source: f'","source":{json.dumps(source)}', leads, "null", "}\n")


class ParquetFile:
    """Parquet: timestamps in UTC, float32 levels, null for what is absent; zstd.

    Blocks are held until they make a group of rows: how rows came leaves no trace in the file, and each array that
    pyarrow makes costs a turn at Python's lock, which the reader of the next blocks wants too.
    """

    def __init__(self, columns: MeasurementColumns) -> None:
        # 90 ms that only Parquet needs
        import pyarrow as pa

        self._columns = columns
        self._pa: Any = pa
        fields = [pa.field("epoch", pa.timestamp("us", tz="UTC"), nullable=False)]
        fields.append(pa.field("source", pa.dictionary(pa.int32(), pa.string()), nullable=False))
        fields += [pa.field(name, pa.float32()) for name in columns.names[2:]]
        self._schema: Any = pa.schema(fields)
        self._stream = ParquetStream(self._schema, ("source",))
        self._held: list[MeasurementBlock] = []
        self._held_rows = 0

    def begin(self) -> bytes:
        """Return the mark of the format."""
        return self._stream.taken()

    def rows(self, block: MeasurementBlock) -> bytes:
        """Return the groups of rows that a block completes."""
        self._held.append(block)
        self._held_rows += len(block.epochs_us)
        return b"".join(self._group(GROUP_ROWS) for _ in range(self._held_rows // GROUP_ROWS))

    def end(self) -> bytes:
        """Return the last group and the index."""
        return (self._group(self._held_rows) if self._held_rows else b"") + self._stream.end()

    def _group(self, rows: int) -> bytes:
        """Write the first rows of those that are held."""
        blocks, missing = [], rows
        while missing:
            block = self._held.pop(0)
            if len(block.epochs_us) > missing:
                self._held.insert(0, block.part(missing, len(block.epochs_us)))
                block = block.part(0, missing)
            blocks.append(block)
            missing -= len(block.epochs_us)
        self._held_rows -= rows
        return self._stream.write_group(self._table(blocks))

    def _table(self, blocks: Sequence[MeasurementBlock]) -> Any:
        pa = self._pa
        epochs = pa.array(np.concatenate([block.epochs_us for block in blocks])).cast(self._schema.field(0).type)
        source = pa.DictionaryArray.from_arrays(*_numbered_sources(blocks))
        values = [self._columns.values(block) for block in blocks]
        levels = [
            pa.array(np.concatenate([part[:, k] for part in values]), from_pandas=True)
            for k in range(len(self._columns.carriers))
        ]
        return pa.Table.from_arrays([epochs, source, *levels], schema=self._schema)


def _numbered_sources(blocks: Sequence[MeasurementBlock]) -> tuple[NDArray[np.int32], list[str]]:
    """Return the number of each row's source, and the sources by number, as they first occur."""
    numbers: dict[str, int] = {}
    of_rows = []
    for block in blocks:
        positions = (
            np.zeros(len(block.epochs_us), np.int64) if block.source_positions is None else block.source_positions
        )
        found, first = np.unique(positions, return_index=True)
        table = np.zeros(len(block.sources), dtype=np.int32)
        for position in found[np.argsort(first)].tolist():
            table[position] = numbers.setdefault(block.sources[position], len(numbers))
        of_rows.append(table[positions])
    return np.concatenate(of_rows), list(numbers)


def measurement_file(columns: MeasurementColumns, file_format: Literal["csv", "ndjson", "parquet"]) -> MeasurementFile:
    """Return the writer of a format."""
    match file_format:
        case "csv":
            return csv_file(columns)
        case "ndjson":
            return ndjson_file(columns)
        case "parquet":
            return ParquetFile(columns)
