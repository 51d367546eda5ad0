"""Rows of any table as bytes, column by column, and back without a bit lost.

Codec 1. A header (JSON) names each column, its form and how many bytes it takes; header and columns are compressed
together by zstd. Integers are delta-coded and laid out byte plane by byte plane (all lowest bytes first); doubles too,
with or without the differences, whichever is shorter, so that a column which repeats another one costs next to nothing.
Of texts each pattern is held once: the numbers in it that are written as Python writes them are columns of their own.
Byte strings of one length are laid out byte by byte.
"""

import json
import math
import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import islice
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from service.records.levels.attitude import IntArray

#: the layout that is written; readers know which one a segment has
CODEC = 1
_LEVEL = 6
#: level at which two forms of a column are compared
_TRIAL_LEVEL = 1
_WORD = 8
_SIZE = struct.Struct("<I")
_NUMBER = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?(?:e[+-]?[0-9]+)?)")
_MOST = 1 << 63
#: pattern of a text that is absent
_ABSENT = -1

#: rows that are wanted: positions, or a range of them
Positions = IntArray | slice
Values = Callable[[Positions], list[Any]]
#: what the header says of a column beside its name and size, and its bytes
_Packed = tuple[dict[str, Any], bytes]


def pack_columns(columns: Mapping[str, Sequence[Any]]) -> bytes:
    """Return columns of equal length as bytes.

    Parameters
    ----------
    columns : mapping
        Values by name, each column of one type: int (64 bits), float, bool, str or bytes; None in any but floats.
    """
    packed = {name: _packed(values) for name, values in columns.items()}
    entries = [{"name": name, **entry, "size": len(body)} for name, (entry, body) in packed.items()]
    head = json.dumps(entries).encode()
    raw = b"".join((_SIZE.pack(len(head)), head, *(body for _, body in packed.values())))
    return zstandard.ZstdCompressor(level=_LEVEL).compress(raw)


class PackedColumns:
    """Columns of ``count`` rows, read from bytes; ValueError where these are no columns.

    Parameters
    ----------
    blob : bytes
        What `pack_columns` gave.
    count : int
        Rows.
    """

    def __init__(self, blob: bytes, count: int) -> None:
        try:
            raw = zstandard.ZstdDecompressor().decompress(blob)
            start = _SIZE.size + _SIZE.unpack_from(raw)[0]
            entries = json.loads(raw[_SIZE.size : start])
        except (zstandard.ZstdError, struct.error) as fault:
            raise ValueError(str(fault)) from fault
        self._columns: dict[str, Values] = {}
        for entry in entries:
            stop = start + entry["size"]
            self._columns[entry["name"]] = _FORMS[entry["form"]](raw[start:stop], count, entry)
            start = stop
        if start != len(raw):
            message = f"{len(raw)} bytes where {start} belong"
            raise ValueError(message)

    def values(self, name: str, chosen: Positions) -> list[Any]:
        """Return some values of a column, as they were packed; a missing double is ``math.nan`` itself."""
        return self._columns[name](chosen)


def _packed(values: Sequence[Any]) -> _Packed:
    kind = next((type(value) for value in values if value is not None), None)
    if kind is None:
        return {"form": "absent"}, b""
    if kind is float:
        return _packed_doubles(values)
    if kind is str:
        return _packed_texts(values)
    is_absent = np.array([value is None for value in values], dtype=np.bool_)
    has_absent = bool(is_absent.any())
    mask = np.packbits(is_absent).tobytes() if has_absent else b""
    if has_absent:
        nothing = kind()
        values = [nothing if value is None else value for value in values]
    packs: dict[type, Callable[[Any], _Packed]] = {int: _packed_integers, bool: _packed_truths, bytes: _packed_strings}
    entry, body = packs[kind](values)
    return {**entry, "has_absent": has_absent}, mask + body


def _packed_integers(values: Sequence[int]) -> _Packed:
    return {"form": "integers"}, _planes(_steps(np.array(values, dtype=np.int64)))


def _packed_truths(values: Sequence[bool]) -> _Packed:
    return {"form": "truths"}, np.array(values, dtype=np.uint8).tobytes()


def _packed_doubles(values: Sequence[float]) -> _Packed:
    bits = np.array(values, dtype="<f8").view("<i8")
    forms = {"doubles": _planes(bits), "double_steps": _planes(_steps(bits))}
    trial = zstandard.ZstdCompressor(level=_TRIAL_LEVEL)
    form = min(forms, key=lambda name: len(trial.compress(forms[name])))
    return {"form": form}, forms[form]


def _packed_strings(values: Sequence[bytes]) -> _Packed:
    sizes = {len(value) for value in values}
    body = b"".join(values)
    if len(sizes) == 1:
        (size,) = sizes
        return {"form": "strings", "width": size}, _transposed(body, len(values), size)
    lengths = _planes(_steps(np.array([len(value) for value in values], dtype=np.int64)))
    return {"form": "strings", "width": None}, lengths + body


def _packed_texts(values: Sequence[str | None]) -> _Packed:
    patterns: dict[tuple[tuple[str, ...], str], int] = {}
    numbers: list[list[list[float]]] = []
    chosen = np.full(len(values), _ABSENT, dtype="<i4")
    for position, text in enumerate(values):
        if text is None:
            continue
        pattern, found = _parsed(text)
        index = patterns.setdefault(pattern, len(numbers))
        if index == len(numbers):
            numbers.append([])
        chosen[position] = index
        numbers[index].append(found)
    slots: list[_Packed] = []
    for (_, kinds), rows in zip(patterns, numbers, strict=True):
        for kind, column in zip(kinds, zip(*rows, strict=True), strict=True):
            slots.append(_packed_doubles(column) if kind == "d" else _packed_integers([int(value) for value in column]))
    entry = {
        "form": "texts",
        "patterns": [[literals, kinds, len(rows)] for (literals, kinds), rows in zip(patterns, numbers, strict=True)],
        "slots": [slot["form"] for slot, _ in slots],
    }
    body = _transposed(chosen.tobytes(), len(chosen), chosen.itemsize)
    return entry, body + b"".join(body for _, body in slots)


def _parsed(text: str) -> tuple[tuple[tuple[str, ...], str], list[float]]:
    """Return what stands around the numbers of a text, the kinds of these (d, i), and the numbers."""
    literals, kinds, numbers = [""], "", []
    for position, token in enumerate(_NUMBER.split(text)):
        number = _number(token) if position % 2 else None
        if number is None:
            literals[-1] += token
            continue
        numbers.append(number)
        kinds += "i" if isinstance(number, int) else "d"
        literals.append("")
    return (tuple(literals), kinds), numbers


def _number(token: str) -> float | None:
    """Return the number that Python writes as this token, None where it writes none so."""
    if token.lstrip("-").isdigit():
        integer = int(token) if len(token) <= len(str(_MOST)) else _MOST
        return integer if str(integer) == token and -_MOST <= integer < _MOST else None
    value = float(token)
    return value if repr(value) == token and math.isfinite(value) else None


def _absent(_body: bytes, count: int, _entry: Mapping[str, Any]) -> Values:
    return lambda chosen: [None] * len(np.empty(count, dtype=np.bool_)[chosen])


def _doubles(body: bytes, count: int, entry: Mapping[str, Any]) -> Values:
    bits = _of_planes(body, count)
    values = (np.cumsum(bits, dtype="<i8") if entry["form"] == "double_steps" else bits).view("<f8")

    def of(chosen: Positions) -> list[float]:
        found = values[chosen]
        if np.isnan(found).any():
            return [value if value == value else math.nan for value in found.tolist()]
        return list(found.tolist())

    return of


def _with_absent(
    body: bytes, count: int, entry: Mapping[str, Any], read: Callable[[bytes, int, Mapping[str, Any]], Values]
) -> Values:
    """Return the values of a column whose absent ones stand in a mask before it."""
    if not entry["has_absent"]:
        return read(body, count, entry)
    size = (count + 7) // 8
    is_absent = np.unpackbits(np.frombuffer(body, dtype=np.uint8, count=size), count=count).astype(np.bool_)
    values = read(body[size:], count, entry)

    def of(chosen: Positions) -> list[Any]:
        stated = zip(values(chosen), is_absent[chosen].tolist(), strict=True)
        return [None if is_none else value for value, is_none in stated]

    return of


def _integers(body: bytes, count: int, _entry: Mapping[str, Any]) -> Values:
    values = np.cumsum(_of_planes(body, count), dtype=np.int64)
    return lambda chosen: list(values[chosen].tolist())


def _truths(body: bytes, _count: int, _entry: Mapping[str, Any]) -> Values:
    values = np.frombuffer(body, dtype=np.bool_)
    return lambda chosen: list(values[chosen].tolist())


def _strings(body: bytes, count: int, entry: Mapping[str, Any]) -> Values:
    if entry["width"] is None:
        ends = np.cumsum(np.cumsum(_of_planes(body[: _WORD * count], count)))
        starts, body = ends - np.diff(ends, prepend=0), body[_WORD * count :]
    else:
        width = entry["width"]
        starts, body = np.arange(count) * width, _transposed(body, width, count)
        ends = starts + width
    return lambda chosen: [
        body[start:end] for start, end in zip(starts[chosen].tolist(), ends[chosen].tolist(), strict=True)
    ]


def _texts(body: bytes, count: int, entry: Mapping[str, Any]) -> Values:
    size = 4 * count
    chosen_pattern = np.frombuffer(_transposed(body[:size], 4, count), dtype="<i4")
    #: index of a row among those of its pattern
    ranks = np.zeros(count, dtype=np.int64)
    renders: list[Callable[[IntArray], list[str]]] = []
    slots, start = iter(entry["slots"]), size
    for index, (literals, kinds, rows) in enumerate(entry["patterns"]):
        ranks[chosen_pattern == index] = np.arange(rows)
        columns = []
        for form in islice(slots, len(kinds)):
            read = _integers if form == "integers" else _doubles
            columns.append(read(body[start : start + _WORD * rows], rows, {"form": form}))
            start += _WORD * rows
        renders.append(partial(_rendered, "%s".join(part.replace("%", "%%") for part in literals), columns))

    def of(chosen: Positions) -> list[str | None]:
        patterns, positions = chosen_pattern[chosen], ranks[chosen]
        texts: NDArray[np.object_] = np.full(len(patterns), None, dtype=object)
        for index in np.unique(patterns[patterns != _ABSENT]).tolist():
            is_its = patterns == index
            texts[is_its] = renders[index](positions[is_its])
        return list(texts.tolist())

    return of


def _rendered(pattern: str, columns: Sequence[Values], positions: IntArray) -> list[str]:
    """Return the texts of one pattern at some positions among its rows."""
    if not columns:
        return [pattern % ()] * len(positions)
    numbers: Iterator[tuple[Any, ...]] = zip(*(column(positions) for column in columns), strict=True)
    return [pattern % tuple(map(repr, row)) for row in numbers]


_FORMS: dict[str, Callable[[bytes, int, Mapping[str, Any]], Values]] = {
    "absent": _absent,
    "doubles": _doubles,
    "double_steps": _doubles,
    "integers": partial(_with_absent, read=_integers),
    "truths": partial(_with_absent, read=_truths),
    "strings": partial(_with_absent, read=_strings),
    "texts": _texts,
}


def _steps(values: IntArray) -> IntArray:
    """Return differences of neighbours, the first from 0; they wrap as their sums do."""
    return np.diff(values, prepend=np.int64(0))


def _planes(values: IntArray) -> bytes:
    """Return (T,) integers of eight bytes, byte plane by byte plane."""
    return _transposed(values.astype("<i8").tobytes(), len(values), _WORD)


def _of_planes(body: bytes, count: int) -> IntArray:
    """Return the (T,) integers of eight bytes that ``_planes`` made bytes of."""
    if len(body) != _WORD * count:
        message = f"{len(body)} bytes where {_WORD * count} belong"
        raise ValueError(message)
    return np.frombuffer(_transposed(body, _WORD, count), dtype="<i8")


def _transposed(body: bytes, rows: int, width: int) -> bytes:
    """Return (rows, width) bytes column by column."""
    return np.ascontiguousarray(np.frombuffer(body, dtype=np.uint8).reshape(rows, width).T).tobytes()
