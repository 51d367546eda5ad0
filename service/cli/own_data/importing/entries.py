"""Entries of a manifest: how a file of powers or of readings is read, and a guess for each question."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from service.cli.command_group import end
from service.cli.own_data.foreign_archive import sample_of
from service.cli.own_data.foreign_file import is_own
from service.cli.own_data.importing.manifest import FolderManifest, Guess, PowersSection, ReferencesSection, validated
from service.cli.own_data.importing.roles import carrier_columns, thin_sample
from service.cli.own_data.tdm_archive import open_any_archive
from service.formats.foreign.layout import OFFSET_DB, ForeignTableError, StatedLayout, TableLayout
from service.formats.foreign.proposal import Question, Sample, propose, with_time
from service.formats.foreign.sensor import AXES, StatedSensor, propose_sensor
from service.frontend.backfill.columns import ArchiveError

_DEFAULT_SOURCE, _DEFAULT_ZONE = "sa-1", "UTC"
#: word in the name of a file -> sensor
_SENSORS = {"star": "star_tracker", "earth": "earth_sensor", "beacon": "radio_beacon"}
_SENSOR_QUESTION = "its name names no sensor: star_tracker, earth_sensor, radio_beacon or other"


#: fields of a file's entry that the command line states, by the name of the file
Statements = Mapping[str, Mapping[str, Any]]
T = TypeVar("T", PowersSection, ReferencesSection)


def _stated_entry(kind: type[T], name: str, known: Sequence[T], statements: Statements) -> T:
    """Return what was stated of a file, by its manifest and by the command line, or end."""
    former = next((each.model_dump() for each in known if each.file == name), {"file": name})
    return validated(Path(name), kind, former | dict(statements.get(name, {})))


def powers_entry(
    path: Path, stated: FolderManifest, statements: Statements, carriers: Mapping[str, str]
) -> dict[str, Any]:
    """Return the entry of a file of powers."""
    known = _stated_entry(PowersSection, path.name, stated.powers, statements)
    if known.layout().is_empty and is_own(path, StatedLayout()):
        return {"file": path.name, "source": known.source or _source_in(path)}
    layout, reasons = _answered(known.layout(), thin_sample(path), carriers)
    entry: dict[str, Any] = {"file": path.name, "source": known.source or _DEFAULT_SOURCE}
    for field in fields(StatedLayout):
        value = getattr(layout, field.name)
        if field.name in reasons:
            entry[field.name] = Guess(_plain(value) or None, reasons[field.name])
        elif value:
            entry[field.name] = _plain(value)
    return entry


def complete_layout(path: Path, section: PowersSection, carriers: Mapping[str, str]) -> TableLayout:
    """Return the layout of a file of powers under its entry, or end where that leaves something open."""
    try:
        proposal = propose(sample_of(path), section.layout(), carriers)
    except (ForeignTableError, ArchiveError) as error:
        end(f"{path}: {error}", cause=error)
    if proposal.layout is None:
        asked = "; ".join(f"{field_of(each)}: {each.text}" for each in proposal.questions)
        end(f"{path}: the manifest must state {asked}")
    return proposal.layout


def _plain(value: Any) -> Any:
    """Return a value as a document has it."""
    if isinstance(value, tuple):
        return list(value)
    return dict(value) if isinstance(value, Mapping) else value


def _source_in(path: Path) -> str:
    """Return the source that the first row of an archive of this project names."""
    with closing(open_any_archive(path)) as archive:
        if "source" in archive.header:
            first = next(archive.rows(), None)
            return _DEFAULT_SOURCE if first is None else str(first.cells[archive.header.index("source")])
    return _DEFAULT_SOURCE


def _answered(layout: StatedLayout, sample: Sample, carriers: Mapping[str, str]) -> tuple[StatedLayout, dict[str, str]]:
    """Return a layout with a guess for each question, and the reasons of the guesses by field."""
    reasons: dict[str, str] = {}
    while questions := [each for each in propose(sample, layout, carriers).questions if field_of(each) not in reasons]:
        question = questions[0]
        reasons[field_of(question)] = question.text
        in_order = carrier_columns(sample, carriers) if question.option == "--map" else None
        answer: dict[str, Any] = {field_of(question): in_order or _likely(question)}
        if all(answer.values()):
            layout = replace(layout, **answer)
    return replace(propose(sample, layout, carriers).found, unit=layout.unit), reasons


def field_of(question: Question) -> str:
    """Return the field of a layout that a question is about."""
    special = {"--map": "carriers", "--time-column": "time_columns"}
    return special.get(question.option, question.option.removeprefix("--").replace("-", "_"))


def _likely(question: Question) -> Any:
    """Return the likely answer of a question; None where there is none."""
    if question.option == "--tz":
        return _DEFAULT_ZONE
    first = question.default or next(iter(question.choices), None)
    if question.option == "--unit":
        return first or next(iter(OFFSET_DB))
    if question.option == "--time-column":
        return tuple(first.split(" + ")) if first else None
    return None if question.option == "--map" else first


def references_entry(path: Path, stated: FolderManifest, statements: Statements) -> dict[str, Any]:
    """Return the entry of a file of readings."""
    known = _stated_entry(ReferencesSection, path.name, stated.references, statements)
    hinted = next((sensor for word, sensor in _SENSORS.items() if word in path.name.lower()), None)
    source = known.source or hinted or Guess("star_tracker", _SENSOR_QUESTION)
    entry: dict[str, Any] = {"file": path.name, "source": source}
    if known.sigma_deg:
        entry["sigma_deg"] = dict(known.sigma_deg)
    return entry if _is_message(path) else entry | _sensor_fields(thin_sample(path), known.layout())


def _is_message(path: Path) -> bool:
    """Return whether a file is an AEM or JSON, which state all there is."""
    with path.open("rb") as file:
        return file.read(200).removeprefix(b"\xef\xbb\xbf").lstrip().startswith((b"{", b"CCSDS_"))


def _sensor_fields(sample: Sample, layout: StatedSensor) -> dict[str, Any]:
    """Return the fields of a table of readings."""
    reasons: dict[str, str] = {}
    while questions := [each for each in propose_sensor(sample, layout).questions if field_of(each) not in reasons]:
        question = questions[0]
        reasons[field_of(question)] = question.text
        answer = _likely(question)
        if question.option == "--unit":
            layout = replace(layout, unit=answer)
        elif answer:
            layout = replace(layout, time=replace(layout.time, **{field_of(question): answer}))
    understood = propose_sensor(sample, layout).understood
    time = with_time(sample, layout.time, [])
    found: dict[str, Any] = {
        "time_columns": list(time.time_columns),
        "time_format": time.time_format,
        "tz": time.tz,
        "unit": understood.get("unit"),
        "scalar": understood.get("scalar"),
        "columns": {understood[axis]: axis for axis in AXES if axis in understood},
    }
    marked = {name: Guess(value or None, reasons[name]) if name in reasons else value for name, value in found.items()}
    return {name: value for name, value in marked.items() if value}
