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
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from service.cli.command_group import end
from service.cli.importing.dialogue import EXIT_DIFFERENT, EXIT_STOPPED, FileRole, is_terminal, printable, stop
from service.cli.operation.connection import (
    DEFAULT_KEY_ENVIRONMENT,
    DEFAULT_SERVICE,
    JsonOption,
    KeyEnvironment,
    ServiceUrl,
    chosen_spacecraft,
    connected,
)

if TYPE_CHECKING:
    from service.client.service_client import ServiceClient
    from service.formats.foreign.columns import Interpretation, TableRows, TableStatement


def _spacecraft_of(ctx: typer.Context, given: str) -> str:
    """Return the spacecraft that is meant; the file of one names it itself."""
    return "" if ctx.params.get("kind") is FileRole.SPACECRAFT else chosen_spacecraft(ctx, given)


#: fields of a statement that an option states as a list, by the option's name
_PAIRS = {"map": "NAME=CARRIER or NAME=AXIS", "sigma_deg": "AXIS=DEG"}
_CATALOGUE = (FileRole.SPACECRAFT, FileRole.CARRIERS, FileRole.EPHEMERIS)
_TABLE_HELP = "Tables only: "


def put(
    kind: Annotated[FileRole, typer.Argument(help="What the file holds.")],
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
    from_source: Annotated[str | None, typer.Option(help="Send rows that the file gives to this source.")] = None,
    change: Annotated[bool, typer.Option("--change", help="Change the fields of a spacecraft that differ.")] = False,
    relocating: Annotated[bool, typer.Option("--relocating", help="The spacecraft leaves its longitude.")] = False,
    inclined: Annotated[bool, typer.Option("--inclined", help="The orbit is inclined by more than 1 deg.")] = False,
    confirmed: Annotated[bool, typer.Option("--confirmed", help="Unlikely figures are right.")] = False,
    time_columns: Annotated[
        list[str] | None, typer.Option("--time-column", help="Column of the epochs; date and time: state both.")
    ] = None,
    time_format: Annotated[
        str | None, typer.Option(help="`iso`, `unix_s`, `gps_week_s`, `mjd`, ..., or a pattern: %d.%m.%Y %H:%M:%S.")
    ] = None,
    tz: Annotated[str | None, typer.Option(help="Zone or scale: UTC, +03:00, Europe/Moscow, GPS, TAI.")] = None,
    date: Annotated[str | None, typer.Option(help="Day of the first row, where rows have times of day only.")] = None,
    last_day: Annotated[str | None, typer.Option(help="Day of the newest row, where it is old.")] = None,
    unit: Annotated[str | None, typer.Option(help="Unit: dBm, dBW, mW, ... or deg, rad, mrad, arcsec, ...")] = None,
    decimal: Annotated[str | None, typer.Option(help="`point` or `comma`.")] = None,
    missing: Annotated[
        list[str] | None, typer.Option(help="Text or number that stands for no reading; none: there is no such.")
    ] = None,
    map_: Annotated[list[str] | None, typer.Option("--map", help="NAME=CARRIER or NAME=AXIS; repeat it.")] = None,
    carrier_column: Annotated[str | None, typer.Option(help="One level a line: column of the carrier.")] = None,
    level_column: Annotated[str | None, typer.Option(help="One level a line: column of the levels.")] = None,
    scalar: Annotated[str | None, typer.Option(help="Scalar of quaternions: `first` or `last`.")] = None,
    sigma_deg: Annotated[list[str] | None, typer.Option(help="AXIS=DEG: one standard deviation, deg.")] = None,
    sheet: Annotated[str | None, typer.Option(help="Sheet of a workbook.")] = None,
    separator: Annotated[str | None, typer.Option(help="Separator of the cells: one sign, `tab` or `space`.")] = None,
    encoding: Annotated[str | None, typer.Option(help="Encoding of the text: cp1251, koi8-r, ...")] = None,
    skip_lines: Annotated[int, typer.Option(min=0, help="Lines before the header.")] = 0,
    partial: Annotated[bool, typer.Option("--partial", help="Store the rows that can be read, however few.")] = False,
    refuse_unknown: Annotated[
        bool, typer.Option("--refuse-unknown", help="Refuse columns that are no carrier of the plan.")
    ] = False,
    batch_rows: Annotated[int, typer.Option(min=1, max=10_000, help="Rows of one request at most.")] = 1000,
    patience: Annotated[float, typer.Option(min=0.0, help="Seconds to wait for a service that is away.")] = 600.0,
    state: Annotated[Path | None, typer.Option(help="Folder for progress and refused rows.", file_okay=False)] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Read and check the file, store nothing.")] = False,
    service: ServiceUrl = DEFAULT_SERVICE,
    key_env: KeyEnvironment = DEFAULT_KEY_ENVIRONMENT,
    as_json: JsonOption = False,
) -> None:
    """Store one file: a spacecraft, a carrier plan, an orbit, readings of a sensor, or powers of carriers."""
    # validation and numpy cost more than the command line itself
    from service.formats.foreign.table import ForeignTableError

    stated: dict[str, Any] = {
        "time_columns": tuple(time_columns or ()), "time_format": time_format, "tz": tz, "date": date,
        "last_day": last_day, "unit": unit, "decimal": decimal, "missing": tuple(missing or ()),
        "map": _pairs(map_ or [], "map"), "carrier_column": carrier_column, "level_column": level_column,
        "scalar": scalar, "sigma_deg": _pairs(sigma_deg or [], "sigma_deg"), "sheet": sheet, "separator": separator,
        "encoding": encoding, "skip_lines": skip_lines, "partial": partial, "from_source": from_source,
    }  # fmt: skip
    stated = {name: value for name, value in stated.items() if value}
    if kind in _CATALOGUE and stated:
        end(f"--{next(iter(stated)).replace('_', '-')} is stated for tables only")
    signal.signal(signal.SIGTERM, stop)
    flags = {"relocating": relocating, "inclined": inclined, "confirmed": confirmed, "change": change}
    sending = {"batch_rows": batch_rows, "patience": patience, "state": state, "refuse_unknown": refuse_unknown}
    options = _Options(file, spacecraft, source, stated, flags, sending, is_dry=dry_run, as_json=as_json)
    with connected(service, key_env, retries=0 if kind is FileRole.POWERS else 3, timeout_s=60.0) as client:
        try:
            _PUTTERS[kind](client, options)
        except ForeignTableError as error:
            end(printable(f"{file}: {error}"), cause=error)
        except KeyboardInterrupt as error:
            end("stopped; the same command continues where this one stopped", EXIT_STOPPED, error)


class _Options:
    """Statements of a person."""

    def __init__(
        self,
        file: Path,
        spacecraft: str,
        source: str | None,
        stated: dict[str, Any],
        flags: dict[str, bool],
        sending: dict[str, Any],
        *,
        is_dry: bool,
        as_json: bool,
    ) -> None:
        self.file, self.spacecraft, self.source, self.stated = file, spacecraft, source, stated
        self.flags, self.sending, self.is_dry, self.as_json = flags, sending, is_dry, as_json

    def report(self, document: dict[str, Any], sentence: str) -> None:
        """Print the outcome: JSON for programs, a sentence for people."""
        typer.echo(json.dumps(document) if self.as_json else printable(sentence))

    def show(self, rows: "list[tuple[str, str]]") -> None:
        """Print what is understood, for people."""
        for name, value in rows if not self.as_json else ():
            typer.echo(printable(f"  {name:24} {value}"))

    def warn(self, text: str) -> None:
        """Print a warning."""
        typer.echo(printable(f"warning: {text}"), err=True)

    def confirm(self, unlikely: list[str]) -> None:
        """End unless unlikely figures are confirmed."""
        if unlikely and not self.flags["confirmed"]:
            lines = (
                f"{self.file}: this must be confirmed:",
                *unlikely,
                "if it is so, run the command with --confirmed",
            )
            end(printable("\n  ".join(lines)))


def _pairs(given: list[str], option: str) -> dict[str, str]:
    """Return values by name from ``NAME=VALUE``, or end; a name may hold equals signs."""
    shown = f"--{option.replace('_', '-')}"
    split = {pair: pair.rpartition("=") for pair in given}
    wrong = [pair for pair, (name, _, value) in split.items() if not name.strip() or not value.strip()]
    if wrong:
        end(f"{shown} {wrong[0]!r}: write {_PAIRS[option]}")
    names = [name.strip() for name, _, _ in split.values()]
    if len(set(names)) < len(names):
        end(f"{shown} names one thing twice; state each once")
    return {name.strip(): value.strip() for name, _, value in split.values()}


def _put_spacecraft(client: "ServiceClient", options: _Options) -> None:
    """Store a spacecraft."""
    from service.cli.importing.catalogue import flat, known_document, read_spacecraft, spacecraft_differences, unlikely

    document = read_spacecraft(options.file, options.warn)
    options.confirm(unlikely(document, None, document.longitude_deg))
    stated = document.model_dump(mode="json", exclude_unset=True)
    options.show([(name, str(value)) for name, value in flat(stated).items()])
    known = known_document(client, f"/spacecraft/{document.id}", "spacecraft.unknown")
    differences = {} if known is None else spacecraft_differences(document, known)
    for name, (here, there) in differences.items():
        typer.echo(f"{name}: the file has {here!r}, the service {there!r}", err=True)
    understood = {"understood": stated, "is_known": known is not None, "differences": list(differences)}
    verdict = "the service has this spacecraft as it is" if known else "the service has no spacecraft of this id"
    verdict = f"{len(differences)} fields differ; --change changes them" if differences else verdict
    if options.is_dry:
        options.report(understood, f"{verdict}; nothing was stored")
    elif known is None:
        client.create_spacecraft(stated)
        options.report(understood, f"spacecraft {document.id} is stored")
    elif differences and options.flags["change"]:
        changed = {name: stated[name] for name in {each.split(".")[0] for each in differences}}
        client.request("PATCH", f"/spacecraft/{document.id}", changed)
        options.report(understood, f"spacecraft {document.id} is changed")
    else:
        options.report(understood, verdict)
    if differences and not options.flags["change"]:
        raise typer.Exit(EXIT_DIFFERENT)


def _put_carriers(client: "ServiceClient", options: _Options) -> None:
    """Store a carrier plan."""
    from service.cli.importing.catalogue import check_plan, plan_rows, read_plan, unlikely

    plan = read_plan(options.file)
    longitude_deg = float(client.spacecraft(options.spacecraft)["longitude_deg"])
    rows = plan_rows(plan, longitude_deg)
    options.show(
        [(row["id"], "  ".join(f"{name} {value}" for name, value in row.items() if name != "id")) for row in rows]
    )
    warnings: list[str] = []
    check_plan(plan, longitude_deg, warnings.append)
    for text in warnings:
        options.warn(text)
    options.confirm(unlikely(None, plan, longitude_deg))
    if options.is_dry:
        options.report({"carriers": rows, "warnings": warnings}, f"{len(rows)} carriers; nothing was stored")
        return
    stored = client.put_carriers(options.spacecraft, plan.model_dump(mode="json", exclude_unset=True)["carriers"])
    options.report(
        {"carriers": rows, "stored": stored}, f"plan {stored['plan_id']} holds {stored['carriers']} carriers"
    )


def _put_ephemeris(client: "ServiceClient", options: _Options) -> None:
    """Store an orbit."""
    from service.cli.importing.catalogue import check_orbit, read_orbit, understood_orbit

    orbit, ephemeris = read_orbit(options.file)
    known = client.spacecraft(options.spacecraft)
    understood = understood_orbit(orbit, ephemeris, client.status(options.spacecraft)["now"])
    options.show([(name, str(value)) for name, value in understood.items() if value is not None])
    flags = options.flags
    check_orbit(orbit, ephemeris, known, is_relocating=flags["relocating"], is_inclined=flags["inclined"])
    if options.is_dry:
        options.report({"understood": understood}, "nothing was stored")
        return
    stored = client.put_ephemeris(
        options.spacecraft, orbit.body | ({"relocating": True} if flags["relocating"] else {})
    )
    sentence = f"ephemeris {stored['ephemeris_id']} is in force until {understood['valid_stop']}"
    options.report({"understood": understood, "stored": stored}, sentence)


def _put_references(client: "ServiceClient", options: _Options) -> None:
    """Store readings of a sensor."""
    from service.cli.importing.folder import SENSOR_NAMES, read_readings
    from service.cli.importing.sending import send_readings, span_lines
    from service.formats.foreign.columns import ReadingsStatement, grouped
    from service.runtime.clock import system_now_us

    source = options.source or "star_tracker"
    if source not in SENSOR_NAMES:
        end(f"--source {source[:40]!r} is no sensor; write {', '.join(SENSOR_NAMES)}")
    is_simulated = bool(client.spacecraft(options.spacecraft).get("simulated", False))
    options.stated |= {"columns": options.stated.pop("map", {}), "source": source}

    def read(statement: "TableStatement") -> "Interpretation":
        assert isinstance(statement, ReadingsStatement)  # noqa: S101 of the class below
        return read_readings(options.file, statement, system_now_us(), is_simulated=is_simulated)

    statement, interpretation, rows = _answered(options, ReadingsStatement, read)
    options.show([*_understood(interpretation), *span_lines(rows, "deg"), *_NOT_CHECKED])
    sigma_deg = {str(axis): value for axis, value in getattr(statement, "sigma_deg", {}).items()}
    counts = {} if options.is_dry else send_readings(client, options.spacecraft, source, rows, sigma_deg)
    faults = {"unreadable": len(rows.faults), "faults": grouped(rows.faults)}
    document = {"rows": len(rows.lines), **dict(_understood(interpretation)), **counts, **faults}
    options.report(document, ", ".join(f"{count} {name}" for name, count in counts.items()) or "nothing was stored")
    if rows.faults or counts.get("refused"):
        raise typer.Exit(EXIT_DIFFERENT)


_NOT_CHECKED = [
    ("checked", "epochs, unit length of quaternions, position of the scalar, roll and pitch within the Earth's disc"),
    (
        "not checked",
        "signs of the axes and direction of the rotation: compare the spans with turns that you know (positive roll"
        " moves stations South, positive pitch West, positive yaw those in the East to the North)",
    ),
]


def _put_powers(client: "ServiceClient", options: _Options) -> None:
    """Store powers of carriers; continues where it was interrupted."""
    from service.cli.importing.catalogue import carrier_names
    from service.cli.importing.folder import table_of
    from service.cli.importing.sending import (
        SendOrder,
        SendState,
        angles_line,
        send_with_progress,
        span_lines,
        wait_for_angles,
    )
    from service.formats.foreign.columns import PowersStatement, interpret_powers
    from service.formats.foreign.table import ForeignTableError
    from service.runtime.clock import system_now_us

    if options.source is None:
        end("state --source, under which the powers are stored")
    options.stated |= {"carriers": options.stated.pop("map", {}), "source": options.source}
    is_simulated = bool(client.spacecraft(options.spacecraft).get("simulated", False))
    statement = json.dumps(options.stated, sort_keys=True, default=str)
    sending = options.sending
    order = SendOrder(
        options.file,
        options.spacecraft,
        options.source,
        statement,
        sending["batch_rows"],
        sending["patience"],
        sending["state"],
    )
    state = SendState(order, client.service_url)
    # rows that were sent before go again under the plan that they were sent under
    plan = client.carriers(options.spacecraft, state.plan_id)
    if not isinstance(plan.get("plan_id"), int):
        raise ForeignTableError(f"{options.spacecraft} has no carrier plan yet")
    state.plan_id = int(plan["plan_id"])
    carriers = carrier_names(plan["carriers"])

    def read(statement: "TableStatement") -> "Interpretation":
        assert isinstance(statement, PowersStatement)  # noqa: S101 of the class below
        table = table_of(options.file, statement.container)
        return interpret_powers(table, statement, carriers, system_now_us(), is_simulated=is_simulated)

    _, interpretation, rows = _answered(options, PowersStatement, read)
    odd = [note for note in interpretation.notes if note.startswith("no carrier of the plan")]
    if odd and sending["refuse_unknown"]:
        raise ForeignTableError(odd[0])
    options.show([*_understood(interpretation), *span_lines(rows, "dBm")])
    if rows.other_sources and not len(rows.lines):
        end(f"no row of {options.source}; the file's are of {', '.join(rows.other_sources)}: see --from-source")
    if options.is_dry:
        _report_powers(options, interpretation, rows)
    else:
        report = send_with_progress(client, order, rows, state, is_quiet=options.as_json)
        angles = wait_for_angles(client, options.spacecraft, sending["patience"], is_quiet=options.as_json)
        names = ("accepted", "duplicates", "late", "refused", "unreadable")
        counts = ", ".join(f"{report[name]} {name}" for name in names)
        sentence = "\n".join((counts, *report["faults"], angles_line(angles, options.spacecraft)))
        options.report(report | {"angles": angles}, sentence)
    if rows.faults or state.counters.refused:
        raise typer.Exit(EXIT_DIFFERENT)


def _report_powers(options: _Options, interpretation: "Interpretation", rows: "TableRows") -> None:
    """Print what would be sent."""
    from service.formats.foreign.columns import grouped
    from service.records.epoch import format_epoch

    start, stop = (format_epoch(int(rows.epochs_us[k])) for k in (0, -1))
    faults = {"unreadable": len(rows.faults), "faults": grouped(rows.faults), "other_sources": rows.other_sources}
    document = {"rows": len(rows.lines), "start": start, "stop": stop, **faults}
    options.report({**document, **dict(_understood(interpretation))}, f"{len(rows.lines)} rows; nothing was sent")


_PUTTERS = {
    FileRole.SPACECRAFT: _put_spacecraft,
    FileRole.CARRIERS: _put_carriers,
    FileRole.EPHEMERIS: _put_ephemeris,
    FileRole.REFERENCES: _put_references,
    FileRole.POWERS: _put_powers,
}


def _answered(options: _Options, kind: Any, read: Any) -> "tuple[TableStatement, Interpretation, TableRows]":
    """Return the reading of a table; what it leaves open is asked on a terminal, or ends the command."""
    from service.cli.importing.manifest import read_statement, validated

    while True:
        statement = validated(options.file, kind, {"file": options.file.name, **options.stated})
        interpretation = read(statement)
        if not interpretation.questions and interpretation.rows is not None:
            return statement, interpretation, interpretation.rows
        if options.as_json or not is_terminal():
            end(printable(_statement(options, interpretation)))
        options.show(_understood(interpretation))
        for question in interpretation.questions:
            shown = f" [{', '.join(question.choices[:20])}]" if question.choices else ""
            default = None if question.default is None else _shown(question.default)
            text = f"--{question.field.replace('_', '-')}: {question.text}{shown}"
            options.stated[question.field] = read_statement(str(typer.prompt(text, default=default, err=True)).strip())


def _understood(interpretation: "Interpretation") -> list[tuple[str, str]]:
    """Return how a table is read, for people."""
    asked = {each.field for each in interpretation.questions}
    fields = [(name, _shown(value)) for name, value in interpretation.found.items() if name not in asked]
    return [*fields, *(("note", note) for note in interpretation.notes)]


def _shown(value: Any) -> str:
    """Return a value for people, as an option takes it."""
    if isinstance(value, dict):
        return ", ".join(f"{name}={each}" for name, each in value.items())
    return " + ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def _statement(options: _Options, interpretation: "Interpretation") -> str:
    """Return what must be stated, and the command that states it."""
    lines = [f"{options.file}: this must be stated, it is not guessed:"]
    words = [word for word in sys.argv[1:] if word != "--json"] if sys.argv[1:2] == ["put"] else ["put", "..."]
    command = shlex.join(["soo", *words])
    for field, text, choices, default in interpretation.questions:
        option = {"carriers": "--map", "columns": "--map", "time_columns": "--time-column"}.get(field, f"--{field}")
        option = option.replace("_", "-")
        likely = "" if default is None else f"; likely {_shown(default)}"
        lines.append(f"  {option}: {text}" + (f" [{', '.join(choices[:20])}]" if choices else "") + likely)
        command += _option_words(option, default)
    notes = (f"  ({note})" for note in interpretation.notes)
    return "\n".join((*lines, *notes, "State it:", f"  {command}"))


def _option_words(option: str, default: Any) -> str:
    """Return the words of a command line that state a likely answer, or its place."""
    if isinstance(default, dict):
        return "".join(f" {option} {shlex.quote(f'{name}={value}')}" for name, value in default.items())
    if option == "--map" or default is None:
        return f" {option} {'NAME=...' if option == '--map' else option.removeprefix('--').upper()}"
    values = default if isinstance(default, list | tuple) else str(default).split(" + ")
    return "".join(f" {option} {shlex.quote(str(value))}" for value in values)
