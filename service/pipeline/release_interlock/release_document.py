"""State of the release as a text that is stored, and back.

    record -> object by field names      enumeration -> its name      tuple -> list      None, numbers, texts, truth

Law of this file: floats come back bit for bit, not-a-number too; a field that a stored text does not have takes its
default, one that the code does not have any more is passed over; a text that does not fit is refused, never guessed.
"""

import json
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from service.pipeline.release_interlock.release_events import ReleaseState


def document_of(state: ReleaseState) -> str:
    """Return the text of a state."""
    return json.dumps(_plain(state), separators=(",", ":"))


def state_of(document: str) -> ReleaseState:
    """Return the state of a text; the state before the first event for an empty one.

    Raises
    ------
    ValueError
        The text is not that of a state.
    """
    if not document:
        return ReleaseState()
    try:
        state: ReleaseState = _read(ReleaseState, json.loads(document))
    except (KeyError, TypeError, AttributeError) as error:
        message = f"the stored state of the release cannot be read: {error!r}"
        raise ValueError(message) from error
    return state


def _plain(value: Any) -> Any:
    """Return a value as what JSON knows."""
    if isinstance(value, Enum):
        return value.name
    kind: Any = type(value)
    names = _names(kind)
    if names is not None:
        return {name: _plain(getattr(value, name)) for name in names}
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return value


def _read(kind: Any, value: Any) -> Any:
    """Return the value of a kind."""
    if get_origin(kind) is UnionType:
        if value is None:
            return None
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    if get_origin(kind) is tuple:
        return _read_tuple(get_args(kind), value)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind[value]
    if _names(kind) is not None:
        hints = _hints(kind)
        return kind(**{name: _read(hints[name], part) for name, part in value.items() if name in hints})
    if not isinstance(value, (int, float) if kind is float else kind):
        message = f"{value!r} is no {kind.__name__}"
        raise TypeError(message)
    return float(value) if kind is float else value


def _read_tuple(kinds: tuple[Any, ...], value: Any) -> tuple[Any, ...]:
    """Return a tuple of any length of one kind, or of one value a kind."""
    if kinds[-1] is Ellipsis:
        return tuple(_read(kinds[0], each) for each in value)
    return tuple(_read(kind, each) for kind, each in zip(kinds, value, strict=True))


@cache
def _names(kind: Any) -> tuple[str, ...] | None:
    """Return the fields of a record, None for what is no record."""
    if is_dataclass(kind):
        return tuple(field.name for field in fields(kind))
    named: tuple[str, ...] | None = getattr(kind, "_fields", None)
    return named


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Return the kind of each field of a record."""
    return get_type_hints(kind)
