"""Fields of records as data: tables, files and answers derive their columns and members from them.

A field added to a record appears in all of these by its type. `AXIS_NAMES` holds the exceptions.
"""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from enum import Enum, auto
from types import NoneType, UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from service.records.levels.attitude import Axes


class FieldKind(Enum):
    """Form of the value of a field."""

    #: int, microseconds UTC; the name ends with _us
    EPOCH = auto()
    COUNT = auto()
    #: float, NaN = not known
    NUMBER = auto()
    TRUTH = auto()
    TEXT = auto()
    #: Enum
    CHOICE = auto()
    #: tuple of str
    TEXTS = auto()
    AXES = auto()
    #: tuple of bool for yaw, roll, pitch
    AXIS_TRUTHS = auto()
    #: tuple of records or of floats
    RECORDS = auto()
    RECORD = auto()
    #: anything that JSON can hold
    DOCUMENT = auto()


#: names of the columns of a field with one value an axis, where they are not ``<axis>_<field>``
AXIS_NAMES = {
    "attitude_deg": "{}_deg",
    "change_deg": "{}_deg",
    "rates_deg_s": "{}_rate_deg_s",
    "control_allowed_axes": "{}_control_allowed",
    "balance_allowed_axes": "{}_balance_allowed",
    "torque_n_m": "{}_n_m",
    "predicted_angle_change_deg": "predicted_{}_change_deg",
    "predicted_rate_change_deg_s": "predicted_{}_rate_change_deg_s",
}
_PLAIN = {
    int: FieldKind.COUNT,
    float: FieldKind.NUMBER,
    bool: FieldKind.TRUTH,
    str: FieldKind.TEXT,
    Axes: FieldKind.AXES,
}


@dataclass(frozen=True, slots=True)
class RecordField:
    """One field of a record."""

    name: str
    kind: FieldKind
    #: class of the value, or of the elements of a tuple
    content: Any
    #: None is a value
    is_optional: bool
    #: `dataclasses.MISSING` without; it is stored as NULL
    default: Any
    #: sentence of the interface; empty = the name says it
    description: str

    def axis_names(self, order: tuple[str, ...] = Axes._fields) -> tuple[str, ...]:
        """Return the names of the columns of a field with one value an axis."""
        pattern = AXIS_NAMES.get(self.name, "{}_" + self.name)
        return tuple(pattern.format(axis) for axis in order)


def record_fields(record: type) -> Mapping[str, RecordField]:
    """Return the fields of a dataclass or a named tuple by name, in their order.

    Raises
    ------
    TypeError
        The type of a field has no `FieldKind`.

    Examples
    --------
    >>> from service.records.inputs import AttitudeReference
    >>> record_fields(AttitudeReference)["sigma_deg"].axis_names()
    ('yaw_sigma_deg', 'roll_sigma_deg', 'pitch_sigma_deg')
    """
    hints = get_type_hints(record, include_extras=True)
    if is_dataclass(record):
        defaults = {each.name: each.default for each in fields(record)}
    else:
        defaults = dict.fromkeys(record._fields, MISSING) | record._field_defaults  # type: ignore[attr-defined]
    return {name: _field(name, hints[name], default) for name, default in defaults.items()}


def _field(name: str, hint: Any, default: Any) -> RecordField:
    description = ""
    if get_origin(hint) is Annotated:
        hint, description = get_args(hint)
    kinds = get_args(hint) if isinstance(hint, UnionType) else (hint,)
    hint = next(kind for kind in kinds if kind is not NoneType)
    kind, content = _kind(name, hint)
    return RecordField(name, kind, content, NoneType in kinds, default, description)


def _kind(name: str, hint: Any) -> tuple[FieldKind, Any]:
    """Return the kind of a type, and the class of a value or of an element."""
    if get_origin(hint) is tuple:
        content, *others = get_args(hint)
        if others == [bool, bool]:
            return FieldKind.AXIS_TRUTHS, bool
        return FieldKind.TEXTS if content is str else FieldKind.RECORDS, content
    if hint is int and name.endswith("_us"):
        return FieldKind.EPOCH, hint
    if hint in _PLAIN:
        return _PLAIN[hint], hint
    if get_origin(hint) in (Mapping, dict):
        return FieldKind.DOCUMENT, hint
    if issubclass(hint, Enum):
        return FieldKind.CHOICE, hint
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        return FieldKind.RECORD, hint
    message = f"field {name} of type {hint} has no form in tables, files and answers"
    raise TypeError(message)
