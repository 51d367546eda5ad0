"""Records, and measurements by the block, as files of named columns: CSV, NDJSON and Parquet; bytes out, page by page.

Each column has a kind, which says how its values read in each format. Floats are written with the fewest digits that
read back to the stored float64, of measurements to float32; NaN and None are absent: an empty cell, null. Columns of
measurements: epoch, source, then ``<carrier id>_dbm`` for the carriers of all plans that occur, in the order in which
ids first appear. Parquet is written piece by piece: what the writer has put out so far is taken away, so that memory
holds one group.
"""

import io
import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np

from service.formats.numbers import csv_field, text_of_float, text_of_level
from service.records.csv_guard import guarded
from service.records.epoch import format_epoch
from service.records.levels.attitude import IntArray
from service.records.levels.measurement import Float32Array, MeasurementBlock

#: rows of a group; a reader holds one at a time, and so does the writer: 4 MB with 16 carriers
GROUP_ROWS = 65_536
#: cells of a group of record batches: a table of more than 40 columns has groups of fewer rows
GROUP_CELLS = 40 * GROUP_ROWS
#: batches that are made one: two sources that take turns come row by row, and a batch costs a kilobyte a column
MERGED_BATCHES = 512


def _parquet_file(schema: Any, dictionary: Sequence[str], batches: Iterable[Any]) -> Iterator[bytes]:
    """Yield a file of record batches, zstd, whose bytes are taken as they come.

    Groups are whole but the last; how rows came in batches leaves no trace, so the same rows make the same bytes.
    """
    # 90 ms that only Parquet needs
    import pyarrow as pa
    from pyarrow import parquet

    sink, group_rows = io.BytesIO(), min(GROUP_ROWS, GROUP_CELLS // len(schema))
    # bytes of floats side by side: neighbours of a column agree in the high ones
    split = [field.name for field in schema if pa.types.is_floating(field.type)]
    writer: Any = parquet.ParquetWriter(
        sink, schema, compression="zstd", use_dictionary=list(dictionary), use_byte_stream_split=split
    )
    held, fresh, rows = schema.empty_table(), [schema.empty_table()], 0
    for batch in chain(batches, [None]):
        if batch is not None:
            fresh.append(pa.Table.from_batches([batch]))
            rows += batch.num_rows
        if batch is None or rows >= group_rows or len(fresh) > MERGED_BATCHES:
            held, fresh = pa.concat_tables([held, pa.concat_tables(fresh).combine_chunks()]), [schema.empty_table()]
        while rows and (batch is None or rows >= group_rows):
            writer.write_table(held.slice(0, group_rows).combine_chunks(), row_group_size=group_rows)
            held = held.slice(group_rows)
            rows = held.num_rows
        if batch is None:
            writer.close()
        if chunk := sink.getvalue():
            yield chunk
            sink.seek(0)
            sink.truncate()


#: epoch: microseconds; figure: float64; level: float32 by its fewest digits; truth: bool; count: int;
#: document: anything that JSON can hold
Kind = Literal["epoch", "text", "figure", "level", "truth", "count", "document"]
TableFormat = Literal["csv", "ndjson", "parquet"]
R = TypeVar("R")


class Column(NamedTuple):
    """One column of a table."""

    name: str
    kind: Kind


class SeriesTable(NamedTuple, Generic[R]):
    """Columns of a series as a table, and the values of its records."""

    columns: tuple[Column, ...]
    #: one value a column of a record
    values: Callable[[R], Sequence[Any]]


def table_bytes(table: SeriesTable[R], file_format: TableFormat, pages: Iterable[Sequence[R]]) -> Iterator[bytes]:
    """Yield the file of records, piece by piece; memory is that of one page.

    Parameters
    ----------
    table : SeriesTable
        Columns, and the values of a record.
    file_format : str
        ``csv``, ``ndjson`` or ``parquet``.
    pages : iterable of sequences
        Records.
    """
    return {"csv": _csv, "ndjson": _ndjson, "parquet": _parquet}[file_format](table, pages)


def _csv(table: SeriesTable[R], pages: Iterable[Sequence[R]]) -> Iterator[bytes]:
    texts = [guarded if column.kind == "text" else _TEXT_OF[column.kind] for column in table.columns]
    yield _csv_line([guarded(column.name) for column in table.columns]).encode()
    for page in pages:
        lines = [
            _csv_line(["" if value is None else text(value) for text, value in zip(texts, values, strict=True)])
            for values in map(table.values, page)
        ]
        yield "".join(lines).encode()


def _ndjson(table: SeriesTable[R], pages: Iterable[Sequence[R]]) -> Iterator[bytes]:
    plain = [(column.name, _JSON_OF[column.kind]) for column in table.columns]
    for page in pages:
        lines = []
        for values in map(table.values, page):
            row = {name: None if v is None else reported(v) for (name, reported), v in zip(plain, values, strict=True)}
            lines.append(_json(row) + "\n")
        yield "".join(lines).encode()


def _parquet(table: SeriesTable[R], pages: Iterable[Sequence[R]]) -> Iterator[bytes]:
    # 90 ms that only Parquet needs
    import pyarrow as pa

    types: dict[Kind, Any] = {
        "epoch": pa.timestamp("us", tz="UTC"),
        "figure": pa.float64(),
        "level": pa.float32(),
        "truth": pa.bool_(),
        "count": pa.int64(),
        "text": pa.string(),
        "document": pa.string(),
    }
    schema: Any = pa.schema([pa.field(column.name, types[column.kind]) for column in table.columns])
    texts = tuple(column.name for column in table.columns if column.kind in {"text", "document"})

    def batch_of(page: Sequence[R]) -> Any:
        arrays = [
            pa.array([_arrow_value(column.kind, value) for value in values], type=types[column.kind])
            for column, values in zip(table.columns, zip(*map(table.values, page), strict=True), strict=True)
        ]
        return pa.RecordBatch.from_arrays(arrays, schema=schema)

    return _parquet_file(schema, texts, (batch_of(page) for page in pages if page))


def _arrow_value(kind: Kind, value: Any) -> Any:
    if value is None or (kind == "figure" and math.isnan(value)):
        return None
    return _json(value) if kind == "document" else value


def _csv_line(fields: Sequence[str]) -> str:
    return ",".join(map(csv_field, fields)) + "\r\n"


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def _truth(value: bool) -> str:  # noqa: FBT001 the value is what is written
    return "true" if value else "false"


def _finite(value: float) -> float | None:
    return None if math.isnan(value) else value


def _same(value: Any) -> Any:
    return value


_TEXT_OF: dict[Kind, Callable[[Any], str]] = {
    "epoch": format_epoch,
    "figure": text_of_float,
    "level": text_of_level,
    "truth": _truth,
    "count": str,
    "text": str,
    "document": _json,
}
_JSON_OF: dict[Kind, Callable[[Any], Any]] = {
    "epoch": format_epoch,
    "figure": _finite,
    "level": _same,
    "truth": _same,
    "count": _same,
    "text": _same,
    "document": _same,
}


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


def measurement_bytes(
    columns: MeasurementColumns, file_format: TableFormat, blocks: Iterable[MeasurementBlock]
) -> Iterator[bytes]:
    """Yield a whole file, piece by piece.

    Parameters
    ----------
    columns : MeasurementColumns
        Columns of the file.
    file_format : str
        ``csv`` by RFC 4180, empty cells for what is absent; ``ndjson``, one JSON object a line, null for what is
        absent; ``parquet``, timestamps in UTC, float32 levels, null for what is absent, zstd.
    blocks : iterable of MeasurementBlock
        Rows.
    """
    return {"csv": _block_csv, "ndjson": _block_ndjson, "parquet": _block_parquet}[file_format](columns, blocks)


def _block_csv(columns: MeasurementColumns, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
    yield ",".join(csv_field(guarded(name)) for name in columns.names).encode() + b"\r\n"

    def source_text(name: str) -> str:
        return "," + csv_field(guarded(name))

    for block in blocks:
        yield _lines(columns, block, "", source_text, [","] * len(columns.carriers), "", "\r\n")


def _block_ndjson(columns: MeasurementColumns, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
    leads = [f",{json.dumps(name)}:" for name in columns.names[2:]]

    def source_text(name: str) -> str:
        return f'","source":{json.dumps(name)}'

    for block in blocks:
        yield _lines(columns, block, '{"epoch":"', source_text, leads, "null", "}\n")


def _lines(
    columns: MeasurementColumns,
    block: MeasurementBlock,
    before: str,
    source_text: Callable[[str], str],
    leads: Sequence[str],
    absent: str,
    after: str,
) -> bytes:
    """Return rows as lines of text: epoch, source, levels with the fewest digits that read back, between fixed pieces.

    Parameters
    ----------
    before, after : str
        Text before the epoch and behind the last level of a row.
    source_text : callable
        Text between epoch and levels, of the name of a source.
    leads : sequence of str
        Text before each level.
    absent : str
        Text in place of an absent level.
    """
    # 90 ms that only files need
    import pyarrow as pa
    from pyarrow import compute

    epochs = compute.strftime(pa.array(block.epochs_us).cast(pa.timestamp("us")), format="%Y-%m-%dT%H:%M:%SZ")
    pieces = [before, epochs, _of_sources(block, map(source_text, block.sources))]
    for lead, level_dbm in zip(leads, columns.values(block).T, strict=True):
        pieces += [lead, pa.array(level_dbm, from_pandas=True).cast(pa.string())]
    lines = compute.binary_join_element_wise(*pieces, after, "", null_handling="replace", null_replacement=absent)
    _, ends, text = lines.buffers()
    return bytes(memoryview(text)[: np.frombuffer(ends, np.int32)[len(lines)]])


def _of_sources(block: MeasurementBlock, texts: Iterable[str]) -> Any:
    """Return the text of each row's source as an array of pyarrow."""
    import pyarrow as pa

    positions = np.zeros(len(block.epochs_us), np.int64) if block.source_positions is None else block.source_positions
    return pa.array(texts, pa.string()).take(pa.array(positions))


def _block_parquet(columns: MeasurementColumns, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
    # 90 ms that only Parquet needs
    import pyarrow as pa

    fields = [pa.field("epoch", pa.timestamp("us", tz="UTC"), nullable=False)]
    fields.append(pa.field("source", pa.string(), nullable=False))
    fields += [pa.field(name, pa.float32()) for name in columns.names[2:]]
    schema: Any = pa.schema(fields)

    def batch_of(block: MeasurementBlock) -> Any:
        levels = [pa.array(level_dbm, from_pandas=True) for level_dbm in columns.values(block).T]
        epochs = pa.array(block.epochs_us).cast(schema.field(0).type)
        return pa.RecordBatch.from_arrays([epochs, _of_sources(block, block.sources), *levels], schema=schema)

    return _parquet_file(schema, ("source",), map(batch_of, blocks))
