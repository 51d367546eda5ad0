"""``soo put KIND FILE``: one file of an operator: a spacecraft, a carrier plan, an orbit, readings or powers.

Exit codes: 0 stored, known as it is, or understood with ``--dry-run``, 1 the service refused the request or did not
answer (the same command continues where it stopped), 2 the file or an option is wrong, or something must be stated
(standard error has the options), 3 the service has other values (``--change`` changes them), or rows were refused or
could not be read.
"""

import json
import shlex
import signal
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end
from service.cli.importing import dialogue
from service.cli.operation import connection

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient
    from service.formats.foreign.columns import Interpretation, TableRows
    from service.formats.foreign.table import Question


def _spacecraft_of(ctx: typer.Context, given: str) -> str:
    """Return the spacecraft that is meant; the file of one names it itself."""
    return "" if ctx.params.get("kind") is dialogue.FileRole.SPACECRAFT else connection.chosen_spacecraft(ctx, given)


#: what may be stated of the catalogue; of a table: the fields of its entry in ``soo.yaml``
_CATALOGUE = {
    dialogue.FileRole.SPACECRAFT: ("confirmed",),
    dialogue.FileRole.CARRIERS: ("confirmed",),
    dialogue.FileRole.EPHEMERIS: ("inclined", "relocating"),
}


def put(
    kind: Annotated[dialogue.FileRole, typer.Argument(help="What the file holds.")],
    file: Annotated[Path, typer.Argument(help="The file.", dir_okay=False, exists=True)],
    *,
    spacecraft: Annotated[
        str,
        typer.Option(
            help="Id of the spacecraft; not for one itself.",
            envvar="SOO_SPACECRAFT",
            default_factory=str,
            show_default="that of the profile, or the only one",
            callback=_spacecraft_of,
        ),
    ],
    source: Annotated[str | None, typer.Option(help="Source of the powers, or sensor of the readings.")] = None,
    state: Annotated[
        list[str] | None,
        typer.Option(help="FIELD=VALUE of what no content proves, as in soo.yaml, or of the catalogue; repeat it."),
    ] = None,
    change: Annotated[bool, typer.Option("--change", help="Change the fields of a spacecraft that differ.")] = False,
    refuse_unknown: Annotated[
        bool, typer.Option("--refuse-unknown", help="Refuse columns that are no carrier of the plan.")
    ] = False,
    batch_rows: Annotated[int, typer.Option(min=1, max=10_000, help="Rows of one request at most.")] = 1000,
    patience: Annotated[float, typer.Option(min=0.0, help="Seconds to wait for a service that is away.")] = 600.0,
    progress: Annotated[
        Path | None, typer.Option(help="Folder for progress and refused rows.", file_okay=False)
    ] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and check the file, store nothing.")] = False,
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
    as_json: connection.JsonOption = False,
) -> None:
    """Store one file: a spacecraft, a carrier plan, an orbit, readings of a sensor, or powers of carriers."""
    options = dict(locals())
    # validation and numpy cost more than the command line itself
    from service.formats.foreign.table import ForeignTableError

    signal.signal(signal.SIGTERM, dialogue.stop)
    order = _PutOrder(kind, file, spacecraft, _stated(kind, state or []), options)
    with connection.connected(
        service, key_env, retries=0 if kind is dialogue.FileRole.POWERS else 3, timeout_s=60.0
    ) as client:
        try:
            _PUTTERS[kind](client, order)
        except ForeignTableError as error:
            end(dialogue.printable(f"{file}: {error}"), cause=error)
        except KeyboardInterrupt as error:
            end("stopped; the same command continues where this one stopped", dialogue.EXIT_STOPPED, error)


@dataclass(frozen=True, slots=True)
class _PutOrder:
    """File to be stored, and what a person states of it."""

    kind: dialogue.FileRole
    file: Path
    spacecraft: str
    #: fields of a table, or what is confirmed of the catalogue
    stated: dict[str, Any]
    #: all options
    options: dict[str, Any]

    def report(self, document: dict[str, Any], sentence: str) -> None:
        """Print the outcome: JSON for programs, a sentence for people."""
        typer.echo(json.dumps(document) if self.options["as_json"] else dialogue.printable(sentence))

    def show(self, rows: Iterable[tuple[str, Any]]) -> None:
        """Print what is understood, for people."""
        for name, value in rows if not self.options["as_json"] else ():
            typer.echo(dialogue.printable(f"  {name:24} {dialogue.shown(value)}"))

    def report_rows(self, document: dict[str, Any], more: str = "") -> None:
        """Print what became of the rows of a table; end with 3 where some were not stored."""
        names = ("accepted", "duplicates", "late", "refused", "unreadable")
        counts = ", ".join(f"{document[name]} {name}" for name in names if name in document)
        is_dry = self.options["dry_run"]
        lines = (f"{document['rows']} rows; nothing was sent",) if is_dry else (counts, *document["faults"], more)
        self.report(document, "\n".join(filter(None, lines)))
        if document["unreadable"] or document.get("refused"):
            raise typer.Exit(dialogue.EXIT_DIFFERENT)

    def warn(self, text: str) -> None:
        """Print a warning."""
        typer.echo(dialogue.printable(f"warning: {text}"), err=True)


def _stated(kind: dialogue.FileRole, texts: list[str]) -> dict[str, Any]:
    """Return what is stated of a file by field, or end."""
    from service.cli.importing.manifest import read_statement

    found: dict[str, Any] = {}
    for text in texts:
        field, _, value = text.partition("=")
        if not field or not value:
            end(f"--state {text!r}: write FIELD=VALUE, as --state tz=Europe/Moscow")
        if kind in _CATALOGUE and (field not in _CATALOGUE[kind] or value != "true"):
            fields = " or ".join(f"{name}=true" for name in _CATALOGUE[kind])
            end(f"--state {text!r}: of {kind} may be stated {fields}")
        found[field] = read_statement(value)
    return found


def _put_spacecraft(client: "ServiceClient", order: _PutOrder) -> None:
    from service.cli.importing.catalogue import (
        check_likely,
        flat,
        known_document,
        read_spacecraft,
        spacecraft_differences,
    )

    document = read_spacecraft(order.file, order.warn)
    if "confirmed" not in order.stated:
        check_likely(document, None, document.longitude_deg)
    stated = document.model_dump(mode="json", exclude_unset=True)
    order.show(flat(stated).items())
    known = known_document(client, f"/spacecraft/{document.id}", "spacecraft.unknown")
    differences = {} if known is None else spacecraft_differences(document, known)
    for name, (here, there) in differences.items():
        typer.echo(f"{name}: the file has {here!r}, the service {there!r}", err=True)
    is_change = order.options["change"]
    verdict = "the service has this spacecraft as it is" if known else "the service has no spacecraft of this id"
    verdict = f"{len(differences)} fields differ; --change changes them" if differences else verdict
    if order.options["dry_run"]:
        verdict += "; nothing was stored"
    elif known is None:
        client.create_spacecraft(stated)
        verdict = f"spacecraft {document.id} is stored"
    elif differences and is_change:
        changed = {name: stated[name] for name in {each.split(".")[0] for each in differences}}
        client.request("PATCH", f"/spacecraft/{document.id}", changed)
        verdict = f"spacecraft {document.id} is changed"
    order.report({"understood": stated, "is_known": known is not None, "differences": list(differences)}, verdict)
    if differences and not is_change:
        raise typer.Exit(dialogue.EXIT_DIFFERENT)


def _put_carriers(client: "ServiceClient", order: _PutOrder) -> None:
    from service.cli.importing.catalogue import check_likely, check_plan, plan_rows, read_plan

    plan = read_plan(order.file)
    longitude_deg = float(client.spacecraft(order.spacecraft)["longitude_deg"])
    rows = plan_rows(plan, longitude_deg)
    order.show((row["id"], "  ".join(f"{name} {value}" for name, value in row.items() if name != "id")) for row in rows)
    warnings: list[str] = []
    check_plan(plan, longitude_deg, warnings.append)
    for text in warnings:
        order.warn(text)
    if "confirmed" not in order.stated:
        check_likely(None, plan, longitude_deg)
    if order.options["dry_run"]:
        order.report({"carriers": rows, "warnings": warnings}, f"{len(rows)} carriers; nothing was stored")
        return
    stored = client.put_carriers(order.spacecraft, plan.model_dump(mode="json", exclude_unset=True)["carriers"])
    sentence = f"plan {stored['plan_id']} holds {stored['carriers']} carriers"
    order.report({"carriers": rows, "stored": stored}, sentence)


def _put_orbit(client: "ServiceClient", order: _PutOrder) -> None:
    from service.cli.importing.catalogue import check_orbit, read_orbit, understood_orbit

    orbit, ephemeris = read_orbit(order.file)
    known = client.spacecraft(order.spacecraft)
    understood = understood_orbit(orbit, ephemeris, client.status(order.spacecraft)["now"])
    order.show((name, value) for name, value in understood.items() if value is not None)
    is_relocating = "relocating" in order.stated
    check_orbit(orbit, ephemeris, known, is_relocating=is_relocating, is_inclined="inclined" in order.stated)
    if order.options["dry_run"]:
        order.report({"understood": understood}, "nothing was stored")
        return
    stored = client.put_ephemeris(order.spacecraft, orbit.body | ({"relocating": True} if is_relocating else {}))
    sentence = f"ephemeris {stored['ephemeris_id']} is in force until {understood['valid_stop']}"
    order.report({"understood": understood, "stored": stored}, sentence)


_NOT_CHECKED = [
    ("checked", "epochs, unit length of quaternions, position of the scalar, roll and pitch within the Earth's disc"),
    (
        "not checked",
        "signs of the axes and direction of the rotation: compare the spans with turns that you know (positive roll"
        " moves stations South, positive pitch West, positive yaw those in the East to the North)",
    ),
]


def _put_references(client: "ServiceClient", order: _PutOrder) -> None:
    """Store readings of a sensor."""
    from service.cli.importing.folder import SENSOR_NAMES
    from service.cli.importing.sending import send_readings
    from service.formats.foreign.columns import ReadingsStatement

    source = order.options["source"] or "star_tracker"
    if source not in SENSOR_NAMES:
        end(f"--source {source[:40]!r} is no sensor; write {', '.join(SENSOR_NAMES)}")
    statement, rows, document = _rows_of(client, order, ReadingsStatement, order.stated | {"source": source}, {})
    if not order.options["dry_run"]:
        document |= send_readings(client, order.spacecraft, statement, rows)
    order.report_rows(document)


def _put_powers(client: "ServiceClient", order: _PutOrder) -> None:
    """Store powers of carriers; continues where it was interrupted."""
    from service.cli.importing.catalogue import carrier_names
    from service.cli.importing.sending import SendOrder, SendState, angles_line, send_powers, wait_for_angles
    from service.formats.foreign.columns import PowersStatement
    from service.formats.foreign.table import ForeignTableError

    options, spacecraft = order.options, order.spacecraft
    if options["source"] is None:
        end("state --source, under which the powers are stored")
    fields, patience_s = order.stated | {"source": options["source"]}, options["patience"]
    said = json.dumps(fields, sort_keys=True, default=str)
    sending = SendOrder(
        order.file, spacecraft, options["source"], said, options["batch_rows"], patience_s, options["progress"]
    )
    state = SendState(sending, client.service_url)
    # rows that were sent before go again under the plan that they were sent under
    plan = client.carriers(spacecraft, state.plan_id)
    if not isinstance(plan.get("plan_id"), int):
        raise ForeignTableError(f"{spacecraft} has no carrier plan yet")
    state.plan_id = int(plan["plan_id"])
    _, rows, document = _rows_of(client, order, PowersStatement, fields, carrier_names(plan["carriers"]))
    if options["dry_run"]:
        return order.report_rows(document)
    is_quiet = options["as_json"]
    report = send_powers(client, sending, rows, state, is_quiet=is_quiet)
    angles = wait_for_angles(client, spacecraft, patience_s, is_quiet=is_quiet)
    return order.report_rows(report | {"angles": angles}, angles_line(angles, spacecraft))


def _rows_of(
    client: "ServiceClient", order: _PutOrder, kind: Any, fields: dict[str, Any], carriers: dict[str, str]
) -> "tuple[Any, TableRows, dict[str, Any]]":
    """Return statement and rows of a table, shown, and the document of them.

    What it leaves open is asked on a terminal, or ends the command.
    """
    from service.cli.importing.folder import interpretation_of
    from service.cli.importing.manifest import validated
    from service.cli.importing.sending import span_lines
    from service.formats.foreign.columns import grouped
    from service.formats.foreign.table import ForeignTableError
    from service.records.epoch import format_epoch
    from service.runtime.clock import system_now_us

    is_simulated = bool(client.spacecraft(order.spacecraft).get("simulated", False))
    while True:
        statement = validated(order.file, kind, {"file": order.file.name, **fields})
        read = interpretation_of(order.file, statement, carriers, system_now_us(), is_simulated=is_simulated)
        if not read.questions and read.rows is not None:
            break
        if order.options["as_json"] or not dialogue.is_terminal():
            end(dialogue.printable(_open_questions(order, read)))
        order.show(_understood(read))
        for question in read.questions:
            fields[question.field] = dialogue.answer(_question(question), question.default)
    odd = [note for note in read.notes if note.startswith("no carrier of the plan")]
    if odd and order.options["refuse_unknown"]:
        raise ForeignTableError(odd[0])
    rows, understood = read.rows, _understood(read)
    order.show([*understood, *(span_lines(rows, "dBm") if carriers else (*span_lines(rows, "deg"), *_NOT_CHECKED))])
    epochs = [format_epoch(int(each)) for each in rows.epochs_us[[0, -1]]]
    document = {"rows": len(rows.lines), "start": epochs[0], "stop": epochs[1], "unreadable": len(rows.faults)}
    document |= {"faults": grouped(rows.faults), "other_sources": rows.other_sources, **dict(understood)}
    return statement, rows, document


_PUTTERS = {
    dialogue.FileRole.SPACECRAFT: _put_spacecraft,
    dialogue.FileRole.CARRIERS: _put_carriers,
    dialogue.FileRole.EPHEMERIS: _put_orbit,
    dialogue.FileRole.REFERENCES: _put_references,
    dialogue.FileRole.POWERS: _put_powers,
}


def _understood(interpretation: "Interpretation") -> list[tuple[str, str]]:
    """Return how a table is read, for people."""
    asked = {each.field for each in interpretation.questions}
    fields = [(name, dialogue.shown(value)) for name, value in interpretation.found.items() if name not in asked]
    return [*fields, *(("note", note) for note in interpretation.notes)]


def _question(question: "Question") -> str:
    choices = f" [{', '.join(question.choices[:20])}]" if question.choices else ""
    return f"{question.field}: {question.text}{choices}"


def _open_questions(order: _PutOrder, interpretation: "Interpretation") -> str:
    """Return what must be stated, and the command that states it."""
    lines = [f"{order.file}: this must be stated, it is not guessed:"]
    words = [word for word in sys.argv[1:] if word != "--json"] if sys.argv[1:2] == ["put"] else ["put", "..."]
    command = ["soo", *words]
    for question in interpretation.questions:
        value = "VALUE" if question.default is None else dialogue.shown(question.default)
        lines.append(f"  {_question(question)}" + ("" if question.default is None else f"; likely {value}"))
        command += ["--state", f"{question.field}={value}"]
    notes = (f"  ({note})" for note in interpretation.notes)
    return "\n".join((*lines, *notes, "State it:", f"  {shlex.join(command)}"))
