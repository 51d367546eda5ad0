"""Files of an operator: their roles by content, and the manifest that their content proposes, guesses marked.

One odd file stops nothing: it is left out with its reason. One that another needs stops the import before anything is
created.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from service.cli.importing.catalogue import (
    INCLINED_DEG,
    carrier_names,
    check_plan,
    decoded,
    file_text,
    inclination_deg,
    read_orbit,
    read_plan,
    read_spacecraft,
    unlikely,
)
from service.cli.importing.dialogue import FileRole
from service.cli.importing.manifest import NAME, FolderManifest, Guess, plain_value, validated
from service.formats.foreign.columns import (
    Interpretation,
    PowersStatement,
    ReadingsStatement,
    TableRows,
    TableStatement,
    interpret_powers,
)
from service.formats.foreign.messages import VERSIONS, message_text, read_attitude_message, tracking_table
from service.formats.foreign.readings import holds_angles, interpret_readings, judged_readings
from service.formats.foreign.table import Container, ForeignTableError, Question, Table, is_workbook, read_table
from service.formats.foreign.units import without_unit
from service.pipeline.config import CalibrationConfig
from service.pipeline.inputs.catalogue_checks import contradiction_of
from service.pipeline.planning.flown_turns import flown_windows
from service.records.epoch import format_epoch

_ELEMENTS = re.compile(r"^1 [ 0-9A-Z]\d{4}.*\n2 [ 0-9A-Z]\d{4}", re.MULTILINE)
#: files that the import writes beside a table
_OWN_NOTES = (".send.json", ".refused.csv")
_SENSORS = {"star": "star_tracker", "earth": "earth_sensor", "beacon": "radio_beacon"}
SENSOR_NAMES = ("star_tracker", "earth_sensor", "radio_beacon", "other")
#: mean of readings from which windows are found
_BIN_US = 60_000_000
#: bytes from which the kind of a file is found
_HEAD = 1 << 16


#: members of a JSON object that only one role has
_MEMBERS = {
    "inertia_kg_m2": FileRole.SPACECRAFT,
    "receiving_site": FileRole.SPACECRAFT,
    "carriers": FileRole.CARRIERS,
    "downlink_hz": FileRole.CARRIERS,
    "references": FileRole.REFERENCES,
    "tle": FileRole.EPHEMERIS,
    "oem": FileRole.EPHEMERIS,
    "ascending_nodes": FileRole.EPHEMERIS,
    "MEAN_MOTION": FileRole.EPHEMERIS,
}
_MESSAGES = {"oem": FileRole.EPHEMERIS, "omm": FileRole.EPHEMERIS, "aem": FileRole.REFERENCES, "tdm": FileRole.POWERS}
Statements = Mapping[str, Mapping[str, Any]]
T = TypeVar("T")
W = TypeVar("W", bound=TableStatement)


@dataclass(slots=True)
class ImportFiles:
    """Files that are imported, what is stated of them, and why others are left out."""

    folder: Path
    paths: list[Path]
    stated: FolderManifest
    statements: Statements
    now_us: int
    left_out: dict[str, str] = field(default_factory=dict)
    #: of the left out, those that were recognized and are at fault, by role
    faulty: dict[str, FileRole] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)

    def guarded(self, path: Path, role: FileRole | None, call: Callable[[], T]) -> T | None:
        """Return what a call gives, or leave its file out with the reason, whatever was raised."""
        try:
            return call()
        except ForeignTableError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001 a library's fault on one file must not stop the others
            reason = f"cannot be read: {type(error).__name__}: {error}; export it again, or leave it out"
        self.left_out[path.name] = reason
        if role is not None:
            self.faulty[path.name] = role
        return None


class FolderProposal(NamedTuple):
    """Sections of a manifest, and what they leave open."""

    sections: dict[str, Any]
    #: windows that were not found
    shortcomings: tuple[str, ...]
    #: how each table is read, by its name
    notes: dict[str, tuple[str, ...]]


def files_of(folder: Path) -> tuple[list[Path], dict[str, str]]:
    """Return the files of a folder that may have a role, and why others are left out."""
    files, left_out = [], {}
    for path in sorted(folder.iterdir()):
        if path.name == NAME or path.name.endswith(_OWN_NOTES):
            continue
        if path.name.startswith((".", "~$")) or not path.is_file():
            left_out[path.name] = "not a file" if not path.is_file() else "hidden"
        else:
            files.append(path)
    return files, left_out


def propose(files: ImportFiles) -> FolderProposal:
    """Return the manifest of files; what was stated before is kept."""
    roles = {path: files.guarded(path, None, lambda path=path: _role_of(path)) for path in files.paths}  # type: ignore[misc]
    spacecraft_name, spacecraft = _first(
        files, _named(roles, FileRole.SPACECRAFT), files.stated.spacecraft.file, FileRole.SPACECRAFT
    )
    plan_name, plan = _first(files, _named(roles, FileRole.CARRIERS), files.stated.carriers, FileRole.CARRIERS)
    longitude_deg = None if spacecraft is None else float(spacecraft.longitude_deg)
    if plan is not None and longitude_deg is not None:
        path = files.folder / plain_value(plan_name)
        files.guarded(path, FileRole.CARRIERS, lambda: check_plan(plan, longitude_deg, files.warnings.append))
    carriers = {} if plan is None else carrier_names([each.model_dump() for each in plan.carriers])
    is_simulated = bool(spacecraft is not None and spacecraft.simulated)
    tables = [path for path, role in roles.items() if role is None and path.name not in files.left_out]
    entries: dict[FileRole, list[dict[str, Any]]] = {FileRole.POWERS: [], FileRole.REFERENCES: []}
    notes: dict[str, tuple[str, ...]] = {}
    readings: list[TableRows] = []
    tables += [path for path, role in roles.items() if role in entries]
    for path in sorted(tables):
        made = _table_entry(files, path, roles[path], carriers, is_simulated=is_simulated)
        if made is not None:
            role, entry, interpretation = made
            entries[role].append(entry)
            notes[path.name] = interpretation.notes
            readings += [interpretation.rows] if role is FileRole.REFERENCES and interpretation.rows is not None else []
    unknown = set(files.statements) - {path.name for path in files.paths} - {""}
    if unknown:
        raise ForeignTableError(f"--state: no file {', '.join(sorted(unknown))} is imported")
    orbits = _orbits(files, _named(roles, FileRole.EPHEMERIS), spacecraft)
    orbit_name = _chosen(list(orbits), files.stated.ephemeris)
    own: dict[str, Any] = {"file": spacecraft_name} if spacecraft_name else {"id": files.stated.spacecraft.id}
    own = own if any(own.values()) else {"id": Guess(None, "no file of a spacecraft")}
    windows, shortcomings = _windows(readings, entries[FileRole.REFERENCES], files.stated)
    odd = [] if longitude_deg is None else unlikely(spacecraft, plan, longitude_deg)
    sections = {
        "spacecraft": own,
        "carriers": plan_name,
        "ephemeris": orbit_name,
        "inclined": _inclined(files, orbits, orbit_name),
        "confirmed": "true" if files.stated.confirmed else (Guess(None, "; ".join(odd)) if odd else None),
        "powers": entries[FileRole.POWERS],
        "references": entries[FileRole.REFERENCES],
        "windows": windows,
        "left_out": files.left_out,
    }
    return FolderProposal({name: value for name, value in sections.items() if value}, shortcomings, notes)


def _role_of(path: Path) -> FileRole | None:
    """Return the role that a file's beginning proves; None: a table."""
    with path.open("rb") as opened:
        head = opened.read(_HEAD)
    if not head:
        raise ForeignTableError("the file is empty")
    if is_workbook(head):
        return _of_first_line(file_text(path))
    if head[:4] == b"PAR1" or path.suffix.lower() in {".ndjson", ".jsonl", ".gz", ".zip"}:
        return None
    text = head.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace").lstrip()
    start = re.sub(r"\A(COMMENT.*\n\s*)*", "", text)
    kind = next((kind for kind, version in VERSIONS.items() if start.startswith(version)), None)
    if kind is not None or start.startswith("<"):
        return _MESSAGES[kind or _kind_of_xml(start)]
    if start.startswith(("{", "[")):
        return _of_json(path)
    return FileRole.EPHEMERIS if _ELEMENTS.search(text.replace("\r", "\n")) else _of_first_line(text)


def _kind_of_xml(text: str) -> str:
    """Return the message that XML holds."""
    kinds: list[str] = re.findall(r"<(?:[\w.-]+:)?(oem|omm|aem|tdm)\b", text)
    if not kinds:
        raise ForeignTableError("XML, and no OEM, OMM, AEM or TDM")
    return kinds[0]


def _of_first_line(text: str) -> FileRole | None:
    """Return the role that the columns of a catalogue's file state, None for other tables."""
    names = {name.strip().strip('"') for name in re.split("[,;\t]", text.lstrip().partition("\n")[0])}
    if names == {"field", "value"}:
        return FileRole.SPACECRAFT
    if {"id", "downlink_hz"} <= names:
        return FileRole.CARRIERS
    return FileRole.EPHEMERIS if "MEAN_MOTION" in names else None


def _of_json(path: Path) -> FileRole:
    """Return the role of a JSON document."""
    try:
        document = json.loads(file_text(path))
    except (ValueError, RecursionError) as error:
        raise ForeignTableError(f"no JSON: {error}") from None
    members: Any = document[0] if isinstance(document, list) and document else document
    role = next((role for name, role in _MEMBERS.items() if isinstance(members, dict) and name in members), None)
    if role is None:
        raise ForeignTableError("JSON of another kind")
    return role


def _named(roles: Mapping[Path, FileRole | None], role: FileRole) -> list[Path]:
    """Return the files of a role."""
    return [path for path, found in roles.items() if found is role]


def _chosen(names: list[str], stated: str | None) -> Any:
    """Return the file of a role that one file has; the first of several is a guess."""
    if stated in names or not names:
        return stated if stated in names else None
    return names[0] if len(names) == 1 else Guess(names[0], f"one of {', '.join(names)}")


def _first(files: ImportFiles, paths: list[Path], stated: str | None, role: FileRole) -> tuple[Any, Any]:
    """Return the file of a role and its document; those at fault are left out."""
    read: Callable[[Path], Any] = (
        read_plan if role is FileRole.CARRIERS else lambda path: read_spacecraft(path, files.warnings.append)
    )
    documents = {path.name: files.guarded(path, role, lambda path=path: read(path)) for path in paths}  # type: ignore[misc]
    names = [name for name, document in documents.items() if document is not None]
    chosen = _chosen(names, stated)
    return chosen, documents.get(plain_value(chosen)) if chosen else None


def _orbits(files: ImportFiles, paths: list[Path], spacecraft: Any) -> dict[str, Any]:
    """Return the orbits of this spacecraft by file; those of others are left out."""
    own = {}
    for path in paths:
        found = files.guarded(path, FileRole.EPHEMERIS, lambda path=path: read_orbit(path))  # type: ignore[misc]
        if found is None:
            continue
        orbit, ephemeris = found
        foreign = None if spacecraft is None else contradiction_of(ephemeris, spacecraft.longitude_deg)
        if spacecraft is not None and spacecraft.cospar_id and orbit.cospar_id not in (None, spacecraft.cospar_id):
            foreign = f"it is of {orbit.cospar_id}"
        if foreign is None:
            own[path.name] = ephemeris
        else:
            files.left_out[path.name] = f"orbit of another satellite: {foreign}"
    return own


def _inclined(files: ImportFiles, orbits: Mapping[str, Any], chosen: Any) -> Any:
    """Return whether the orbit is stated to be inclined; a guess where it must be."""
    if files.stated.inclined or not chosen:
        return "true" if files.stated.inclined else None
    greatest_deg = inclination_deg(orbits[plain_value(chosen)])
    return Guess("true", f"the orbit is inclined by {greatest_deg:.2f} deg") if greatest_deg > INCLINED_DEG else None


def table_of(path: Path, stated: Container) -> Table:
    """Return the table of a file; that of a tracking message has one power a line."""
    with path.open("rb") as opened:
        head = opened.read(_HEAD)
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if text.startswith((VERSIONS["tdm"].encode(), b"<", b"COMMENT")):
        return tracking_table(file_text(path))
    return read_table(path, stated)


def read_readings(path: Path, stated: ReadingsStatement, now_us: int, *, is_simulated: bool) -> Interpretation:
    """Return how a file of readings is read: a table, an AEM, or a document of the interface."""
    with path.open("rb") as opened:
        head = opened.read(_HEAD).removeprefix(b"\xef\xbb\xbf").lstrip()
    if head.startswith((VERSIONS["aem"].encode(), b"<", b"COMMENT")):
        rows = read_attitude_message(message_text(file_text(path)))
        return judged_readings(*rows, stated, now_us, is_simulated=is_simulated)
    if head.startswith(b"{"):
        epochs_us, angles, sigma_deg = _readings_of_json(path, stated.source)
        return judged_readings(epochs_us, angles, stated, now_us, is_simulated=is_simulated, sigma_deg=sigma_deg)
    return interpret_readings(table_of(path, stated.container), stated, now_us, is_simulated=is_simulated)


def _readings_of_json(path: Path, source: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return epochs, angles and deviations of a document of the interface."""
    from pydantic import TypeAdapter

    from service.api.schemas.inputs import ReferenceBatchDocument

    document = decoded(TypeAdapter(ReferenceBatchDocument), file_text(path).encode())
    if source and document.source != source:
        raise ForeignTableError(f"the file holds readings of {document.source}; state source {document.source}")
    angles = [[each.yaw_deg, each.roll_deg, each.pitch_deg] for each in document.references]
    epochs_us = np.array([each.epoch for each in document.references], dtype=np.int64)
    sigma_deg = [
        [None] * 3 if each.sigma_deg is None else [each.sigma_deg.yaw, each.sigma_deg.roll, each.sigma_deg.pitch]
        for each in document.references
    ]
    found, deviations = (np.array(each, dtype=np.float64).reshape(-1, 3) for each in (angles, sigma_deg))
    return epochs_us, found, deviations


def _table_entry(
    files: ImportFiles, path: Path, role: FileRole | None, carriers: Mapping[str, str], *, is_simulated: bool
) -> tuple[FileRole, dict[str, Any], Interpretation] | None:
    """Return role, entry and reading of a table or message; None: it is left out."""
    own = files.stated.powers, files.stated.references

    def stated(kind: type[W], known: Sequence[W]) -> W:
        given = next((each for each in known if each.file == path.name), None)
        former = {"file": path.name} if given is None else given.model_dump(exclude_unset=True)
        return validated(Path(path.name), kind, former | dict(files.statements.get(path.name, {})))

    def read() -> tuple[FileRole, TableStatement, Interpretation]:
        container = _container_of(files, path)
        kind = role or _table_role(table_of(path, container), carriers, files.stated, path.name)
        if kind is FileRole.REFERENCES:
            readings = stated(ReadingsStatement, own[1])
            return kind, readings, read_readings(path, readings, files.now_us, is_simulated=is_simulated)
        powers = stated(PowersStatement, own[0])
        table = table_of(path, container)
        return kind, powers, interpret_powers(table, powers, carriers, files.now_us, is_simulated=is_simulated)

    found = files.guarded(path, role, read)
    if found is None:
        is_stated = path.name in files.statements or path.name in {each.file for section in own for each in section}
        if is_stated and not files.faulty:
            # left out, what a person stated would be lost with it
            raise ForeignTableError(f"{path.name}: {files.left_out[path.name]}")
        return None
    kind, statement, interpretation = found
    entry: dict[str, Any] = {"file": path.name, "source": statement.source or _source_guess(path, kind, interpretation)}
    if isinstance(statement, ReadingsStatement) and statement.sigma_deg:
        entry["sigma_deg"] = {axis: str(value) for axis, value in statement.sigma_deg.items()}
    return kind, entry | marked_fields(interpretation), interpretation


def _container_of(files: ImportFiles, path: Path) -> Container:
    """Return what is stated of the container of a file, whatever its role is."""
    names = ("sheet", "encoding", "separator", "skip_lines")
    known = next((each for each in (*files.stated.powers, *files.stated.references) if each.file == path.name), None)
    former = {} if known is None else known.model_dump(include=set(names), exclude_none=True)
    said = files.statements.get(path.name, {})
    fields = former | {name: said[name] for name in names if name in said}
    return validated(Path(path.name), TableStatement, {"file": path.name, **fields}).container


def _table_role(table: Table, carriers: Mapping[str, str], stated: FolderManifest, name: str) -> FileRole:
    """Return whether a table holds powers or readings."""
    if any(each.file == name for each in stated.powers):
        return FileRole.POWERS
    if any(each.file == name for each in stated.references) or holds_angles(table):
        return FileRole.REFERENCES
    known = {each.casefold() for each in carriers}
    if any(without_unit(each).casefold() in known for each in table.header):
        return FileRole.POWERS
    for column in table.columns:
        if {str(each).casefold() for each in column.unique().to_pylist()[:2000]} & known:
            return FileRole.POWERS
    numbers = sum(table_is_numeric(table, each) for each in table.header)
    if carriers and 0 <= numbers - len(set(carriers.values())) <= 1:
        return FileRole.POWERS
    raise ForeignTableError("no column is a carrier or an angle")


def table_is_numeric(table: Table, name: str) -> bool:
    """Return whether most cells of a column are numbers."""
    import pyarrow.compute as pc

    column = table.column(name)
    numbers = pc.sum(pc.match_substring_regex(column, pattern=r"^[+-]?\d+([.,]\d+)?([eE][+-]?\d+)?$")).as_py() or 0
    return bool(2 * numbers > len(column))


def _source_guess(path: Path, role: FileRole, interpretation: Interpretation) -> Any:
    """Return the source of a file: that of its own rows, of its name, or a guess."""
    if role is FileRole.POWERS:
        return interpretation.found.get("from_source") or "sa-1"
    hinted = next((sensor for word, sensor in _SENSORS.items() if word in path.name.lower()), None)
    return hinted or Guess("star_tracker", f"its name names no sensor: {', '.join(SENSOR_NAMES)}")


def marked_fields(interpretation: Interpretation) -> dict[str, Any]:
    """Return the fields of an entry, a guess for each question."""
    asked: dict[str, Question] = {each.field: each for each in interpretation.questions}
    fields = {name: value for name, value in interpretation.found.items() if name not in asked}
    for name, question in asked.items():
        default = question.default if question.default is not None else interpretation.found.get(name)
        default = default.split(" + ") if name == "time_columns" and isinstance(default, str) else default
        fields[name] = Guess(default, question.text)
    return {name: (str(value).lower() if isinstance(value, bool | int) else value) for name, value in fields.items()}


def _windows(
    readings: Sequence[TableRows], entries: Sequence[Mapping[str, Any]], stated: FolderManifest
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the windows that readings show; stated ones stay."""
    kept = {name: value for name, value in stated.windows.model_dump(mode="json").items() if value}
    if len(kept) == 3 or not readings:
        return kept, () if kept else ("no readings of a sensor, so no windows",)
    epochs_us = np.concatenate([each.epochs_us for each in readings])
    angles_deg = np.concatenate([each.values for each in readings])
    # a sensor that gives ten readings a second says no more than one a minute
    _, first = np.unique(epochs_us // _BIN_US, return_index=True)
    found = flown_windows(epochs_us[first], angles_deg[first], CalibrationConfig())
    windows: dict[str, Any] = {
        name: {"start": format_epoch(window.start_us), "stop": format_epoch(window.stop_us)}
        for name, window in (("quiet", found.quiet), ("turns", found.turns), ("align", found.align))
        if window is not None
    }
    guessed = [name for entry in entries for name, value in entry.items() if isinstance(value, Guess)]
    if guessed:
        reason = f"found with guesses for {', '.join(dict.fromkeys(guessed))}; propose again once these are stated"
        windows = {name: Guess(window, reason) for name, window in windows.items()}
    return windows | kept, found.shortcomings
