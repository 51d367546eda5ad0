"""Measurements as files by columns: CSV, NDJSON and Parquet; bytes out, block by block.

Columns: epoch, source, then ``<carrier id>_dbm`` for the carriers of all plans that occur, in the order in which ids
first appear. A carrier that a plan does not hold is absent, as is a level that was not measured. What is written reads
back to the stored float32 bit for bit. Memory is that of one block.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from service.formats.numbers import csv_field
from service.formats.tabular.parquet_stream import ParquetStream
from service.formats.tabular.table_file import TableFormat
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
    return {"csv": _csv, "ndjson": _ndjson, "parquet": _parquet}[file_format](columns, blocks)


def _csv(columns: MeasurementColumns, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
    yield ",".join(csv_field(guarded(name)) for name in columns.names).encode() + b"\r\n"

    def source_text(name: str) -> str:
        return "," + csv_field(guarded(name))

    for block in blocks:
        yield _lines(columns, block, "", source_text, [","] * len(columns.carriers), "", "\r\n")


def _ndjson(columns: MeasurementColumns, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
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


def _parquet(columns: MeasurementColumns, blocks: Iterable[MeasurementBlock]) -> Iterator[bytes]:
    # 90 ms that only Parquet needs
    import pyarrow as pa

    fields = [pa.field("epoch", pa.timestamp("us", tz="UTC"), nullable=False)]
    fields.append(pa.field("source", pa.string(), nullable=False))
    fields += [pa.field(name, pa.float32()) for name in columns.names[2:]]
    schema: Any = pa.schema(fields)
    stream = ParquetStream(schema, ("source",))
    yield stream.taken()
    for block in blocks:
        levels = [pa.array(level_dbm, from_pandas=True) for level_dbm in columns.values(block).T]
        epochs = pa.array(block.epochs_us).cast(schema.field(0).type)
        arrays = [epochs, _of_sources(block, block.sources), *levels]
        if chunk := stream.add(pa.RecordBatch.from_arrays(arrays, schema=schema)):
            yield chunk
    yield stream.end()
