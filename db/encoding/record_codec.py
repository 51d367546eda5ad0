"""Records as columns of a row, and documents as JSON, with digests of those that estimates rest on.

Spacecraft, carrier plans, ephemerides, calibrations and alignments have a digest from their creation on. The journal
entry that puts a document into force names it by that digest, so a document that was changed in the database differs
from its own digest, or from the one in the journal. It is read all the same, so that a replay stays equal; what differs
is for the interlock, the doctor and backups.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING
from functools import cache, lru_cache, partial
from hashlib import sha256
from operator import attrgetter
from typing import Any, Generic, TypeVar, cast

from pydantic import ConfigDict, TypeAdapter, ValidationError
from sqlalchemy import Connection, Row, Table, select

from db.columns import agrees, column_names
from db.tables import alignment, calibration, carrier_plan, ephemeris, journal, spacecraft
from service.errors import StorageError
from service.records.calibration import CalibrationState
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
#: values of stored columns
Decode = Callable[..., Iterable[Any]]


class RecordCodec(Generic[Record]):
    """Columns of the records of one class.

    Parameters
    ----------
    record : type
        Dataclass.
    table : Table
        Has the columns of `db.columns.record_columns`.
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
        self._decodes = list(zip(map(_decode, fields), positions, strict=True))

    def columns(self, records: Sequence[Record]) -> dict[str, Sequence[Any]]:
        """Return records, at least one, as columns."""
        columns: dict[str, Sequence[Any]] = dict(
            zip(self._plain_names, zip(*map(self._plain, records), strict=True), strict=True)
        )
        for get, names, encode_value in self._encodes:
            columns.update(zip(names, zip(*map(encode_value, map(get, records)), strict=True), strict=True))
        return columns

    def records(self, rows: Sequence[Row[Any]]) -> list[Record]:
        """Return the records of rows of the table, with all of its columns in their order."""
        if not rows:
            return []
        columns = list(zip(*rows, strict=True))
        values = (decode(*(columns[place] for place in places)) for decode, places in self._decodes)
        return list(map(self._record, *values))

    def record(self, row: Row[Any]) -> Record:
        """Return the record of a row."""
        return self.records([row])[0]


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


#: makes what `Axes._make` does of three values without a call of Python
_axes_of = partial(tuple.__new__, Axes)


def _decode(field: RecordField) -> Decode:
    """Return the function from the columns of a field to its values."""
    match field.kind:
        case FieldKind.AXES if field.is_optional:
            return lambda has, *axes: (
                _axes_of(each) if its else None for its, each in zip(has, zip(*axes, strict=True), strict=True)
            )
        case FieldKind.AXES:
            return lambda *axes: map(_axes_of, zip(*axes, strict=True))
        case FieldKind.AXIS_TRUTHS:
            return zip
        case FieldKind.CHOICE:
            return partial(map, field.content)
        case _:
            pass
    of_text, default = _value_of(field), field.default
    if default is MISSING:
        return partial(map, of_text) if of_text is not None else lambda column: column
    same = of_text or (lambda value: value)
    return lambda column: (default if value is None else same(value) for value in column)


def _value_of(field: RecordField) -> Callable[[str], Any] | None:
    """Return the function that reads a value from JSON; of texts most rows have one of a few."""
    content = field.content
    if field.kind is FieldKind.RECORD:
        return lambda text: decode(content, text)
    if field.kind is FieldKind.TEXTS:
        return lru_cache(maxsize=1024)(lambda text: tuple(json.loads(text)))
    if field.kind is not FieldKind.RECORDS:
        return None
    if issubclass(content, tuple):
        return lru_cache(maxsize=1024)(lambda text: tuple(content(*each) for each in json.loads(text)))
    return lambda text: decode_all(content, text)


#: columns of each table that its digest covers, the number of a document first
COVERED: dict[Table, tuple[str, ...]] = {
    spacecraft: ("id", "document"),
    carrier_plan: ("plan_id", "document"),
    ephemeris: ("ephemeris_id", "document"),
    calibration: ("calibration_id", "method", "plan_id", "ephemeris_id", "request", "result"),
    alignment: ("alignment_id", "epoch_us", "document"),
}
#: table of the document that an entry of a kind puts into force
_NAMED_BY: dict[str, Table] = {
    "spacecraft": spacecraft,
    "plan": carrier_plan,
    "ephemeris": ephemeris,
    "activation": calibration,
    "alignment": alignment,
}


def digest_of(table: Table, values: Mapping[str, Any]) -> str:
    """Return the digest of a document, hexadecimal: SHA-256 of its covered columns as JSON."""
    return sha256(json.dumps([values.get(name) for name in COVERED[table]]).encode()).hexdigest()


def with_digest(table: Table, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the columns of a new document with its digest."""
    return {**values, "digest": digest_of(table, values)}


def differs(table: Table, row: Row[Any]) -> bool:
    """Return whether a stored document differs from its own digest."""
    return bool(row.digest != digest_of(table, row._asdict()))


def damaged_documents(connection: Connection, key: int | None = None) -> Iterator[str]:
    """Yield the names of documents that differ from their digest or from the one in the journal.

    Of one spacecraft those in force; without a key all documents of all spacecraft.
    """
    owners = select(spacecraft).order_by(spacecraft.c.spacecraft_key)
    for owner in connection.execute(owners if key is None else owners.where(spacecraft.c.spacecraft_key == key)).all():
        of = f" of {owner.id}" if key is None else ""
        yield from (f"{name}{of}" for name in _damaged(connection, owner, in_force=key is not None))


def _damaged(connection: Connection, owner: Row[Any], *, in_force: bool) -> Iterator[str]:
    """Yield the names of the damaged documents of a spacecraft."""
    named: dict[Table, dict[Any, str]] = {table: {} for table in COVERED}
    is_entry = (journal.c.spacecraft_key == owner.spacecraft_key, journal.c.kind.in_(_NAMED_BY))
    for entry in connection.execute(select(journal).where(*is_entry).order_by(journal.c.number)):
        if not agrees(journal, entry):
            yield f"journal entry {entry.number}"
            continue
        table, content = _NAMED_BY[entry.kind], json.loads(entry.document)
        number = owner.id if table is spacecraft else content[COVERED[table][0]]
        # the last to come into force stands last
        named[table].pop(number, None)
        named[table][number] = content["digest"]
    for table, digests in named.items():
        rows = select(table).where(table.c.spacecraft_key == owner.spacecraft_key)
        if in_force and table is calibration:
            rows = rows.where(table.c.state == CalibrationState.ACTIVE.value)
        elif in_force:
            rows = rows.where(table.c[COVERED[table][0]].in_(list(digests)[-1:]))
        for row in connection.execute(rows.order_by(table.c[COVERED[table][0]])):
            number = row._mapping[COVERED[table][0]]  # noqa: SLF001
            if differs(table, row) or digests.get(number, row.digest) != row.digest:
                yield "catalogue entry" if table is spacecraft else f"{table.name.replace('_', ' ')} {number}"
