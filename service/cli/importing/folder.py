"""Files of an operator: their roles by content, and the manifest that their content proposes, guesses marked.

One odd file stops nothing: it is left out with its reason. One that another needs stops the import before anything is
created.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from service.cli.importing import catalogue
from service.cli.importing.dialogue import FileRole
from service.cli.importing.manifest import NAME, FolderManifest, Guess, plain_value, validated
from service.formats.foreign.columns import (
    AXES,
    Interpretation,
    PowersStatement,
    ReadingsStatement,
    TableRows,
    TableStatement,
    carriers_named,
    interpret_powers,
    texts_of,
)
from service.formats.foreign.messages import VERSIONS, attitude_table, message_table, message_text, tracking_table
from service.formats.foreign.readings import SIGMA_COLUMNS, holds_angles, interpret_readings
from service.formats.foreign.table import NUMBER, Container, ForeignTableError, Table, is_workbook, read_table
from service.formats.foreign.units import without_unit
from service.pipeline.config import CalibrationConfig
from service.pipeline.planning.quiet_days import flown_windows
from service.records.epoch import format_epoch
from service.runtime.clock import system_now_us

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient


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
#: columns that only a file of one role has
_COLUMNS = {
    frozenset({"field", "value"}): FileRole.SPACECRAFT,
    frozenset({"id", "downlink_hz"}): FileRole.CARRIERS,
    frozenset({"MEAN_MOTION"}): FileRole.EPHEMERIS,
}
_MESSAGES = {"oem": FileRole.EPHEMERIS, "omm": FileRole.EPHEMERIS, "aem": FileRole.REFERENCES, "tdm": FileRole.POWERS}
#: roles of tables; None: the columns show which
_TABLES = (None, FileRole.POWERS, FileRole.REFERENCES)
T = TypeVar("T")


@dataclass(slots=True)
class ImportFiles:
    """Files that are imported, what is stated of them, and why others are left out."""

    folder: Path
    paths: list[Path]
    stated: FolderManifest
    statements: Mapping[str, Mapping[str, Any]]
    now_us: int
    left_out: dict[str, str] = field(default_factory=dict)
    #: of the left out, those that were recognized and are at fault, by role
    faulty: dict[str, FileRole] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    #: windows that were not found
    shortcomings: tuple[str, ...] = ()
    #: how each table is read, by its name
    notes: dict[str, tuple[str, ...]] = field(default_factory=dict)

    def guarded(self, path: Path, role: FileRole | None, call: Callable[[Path], T]) -> T | None:
        """Return what a call gives for a file, or leave the file out with the reason, whatever was raised."""
        try:
            return call(path)
        except ForeignTableError as error:
            reason = str(error)
        except Exception as error:  # noqa: BLE001 a library's fault on one file must not stop the others
            reason = f"cannot be read: {type(error).__name__}: {error}; export it again, or leave it out"
        self.left_out[path.name] = reason
        if role is not None:
            self.faulty[path.name] = role
        return None

    def fields_of(self, path: Path) -> dict[str, Any]:
        """Return what manifest and command line state of a table."""
        tables = (*self.stated.powers, *self.stated.references)
        former = next((each.model_dump(exclude_unset=True) for each in tables if each.file == path.name), {})
        return {"file": path.name, **former, **self.statements.get(path.name, {})}


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


def propose(files: ImportFiles) -> dict[str, Any]:
    """Return the sections of the manifest of files; what was stated before is kept."""
    roles = {path: files.guarded(path, None, _role_of) for path in files.paths}
    unknown = set(files.statements) - {path.name for path in files.paths} - {""}
    if unknown:
        raise ForeignTableError(f"--state: no file {', '.join(sorted(unknown))} is imported")
    stated, warn = files.stated, files.warnings.append

    def documents(role: FileRole, read: Callable[[Path], Any]) -> dict[str, Any]:
        made = {path.name: files.guarded(path, role, read) for path, found in roles.items() if found is role}
        return {name: document for name, document in made.items() if document is not None}

    bodies = documents(FileRole.SPACECRAFT, lambda path: catalogue.read_spacecraft(path, warn))
    spacecraft_name = _chosen(list(bodies), stated.spacecraft.file)
    spacecraft = bodies.get(plain_value(spacecraft_name))
    plans = documents(FileRole.CARRIERS, catalogue.read_plan)
    plan_name = _chosen(list(plans), stated.carriers)
    plan = plans.get(plain_value(plan_name))
    orbits = documents(FileRole.EPHEMERIS, catalogue.read_orbit)
    known = {} if spacecraft is None else spacecraft.model_dump(mode="json")
    for name, (orbit, ephemeris) in list(orbits.items()) if known else ():
        foreign = catalogue.foreign_orbit(orbit, ephemeris, known)
        if foreign is not None:
            files.left_out[name] = f"orbit of another satellite: {foreign}"
            del orbits[name]
    orbit_name = _chosen(list(orbits), stated.ephemeris)
    own: dict[str, Any] = {"file": spacecraft_name} if spacecraft_name else {"id": stated.spacecraft.id}
    odd: list[str] = []
    if spacecraft is not None:
        if plan is not None:
            path = files.folder / plain_value(plan_name)
            files.guarded(path, FileRole.CARRIERS, lambda _: catalogue.check_plan(plan, spacecraft.longitude_deg, warn))
        odd = catalogue.unlikely(spacecraft, plan, spacecraft.longitude_deg)
    greatest_deg = catalogue.inclination_deg(orbits[plain_value(orbit_name)][1]) if orbit_name else 0.0
    steep = (
        Guess("true", f"the orbit is inclined by {greatest_deg:.2f} deg")
        if greatest_deg > catalogue.INCLINED_DEG
        else None
    )
    carriers = {} if plan is None else catalogue.carrier_names([each.model_dump() for each in plan.carriers])
    is_simulated = bool(spacecraft is not None and spacecraft.simulated)
    tables = {path: role for path, role in roles.items() if path.name not in files.left_out and role in _TABLES}
    made = [_table_entry(files, *each, carriers, is_simulated=is_simulated) for each in sorted(tables.items())]
    entries = list(filter(None, made))
    readings = [each for each in entries if each[0] is FileRole.REFERENCES]
    rows = [read.rows for _, _, read in readings if read.rows is not None]
    windows, files.shortcomings = _windows(rows, [entry for _, entry, _ in readings], stated)
    sections = {
        "spacecraft": own if any(own.values()) else {"id": Guess(None, "no file of a spacecraft")},
        "carriers": plan_name,
        "ephemeris": orbit_name,
        "inclined": "true" if stated.inclined else steep,
        "confirmed": "true" if stated.confirmed else (Guess(None, "; ".join(odd)) if odd else None),
        "powers": [entry for role, entry, _ in entries if role is FileRole.POWERS],
        "references": [entry for _, entry, _ in readings],
        "windows": windows,
        "left_out": files.left_out,
    }
    files.notes = {entry["file"]: read.notes for _, entry, read in entries}
    return {name: value for name, value in sections.items() if value}


def _role_of(path: Path) -> FileRole | None:
    """Return the role that a file's beginning proves; None: a table."""
    with path.open("rb") as opened:
        head = opened.read(_HEAD)
    if not head:
        raise ForeignTableError("the file is empty")
    if head[:4] == b"PAR1" or path.suffix.lower() in {".ndjson", ".jsonl", ".gz", ".zip"}:
        return None
    text = head.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    if is_workbook(head):
        text = ""
        # of several sheets a person states the one of the table
        with suppress(ForeignTableError):
            text = catalogue.file_text(path)
    start = re.sub(r"\A(COMMENT.*\n\s*)*", "", text.lstrip())
    if start.startswith("<"):
        roles = [_MESSAGES[kind] for kind in re.findall(r"<(?:[\w.-]+:)?(oem|omm|aem|tdm)\b", start)]
    elif start.startswith(("{", "[")):
        roles = [role for name, role in _MEMBERS.items() if f'"{name}"' in start]
    else:
        names = {name.strip().strip('"') for name in re.split("[,;\t]", start.partition("\n")[0])}
        roles = [_MESSAGES[kind] for kind, version in VERSIONS.items() if start.startswith(version)]
        roles += [FileRole.EPHEMERIS] if _ELEMENTS.search(text.replace("\r", "\n")) else []
        roles += [role for columns, role in _COLUMNS.items() if names >= columns]
    if not roles and start[:1] in ("<", "{", "["):
        raise ForeignTableError("a document of another kind: neither orbit, attitude, tracking nor catalogue")
    return roles[0] if roles else None


def _chosen(names: list[str], stated: str | None) -> Any:
    """Return the file of a role that one file has; the first of several is a guess."""
    if stated in names or not names:
        return stated if stated in names else None
    return names[0] if len(names) == 1 else Guess(names[0], f"one of {', '.join(names)}")


def table_of(path: Path, stated: Container) -> Table:
    """Return the table of a file; messages and documents of the interface become one."""
    with path.open("rb") as opened:
        head = opened.read(_HEAD).removeprefix(b"\xef\xbb\xbf").lstrip()
    if head.startswith((VERSIONS["tdm"].encode(), VERSIONS["aem"].encode(), b"<", b"COMMENT")):
        text = message_text(catalogue.file_text(path))
        return attitude_table(text) if text.startswith(VERSIONS["aem"]) else tracking_table(text)
    if head.startswith(b"{") and b'"references"' in head:
        return _table_of_document(path)
    return read_table(path, stated)


def _table_of_document(path: Path) -> Table:
    """Return the readings of a document of the interface as a table."""
    from pydantic import TypeAdapter

    from service.api.schemas.inputs import ReferenceBatchDocument

    document = catalogue.decoded(TypeAdapter(ReferenceBatchDocument), catalogue.file_text(path).encode())
    epochs_us, rows = [], []
    for each in document.references:
        epochs_us.append(each.epoch)
        sigma = each.sigma_deg
        deviations = (None, None, None) if sigma is None else (sigma.yaw, sigma.roll, sigma.pitch)
        rows.append((document.source, each.yaw_deg, each.roll_deg, each.pitch_deg, *deviations))
    names = ("source", *(f"{axis}_deg" for axis in AXES), *SIGMA_COLUMNS)
    return message_table(names, epochs_us, zip(*rows, strict=True), "document of the interface")


def interpretation_of(
    path: Path, stated: TableStatement, carriers: Mapping[str, str], now_us: int, *, is_simulated: bool
) -> Interpretation:
    """Return how a file of powers or readings is read under its statement."""
    table = table_of(path, stated)
    if isinstance(stated, PowersStatement):
        return interpret_powers(table, stated, carriers, now_us, is_simulated=is_simulated)
    if table.is_standard and "source" in table.header and stated.source:
        (source,) = table.column("source").unique().to_pylist()
        if source != stated.source:
            raise ForeignTableError(f"the file holds readings of {source}; state source {source}")
    statement = ReadingsStatement.model_validate(stated.model_dump(exclude_unset=True))
    return interpret_readings(table, statement, now_us, is_simulated=is_simulated)


def _table_entry(
    files: ImportFiles, path: Path, known_role: FileRole | None, carriers: Mapping[str, str], *, is_simulated: bool
) -> tuple[FileRole, dict[str, Any], Interpretation] | None:
    """Return role, entry and reading of a table or message; None: it is left out."""

    def read(path: Path) -> tuple[FileRole, TableStatement, Interpretation]:
        fields, where = files.fields_of(path), Path(path.name)
        container = {name: value for name, value in fields.items() if name in Container.model_fields}
        role = known_role or _table_role(
            table_of(path, validated(where, Container, container)), carriers, files.stated, path.name
        )
        kind = PowersStatement if role is FileRole.POWERS else ReadingsStatement
        statement: TableStatement = validated(where, kind, fields)
        return role, statement, interpretation_of(path, statement, carriers, files.now_us, is_simulated=is_simulated)

    made = files.guarded(path, known_role, read)
    if made is None:
        if len(files.fields_of(path)) > 1 and not files.faulty:
            # left out, what a person stated would be lost with it
            raise ForeignTableError(f"{path.name}: {files.left_out[path.name]}")
        return None
    role, statement, interpretation = made
    entry: dict[str, Any] = {"file": path.name, "source": statement.source or _source_guess(path, role)}
    if isinstance(statement, ReadingsStatement) and statement.sigma_deg:
        entry["sigma_deg"] = {axis: str(value) for axis, value in statement.sigma_deg.items()}
    return role, entry | _marked_fields(interpretation), interpretation


def _table_role(table: Table, carriers: Mapping[str, str], stated: FolderManifest, name: str) -> FileRole:
    """Return whether a table holds powers or readings."""
    import pyarrow.compute as pc

    if any(each.file == name for each in stated.powers):
        return FileRole.POWERS
    if any(each.file == name for each in stated.references) or holds_angles(table):
        return FileRole.REFERENCES
    known = {each.casefold() for each in carriers}
    names = {without_unit(each).casefold() for each in table.header}
    if names & known or any(texts_of(column) & known for column in table.columns):
        return FileRole.POWERS
    if any(carriers_named(each, carriers) for each in table.header):
        return FileRole.POWERS
    is_number = [pc.match_substring_regex(column, pattern=f"^{NUMBER}$") for column in table.columns]
    numbers = sum(2 * (pc.sum(each).as_py() or 0) > len(each) for each in is_number)
    if carriers and 0 <= numbers - len(set(carriers.values())) <= 1:
        return FileRole.POWERS
    raise ForeignTableError("no column is a carrier or an angle")


def _source_guess(path: Path, role: FileRole) -> Any:
    """Return the source of a file: that of its name, or a guess."""
    if role is FileRole.POWERS:
        return "sa-1"
    hinted = next((sensor for word, sensor in _SENSORS.items() if word in path.name.lower()), None)
    return hinted or Guess("star_tracker", f"its name names no sensor: {', '.join(SENSOR_NAMES)}")


def _marked_fields(interpretation: Interpretation) -> dict[str, Any]:
    """Return the fields of an entry, a guess for each question."""
    fields = dict(interpretation.found)
    for name, text, _, default in interpretation.questions:
        guess = fields.get(name) if default is None else default
        fields[name] = Guess(guess.split(" + ") if name == "time_columns" and guess else guess, text)
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


def require_files(manifest: FolderManifest, folder: Path) -> None:
    """Refuse a manifest that names a file that is not in its folder, or states no source of one."""
    single = [manifest.spacecraft.file, manifest.carriers, manifest.ephemeris]
    tables = (*manifest.powers, *manifest.references)
    nameless = [each.file for each in tables if not each.source]
    if nameless:
        raise ForeignTableError(f"the manifest states no source of {', '.join(nameless)}")
    names = [*filter(None, single), *(each.file for each in tables)]
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise ForeignTableError(f"{folder} has no {', '.join(missing)}, which the manifest names")


def read_catalogue(folder: Path, manifest: FolderManifest) -> catalogue.OwnCatalogue:
    """Return the catalogue of a manifest; a file at fault is named."""
    warnings: list[str] = []
    spacecraft_file = manifest.spacecraft.file
    with _of_file(folder, spacecraft_file):
        spacecraft = (
            None if spacecraft_file is None else catalogue.read_spacecraft(folder / spacecraft_file, warnings.append)
        )
    spacecraft_id = manifest.spacecraft.id if spacecraft is None else spacecraft.id
    if spacecraft_id is None:
        text = "the manifest names no spacecraft: state spacecraft.file, or spacecraft.id of one that the service has"
        raise ForeignTableError(text)
    with _of_file(folder, manifest.ephemeris):
        orbit = None if manifest.ephemeris is None else catalogue.read_orbit(folder / manifest.ephemeris)
        if orbit is not None and spacecraft is not None:
            members = spacecraft.model_dump(mode="json")
            catalogue.check_orbit(*orbit, members, is_relocating=False, is_inclined=manifest.inclined)
    with _of_file(folder, manifest.carriers):
        plan = None if manifest.carriers is None else catalogue.read_plan(folder / manifest.carriers)
        if plan is not None and spacecraft is not None:
            catalogue.check_plan(plan, spacecraft.longitude_deg, warnings.append)
    if spacecraft is not None and not manifest.confirmed:
        catalogue.check_likely(spacecraft, plan, spacecraft.longitude_deg)
    return catalogue.OwnCatalogue(spacecraft_id, spacecraft, plan, orbit)


@contextmanager
def _of_file(folder: Path, name: str | None) -> Iterator[None]:
    """Name the file in what is raised within."""
    try:
        yield
    except ForeignTableError as error:
        raise ForeignTableError(f"{folder / str(name)}: {error}") from error


def read_tables(
    client: "ServiceClient", folder: Path, manifest: FolderManifest, own: catalogue.OwnCatalogue, *, is_simulated: bool
) -> dict[str, TableRows]:
    """Return the rows of all tables of a manifest by file, each read to its end."""
    plan = [] if own.plan is None else [each.model_dump() for each in own.plan.carriers]
    if own.plan is None and manifest.powers:
        plan = client.carriers(own.spacecraft_id)["carriers"]
    found, carriers, now_us = {}, catalogue.carrier_names(plan), system_now_us()
    for stated in (*manifest.references, *manifest.powers):
        with _of_file(folder, stated.file):
            path = folder / stated.file
            interpretation = interpretation_of(path, stated, carriers, now_us, is_simulated=is_simulated)
            if interpretation.questions or interpretation.rows is None:
                asked = "; ".join(f"{each.field}: {each.text}" for each in interpretation.questions)
                raise ForeignTableError(f"the manifest must state {asked}")
            found[stated.file] = interpretation.rows
    return found


def calibrate(
    client: "ServiceClient", spacecraft_id: str, manifest: FolderManifest, reason: str | None
) -> dict[str, Any]:
    """Make a calibration of the manifest's windows the active one, unless it is, and return it.

    One with warnings stays a draft unless a reason to accept them is given; then the newest such draft is activated.
    Made again with the same figures, the former draft stays and the new one is deleted.
    """
    from service.cli.operation.operate import wait_for_job

    body = {**_stated_windows(manifest, "quiet", "turns"), "method": "geometry"}
    asked = body | {"sources": dict.fromkeys(("yaw", "roll", "pitch"), _sensor(manifest))}
    former = [one for one in _calibrations(client, spacecraft_id) if asked.items() <= one.items()]
    drafts = [one for one in former if one["state"] == "draft" and one["observability"] is not None]
    active = next((one for one in former if one["state"] == "active"), None)
    if active is not None:
        return active
    if reason and drafts:
        return client.activate_calibration(spacecraft_id, drafts[0]["id"], reason)
    started = client.start_calibration(spacecraft_id, body | {"source": _sensor(manifest)})
    wait_for_job(client, started["job"], "calibration")
    made = client.calibration(spacecraft_id, started["id"])
    if not made["quality"].get("warnings") or reason:
        return client.activate_calibration(spacecraft_id, started["id"], reason)
    for one in drafts:
        if all(one[name] == made[name] for name in ("plan_id", "ephemeris_id", "quality", "carriers")):
            client.request("DELETE", f"/spacecraft/{spacecraft_id}/calibrations/{made['id']}")
            return one
    return made


def _calibrations(client: "ServiceClient", spacecraft_id: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = client.request("GET", f"/spacecraft/{spacecraft_id}/calibrations")["rows"]
    return found


def align(client: "ServiceClient", spacecraft_id: str, manifest: FolderManifest) -> dict[str, Any]:
    """Align in the window of the manifest, unless that is done, and return the alignment."""
    window = _stated_windows(manifest, "align")["align"]
    active = [each["id"] for each in _calibrations(client, spacecraft_id) if each["state"] == "active"]
    for each in client.request("GET", f"/spacecraft/{spacecraft_id}/alignments")["rows"]:
        if each["window"] == window and each["calibration_id"] in active:
            return dict(each)
    return client.align(spacecraft_id, window | {"source": _sensor(manifest)})


def _stated_windows(manifest: FolderManifest, *names: str) -> dict[str, Any]:
    """Return windows as the interface has them; ForeignTableError where the manifest does not state them."""
    stated = manifest.windows.model_dump(mode="json", include=set(names), exclude_none=True)
    if len(stated) < len(names):
        where = "soo import FOLDER --propose finds them, or write start and stop"
        raise ForeignTableError(f"the manifest states no window {' or '.join(names)}: {where}")
    return stated


def _sensor(manifest: FolderManifest) -> str:
    """Return the sensor of calibration and alignment: that of the first file of readings."""
    return manifest.references[0].source if manifest.references else "star_tracker"
