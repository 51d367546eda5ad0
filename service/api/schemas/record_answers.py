"""Members of answers derived from the fields of a record, with the descriptions that stand with the fields."""

from collections.abc import Callable, Collection, Mapping, Sequence
from operator import attrgetter
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, Field, create_model

from service.api.schemas.base import AllowedAxesAnswer, AnglesAnswer, Answer, EpochAnswer, Figure
from service.records.levels.attitude import Axes
from service.records.record_fields import FieldKind, RecordField, record_fields

_TYPES: dict[FieldKind, Any] = {
    FieldKind.EPOCH: EpochAnswer,
    FieldKind.TEXTS: list[str],
    FieldKind.AXES: AnglesAnswer,
    FieldKind.AXIS_TRUTHS: AllowedAxesAnswer,
}
#: an epoch of one of these is shown as <participle>_at
_PARTICIPLES = frozenset({"created", "expires", "prepared", "released", "reported", "sent", "started"})


class RecordMembers:
    """Members of the answer that shows a record.

    Parameters
    ----------
    record : type
        Dataclass.
    first : sequence of str
        Fields that come first; the others follow as they stand.
    without, only : collection of str
        Fields that are not shown; if any, those that are.
    flat : collection of str
        Fields of axes that are shown as one member an axis.
    number : type
        Of a figure; `Figure` tells NaN as null.
    types : mapping
        Types of members that do not follow from the type of the field; of a field of records, that of its elements.
    descriptions : mapping
        Of members, in place of those of the fields.
    others : mapping
        Members that are no fields: the field that each comes before, its type and its description.
    """

    def __init__(
        self,
        record: type[Any],
        *,
        first: Sequence[str] = (),
        without: Collection[str] = (),
        only: Collection[str] = (),
        flat: Collection[str] = (),
        number: Any = Figure,
        types: Mapping[str, Any] = MappingProxyType({}),
        descriptions: Mapping[str, str] = MappingProxyType({}),
        others: Mapping[str, tuple[str, Any, str]] = MappingProxyType({}),
    ) -> None:
        known = record_fields(record)
        shown = [name for name in known if name not in without and (not only or name in only)]
        self._members: dict[str, Any] = {}
        paths: list[str] = []
        for name in dict.fromkeys((*first, *shown)):
            for member, (_, kind, about) in ((m, other) for m, other in others.items() if other[0] == name):
                self._members[member] = (kind, Field(description=about or None))
            field = known[name]
            for member, path, kind in _members(field, types.get(name), number, is_flat=name in flat):
                description = descriptions.get(member, field.description) or None
                self._members[member] = (kind, Field(description=description))
                paths.append(path)
        self._by_axis = [name for name, field in known.items() if field.kind is FieldKind.AXIS_TRUTHS]
        self._values: Callable[[Any], tuple[Any, ...]] = attrgetter(*paths)

    def model(self, name: str) -> Any:
        """Return a base class of answers with these members."""
        # nothing here has a docstring, and the search of the source for one takes 50 ms a model
        no_search = {"use_attribute_docstrings": False}
        model: type[BaseModel] = create_model(
            name, __base__=Answer, __module__=__name__, __cls_kwargs__=no_search, **self._members
        )
        # the answers made of it have docstrings
        model.model_config["use_attribute_docstrings"] = True
        return model

    def values(self, record: Any) -> dict[str, Any]:
        """Return the members of a record."""
        members = dict(zip(self._members, self._values(record)))  # noqa: B905 a tenth of a row's time
        for name in self._by_axis:
            yaw, roll, pitch = members[name]
            members[name] = {"yaw": yaw, "roll": roll, "pitch": pitch}
        return members


def members_of(record: type[Any], **choices: Any) -> Any:
    """Return a base class of answers with the members of a record; ``choices`` are those of `RecordMembers`."""
    return RecordMembers(record, **choices).model(f"{record.__name__}Members")


def _members(field: RecordField, kind: Any, number: Any, *, is_flat: bool) -> list[tuple[str, str, Any]]:
    """Return name, path to the value, and type of each member of a field."""
    if is_flat:
        paths = (f"{field.name}.{axis}" for axis in Axes._fields)
        return [(name, path, number) for name, path in zip(field.axis_names(), paths, strict=True)]
    name = field.name.removesuffix("_us").removeprefix("is_")
    name = f"{name}_at" if name in _PARTICIPLES and field.kind is FieldKind.EPOCH else name
    types = _TYPES | {FieldKind.NUMBER: number}
    made = kind or types.get(field.kind, field.content)
    if field.kind is FieldKind.RECORDS:
        element = EpochAnswer if field.name.endswith("_us") else number if field.content is float else field.content
        made = list[kind or element]
    return [(name, field.name, made | None if field.is_optional else made)]
