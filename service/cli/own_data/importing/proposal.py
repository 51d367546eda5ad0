"""Proposal of a manifest: role and layout of each file, guesses marked, windows where the readings show turns."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from service.cli.command_group import end
from service.cli.own_data.carriers import read_plan
from service.cli.own_data.ephemeris import read_orbit
from service.cli.own_data.foreign_file import carrier_names
from service.cli.own_data.importing.entries import Statements, powers_entry, references_entry
from service.cli.own_data.importing.manifest import FolderManifest, Guess, plain_value
from service.cli.own_data.importing.roles import Content, FileRole, content_of, files_of
from service.cli.own_data.importing.windows import proposed_windows
from service.cli.own_data.spacecraft import read_spacecraft
from service.pipeline.inputs.catalogue_checks import contradiction_of

if TYPE_CHECKING:
    from service.api.schemas.catalogue import SpacecraftDocument


#: roles whose files have fields of their own
_TABLES = (FileRole.POWERS, FileRole.REFERENCES)


class FolderProposal(NamedTuple):
    """Sections of a manifest, and what they leave open."""

    sections: dict[str, Any]
    #: windows that were not found
    shortcomings: tuple[str, ...]


def propose_folder(folder: Path, stated: FolderManifest, statements: Statements) -> FolderProposal:
    """Return the manifest of a folder; what was stated before is kept."""
    files, left_out = files_of(folder)
    contents = {path: content_of(path, None) for path in files}
    plan_file = _chosen(_named(contents, FileRole.CARRIERS), stated.carriers)
    carriers: dict[str, str] = {}
    if plan_file is not None:
        plan = read_plan(folder / plain_value(plan_file))
        carriers = carrier_names([each.model_dump() for each in plan.carriers])
    contents = {path: one if one.role or one.reason else content_of(path, carriers) for path, one in contents.items()}
    unknown = set(statements) - {path.name for path, one in contents.items() if one.role in _TABLES}
    if unknown:
        end(f"--state: no powers or readings in {', '.join(sorted(unknown))}")
    left_out |= {path.name: one.reason for path, one in contents.items() if one.role is None}
    spacecraft_file = _chosen(_named(contents, FileRole.SPACECRAFT), stated.spacecraft.file)
    spacecraft = None if spacecraft_file is None else read_spacecraft(folder / plain_value(spacecraft_file))
    orbits, others = _orbits(folder, _named(contents, FileRole.EPHEMERIS), spacecraft)
    references = [references_entry(folder / name, stated, statements) for name in _named(contents, FileRole.REFERENCES)]
    own = (
        {"file": spacecraft_file}
        if spacecraft_file
        else {"id": stated.spacecraft.id or Guess(None, "no file of a spacecraft")}
    )
    windows, shortcomings = proposed_windows(folder, references, stated)
    sections = {
        "spacecraft": own,
        "carriers": plan_file,
        "ephemeris": _chosen(orbits, stated.ephemeris),
        "powers": [
            powers_entry(folder / name, stated, statements, carriers) for name in _named(contents, FileRole.POWERS)
        ],
        "references": references,
        "windows": windows,
        "left_out": left_out | others,
    }
    return FolderProposal({name: value for name, value in sections.items() if value}, shortcomings)


def _named(contents: Mapping[Path, Content], role: FileRole) -> list[str]:
    """Return the names of the files of a role."""
    return [path.name for path, content in contents.items() if content.role is role]


def _chosen(names: list[str], stated: str | None) -> Any:
    """Return the file of a role that one file has; the first of several is a guess."""
    if stated in names or not names:
        return stated if stated in names else None
    return names[0] if len(names) == 1 else Guess(names[0], f"one of {', '.join(names)}")


def _orbits(
    folder: Path, names: list[str], spacecraft: "SpacecraftDocument | None"
) -> tuple[list[str], dict[str, str]]:
    """Return the files with an orbit of this spacecraft, and why others are left out."""
    own, others = [], {}
    for name in names:
        orbit, ephemeris = read_orbit(folder / name)
        foreign = None if spacecraft is None else contradiction_of(ephemeris, spacecraft.longitude_deg)
        if spacecraft is not None and spacecraft.cospar_id and orbit.cospar_id not in (None, spacecraft.cospar_id):
            foreign = f"it is of {orbit.cospar_id}"
        if foreign is None:
            own.append(name)
        else:
            others[name] = f"orbit of another satellite: {foreign}"
    return own, others


def require_files(manifest: FolderManifest, folder: Path) -> None:
    """End where a manifest names a file that is not in its folder, or states no source of one."""
    single = [manifest.spacecraft.file, manifest.carriers, manifest.ephemeris]
    tables = (*manifest.powers, *manifest.references)
    nameless = [each.file for each in tables if not each.source]
    if nameless:
        end(f"the manifest states no source of {', '.join(nameless)}")
    names = [*filter(None, single), *(each.file for each in tables)]
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        end(f"{folder} has no {', '.join(missing)}, which the manifest names")
