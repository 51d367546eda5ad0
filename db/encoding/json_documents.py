"""Documents: records as JSON text that comes back equal, floats bit for bit, NaN and infinities included."""

from functools import cache
from typing import Any, TypeVar, cast

from pydantic import ConfigDict, TypeAdapter

from service.records.journal import KIND_OF, KINDS, SlowInput

Record = TypeVar("Record")


def encode(record: object) -> str:
    """Return the JSON text of a record."""
    return encode_all(type(record), (record,))[1:-1]


def decode(kind: type[Record], text: str) -> Record:
    """Return the record of a kind that a JSON text holds."""
    return decode_all(kind, f"[{text}]")[0]


def encode_all(kind: Any, records: object) -> str:
    """Return the JSON text of a sequence of values of one kind."""
    return _adapter(kind).dump_json(records).decode()


def decode_all(kind: type[Record], text: str) -> tuple[Record, ...]:
    """Return the values of one kind that a JSON list holds."""
    adapter: TypeAdapter[tuple[Record, ...]] = _adapter(cast("Any", kind))
    return adapter.validate_json(text)


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
