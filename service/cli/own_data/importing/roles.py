"""Roles of the files of a folder, by their content."""

import json
import re
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

from service.cli.own_data.foreign_archive import sample_of
from service.cli.own_data.foreign_file import is_own
from service.cli.own_data.importing.manifest import NAME
from service.formats.foreign.layout import ForeignTableError, StatedLayout
from service.formats.foreign.messages import VERSIONS
from service.formats.foreign.proposal import Question, Sample, propose, with_time
from service.formats.foreign.sensor import StatedSensor, propose_sensor
from service.frontend.backfill.columns import ArchiveError

#: bytes and rows from which a kind of file is found
_HEAD_BYTES = 1 << 16
_SAMPLE_ROWS = 300
_ELEMENTS = re.compile(r"^1 [ 0-9A-Z]\d{4}.*\n2 [ 0-9A-Z]\d{4}", re.MULTILINE)
#: files that soo send writes beside an archive
_OWN_NOTES = (".send.json", ".refused.csv")


class FileRole(StrEnum):
    """Role of a file."""

    SPACECRAFT = "spacecraft"
    CARRIERS = "carriers"
    EPHEMERIS = "ephemeris"
    POWERS = "powers"
    REFERENCES = "references"


#: members of a JSON object that only one role has
_MEMBERS = {
    "inertia_kg_m2": FileRole.SPACECRAFT,
    "receiving_site": FileRole.SPACECRAFT,
    "carriers": FileRole.CARRIERS,
    "references": FileRole.REFERENCES,
    "tle": FileRole.EPHEMERIS,
    "oem": FileRole.EPHEMERIS,
    "ascending_nodes": FileRole.EPHEMERIS,
    "MEAN_MOTION": FileRole.EPHEMERIS,
    "downlink_hz": FileRole.CARRIERS,
}
_STARTS = {
    "CCSDS_OEM_VERS": FileRole.EPHEMERIS,
    "CCSDS_OMM_VERS": FileRole.EPHEMERIS,
    "CCSDS_AEM_VERS": FileRole.REFERENCES,
    "CCSDS_TDM_VERS": FileRole.POWERS,
}


class Content(NamedTuple):
    """Role of a file, None with the reason why it has none."""

    role: FileRole | None
    reason: str = ""


def files_of(folder: Path) -> tuple[list[Path], dict[str, str]]:
    """Return the files of a folder that may have a role, and why others are left out."""
    files, left_out = [], {}
    for path in sorted(folder.iterdir()):
        if path.name == NAME or path.name.endswith(_OWN_NOTES):
            continue
        if path.name.startswith(".") or not path.is_file():
            left_out[path.name] = "hidden" if path.name.startswith(".") else "not a file"
        else:
            files.append(path)
    return files, left_out


def content_of(path: Path, carriers: Mapping[str, str] | None) -> Content:
    """Return the role of a file.

    Parameters
    ----------
    path : Path
        The file; of a table the first rows are read.
    carriers : mapping or None
        Carriers of the plan: id by id and by name; powers are found by them. None: tables have no role yet.
    """
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace").lstrip()
        by_start = next((role for start, role in _STARTS.items() if head.startswith(start)), None)
        if by_start is not None or path.suffix.lower() == ".tdm":
            return Content(by_start or FileRole.POWERS)
        if path.suffix.lower() not in {".ndjson", ".jsonl"} and head.startswith(("{", "[")):
            return _of_json(path)
        if head.startswith("<"):
            kinds = re.findall(r"<(?:[\w.-]+:)?(oem|omm|aem|tdm)\b", head)
            return Content(_STARTS[VERSIONS[kinds[0]]]) if kinds else Content(None, "XML, and no OEM, OMM, AEM or TDM")
        if _ELEMENTS.search(head):
            return Content(FileRole.EPHEMERIS)
        catalogue = _of_first_line(head.partition("\n")[0].strip())
        return catalogue or (Content(None) if carriers is None else _of_table(path, carriers))
    except (ArchiveError, ForeignTableError, OSError) as error:
        return Content(None, str(error).removeprefix(f"{path}: "))


def _of_json(path: Path) -> Content:
    """Return the role of a JSON document."""
    try:
        document = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        return Content(None, f"no JSON: {error}")
    members: Any = document[0] if isinstance(document, list) and document else document
    role = next((role for name, role in _MEMBERS.items() if isinstance(members, dict) and name in members), None)
    return Content(role, "" if role else "JSON of another kind")


def _of_first_line(line: str) -> Content | None:
    """Return the role that the columns of a catalogue's file state, None for other tables."""
    names = {name.strip().strip('"') for name in re.split("[,;]", line)}
    if names == {"field", "value"}:
        return Content(FileRole.SPACECRAFT)
    if {"id", "downlink_hz"} <= names:
        return Content(FileRole.CARRIERS)
    return Content(FileRole.EPHEMERIS) if "MEAN_MOTION" in names else None


def _of_table(path: Path, carriers: Mapping[str, str]) -> Content:
    """Return the role of a table with epochs."""
    if is_own(path, StatedLayout()):
        return Content(FileRole.POWERS)
    sample = thin_sample(path)
    asked = {question.option for question in propose_sensor(sample, StatedSensor()).questions}
    if "--map" not in asked:
        return Content(None, "angles without epochs") if "--time-column" in asked else Content(FileRole.REFERENCES)
    if not carrier_columns(sample, carriers):
        return Content(None, "no column is a carrier or an angle")
    return Content(FileRole.POWERS) if has_epochs(sample) else Content(None, "a table without epochs")


def thin_sample(path: Path) -> Sample:
    """Return the header of a table and some hundreds of its first rows; all are read where the file is sent."""
    header, rows = sample_of(path)
    return Sample(header, rows[:: max(1, len(rows) // _SAMPLE_ROWS)])


def has_epochs(sample: Sample) -> bool:
    """Return whether a column of a table, or a pair, holds epochs."""
    questions: list[Question] = []
    with_time(sample, StatedLayout(), questions)
    return not any(each.option == "--time-column" and len(each.choices) == len(sample.header) for each in questions)


def carrier_columns(sample: Sample, carriers: Mapping[str, str]) -> dict[str, str]:
    """Return the carrier of each column or name, by name or, where none fits and the numbers agree, in their order."""
    proposal = propose(sample, StatedLayout(), carriers)
    if proposal.found.carriers:
        return dict(proposal.found.carriers)
    numbers = next((each.choices for each in proposal.questions if each.option == "--map"), ())
    plan = list(dict.fromkeys(carriers.values()))
    return dict(zip(numbers, plan, strict=True)) if plan and len(numbers) == len(plan) else {}
