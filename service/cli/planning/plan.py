"""``soo plan``: which carriers to measure, what they can see, and which turns to fly."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from service.cli.operation import connection
from service.errors import SooError
from service.records.epoch import US_PER_S, format_epoch, parse_epoch

if TYPE_CHECKING:
    from service.cli.planning.sources import CarrierPlanning

#: columns of a report that is no terminal's
_FILE_COLUMNS = 140
_CONTOURS_HELP = "Beams by points of gain (CSV: transponder, latitude_deg, longitude_deg, gain_db)."
_BEAM_HELP = "Assumed beam, [TRANSPONDER=]AZ,EL,WIDTH[,WIDTH_EL] deg; repeat it for others."


def plan(
    folder: Annotated[Path | None, typer.Argument(help="Folder with the files that soo import takes.")] = None,
    *,
    spacecraft: Annotated[str | None, typer.Option(help="Id of a calibrated spacecraft of the service.")] = None,
    spacecraft_file: Annotated[
        Path | None, typer.Option(help="Spacecraft (JSON, CSV) to plan without a service.")
    ] = None,
    carriers_file: Annotated[Path | None, typer.Option(help="Its carrier plan (CSV or JSON).")] = None,
    beam: Annotated[list[str] | None, typer.Option(help=_BEAM_HELP)] = None,
    contours: Annotated[Path | None, typer.Option(help=_CONTOURS_HELP)] = None,
    quiet: Annotated[Path | None, typer.Option(help="Powers of three quiet days; foreign ones with soo.yaml.")] = None,
    ephemeris: Annotated[Path | None, typer.Option(help="Orbit of these days: TLE, OMM, OEM or JSON.")] = None,
    noise: Annotated[Literal["links", "quiet"], typer.Option(help="Assumed noise.")] = "links",
    count: Annotated[int | None, typer.Option(help="Carriers wanted; default 16.", min=5, max=1000)] = None,
    rule: Annotated[Literal["optimal", "paper"], typer.Option(help="Rule of the choice.")] = "optimal",
    far_yaw: Annotated[bool, typer.Option("--far-yaw", help="Turn to 1 deg about yaw.")] = False,
    wheels: Annotated[float | None, typer.Option(help="Momentum along pitch in telemetry, N m s.")] = None,
    wheel_sigma: Annotated[float | None, typer.Option(help="Noise of its records, N m s.", min=1e-6, max=10)] = None,
    wheel_period: Annotated[
        float | None, typer.Option(help="Time between its records, s; default 300.", min=60, max=86_400)
    ] = None,
    turns_start: Annotated[str | None, typer.Option(help="RFC 3339 start of the turns; default: from +0:00.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw the stations into this PNG or SVG file.")] = None,
    report: Annotated[Path | None, typer.Option(help="Write Markdown, JSON and figures into this folder.")] = None,
    service: connection.ServiceUrl = connection.DEFAULT_SERVICE,
    key_env: connection.KeyEnvironment = connection.DEFAULT_KEY_ENVIRONMENT,
    as_json: connection.JsonOption = False,
) -> None:
    """Choose carriers, judge what they can see, and print a timetable of calibration turns."""
    # numpy and httpx cost more than the command line itself
    from service.cli.planning.sources import PlanFiles, PlanRequest, planned_by_files, planned_by_service

    if folder is not None:
        spacecraft_file, carriers_file, found = _files_of(folder)
        quiet, ephemeris = quiet or found[0], ephemeris or (found[1] if quiet or found[0] else None)
    is_offline = spacecraft_file is not None or carriers_file is not None
    if is_offline == (spacecraft is not None):
        raise _refused("name a spacecraft of the service, or both --spacecraft-file and --carriers-file")
    _require_together(spacecraft, quiet, ephemeris, beam or contours or quiet or ephemeris)
    request = PlanRequest(count, rule, far_yaw, wheels, wheel_sigma, wheel_period)
    try:
        begin_us = None if turns_start is None else parse_epoch(turns_start)
        if spacecraft is not None:
            with connection.connected(service, key_env) as client:
                planning = planned_by_service(client, spacecraft, request)
        elif spacecraft_file is not None and carriers_file is not None:
            files = PlanFiles(spacecraft_file, carriers_file, contours, quiet, ephemeris)
            planning = planned_by_files(files, beam or [], noise, request)
        else:
            raise _refused("planning without a service needs both --spacecraft-file and --carriers-file")
    except SooError as error:
        raise _refused(error.detail) from None
    except ValueError as error:
        raise _refused(str(error)) from None
    if begin_us is not None:
        _add_starts(planning.document["turns"], begin_us)
    _draw(planning, figure, report)
    _deliver(planning, as_json=as_json)


def _files_of(folder: Path) -> tuple[Path | None, Path | None, tuple[Path | None, Path | None]]:
    """Return spacecraft and carriers of a folder, and quiet days and orbit where its soo.yaml states them."""
    from service.cli.importing.folder import ImportFiles, files_of, propose
    from service.cli.importing.manifest import NAME, plain_value, read_stated
    from service.formats.foreign.table import ForeignTableError
    from service.runtime.clock import system_now_us

    try:
        paths, left_out = files_of(folder)
        stated = read_stated(folder)
        sections = propose(ImportFiles(folder, paths, stated, {}, system_now_us(), left_out))
    except (ForeignTableError, OSError) as error:
        raise _refused(str(error)) from None
    names = [sections.get("spacecraft", {}).get("file"), sections.get("carriers"), sections.get("ephemeris")]
    if not names[0] or not names[1]:
        raise _refused(f"{folder} has no file of a spacecraft or of carriers: {sections.get('left_out', {})}")
    spacecraft, carriers, orbit = (folder / plain_value(name) if name else None for name in names)
    quiet = folder / stated.powers[0].file if (folder / NAME).exists() and stated.powers else None
    return spacecraft, carriers, (quiet, orbit)


def _require_together(spacecraft: str | None, quiet: Path | None, ephemeris: Path | None, assumed: object) -> None:
    """Refuse options that nothing would read."""
    if spacecraft is not None and assumed:
        raise _refused("--beam, --contours, --quiet and --ephemeris go with --spacecraft-file, not with --spacecraft")
    if ephemeris is not None and quiet is None:
        raise _refused("--ephemeris is the orbit of the quiet days: state --quiet with it")


def _draw(planning: "CarrierPlanning", figure: Path | None, report: Path | None) -> None:
    """Draw the map and write the folder of the report."""
    # matplotlib costs half a second that a plan without a figure need not pay
    try:
        if figure is not None:
            from service.cli.planning.figures import draw_planning

            draw_planning(planning, figure)
        if report is not None:
            from service.cli.planning.report import write_report

            write_report(planning, report)
    except (OSError, ValueError) as error:
        name = "figure" if report is None else "figure or the report"
        raise _refused(f"the {name} cannot be written: {error}") from None


def _deliver(planning: "CarrierPlanning", *, as_json: bool) -> None:
    from rich.console import Console

    if as_json:
        typer.echo(json.dumps(planning.document, allow_nan=False))
        return
    from service.cli.planning.report import print_planning

    console = Console()
    print_planning(console if console.is_terminal else Console(width=_FILE_COLUMNS), planning)


def _add_starts(turns: dict[str, Any], begin_us: int) -> None:
    """Add the instant at which each level begins."""
    for step in turns["steps"]:
        step["start"] = format_epoch(begin_us + round(step["offset_s"] * US_PER_S))


def _refused(text: str) -> typer.Exit:
    """Say what is wrong with the options and return the end of the command."""
    typer.echo(text, err=True)
    return typer.Exit(2)
