"""Command line: every command by name, with the module that is imported when it is run and its line in the help.

The line is the first of the command's docstring or of its group's help; ``tests/docs/test_reference.py`` holds it.
"""

from typing import Annotated

import typer

from service.cli.command_group import CommandSource, begin_command, late_app

_COMMANDS = {
    "demo": CommandSource(
        "demonstration.demo",
        "Show the whole chain: SCPI analyzer to angles to torques that keep the spacecraft, on a virtual clock.",
    ),
    "init": CommandSource(
        "administration.server",
        "Make a folder from which a service starts: settings, archive, first key, systemd unit.",
    ),
    "serve": CommandSource(
        "administration.server", "Serve the REST interface; makes a new archive where there is none."
    ),
    "acquire": CommandSource(
        "station.acquire", "Measure carrier powers on spectrum analyzers and send them to the service."
    ),
    "put": CommandSource(
        "importing.put_command",
        "Store one file: a spacecraft, a carrier plan, an orbit, readings of a sensor, or powers of carriers.",
    ),
    "import": CommandSource(
        "importing.import_command",
        "Send files: spacecraft, carriers, orbit, readings and powers; creates what is missing, changes nothing.",
    ),
    "calibrate": CommandSource(
        "operation.operate", "Fit daily changes and sensitivities from quiet days and calibration turns."
    ),
    "align": CommandSource(
        "operation.operate", "Take angles and reference powers from a window; from then on no sensor is used."
    ),
    "replay": CommandSource("operation.operate", "Run the chain again over the archive, as a new version."),
    "replays": CommandSource("operation.operate", "List the versions that replays wrote, or delete one."),
    "compare": CommandSource("operation.comparison", "Compare the attitude of two versions row by row."),
    "status": CommandSource("shift.reading", "Say whether torques may go, why not, and what to do next."),
    "attitude": CommandSource(
        "shift.reading", "Say where the spacecraft points, how sure that is, and what both methods say."
    ),
    "alarms": CommandSource("shift.reading", "List open alarms with their ids and next steps."),
    "ack": CommandSource(
        "shift.reading", "Acknowledge an alarm; no further notice unless it becomes worse or comes back."
    ),
    "shelve": CommandSource("shift.reading", "Keep an alarm quiet for some hours of the spacecraft's clock."),
    "control": CommandSource("shift.control", "Control: arm, stop, reset."),
    "torque": CommandSource("shift.control", "Release of torques by two persons: prepare, confirm, report."),
    "note": CommandSource("shift.reading", "Write a note into the shift log."),
    "handover": CommandSource(
        "shift.handover", "Write what the next shift must know: alarms, control, operations, links, what ends, notes."
    ),
    "watch": CommandSource("shift.watch", "Follow a spacecraft on one screen; q or Ctrl-C ends it."),
    "report": CommandSource(
        "shift.handover", "Write a report of the last day or shift with figures, then the hand-over."
    ),
    "export": CommandSource("operation.operate", "Download a stretch of the archive."),
    "plan": CommandSource(
        "planning.plan", "Choose carriers, judge what they can see, and print a timetable of calibration turns."
    ),
    "doctor": CommandSource(
        "administration.archive", "Look at an archive, also of a running service, and say what is wrong and what to do."
    ),
    "maintenance": CommandSource(
        "administration.archive",
        "Seal closed days and drop what retention no longer keeps, as the service does by itself.",
    ),
    "openapi": CommandSource("reference", "Write the OpenAPI document of this version."),
    "settings": CommandSource("reference", "Print the settings in force, or the reference of all settings."),
    "keys": CommandSource("administration.access", "Access keys of a service: make, list, revoke."),
    "audit": CommandSource("administration.access", "The audit log: who did what, chained by hashes."),
    "backup": CommandSource(
        "administration.archive", "Copies of an archive: made while the service runs, proved, put back."
    ),
    "study": CommandSource("studies", "Campaigns on simulated truth and reproductions of papers."),
    "carriers": CommandSource(
        "shift.reading", "Say which carriers the newest attitude uses, which it leaves out, and why."
    ),
}


def _print_version(wanted: bool) -> None:
    """Print the version of the program and end."""
    if wanted:
        # reading the metadata of the installation costs time that commands need not pay
        from importlib.metadata import version

        typer.echo(version("soo"))
        raise typer.Exit


def _begin(
    ctx: typer.Context,
    *,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    begin_command(ctx)


app = late_app(
    _COMMANDS,
    begin=_begin,
    name="soo",
    add_completion=True,
    help="Attitude of a geostationary satellite from the powers of the carriers it retransmits.",
)
