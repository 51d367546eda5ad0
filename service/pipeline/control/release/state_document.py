"""State of the release as a text that is stored, and back.

    record -> object by field names      enumeration -> its name      tuple -> list      None, numbers, texts, truth

Law of this file: floats come back bit for bit, not-a-number too; a field that a stored text does not have takes its
default, one that the code does not have any more is passed over; a text that does not fit is refused, never guessed.
"""

import json
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache
from types import NoneType, UnionType
from typing import Any, get_args, get_origin, get_type_hints

from service.pipeline.control.release.events import ReleaseState
from service.pipeline.control.release.interlock_conditions import InterlockInputs
from service.records.operations.release import Command, SignCheck

#: fields that are stored under the name that they had first
_STORED_AS = {"inputs": "around"}


def document_of(state: ReleaseState) -> str:
    """Return the text of a state; of its commands the counters, because their records are stored by themselves."""
    document = _plain(replace(state, commands=(), sign_check=None))
    document["commands"] = [{"counter": command.counter} for command in state.commands]
    return json.dumps({"state": document, "sign_check": _plain(state.sign_check)}, separators=(",", ":"))


def state_of(document: str, command_of: Callable[[int], Command]) -> ReleaseState:
    """Return the state of a text; that before the first event for an empty one.

    Parameters
    ----------
    document : str
        Of `document_of`; in those of former versions commands stand whole, and their counters alone are read.
    command_of : callable
        Gives the stored command of a counter.

    Raises
    ------
    ValueError
        The text is not that of a state.
    """
    if not document:
        return ReleaseState()
    try:
        stored = json.loads(document)
        counters = [command["counter"] for command in stored["state"].pop("commands", ())]
        state: ReleaseState = _read(ReleaseState, stored["state"])
        check: SignCheck | None = _read(SignCheck | None, stored.get("sign_check"))
    except (KeyError, TypeError, AttributeError) as error:
        message = f"the stored state of the release cannot be read: {error!r}"
        raise ValueError(message) from error
    return replace(state, commands=tuple(map(command_of, counters)), sign_check=check)


def essence(state: ReleaseState) -> ReleaseState:
    """Return the part of a state that must not be lost; rows and inputs are read again after a restart."""
    interlock, check = state.interlock, state.sign_check
    calibration_id, plan_id, version, control = interlock.configuration
    inputs = InterlockInputs(
        calibration_id=calibration_id, plan_id=plan_id, spacecraft_version=version, control_version=control
    )
    kept = replace(
        interlock,
        row=None,
        inputs=inputs,
        innovation_since_us=None,
        clock=None,
        good_since_us=None,
        standing=(),
        since=(),
    )
    # impulses are kept with the release that they belong to, likelihoods with the next leg
    kept_check = None if check is None else replace(check, log_ratio=None)
    return replace(state, interlock=kept, sent=(), sign_check=kept_check)


def _plain(value: Any) -> Any:
    """Return a value as what JSON knows."""
    if isinstance(value, Enum):
        return value.name
    kind: Any = type(value)
    names = _names(kind)
    if names is not None:
        return {_STORED_AS.get(name, name): _plain(getattr(value, name)) for name in names}
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
        stored = {_STORED_AS.get(name, name): name for name in hints}
        return kind(**{stored[key]: _read(hints[stored[key]], part) for key, part in value.items() if key in stored})
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
        return tuple(each.name for each in fields(kind))
    named: tuple[str, ...] | None = getattr(kind, "_fields", None)
    return named


@cache
def _hints(kind: Any) -> dict[str, Any]:
    """Return the kind of each field of a record."""
    return get_type_hints(kind)
