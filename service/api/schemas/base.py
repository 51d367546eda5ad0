"""Base of all documents: strictness, text without control characters, epochs, angles by name.

Documents that come in are strict: no unknown fields, no coercion, finite numbers only. Answers turn NaN into null and
microseconds into RFC 3339 by themselves, so routes hand over records as they are.
"""

import math
from collections.abc import Callable
from functools import cache
from operator import attrgetter
from typing import Annotated, Any, Self, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    AliasChoices,
    AliasGenerator,
    AliasPath,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    WithJsonSchema,
)

from service.api.protocol.epochs import epoch_of, plausible_epoch
from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes
from service.records.record_fields import AXIS_NAMES

#: any dataclass
Record = TypeVar("Record", bound=Any)
_EPOCH_SCHEMA = {"type": "string", "format": "date-time", "examples": ["2026-11-21T03:02:32.011250Z"]}

#: rows of a batch beyond which decoding stops, whatever the settings say
MAX_ROWS = 100_000
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}$"
#: one line of text; control characters would break logs, CSV and PostgreSQL
Text = Annotated[str, StringConstraints(max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
#: a remark of several lines
CommentText = Annotated[str, StringConstraints(max_length=4000, pattern=r"^[^\x00-\x08\x0b\x0c\x0e-\x1f\x7f]*$")]
#: name of a carrier, transponder, band or front end; it stands in paths and column names
Name = Annotated[str, StringConstraints(pattern=NAME_PATTERN)]
#: any instant; the route judges whether it is plausible
AnyEpoch = Annotated[int, BeforeValidator(epoch_of), WithJsonSchema(_EPOCH_SCHEMA)]
#: an instant of this century
Epoch = Annotated[AnyEpoch, AfterValidator(plausible_epoch)]
LatitudeDeg = Annotated[float, Field(ge=-90, le=90)]
LongitudeDeg = Annotated[float, Field(ge=-180, le=360)]
#: number of a version in the archive, which counts with int32
PlanNumber = Annotated[int, Field(ge=1, le=2**31 - 1)]


class Document(BaseModel):
    """Base of request documents."""

    model_config = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False, frozen=True, use_attribute_docstrings=True
    )


def _record_names(name: str) -> AliasChoices:
    """Return the names that a member has in dictionaries and in records."""
    at_axis = (
        AliasPath(field, axis)
        for field, pattern in AXIS_NAMES.items()
        for axis in Axes._fields
        if pattern.format(axis) == name
    )
    return AliasChoices(name, f"{name}_us", f"{name.removesuffix('_at')}_us", f"is_{name}", *at_axis)


class Answer(BaseModel):
    """Base of answers; made from a record whose fields have the same names, or those of `_record_names`."""

    model_config = ConfigDict(
        frozen=True,
        use_attribute_docstrings=True,
        from_attributes=True,
        alias_generator=AliasGenerator(validation_alias=_record_names),
    )

    @classmethod
    def of(cls, record: Any, *_of_subclasses: Any, **others: Any) -> Self:
        """Return the answer for a record; ``others`` are the members that it does not have by name."""
        if not others:
            return cls.model_validate(record)
        getters = _getters(cls, type(record))  # type: ignore[arg-type] # a class is hashable
        members = {name: get(record) for name, get in getters.items() if name not in others}
        return cls.model_validate(members | others)


@cache
def _getters(answer: type[Answer], record: type[object]) -> dict[str, Callable[[Any], Any]]:
    """Return what reads the members of an answer that a record has; found once, asked of every record."""
    held = {*dir(record), *getattr(record, "__dataclass_fields__", ())}
    names = {member: _record_names(member).convert_to_aliases() for member in answer.model_fields}
    paths = {member: next((path for path in choices if path[0] in held), None) for member, choices in names.items()}
    return {member: attrgetter(".".join(map(str, path))) for member, path in paths.items() if path is not None}


def _epoch_text(value: Any) -> Any:
    """Return RFC 3339 for microseconds."""
    return format_epoch(value) if isinstance(value, int) else value


def _finite_or_none(value: Any) -> Any:
    """Return None for NaN."""
    return None if isinstance(value, float) and math.isnan(value) else value


def _list_of(value: Any) -> Any:
    """Return a list for an array."""
    return value.tolist() if isinstance(value, np.ndarray) else value


#: of a list that records hold as an array
OF_ARRAY = BeforeValidator(_list_of)
EpochAnswer = Annotated[str, BeforeValidator(_epoch_text), WithJsonSchema(_EPOCH_SCHEMA)]
Figure = Annotated[float | None, BeforeValidator(_finite_or_none)]


class CatalogueWarning(Answer):
    """Something doubtful in a document that was stored."""

    pointer: str
    """JSON pointer into the document."""
    code: str
    detail: str


def record_of(record: type[Record], document: Document, **others: Any) -> Record:
    """Return the record of a document whose members have the names of its fields, epochs without their ending.

    ``others`` are the fields that differ; a field that the document does not have keeps its default.
    """
    names = {name: name.removesuffix("_us") for name in record.__dataclass_fields__ if name not in others}
    stated = {name: getattr(document, member) for name, member in names.items() if hasattr(document, member)}
    values = {name: value.to_record() if hasattr(value, "to_record") else value for name, value in stated.items()}
    made: Record = record(**values, **others)
    return made


class AnglesDocument(Document):
    """One value an axis; absent = null."""

    yaw: float | None = None
    roll: float | None = None
    pitch: float | None = None

    def to_record(self) -> Axes:
        """Return the axes, NaN where absent."""
        return axes_of(self.yaw, self.roll, self.pitch)


class AnglesAnswer(Answer):
    """One value an axis; absent = null."""

    yaw: Figure
    roll: Figure
    pitch: Figure


class AllowedAxesAnswer(Answer):
    """Permission of control for each axis."""

    yaw: bool
    roll: bool
    pitch: bool


class WindowAnswer(Answer):
    """Interval of epochs, start inclusive, stop exclusive."""

    start: EpochAnswer
    stop: EpochAnswer


class RowList(Answer):
    """All rows of one kind; a subclass states the type of its rows."""

    rows: list[Any]
    next: str | None = None


class RowPage(Answer):
    """One page of rows that stand in a range; a subclass states the type of its rows."""

    range: WindowAnswer
    rows: list[Any]
    next: str | None


def axes_of(yaw: float | None, roll: float | None, pitch: float | None) -> Axes:
    """Return the axes, NaN where absent."""
    return Axes(*(math.nan if value is None else value for value in (yaw, roll, pitch)))
