"""Records as files of named columns: CSV, NDJSON and Parquet; bytes out, page by page.

Each column has a kind, which says how its values read in each format. Floats are written with the fewest digits that
read back to the stored float64; NaN and None are absent: an empty cell, null.
"""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Generic, Literal, NamedTuple, TypeVar

from service.formats.numbers import csv_field, text_of_float, text_of_level
from service.formats.tabular.parquet_stream import ParquetStream
from service.records.csv_guard import guarded
from service.records.epoch import format_epoch

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
    stream = ParquetStream(schema, texts)
    if start := stream.taken():
        yield start
    for page in pages:
        columns = list(zip(*map(table.values, page), strict=True))
        arrays = [
            pa.array([_arrow_value(column.kind, value) for value in values], type=types[column.kind])
            for column, values in zip(table.columns, columns, strict=True)
        ]
        if arrays and (chunk := stream.add(pa.RecordBatch.from_arrays(arrays, schema=schema))):
            yield chunk
    yield stream.end()


def _arrow_value(kind: Kind, value: Any) -> Any:
    """Return a value as Parquet keeps it."""
    if value is None or (kind == "figure" and math.isnan(value)):
        return None
    return _json(value) if kind == "document" else value


def _csv_line(fields: Sequence[str]) -> str:
    return ",".join(map(csv_field, fields)) + "\r\n"


def _json(value: Any) -> str:
    """Return compact JSON."""
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
