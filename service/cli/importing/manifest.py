"""Manifest of a folder, ``soo.yaml``: role, columns, unit, time zone and source of each file, and windows.

Every scalar is read as text: YAML would make a number of the offset ``+10:00`` and an instant without a zone of an
epoch. A value tagged ``!guess`` is one that the content does not prove.
"""

from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainSerializer, ValidationError
from pydantic_core import PydanticCustomError

from service.formats.foreign.columns import PowersStatement, ReadingsStatement
from service.formats.foreign.table import ForeignTableError
from service.records.epoch import format_epoch, parse_epoch

NAME = "soo.yaml"
_TAG = "!guess"
_HEAD = """\
# Manifest of soo import. A value marked !guess is not proven by the files: correct it and remove the mark.
# soo import FOLDER --propose writes it again; what is not marked stays.
"""


class Guess(NamedTuple):
    """A value that the content does not prove, and why it is a question."""

    value: Any
    reason: str
    #: in the manifest
    line: int = 0


S = TypeVar("S", bound=BaseModel)


def plain_value(given: Any) -> Any:
    """Return a value, of a guess its own."""
    return given.value if isinstance(given, Guess) else given


class _Section(BaseModel):
    """Part of a manifest."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SpacecraftSection(_Section):
    """The spacecraft: a file, or the id of one that the service has."""

    file: str | None = None
    id: str | None = None


def _epoch_us(given: Any) -> int:
    """Return microseconds UTC of a text."""
    try:
        return parse_epoch(str(given))
    except ValueError as error:
        raise PydanticCustomError("epoch.invalid", "{detail}", {"detail": str(error)}) from None


EpochText = Annotated[int, BeforeValidator(_epoch_us), PlainSerializer(format_epoch, return_type=str)]


class WindowSection(_Section):
    """Interval of epochs, start inclusive, stop exclusive."""

    start: EpochText
    stop: EpochText


class WindowsSection(_Section):
    """Windows of calibration and alignment."""

    quiet: WindowSection | None = None
    turns: WindowSection | None = None
    align: WindowSection | None = None


class FolderManifest(_Section):
    """Files of a folder and their roles."""

    spacecraft: SpacecraftSection = SpacecraftSection()
    carriers: str | None = None
    ephemeris: str | None = None
    #: an orbit inclined by more than 1 deg, and a catalogue outside of what satellites have, are what they should be
    inclined: bool = False
    confirmed: bool = False
    powers: tuple[PowersStatement, ...] = ()
    references: tuple[ReadingsStatement, ...] = ()
    windows: WindowsSection = WindowsSection()
    #: why a file has no role, by its name
    left_out: dict[str, str] = Field(default_factory=dict)


class _Loader(yaml.SafeLoader):  # type: ignore[misc] # untyped
    """Loader of manifests: scalars are texts, names occur once, guesses keep their line."""

    yaml_implicit_resolvers: Mapping[str, Any] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return a node; ComposerError for an alias, by which a short file could become an endless one."""
        if self.check_event(yaml.AliasEvent):
            raise yaml.composer.ComposerError(None, None, "a manifest has no aliases", self.peek_event().start_mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """Return a mapping; ConstructorError where a name occurs twice."""
        names = [self.construct_object(key, deep=True) for key, _ in node.value]
        for number, name in enumerate(names):
            if name in names[:number]:
                mark = node.value[number][0].start_mark
                raise yaml.constructor.ConstructorError(None, None, f"{name!r} occurs twice", mark)
        document: dict[Hashable, Any] = super().construct_mapping(node, deep=deep)
        return document

    def construct_guess(self, node: yaml.Node) -> Guess:
        """Return a guess with its line."""
        makers = {yaml.MappingNode: self.construct_mapping, yaml.SequenceNode: self.construct_sequence}
        maker = makers.get(type(node))
        value = self.construct_scalar(node) if maker is None else maker(node, deep=True)
        return Guess(value, "", node.start_mark.line + 1)


_Loader.add_constructor(_TAG, _Loader.construct_guess)


def read_manifest(folder: Path) -> FolderManifest:
    """Return the manifest of a folder, ; ForeignTableError where it holds guesses or is none."""
    path = folder / NAME
    document = _document(path)
    guesses = list(guesses_in(document))
    if guesses:
        lines = [f"{path} holds guesses; correct each value, remove its {_TAG}, and run the command again:"]
        lines += [f"  line {guess.line}: {name}: {guess.value or 'nothing'}" for name, guess in guesses]
        raise ForeignTableError("\n".join(lines))
    return validated(path, FolderManifest, document)


def read_stated(folder: Path) -> FolderManifest:
    """Return what a manifest states, guesses left out; an empty one where there is no file."""
    path = folder / NAME
    return (
        validated(path, FolderManifest, _without(_document(path), lambda each: isinstance(each, Guess)))
        if path.exists()
        else FolderManifest()
    )


#: fields of the whole manifest that the command line states
TOP_FIELDS = ("inclined", "confirmed", "spacecraft", "carriers", "ephemeris")


def with_top_fields(manifest: FolderManifest, stated: Mapping[str, Any]) -> FolderManifest:
    """Return a manifest with fields that the command line states; a spacecraft is stated by its id."""
    if not stated:
        return manifest
    fields = dict(stated) | ({"spacecraft": {"id": stated["spacecraft"]}} if "spacecraft" in stated else {})
    return validated(Path(NAME), FolderManifest, manifest.model_dump(mode="json", exclude_unset=True) | fields)


def read_statement(text: str) -> Any:
    """Return the value that a text of the command line states, as a manifest would."""
    try:
        # a safe loader: it makes texts, lists, mappings and guesses only
        return yaml.load(text, Loader=_Loader)  # noqa: S506
    except yaml.YAMLError:
        return text


def _document(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise ForeignTableError(f"{path.parent} has no {NAME}; make it: soo import {path.parent} --propose")
    try:
        # a safe loader: it makes texts, lists, mappings and guesses only
        document = yaml.load(path.read_text("utf-8-sig"), Loader=_Loader)  # noqa: S506
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ForeignTableError(f"{path} is no YAML: {error}") from None
    if not isinstance(document, dict):
        raise ForeignTableError(f"{path} is no manifest; make it with soo import {path.parent} --propose")
    return document


def validated(path: Path, kind: type[S], document: Any) -> S:
    """Return a manifest or a section of one, or raise ForeignTableError with every field at fault."""
    try:
        return kind.model_validate(_without(document, lambda each: each in ("", None)))
    except ValidationError as error:
        # the web framework is loaded only where its words for faults are needed
        from service.api.problems.problems import faults_of

        faults = [f"  {fault.pointer}: {fault.detail}" for fault in faults_of(error.errors())]
        raise ForeignTableError("\n".join((f"{path} is refused:", *faults))) from None


def guesses_in(value: Any, name: str = "") -> Iterable[tuple[str, Guess]]:
    """Yield the guesses of a document by dotted name."""
    if isinstance(value, Guess):
        yield name, value
    elif isinstance(value, dict):
        for key, member in value.items():
            yield from guesses_in(member, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list):
        for number, member in enumerate(value):
            label = member.get("file", number) if isinstance(member, dict) else number
            yield from guesses_in(member, f"{name} {label}")


def _without(value: Any, is_left_out: Callable[[Any], bool]) -> Any:
    if isinstance(value, dict):
        return {key: _without(each, is_left_out) for key, each in value.items() if not is_left_out(each)}
    return (
        [_without(each, is_left_out) for each in value if not is_left_out(each)] if isinstance(value, list) else value
    )


class _Dumper(yaml.SafeDumper):  # type: ignore[misc] # untyped
    """Dumper of manifests."""

    def ignore_aliases(self, _: Any) -> bool:
        """Write every value where it stands."""
        return True

    def represent_guess(self, guess: Guess) -> yaml.Node:
        """Return the node of a guess."""
        node = self.represent_data(guess.value if guess.value is not None else "")
        node.tag = _TAG
        return node


_Dumper.add_representer(Guess, _Dumper.represent_guess)


def manifest_text(sections: Mapping[str, Any]) -> str:
    """Return sections as a manifest has them; the reason of a guess stands above it."""
    text = ""
    for name, value in sections.items():
        # an entry of its own each, so that its comments stand above it
        entries = [[each] for each in value] if isinstance(value, list) else [{name: value}]
        text += f"{name}:\n" if isinstance(value, list) else ""
        for entry in entries:
            text += "".join(f"# {where.strip()}: {guess.reason}\n" for where, guess in guesses_in(entry))
            text += yaml.dump(entry, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    return text


def write_manifest(folder: Path, sections: Mapping[str, Any]) -> Path:
    """Write a manifest and return its file."""
    path = folder / NAME
    path.write_text(_HEAD + manifest_text(sections), encoding="utf-8")
    return path
