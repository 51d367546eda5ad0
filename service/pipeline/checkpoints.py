"""Checkpoints: the state of a chain as bytes."""

import dataclasses
import hashlib
import io
import json
import typing
from collections.abc import Sequence
from enum import Enum
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np

from service.core.estimation.filtering.filter_state import CARRIER, RATES, SENSOR, WATCH
from service.core.estimation.filtering.readings import READING
from service.core.estimation.paper.downlink_fade import FADE
from service.core.estimation.paper.row import COUNTERS, LEVEL, PENDING
from service.pipeline.config import ChainConfig
from service.pipeline.control.command.control_design import PanelSwing
from service.pipeline.estimation.paper.runner import SavedPaper
from service.pipeline.estimation.robust.robust_state import SavedRobust
from service.pipeline.estimation.row_inhibitions import Disagreement
from service.records.levels.attitude import BalanceBasis, FloatArray, IntArray
from service.records.levels.measurement import Measurement

T = TypeVar("T")


class Layout:
    """Classes of a state, by name.

    Parameters
    ----------
    outermost : type
        NamedTuple or dataclass whose annotations name the others.
    dtypes : sequence of dtype, optional
        Of arrays of records in the state, which annotations do not tell apart.
    """

    def __init__(self, outermost: type, dtypes: Sequence[np.dtype[np.void]] = ()) -> None:
        self._classes: dict[str, type] = {}
        # by the same types without padding, whose bytes are whatever lay there in memory
        self._dtypes = {np.dtype([(name, each[name]) for name in each.names or ()]): each for each in dtypes}
        self._find(outermost)

    @cached_property
    def digest(self) -> str:
        """Return what changes with the names, the fields or their types (16 hexadecimal digits)."""
        lines = [f"{name}: {self._members(one)}" for name, one in sorted(self._classes.items())]
        lines += [str(each.descr) for each in self._dtypes.values()]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]

    def pack(self, value: Any) -> bytes:
        """Return a state as bytes.

        Raises
        ------
        TypeError
            A value is neither a record of the layout nor a plain value.
        """
        arrays: list[Any] = []
        document = json.dumps(self._encoded(value, arrays), separators=(",", ":"))
        kept, text = io.BytesIO(), np.frombuffer(document.encode(), dtype=np.uint8)
        np.savez_compressed(kept, text, *arrays)
        return kept.getvalue()

    def unpack(self, content: bytes, outermost: type[T]) -> T:
        """Return the state of `pack`.

        Raises
        ------
        ValueError, KeyError, TypeError, OSError
            The bytes are not those of a state of this layout.
        """
        with np.load(io.BytesIO(content), allow_pickle=False) as kept:
            arrays = [self._own(kept[f"arr_{k}"]) for k in range(len(kept.files))]
        value = self._decoded(json.loads(arrays[0].tobytes()), arrays)
        if not isinstance(value, outermost):
            message = f"the state is a {type(value).__name__}, not a {outermost.__name__}"
            raise TypeError(message)
        return value

    def _find(self, annotation: Any) -> None:
        """Add the classes that an annotation names, and those of their fields."""
        for part in typing.get_args(annotation):
            self._find(part)
        if not isinstance(annotation, type) or self._classes.get(annotation.__name__) is annotation:
            return
        if not (_is_record(annotation) or issubclass(annotation, Enum)):
            return
        if annotation.__name__ in self._classes:
            message = f"two classes of the state are called {annotation.__name__}"
            raise TypeError(message)
        self._classes[annotation.__name__] = annotation
        if _is_record(annotation):
            for part in typing.get_type_hints(annotation).values():
                self._find(part)

    def _members(self, one: type) -> str:
        """Return fields and types of a record, or the members of an enumeration, as text."""
        if issubclass(one, Enum):
            return ", ".join(sorted(one.__members__))
        hints = typing.get_type_hints(one)
        return ", ".join(f"{name} {hints[name]}" for name in _fields(one))

    def _encoded(self, value: Any, arrays: list[Any]) -> Any:
        """Return a value as JSON knows it; arrays are numbered from 1."""
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            arrays.append(self._packed(value))
            return {"array" if isinstance(value, np.ndarray) else "scalar": len(arrays)}
        if isinstance(value, Enum):
            return {"is": type(value).__name__, "member": value.name}
        if _is_record(type(value)):
            self._known(type(value))
            return {"is": type(value).__name__, "of": [self._encoded(each, arrays) for each in _values(value)]}
        if isinstance(value, tuple):
            return [self._encoded(each, arrays) for each in value]
        if isinstance(value, complex):
            return {"complex": [value.real, value.imag]}
        if value is None or isinstance(value, bool | int | float | str):
            return value
        message = f"a {type(value).__name__} is no part of a state"
        raise TypeError(message)

    def _decoded(self, document: Any, arrays: list[Any]) -> Any:
        """Return the value of `_encoded`."""
        match document:
            case list():
                return tuple(self._decoded(each, arrays) for each in document)
            case {"array": number}:
                return arrays[number]
            case {"scalar": number}:
                return arrays[number][()]
            case {"complex": [real, imaginary]}:
                return complex(real, imaginary)
            case {"is": name, "member": member}:
                return self._classes[name][member]  # type: ignore[index]
            case {"is": name, "of": values}:
                return self._classes[name](*(self._decoded(each, arrays) for each in values))
            case _:
                return document

    def _packed(self, value: Any) -> Any:
        """Return a value as it is stored: records without padding."""
        if value.dtype.names is None:
            return value
        packed = next((packed for packed, own in self._dtypes.items() if own == value.dtype), None)
        if packed is None:
            message = f"an array of {value.dtype} is no part of a state"
            raise TypeError(message)
        return value.astype(packed)

    def _own(self, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
        """Return an array of `_packed` whose records are of the very type that the filter was compiled for."""
        if array.dtype.names is None:
            return array
        own = self._dtypes.get(array.dtype)
        if own is None:
            message = "the state has an array of records of another type"
            raise TypeError(message)
        return array.astype(own)

    def _known(self, one: type) -> None:
        if self._classes.get(one.__name__) is not one:
            message = f"{one.__name__} is not among the classes of the state"
            raise TypeError(message)


def _is_record(one: type) -> bool:
    return dataclasses.is_dataclass(one) or (issubclass(one, tuple) and hasattr(one, "_fields"))


def _fields(one: type) -> tuple[str, ...]:
    """Return the names of the fields that make a record."""
    if dataclasses.is_dataclass(one):
        return tuple(field.name for field in dataclasses.fields(one))
    return tuple(one._fields)  # type: ignore[attr-defined]


def _values(value: Any) -> list[Any]:
    return [getattr(value, name) for name in _fields(type(value))]


#: raised when the state means something else than before, though its classes look alike; their names, fields and types
#: are compared by themselves
LAYOUT_NUMBER = 2


class ChainState(NamedTuple):
    """State of a chain that runs."""

    alignment_id: int
    robust: SavedRobust | None
    paper: SavedPaper | None
    #: torque that wheels have not been given yet
    carry_n_m_s: FloatArray
    basis: BalanceBasis | None
    swing: PanelSwing | None
    newest_us: int | None
    recent_us: IntArray
    disagreement: Disagreement
    #: newest row, and whether anything was computed from it
    last: tuple[Measurement, bool] | None


#: records of arrays of the state
RECORDS = (CARRIER, WATCH, SENSOR, RATES, READING, COUNTERS, FADE, PENDING, LEVEL)
_LAYOUT = Layout(ChainState, RECORDS)


def fingerprint(config: ChainConfig) -> str:
    """Return what a checkpoint must share with the program that restores it: layout and configuration."""
    settings = hashlib.sha256(repr(config).encode()).hexdigest()[:16]
    return f"{LAYOUT_NUMBER}/{_LAYOUT.digest}/{settings}"


def pack_state(state: ChainState) -> bytes:
    """Return a state as bytes."""
    return _LAYOUT.pack(state)


def unpack_state(content: bytes) -> ChainState:
    """Return the state of `pack_state`.

    Raises
    ------
    ValueError, KeyError, TypeError, OSError
        The bytes are not those of a state of this layout.
    """
    return _LAYOUT.unpack(content, ChainState)
