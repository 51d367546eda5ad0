"""Records as columns of a row, and documents as JSON."""

import json
from collections.abc import Callable, Sequence
from dataclasses import MISSING
from functools import cache, lru_cache
from operator import attrgetter, itemgetter
from typing import Any, Generic, TypeVar, cast

from pydantic import ConfigDict, TypeAdapter, ValidationError
from sqlalchemy import Row, Table

from db.schema.columns import column_names
from service.errors import StorageError
from service.records.inputs import KIND_OF, KINDS, SlowInput
from service.records.levels.attitude import NO_ANGLES, Axes
from service.records.record_fields import FieldKind, RecordField, record_fields

Record = TypeVar("Record")


def encode(record: object) -> str:
    """Return the JSON text of a record."""
    return encode_all(type(record), (record,))[1:-1]


def decode(kind: type[Record], text: str, what: str = "") -> Record:
    """Return the record of a kind that a JSON text holds; an error says what it is."""
    return decode_all(kind, f"[{text}]", what)[0]


def encode_all(kind: Any, records: object) -> str:
    """Return the JSON text of a sequence of values of one kind."""
    return _adapter(kind).dump_json(records).decode()


def decode_all(kind: type[Record], text: str, what: str = "") -> tuple[Record, ...]:
    """Return the values of one kind that a JSON list holds; StorageError ``storage.corrupt`` where it holds others."""
    adapter: TypeAdapter[tuple[Record, ...]] = _adapter(cast("Any", kind))
    try:
        return adapter.validate_json(text)
    except ValidationError as fault:
        found = fault.errors(include_url=False, include_input=False)[0]
        place = ".".join(map(str, found["loc"][1:])) or "its text"
        named = f"{what}: a" if what else "A"
        detail = f"{named} stored {kind.__name__} cannot be read: {place}: {found['msg']}."
        raise StorageError("storage.corrupt", detail) from fault


def kind_of(record: SlowInput) -> str:
    """Return the name of the kind of a slow input."""
    return KIND_OF[type(record)]


def decode_input(kind: str, text: str) -> SlowInput:
    """Return the slow input that a document of a kind holds."""
    return decode(KINDS[kind], text)


@cache
def _adapter(kind: Any) -> TypeAdapter[Any]:
    # the configuration reaches a standard dataclass only from a container around it
    return TypeAdapter(tuple[kind, ...], config=ConfigDict(ser_json_inf_nan="constants"))


#: columns of a value
Encode = Callable[[Any], tuple[Any, ...]]
#: value of a stored row
Decode = Callable[[Any], Any]


class RecordCodec(Generic[Record]):
    """Columns of the records of one class.

    Parameters
    ----------
    record : type
        Dataclass.
    table : Table
        Has the columns of `db.schema.columns.record_columns`.
    """

    def __init__(self, record: type[Record], table: Table) -> None:
        self._record = record
        fields = record_fields(record).values()
        paths = {name: path for field in fields for name, path in _plain_paths(field).items()}
        self._plain_names, self._plain = tuple(paths), attrgetter(*paths.values())
        encodes = ((field, _encode(field)) for field in fields)
        self._encodes = [(attrgetter(f.name), column_names(f), encode) for f, encode in encodes if encode is not None]
        position_of = {name: position for position, name in enumerate(table.c.keys())}
        positions = [tuple(position_of[name] for name in column_names(field)) for field in fields]
        self._first_columns = itemgetter(*(first for first, *_ in positions))
        decodes = enumerate(map(_decode, fields, positions))
        self._decodes = [(position, decode) for position, decode in decodes if decode is not None]

    def columns(self, records: Sequence[Record]) -> dict[str, Sequence[Any]]:
        """Return records, at least one, as columns."""
        columns: dict[str, Sequence[Any]] = dict(
            zip(self._plain_names, zip(*map(self._plain, records), strict=True), strict=True)
        )
        for get, names, encode_value in self._encodes:
            columns.update(zip(names, zip(*map(encode_value, map(get, records)), strict=True), strict=True))
        return columns

    def record(self, row: Row[Any]) -> Record:
        """Return the record of a row of the table, with all of its columns in their order."""
        stored = tuple(row)
        values = list(self._first_columns(stored))
        for position, decode_row in self._decodes:
            values[position] = decode_row(stored)
        return self._record(*values)


def _plain_paths(field: RecordField) -> dict[str, str]:
    """Return the path to the value of each column that needs no coding."""
    if _encode(field) is not None:
        return {}
    if field.kind is FieldKind.AXES:
        return dict(zip(field.axis_names(), (f"{field.name}.{axis}" for axis in Axes._fields), strict=True))
    return {field.name: f"{field.name}.value" if field.kind is FieldKind.CHOICE else field.name}


def _encode(field: RecordField) -> Encode | None:
    """Return the function from a value to its columns; None where they are the value itself."""
    if field.kind is FieldKind.AXES:
        return _optional_axes if field.is_optional else None
    if field.kind is FieldKind.AXIS_TRUTHS:
        return tuple
    text = _text_of(field)
    if field.default is MISSING or field.default != field.default:
        return None if text is None else lambda value: (text(value),)
    # most rows have the default
    same = text or (lambda value: value)
    return lambda value: (None if value == field.default else same(value),)


def _optional_axes(value: Axes | None) -> tuple[Any, ...]:
    return (False, *NO_ANGLES) if value is None else (True, *value)


def _text_of(field: RecordField) -> Callable[[Any], str] | None:
    """Return the function that writes a value as JSON; None for values that columns hold."""
    content = field.content
    if field.kind is FieldKind.RECORD:
        return encode
    if field.kind is FieldKind.TEXTS or (field.kind is FieldKind.RECORDS and issubclass(content, tuple)):
        return _list_text
    return (lambda value: encode_all(content, value)) if field.kind is FieldKind.RECORDS else None


@lru_cache(maxsize=1024)
def _list_text(texts: tuple[str | tuple[str, ...], ...]) -> str:
    """Return texts, or records of texts, as JSON; most rows have one of a few."""
    return json.dumps(texts)


def _decode(field: RecordField, positions: tuple[int, ...]) -> Decode | None:
    """Return the function from a row to the value; None where the column holds it."""
    get, content, first = itemgetter(*positions), field.content, positions[0]
    match field.kind:
        case FieldKind.AXES if field.is_optional:
            axes = itemgetter(*positions[1:])
            return lambda row: Axes._make(axes(row)) if row[first] else None
        case FieldKind.AXES:
            return lambda row: Axes._make(get(row))
        case FieldKind.AXIS_TRUTHS:
            return get
        case FieldKind.CHOICE:
            return lambda row: content(row[first])
        case _:
            pass
    of_text = _value_of(field)
    if field.default is MISSING:
        return None if of_text is None else lambda row: of_text(row[first])
    same = of_text or (lambda value: value)
    return lambda row: field.default if (stored := row[first]) is None else same(stored)


def _value_of(field: RecordField) -> Callable[[str], Any] | None:
    """Return the function that reads a value from JSON."""
    content = field.content
    if field.kind is FieldKind.RECORD:
        return lambda text: decode(content, text)
    if field.kind is FieldKind.TEXTS:
        return lambda text: tuple(json.loads(text))
    if field.kind is not FieldKind.RECORDS:
        return None
    if issubclass(content, tuple):
        return lambda text: tuple(content(*each) for each in json.loads(text))
    return lambda text: decode_all(content, text)
