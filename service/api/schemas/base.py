"""Base of all documents: strictness, epochs, angles by name, members derived from the fields of a record."""

import ast
import inspect
import linecache
import math
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache
from itertools import pairwise
from operator import attrgetter
from types import MappingProxyType
from typing import Annotated, Any, Generic, Self, TypeVar

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
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from service.api.problems.next_steps import NEXT_STEPS
from service.api.protocol.paging import epoch_of, plausible_epoch
from service.records.catalogue import LIVE_METHODS, Method
from service.records.epoch import format_epoch
from service.records.levels.attitude import Axes
from service.records.record_fields import AXIS_NAMES, FieldKind, RecordField, record_fields

#: any dataclass
Record = TypeVar("Record", bound=Any)
#: any class whose members have docstrings behind them
DocumentClass = TypeVar("DocumentClass", bound=type[Any])
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


@cache
def _docstrings(module: str) -> Mapping[str, Mapping[str, str]]:
    """Return the docstrings behind the members of the classes of a module, by class and member."""
    names = vars(sys.modules[module])
    source = "".join(linecache.getlines(names.get("__file__") or "", names))
    return {
        each.name: dict(_member_docstrings(each)) for each in ast.parse(source).body if isinstance(each, ast.ClassDef)
    }


def _member_docstrings(node: ast.ClassDef) -> Iterator[tuple[str, str]]:
    for member, behind in pairwise(node.body):
        match member, behind:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(text))):
                yield name, inspect.cleandoc(text)
            case _:
                pass


def with_descriptions(document: DocumentClass) -> DocumentClass:
    """Return a class whose members are described by the docstrings behind them.

    pydantic's `use_attribute_docstrings` does the same, but looks for the source of each class in the frames of the
    stack, which was a quarter of a start of the service.
    """
    for name, text in _docstrings(document.__module__).get(document.__qualname__, {}).items():
        member = document.__annotations__[name]
        document.__annotations__[name] = Annotated[member, Field(description=text)]
    return document


class _Described(BaseModel):
    """Model with descriptions of its members."""

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        with_descriptions(cls)


class Document(_Described):
    """Base of request documents."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)


def _record_names(name: str) -> AliasChoices:
    """Return the names that a member has in dictionaries and in records."""
    at_axis = (
        AliasPath(field, axis)
        for field, pattern in AXIS_NAMES.items()
        for axis in Axes._fields
        if pattern.format(axis) == name
    )
    return AliasChoices(name, f"{name}_us", f"{name.removesuffix('_at')}_us", f"is_{name}", *at_axis)


class Answer(_Described):
    """Base of answers; made from a record whose fields have the same names, or those of `_record_names`."""

    model_config = ConfigDict(
        frozen=True,
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
    """Permission for each axis."""

    yaw: bool
    roll: bool
    pitch: bool

    @model_validator(mode="before")
    @classmethod
    def _of_tuple(cls, axes: Any) -> Any:
        return dict(zip(Axes._fields, axes, strict=True)) if isinstance(axes, tuple) else axes


class WindowAnswer(Answer):
    """Interval of epochs, start inclusive, stop exclusive."""

    start: EpochAnswer
    stop: EpochAnswer


Row = TypeVar("Row")


# of members of lists and pages nothing is said, and the search of the source for it takes 10 ms a kind of rows
class RowList(Answer, Generic[Row], use_attribute_docstrings=False):
    """All rows of one kind."""

    rows: list[Row]
    next: str | None = None


class RowPage(Answer, Generic[Row], use_attribute_docstrings=False):
    """One page of rows that stand in a range."""

    range: WindowAnswer
    rows: list[Row]
    next: str | None


def axes_of(yaw: float | None, roll: float | None, pitch: float | None) -> Axes:
    """Return the axes, NaN where absent."""
    return Axes(*(math.nan if value is None else value for value in (yaw, roll, pitch)))


def _live(method: Method) -> Method:
    """Refuse a method that does not run on every row."""
    if method not in LIVE_METHODS:
        detail = "smoothed rows run on no measurement and drive no control"
        raise PydanticCustomError("method.smoothed", detail)
    return method


LiveMethod = Annotated[Method, AfterValidator(_live)]


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
        return create_model(name, __base__=Answer, __module__=__name__, **self._members)

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


class RefusalAnswer(Answer):
    """A refused row."""

    index: int
    code: str
    detail: str
    next_step: str
    """Action that the code asks of the sender."""

    @classmethod
    def of_fault(cls, index: int, fault: tuple[str, str]) -> Self:
        """Return the answer for a row that is refused with a code and a detail."""
        code, detail = fault
        return cls(index=index, code=code, detail=detail, next_step=NEXT_STEPS.get(code, ""))
