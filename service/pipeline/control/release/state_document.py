"""State of the release as a text that is stored, and back.

    record -> object by field names      enumeration -> its name      tuple -> list      None, numbers, texts, truth

Law of this file: floats come back bit for bit, not-a-number too; a text that does not fit is refused, never guessed.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass, replace
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from service.pipeline.control.release.events import ReleaseState
from service.pipeline.control.release.interlock import Interlock
from service.records.operations.release import Command, SignCheck

#: what of the interlock may be lost
_FORGOTTEN = ("row", "inputs", "innovation_since_us", "clock", "good_since_us", "standing", "since")
_FRESH = Interlock()


def document_of(state: ReleaseState) -> str:
    """Return the text of a state; of its commands the counters, because their records are stored by themselves."""
    document = _plain(replace(state, commands=(), sign_check=None))
    document["commands"] = [command.counter for command in state.commands]
    return json.dumps({"state": document, "sign_check": _plain(state.sign_check)}, separators=(",", ":"))


def state_of(document: str, command_of: Callable[[int], Command]) -> ReleaseState:
    """Return the state of a text of `document_of`, that before the first event for an empty one.

    `command_of` gives the stored command of a counter. ValueError: the text is not that of a state.
    """
    if not document:
        return ReleaseState()
    try:
        stored = json.loads(document)
        counters: tuple[int, ...] = _read(tuple[int, ...], stored["state"].pop("commands"))
        state: ReleaseState = _read(ReleaseState, stored["state"])
        check: SignCheck | None = _read(SignCheck | None, stored["sign_check"])
    except (KeyError, TypeError, AttributeError) as error:
        message = f"the stored state of the release cannot be read: {error!r}"
        raise ValueError(message) from error
    return replace(state, commands=tuple(map(command_of, counters)), sign_check=check)


def essence(state: ReleaseState) -> tuple[object, ...]:
    """Return what of a state must not be lost; rows and inputs are read again after a restart."""
    interlock, check = state.interlock, state.sign_check
    forgotten = {name: getattr(_FRESH, name) for name in _FORGOTTEN}
    # impulses are kept with the release that they belong to, likelihoods with the next leg
    kept = None if check is None else replace(check, log_ratio=None)
    return replace(state, interlock=replace(interlock, **forgotten), sent=(), sign_check=kept), interlock.configuration


def _plain(value: Any) -> Any:
    """Return a value as what JSON knows."""
    if isinstance(value, Enum):
        return value.name
    kind: Any = type(value)
    kinds = _kinds(kind)
    if kinds is not None:
        return {name: _plain(getattr(value, name)) for name in kinds}
    return [_plain(each) for each in value] if isinstance(value, tuple) else value


def _read(kind: Any, value: Any) -> Any:
    """Return the value of a kind."""
    if get_origin(kind) is UnionType:
        if value is None:
            return None
        (kind,) = (each for each in get_args(kind) if each is not NoneType)
    if get_origin(kind) is tuple:
        first, *others = get_args(kind)
        each = (first,) * len(value) if Ellipsis in others else (first, *others)
        return tuple(_read(one, part) for one, part in zip(each, value, strict=True))
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind[value]
    kinds = _kinds(kind)
    if kinds is not None:
        return kind(**{name: _read(kinds[name], part) for name, part in value.items()})
    if not isinstance(value, (int, float) if kind is float else kind):
        message = f"{value!r} is no {kind.__name__}"
        raise TypeError(message)
    return float(value) if kind is float else value


@cache
def _kinds(kind: Any) -> Mapping[str, Any] | None:
    """Return the kind of each field of a record, None for what is no record."""
    return get_type_hints(kind) if is_dataclass(kind) or hasattr(kind, "_fields") else None
