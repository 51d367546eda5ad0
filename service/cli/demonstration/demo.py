"""``soo demo``: simulated analyzer, front end and service on this machine, from nothing to angles beside the truth."""

import json
import os
import signal
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

import typer

from service.cli.command_group import end, new_app
from service.cli.demonstration.inject import inject
from service.cli.demonstration.running import RunningDemonstration, published
from service.cli.extras import require
from service.cli.studies.screen import ended_by_signals

#: operation that the endless demonstration can show, days
_ENDLESS_DAYS = 30.0
_EXIT_DAYS = 2.0
ReleaseMode = Literal["automatic", "two_step"]


app = new_app(invoke_without_command=True, context_settings={"allow_interspersed_args": False})


@app.callback()
def demo(
    context: typer.Context,
    leave: Annotated[bool, typer.Option("--exit", help="Stop after two virtual days and print figures.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print figures as JSON only.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the simulated world.")] = 1,
    days: Annotated[float | None, typer.Option(help="Virtual days of operation.")] = None,
    quiet_days: Annotated[float | None, typer.Option(help="Virtual quiet days before the turns.")] = None,
    figure: Annotated[Path | None, typer.Option(help="Draw estimate and truth into this PNG file at the end.")] = None,
    keep: Annotated[Path | None, typer.Option(help="Keep database and logs in this folder.", file_okay=False)] = None,
    release: Annotated[
        ReleaseMode, typer.Option(help="automatic, or two_step: two persons release each command, their keys printed.")
    ] = "automatic",
    rows_per_second: Annotated[
        float, typer.Option(help="Pace of tracking under release automatic; 0 = as fast as it goes.")
    ] = 20.0,
    service: Annotated[str | None, typer.Option(help="Use a service that runs already (key in SOO_KEY).")] = None,
    analyzer: Annotated[str | None, typer.Option(help="HOST:PORT of a simulated analyzer that runs already.")] = None,
    ground: Annotated[str | None, typer.Option(help="HOST:PORT of its ground port.")] = None,
    uplink: Annotated[str | None, typer.Option(help="HOST:PORT of its uplink, when its spacecraft is flown.")] = None,
    closed: Annotated[bool, typer.Option("--closed/--open", help="Keep the spacecraft, or follow its slews.")] = True,
) -> None:
    """Show the whole chain: SCPI analyzer to angles to torques that keep the spacecraft, on a virtual clock."""
    if context.invoked_subcommand is not None:
        return
    from rich.console import Console

    # its front end measures by it, in a process of its own
    require("pyvisa")
    # the story costs half a second that a wrong option need not pay
    from service.cli.demonstration.demo_run import FAILURES, Alone, external, own_station, play
    from service.cli.demonstration.demo_screen import Presenter, print_figures
    from service.cli.demonstration.invitation import offer_archive
    from service.cli.demonstration.persons import write_key

    is_two_step = release == "two_step"
    if is_two_step and (leave or as_json or not closed or service):
        end("--release two_step waits for persons at the console: leave out --exit, --json, --open and --service")
    console = Console(stderr=as_json)
    operation_days = days or (_EXIT_DAYS if leave else _ENDLESS_DAYS)
    story = Alone(seed, operation_days, quiet_days)
    pace = 0.0 if leave or is_two_step else rows_per_second
    presenter = Presenter(console, pace, with_table=not leave and not as_json)
    with ExitStack() as stack:
        stack.enter_context(ended_by_signals())
        directory = _directory(stack, keep)
        try:
            with ExitStack() as station:
                station.callback(presenter.close)
                presenter.open()
                if service and analyzer and ground:
                    endpoints = external(service, analyzer, ground, uplink)
                else:
                    endpoints = station.enter_context(own_station(directory, story, release if closed else None))
                    write_key(directory / "administrator.key", endpoints.key)
                    presenter.announce(endpoints.service_url, directory / "administrator.key")
                    key_file = str((directory / "administrator.key").resolve())
                    found = RunningDemonstration(os.getpid(), endpoints.service_url, key_file, endpoints.changes)
                    station.enter_context(published(found))
                figures = play(directory, endpoints, presenter, figure, story, is_two_step=is_two_step)
        except KeyboardInterrupt as interruption:
            console.print("stopped")
            if not service:
                offer_archive(console, directory, keep, is_asked=interruption.args == (signal.SIGINT,))
            return
        except FAILURES as error:
            end(f"the demonstration failed: {error}", cause=error)
    typer.echo(json.dumps({"seed": seed, **figures}, allow_nan=False)) if as_json else print_figures(console, figures)
    if figures["missed"]:
        raise typer.Exit(1)


app.command()(inject)


def _directory(stack: ExitStack, keep: Path | None) -> Path:
    """Return the folder of database and logs; it goes with the demonstration unless it is to be kept."""
    if keep is None:
        return Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="soo-demo-")))
    if (keep / "soo.db").exists():
        end(f"{keep} holds the database of an earlier demonstration; name another folder")
    keep.mkdir(parents=True, exist_ok=True)
    return keep
