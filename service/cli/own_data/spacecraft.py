"""``soo spacecraft``: a spacecraft from JSON or CSV.

Exit codes: 0 stored, known as it is, or understood with ``--dry-run``, 1 the service refused it or did not answer, 2
the file is no spacecraft or contradicts itself, 3 the service has other values for this id (``--change`` changes them).
"""

import csv
import io
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end, new_app
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    connected,
)
from service.cli.own_data.document_file import (
    EXIT_DIFFERENT,
    decoded,
    read_text,
    refuse_findings,
    report,
    show,
)

if TYPE_CHECKING:
    from service.api.schemas.catalogue import SpacecraftDocument
    from service.client.service_client import ServiceClient

app = new_app(help="Spacecraft of the catalogue.", no_args_is_help=True)


@app.callback()
def group() -> None:
    """Spacecraft of the catalogue."""


@app.command()
def put(
    file: Annotated[
        Path, typer.Argument(help="JSON, or CSV with the columns field and value.", dir_okay=False, exists=True)
    ],
    *,
    change: Annotated[bool, typer.Option("--change", help="Change the fields that differ.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Show what is understood, store nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Store a spacecraft of a JSON or CSV file."""
    document = read_spacecraft(file)
    stated = document.model_dump(mode="json", exclude_unset=True)
    if not as_json:
        show(str(file), ((name, str(value)) for name, value in flat(stated).items()))
    with connected(service, key_env) as client:
        known = known_spacecraft(client, document.id)
        differences = {} if known is None else differences_of(document, known)
        for name, (here, there) in differences.items():
            typer.echo(f"{name}: the file has {here!r}, the service {there!r}", err=True)
        understood = {"understood": stated, "is_known": known is not None, "differences": list(differences)}
        if dry_run:
            report(understood, as_json=as_json, sentence=_verdict(known, differences) + "; nothing was stored")
        elif known is None:
            client.create_spacecraft(stated)
            report(understood, as_json=as_json, sentence=f"spacecraft {document.id} is stored")
        elif differences and change:
            changed = {name: stated[name] for name in {each.split(".")[0] for each in differences}}
            client.request("PATCH", f"/spacecraft/{document.id}", changed)
            report(understood, as_json=as_json, sentence=f"spacecraft {document.id} is changed")
        else:
            report(understood, as_json=as_json, sentence=_verdict(known, differences))
    if differences and not change:
        raise typer.Exit(EXIT_DIFFERENT)


def read_spacecraft(file: Path) -> "SpacecraftDocument":
    """Return the spacecraft of a file, or end."""
    from service.api.schemas.catalogue import SPACECRAFT_ADAPTER
    from service.pipeline.inputs.catalogue_checks import Position, check_positions

    text = read_text(file)
    raw = text if text.lstrip().startswith("{") else json.dumps(_from_csv(file, text))
    document = decoded(file, SPACECRAFT_ADAPTER, raw.encode())
    site = document.receiving_site
    position = Position("/receiving_site", site.latitude_deg, site.longitude_deg, site.height_m)
    findings = check_positions([position], document.longitude_deg)
    refuse_findings(file, findings.faults)
    for warning in findings.warnings:
        typer.echo(f"warning: {warning.pointer}: {warning.detail}", err=True)
    return document


def flat(document: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return the members of a document by dotted name."""
    found: dict[str, Any] = {}
    for name, value in document.items():
        found |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
    return found


def _from_csv(file: Path, text: str) -> dict[str, Any]:
    """Return a document of lines with a dotted name and a value, or end."""
    separator = ";" if text.partition("\n")[0].count(";") else ","
    rows = [row for row in csv.reader(io.StringIO(text), delimiter=separator) if any(cell.strip() for cell in row)]
    if not rows or [cell.strip() for cell in rows[0]] != ["field", "value"]:
        end(f"{file}: neither JSON nor CSV with the columns field and value")
    document: dict[str, Any] = {}
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != 2:
            end(f"{file}, line {number}: {len(row)} cells; write field and value, in quotes where it has {separator}")
        *path, last = row[0].strip().split(".")
        member = document
        for name in path:
            member = member.setdefault(name, {})
            if not isinstance(member, dict):
                end(f"{file}, line {number}: {row[0].strip()} lies within a field that has a value")
        if last in member:
            end(f"{file}, line {number}: {row[0].strip()} occurs twice")
        member[last] = _value(row[1].strip())
    return document


def _value(cell: str) -> Any:
    """Return a number, truth value or array that a cell holds, else its text."""
    try:
        return json.loads(cell)
    except ValueError:
        return cell


def known_spacecraft(client: "ServiceClient", spacecraft_id: str) -> dict[str, Any] | None:
    """Return the spacecraft that the service has under this id; None: none."""
    from service.client.problem import ProblemError

    try:
        return client.spacecraft(spacecraft_id)
    except ProblemError as error:
        if error.code != "spacecraft.unknown":
            raise
        return None


def differences_of(document: "SpacecraftDocument", known: dict[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Return the stated fields that the service has otherwise, with both values."""
    stated = flat(document.model_dump(mode="json", exclude_unset=True))
    # members of arrays have their defaults here, as the service has them
    here, there = flat(document.model_dump(mode="json")), flat(known)
    return {name: (here[name], there.get(name)) for name in stated if there.get(name) != here[name]}


def _verdict(known: dict[str, Any] | None, differences: dict[str, tuple[Any, Any]]) -> str:
    """Return how a file and the service agree."""
    if known is None:
        return "the service has no spacecraft of this id"
    if not differences:
        return "the service has this spacecraft as it is"
    return f"{len(differences)} fields differ; --change changes them"
