"""Members of answers derived from the fields of a record, with the descriptions that stand with the fields."""

from collections.abc import Callable, Collection, Mapping, Sequence
from operator import attrgetter
from typing import Any

from pydantic import BaseModel, Field, create_model

from service.api.schemas.base import AllowedAxesAnswer, AnglesAnswer, Answer, EpochAnswer, Figure
from service.records.levels.attitude import Axes
from service.records.record_fields import FieldKind, RecordField, record_fields

_TYPES: dict[FieldKind, Any] = {
    FieldKind.EPOCH: EpochAnswer,
    FieldKind.NUMBER: Figure,
    FieldKind.TEXTS: list[str],
    FieldKind.AXES: AnglesAnswer,
    FieldKind.AXIS_TRUTHS: AllowedAxesAnswer,
}


class RecordMembers:
    """Members of the answer that shows a record.

    Parameters
    ----------
    record : type
        Dataclass.
    first : sequence of str
        Fields that come first; the others follow as they stand.
    without : collection of str
        Fields that are not shown.
    flat : collection of str
        Fields of axes that are shown as one member an axis.
    types : mapping
        Types of members that do not follow from the type of the field; of a field of records, that of its elements.
    descriptions : mapping
        In place of those of the fields.
    """

    def __init__(
        self,
        record: type[Any],
        *,
        first: Sequence[str] = (),
        without: Collection[str] = (),
        flat: Collection[str] = (),
        types: Mapping[str, Any],
        descriptions: Mapping[str, str],
    ) -> None:
        known = record_fields(record)
        self._members: dict[str, Any] = {}
        paths: list[str] = []
        for name in dict.fromkeys((*first, *(name for name in known if name not in without))):
            field = known[name]
            description = descriptions.get(name, field.description) or None
            for member, path, kind in _members(field, types.get(name), is_flat=name in flat):
                self._members[member] = (kind, Field(description=description))
                paths.append(path)
        self._by_axis = [name for name, field in known.items() if field.kind is FieldKind.AXIS_TRUTHS]
        self._values: Callable[[Any], tuple[Any, ...]] = attrgetter(*paths)

    def model(self, name: str) -> Any:
        """Return a base class of answers with these members."""
        model: type[BaseModel] = create_model(name, __base__=Answer, __module__=__name__, **self._members)
        return model

    def values(self, record: Any) -> dict[str, Any]:
        """Return the members of a record."""
        members = dict(zip(self._members, self._values(record)))  # noqa: B905 a tenth of a row's time
        for name in self._by_axis:
            yaw, roll, pitch = members[name]
            members[name] = {"yaw": yaw, "roll": roll, "pitch": pitch}
        return members


def _members(field: RecordField, kind: Any, *, is_flat: bool) -> list[tuple[str, str, Any]]:
    """Return name, path to the value, and type of each member of a field."""
    if is_flat:
        paths = (f"{field.name}.{axis}" for axis in Axes._fields)
        return [(name, path, Figure) for name, path in zip(field.axis_names(), paths, strict=True)]
    name = field.name.removesuffix("_us") if field.kind is FieldKind.EPOCH else field.name
    if field.kind is FieldKind.RECORDS:
        return [(name, field.name, list[kind])]
    made = kind or _TYPES.get(field.kind, field.content)
    return [(name, field.name, made | None if field.is_optional else made)]
