"""Columns of a sealed day as one Parquet blob, and back without a bit lost.

zstd at level 3; integers as differences, floats and decimals byte by byte, texts of few kinds by number. A column
without any value is left out, and so is one of floats that repeats another bit for bit. Of texts that differ in their
numbers alone, as records in JSON do, the numbers are columns. The metadata of the file name both.

Every fault of a blob is a ValueError. That its bytes are those that were written is compared before, by the checksum
of the row that holds it: checksums of pages do not cover the footer.
"""

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from service.records.levels.attitude import IntArray

_LEVEL = 3
#: a column of texts with more rows than this for each different one is held by number
_ROWS_OF_A_TEXT = 4
_NUMBER = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?)")
#: integers above are left in their text
_MOST = 1 << 62
#: key of the metadata: columns that repeat others, and what stands around the numbers of texts
_META = b"soo"
#: rows that are wanted: positions, or a range of them
Positions = IntArray | slice


@cache
def arrow() -> Any:
    """Return pyarrow, which takes 90 ms to import; its memory is that of the process, which gives back what is free."""
    import pyarrow as pa

    pa.set_memory_pool(pa.system_memory_pool())
    return pa


def pack_columns(columns: Mapping[str, Any]) -> bytes:
    """Return columns of equal length as a blob.

    Parameters
    ----------
    columns : mapping
        Arrays of pyarrow, or what it makes them of, by name.
    """
    pa = arrow()
    from pyarrow import parquet

    arrays = {name: values if isinstance(values, pa.Array) else pa.array(values) for name, values in columns.items()}
    count = len(next(iter(arrays.values())))
    held: dict[str, Any] = {}
    texts: dict[str, list[str]] = {}
    for name, array in arrays.items():
        if pa.types.is_string(array.type) and (numbers := _numbers(name, array)) is not None:
            texts[name], columns = numbers
            held |= columns
        elif array.null_count < count:
            held[name] = array
    held, same = _different(held)
    encodings = {name: _encoding(array) for name, array in held.items()}
    table, sink = pa.table(held), pa.BufferOutputStream()
    with parquet.ParquetWriter(
        sink,
        table.schema,
        compression="zstd",
        compression_level=_LEVEL,
        use_dictionary=[name for name, encoding in encodings.items() if encoding is None],
        column_encoding={name: encoding for name, encoding in encodings.items() if encoding is not None},
        store_schema=False,
        store_decimal_as_integer=True,
        write_statistics=False,
    ) as writer:
        writer.write_table(table, row_group_size=count)
        if same or texts:
            meta = json.dumps({"same": same, "texts": texts}, separators=(",", ":"))
            writer.add_key_value_metadata({_META: meta})
    return bytes(sink.getvalue())


def _encoding(array: Any) -> str | None:
    """Return the encoding of a column, None for the numbers of a dictionary."""
    kind, pa = array.type, arrow()
    if pa.types.is_integer(kind):
        return "DELTA_BINARY_PACKED"
    if pa.types.is_floating(kind) or pa.types.is_decimal(kind) or pa.types.is_fixed_size_binary(kind):
        return "BYTE_STREAM_SPLIT"
    if pa.types.is_dictionary(kind) or len(array.unique()) * _ROWS_OF_A_TEXT <= len(array):
        return None
    return "PLAIN" if pa.types.is_boolean(kind) else "DELTA_LENGTH_BYTE_ARRAY"


def _different(held: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return columns without those of floats that repeat an earlier one, and which those repeat."""
    first: dict[bytes, str] = {}
    same: dict[str, str] = {}
    for name, array in held.items():
        if arrow().types.is_floating(array.type):
            content = (array.is_null().to_numpy(zero_copy_only=False), array.to_numpy(zero_copy_only=False))
            other = first.setdefault(b"".join(each.tobytes() for each in content), name)
            if other != name:
                same[name] = other
    return {name: array for name, array in held.items() if name not in same}, same


def _numbers(name: str, array: Any) -> tuple[list[str], dict[str, Any]] | None:
    """Return what stands around the numbers of most texts, and the numbers of each place; None where these differ.

    A number counts where `_spelled` writes it so. Other texts stand in the column of the texts.
    """
    pa = arrow()
    texts = array.to_pylist()
    # most texts are one of a few
    parts = {text: None if text is None else _NUMBER.split(text) for text in set(texts)}
    rows = [parts[text] for text in texts]
    patterns = Counter(tuple(row[::2]) for row in rows if row is not None)
    around, times = patterns.most_common(1)[0] if patterns else ((), 0)
    if len(around) < 2 or 2 * times < len(texts) - array.null_count:
        return None
    first = next(row for row in rows if row is not None and tuple(row[::2]) == around)
    kinds = [int if word.lstrip("-").isdigit() else float for word in first[1::2]]
    columns: list[list[Any]] = [[] for _ in kinds]
    for position, row in enumerate(rows):
        values = None if row is None or tuple(row[::2]) != around else _values(row[1::2], kinds)
        if values is not None:
            texts[position] = None
        for column, value in zip(columns, values or [None] * len(kinds), strict=True):
            column.append(value)
    types = {int: pa.int64(), float: pa.float64()}
    found = {f"{name}#{k}": pa.array(column, types[kinds[k]]) for k, column in enumerate(columns)}
    rest = pa.array(texts, pa.string())
    return list(around), found if rest.null_count == len(rest) else {**found, name: rest}


def _values(words: Sequence[str], kinds: Sequence[type]) -> list[Any] | None:
    """Return the numbers of words; None where one is not written so."""
    try:
        values = [kind(word) for kind, word in zip(kinds, words, strict=True)]
    except ValueError:
        return None
    is_so = all(_spelled(value) == word for value, word in zip(values, words, strict=True))
    return values if is_so and all(abs(value) < _MOST for value in values) else None


def _spelled(value: float) -> str:
    """Return a number as documents write it: with the fewest digits of an exponent, which begins at 1e-6."""
    if 1e-5 <= abs(value) < 1e-4:
        return f"{Decimal(repr(value)):f}"
    return repr(value).replace("e-0", "e-").replace("e+", "e")


class ColumnBlob:
    """Columns read from a blob; ValueError where it holds none, or not ``count`` rows where that is stated."""

    def __init__(self, blob: bytes, count: int | None = None) -> None:
        pa = arrow()
        from pyarrow import parquet

        try:
            self._file = parquet.ParquetFile(pa.BufferReader(blob))
        except (pa.ArrowException, OSError) as fault:
            raise ValueError(str(fault)) from fault
        self.count: int = self._file.metadata.num_rows
        self.size = len(blob)
        if count not in {None, self.count}:
            message = f"{self.count} rows where {count} belong"
            raise ValueError(message)
        meta = json.loads((self._file.metadata.metadata or {}).get(_META, b"{}"))
        self._same: dict[str, str] = meta.get("same", {})
        self._texts: dict[str, list[str]] = meta.get("texts", {})
        slots = {f"{name}#{slot}" for name, around in self._texts.items() for slot in range(len(around) - 1)}
        stored = dict.fromkeys((*self._file.schema.names, *self._same, *self._texts))
        #: of the columns that hold any value
        self.names: tuple[str, ...] = tuple(name for name in stored if name not in slots)

    def read(self, names: Iterable[str]) -> dict[str, Any]:
        """Return those of some columns that hold any value as arrays of pyarrow."""
        pa = arrow()
        stored = {name: self._same.get(name, name) for name in names}
        try:
            held = set(self._file.schema.names)
            table = self._file.read(list({name for name in stored.values() if name in held}), use_threads=False)
        except (pa.ArrowException, OSError) as fault:
            raise ValueError(str(fault)) from fault
        found = dict(zip(table.column_names, (column.combine_chunks() for column in table), strict=True))
        return {name: found[other] for name, other in stored.items() if other in found}

    def whole(self, *names: str) -> list[NDArray[Any]]:
        """Return columns that every row has a number in, as they were packed."""
        found = self.read(names)
        for name in names:
            if name not in found or found[name].null_count:
                message = f"rows lack the column {name}"
                raise ValueError(message)
        return [found[name].to_numpy(zero_copy_only=False) for name in names]

    def values(self, name: str, chosen: Positions = slice(None)) -> list[Any]:
        """Return some values of a column as Python has them; a missing double is ``math.nan`` itself."""
        return self.columns([name], chosen)[name]

    def columns(self, names: Sequence[str], chosen: Positions) -> dict[str, list[Any]]:
        """Return some values of columns, as `values` does."""
        slots = {name: self._slots(name) for name in names}
        arrays = self.read([*names, *chain.from_iterable(slots.values())])
        nothing = [None] * len(np.empty(self.count, dtype=np.bool_)[chosen])

        def held(name: str) -> list[Any]:
            return _values_of(arrays[name], chosen) if name in arrays else nothing

        return {
            name: _rendered(self._texts[name], [held(slot) for slot in slots[name]], held(name))
            if slots[name]
            else held(name)
            for name in names
        }

    def _slots(self, name: str) -> list[str]:
        """Return the columns with the numbers of texts."""
        return [f"{name}#{slot}" for slot in range(len(self._texts.get(name, "x")) - 1)]


def _rendered(around: Sequence[str], numbers: Sequence[list[Any]], others: Sequence[str | None]) -> list[str | None]:
    """Return the texts that stand around numbers, and the others."""
    pattern = "%s".join(part.replace("%", "%%") for part in around)
    rows = zip(zip(*numbers, strict=True), others, strict=True)
    return [other if row[0] is None else pattern % tuple(map(_spelled, row)) for row, other in rows]


def _values_of(array: Any, chosen: Positions) -> list[Any]:
    if str(array.type) in {"string", "binary"} or str(array.type).startswith("fixed_size_binary"):
        return _texts(array, chosen)
    if array.null_count:
        return list(np.array(array.to_pylist(), dtype=object)[chosen])
    found = array.to_numpy(zero_copy_only=False)[chosen]
    if found.dtype.kind == "f" and np.isnan(found).any():
        return [value if value == value else math.nan for value in found.tolist()]
    return list(found.tolist())


def _texts(array: Any, chosen: Positions) -> list[Any]:
    """Return some of the texts, or bytes, of a column: each different one is made once."""
    numbered = array.dictionary_encode()
    texts = np.array([*numbered.dictionary.to_pylist(), None], dtype=object)
    places = numbered.indices.fill_null(len(texts) - 1).to_numpy(zero_copy_only=False)
    return list(texts[places[chosen]].tolist())


def decimals(values: NDArray[np.float32], places: int) -> Any | None:
    """Return levels as decimals, NaN as null; None where they do not come back bit for bit.

    Parameters
    ----------
    values : ndarray, shape (T,)
        float32.
    places : int
        Decimal places.
    """
    pa = arrow()
    is_known = ~np.isnan(values)
    known = values[is_known]
    scale = 10.0**places
    steps = np.rint(known.astype(np.float64) * scale)
    if not len(known) or not np.abs(steps).max() < 1e9:
        return None
    if not np.array_equal(_of_steps(steps, places).view("<u4"), np.ascontiguousarray(known).view("<u4")):
        return None
    whole = np.zeros(len(values), dtype="<i4")
    whole[is_known] = steps
    mask = None if len(known) == len(values) else pa.py_buffer(np.packbits(is_known, bitorder="little"))
    return pa.Array.from_buffers(pa.decimal32(9, places), len(values), [mask, pa.py_buffer(whole)])


def levels_of(array: Any) -> NDArray[np.float32]:
    """Return levels from a column of decimals or of float32; NaN where there is none."""
    if array.type.id != _decimal_type():
        found: NDArray[np.float32] = np.asarray(array.to_numpy(zero_copy_only=False), dtype="<f4")
        return found
    words = np.frombuffer(array.buffers()[1], dtype="<i8").reshape(-1, 2)[array.offset : array.offset + len(array), 0]
    levels = _of_steps(words, array.type.scale)
    if array.null_count:
        levels[array.is_null().to_numpy(zero_copy_only=False)] = np.nan
    return levels


def _of_steps(steps: NDArray[Any], places: int) -> NDArray[np.float32]:
    # through whole numbers, so that no sign of zero is made
    return (steps.astype(np.int64) / 10.0**places).astype("<f4")


def _decimal_type() -> int:
    kind: int = arrow().decimal128(9, 2).id
    return kind
