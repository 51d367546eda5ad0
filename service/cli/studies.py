"""``soo study``: campaigns on simulated truth and reproductions of papers, and how their results are printed.

Exit codes: 0 every bound kept and every group as it shall be, 1 one is not or a world was refused, 2 the study could
not be run.
"""

import json
import shlex
import signal
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from service.cli.command_group import Scheduler, end, new_app, require

if TYPE_CHECKING:
    from rich.console import Console

    from service.study.closed_loop.campaign import LoopPlan
    from service.study.published import Row


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """Let the first signal end the study; further ones do not disturb the end of its processes.

    Raises
    ------
    KeyboardInterrupt
        A signal came; its number is the argument.
    """
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def end(received: int, _frame: object) -> NoReturn:
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt(received)

    former = {number: signal.signal(number, end) for number in numbers}
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


EXIT_MISSED = 1
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON only.")]
AsMarkdown = Annotated[bool, typer.Option("--markdown", help="Print the tables as sections of a page.")]


def _drawable(folder: Path | None) -> Path | None:
    """Return the folder of figures, or end before a study that could not draw them begins."""
    if folder is not None:
        require("matplotlib")
    return folder


Figures = Annotated[
    Path | None,
    typer.Option(help="Draw the figures into this folder.", file_okay=False, callback=_drawable),
]


def console_of(width: int, *, is_stderr: bool = False) -> "Console":
    """Return a console; a file or a pipe is as wide as the tables."""
    from rich.console import Console

    console = Console(stderr=is_stderr)
    return console if console.is_terminal else Console(stderr=is_stderr, width=width)


def print_tables(
    console: "Console", tables: Iterable[tuple[str, Sequence[str], Iterable[Sequence[str]]]], lines: Iterable[str] = ()
) -> None:
    """Print tables of title, columns and rows, then lines."""
    from rich.table import Table

    for title, columns, rows in tables:
        table = Table(title=title, title_justify="left")
        for column in columns:
            table.add_column(column, overflow="fold")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    for line in lines:
        console.print(line, soft_wrap=True, highlight=False)


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """Give what moves a progress bar: done, total; away from a terminal it would be noise."""
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

    console = Console(stderr=True)
    text, bar, *_ = Progress.get_default_columns()
    columns = (text, bar, MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=None)
        yield lambda done, total: progress.update(task, completed=done, total=total)


@contextmanager
def named_steps() -> Iterator[Callable[[str], None]]:
    """Give what tells the step that a study is at."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("", total=None)
        yield lambda step: progress.update(task, description=step)


@contextmanager
def failures_shown(*failures: type[Exception]) -> Iterator[None]:
    """End with exit code 2 by a signal or by one of the failures."""
    try:
        with ended_by_signals():
            yield
    except KeyboardInterrupt:
        end("stopped")
    except failures as error:
        end(f"the study failed: {error}", cause=error)


def draw(folder: Path | None, module: str, drawn: Callable[[Any, Path], Iterable[Path]]) -> None:
    """Draw figures into a folder, where one is given, by a module of studies, and name them."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        # matplotlib costs a second that only figures need
        for path in drawn(import_module(f"service.study.{module}"), folder):
            typer.echo(f"drawn: {path}", err=True)


#: columns of a table that is written to a file
_FILE_WIDTH = 160


def report(tables: "Mapping[str, Sequence[Row]]", *, as_json: bool, as_markdown: bool) -> None:
    """Print published figures beside reproduced ones; end with 1 where one does not reproduce that should."""
    from service.study.published import COLUMNS, markdown

    rows = [(title, row) for title, table in tables.items() for row in table]
    missed = [(title, row) for title, row in rows if row.is_surprising]
    if as_json:
        document = {"rows": [{"table": title, **row.document()} for title, row in rows], "missed": len(missed)}
        typer.echo(json.dumps(document, allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(tables), nl=False)
    else:
        shown = [(title, COLUMNS, [row.cells for row in table]) for title, table in tables.items()]
        lines = [f"missed: {title}: {', '.join(row.cells)}" for title, row in missed]
        print_tables(console_of(_FILE_WIDTH), shown, [f"{len(rows)} figures, {len(missed)} missed", *lines])
    if missed:
        raise typer.Exit(EXIT_MISSED)


def estimation(
    scenario: Annotated[list[str] | None, typer.Option(help="Scenario to run; may be given many times.")] = None,
    group: Annotated[str | None, typer.Option(help="Scenarios of a group; default `all` where none is named.")] = None,
    seeds: Annotated[int, typer.Option(min=1, max=1000, help="Seeds 1 to this number for each scenario.")] = 10,
    workers: Annotated[int, typer.Option(min=1, max=256, help="Processes.")] = 2,
    scheduler: Scheduler = None,
    operation_days: Annotated[
        float | None, typer.Option(help="Length of the operation phase; default: that of each scenario.")
    ] = None,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Run both methods over simulated worlds and hold their figures against the bounds."""
    # these cost half a second that no other command needs
    from concurrent.futures import BrokenExecutor

    from service.study.estimation.campaign import CampaignPlan, run_campaign
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.estimation.report import as_document, markdown, tables, verdict_lines
    from service.study.executors import ClusterError, WorkerChoice

    plan = CampaignPlan(_scenarios(scenario, group), seeds, WorkerChoice(workers, scheduler), operation_days)
    with failures_shown(ExportFailedError, BrokenExecutor, ClusterError, OSError), counted("worlds") as show:
        campaign = run_campaign(plan, show)
    draw(figures, "estimation.figures", lambda study, folder: study.draw_campaign(campaign, folder))
    command = _estimation_command(scenario, group, seeds, operation_days)
    if as_json:
        typer.echo(json.dumps(as_document(campaign, command), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(campaign, command), nl=False)
    else:
        lines = [*verdict_lines(campaign), f"made by: {command}"]
        print_tables(console_of(_FILE_WIDTH), tables(campaign), lines)
    if campaign.missed or campaign.idle or campaign.refusals:
        raise typer.Exit(EXIT_MISSED)


def _scenarios(named: list[str] | None, group: str | None) -> tuple[str, ...]:
    """Return the scenarios to run: those named, a group, or both; all where neither is given."""
    from service.study.estimation.campaign import GROUPS

    if group is not None and group not in GROUPS:
        end(f"no group {group!r}; there are {', '.join(GROUPS)}")
    grouped = GROUPS[group or "all"] if group or not named else ()
    return tuple(dict.fromkeys([*grouped, *(named or ())]))


def _estimation_command(scenario: list[str] | None, group: str | None, seeds: int, operation_days: float | None) -> str:
    """Return the command that makes the same figures again."""
    words = ["soo", "study", "estimation"]
    words += [word for name in scenario or () for word in ("--scenario", name)]
    words += ["--group", group] if group else []
    words += ["--seeds", str(seeds)]
    words += ["--operation-days", f"{operation_days:g}"] if operation_days else []
    return shlex.join(words)


SCENARIOS = (
    "nominal",
    "steps",
    "downlink_rain",
    "slew_fade",
    "unknown_residual_constant",
    "unknown_residual_daily",
    "plant_varied",
)
_UPLINKS = ("ideal", "link")
#: columns of a table that is written to a file
_LOOPS_WIDTH = 200


def closed_loop(
    runs: Annotated[int, typer.Option(min=1, max=1000, help="Seeds 1 to this number of each scenario.")] = 3,
    scenario: Annotated[
        list[str] | None, typer.Option(help=f"Scenario; may be given many times. Default: {', '.join(SCENARIOS)}.")
    ] = None,
    uplink: Annotated[
        str, typer.Option(help="Way to the spacecraft: link (delay, loss, repetition) or ideal.")
    ] = "link",
    sensing: Annotated[
        list[str] | None, typer.Option(help="automatic, truth or off; may be given many times. Default: all.")
    ] = None,
    workers: Annotated[int, typer.Option("--jobs", min=1, max=256, help="Processes.")] = 2,
    scheduler: Scheduler = None,
    operation_days: Annotated[
        float | None, typer.Option(help="Length of the operation phase; default: that of each scenario.")
    ] = None,
    residual_torque_n_m: Annotated[
        float | None,
        typer.Option(help="Size of the unknown torque that the catalogue states; default: the scenario's."),
    ] = None,
    mode: Annotated[
        str, typer.Option(help="ground: torques go up; onboard: angles do, for a loop on board.")
    ] = "ground",
    method: Annotated[str, typer.Option(help="Method that drives control: robust or paper.")] = "robust",
    silence_h: Annotated[tuple[float, float], typer.Option(help="Begin and length of a time without uplink, h.")] = (
        0.0,
        0.0,
    ),
    flights: Annotated[
        Path | None,
        typer.Option(help="Keep each flight in this folder; what it has kept is not flown again.", file_okay=False),
    ] = None,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Close the loop with the chain, beside perfect sensing and beside no control, which must fail."""
    from concurrent.futures import BrokenExecutor

    from service.records.catalogue import Method
    from service.study.closed_loop.campaign import COLUMNS, LoopPlan, as_document, cells, markdown, run_loops
    from service.study.closed_loop.controllers import Sensing
    from service.study.closed_loop.plant_process import PlantFailedError
    from service.study.closed_loop.run import LoopUnit
    from service.study.executors import ClusterError, WorkerChoice

    _require("uplink", [uplink], _UPLINKS)
    _require("sensing", sensing or [], [one.value for one in Sensing])
    scenarios = tuple(dict.fromkeys(scenario or SCENARIOS))
    sensings = tuple(one for one in Sensing if not sensing or one.value in sensing)
    _require("mode", [mode], ("ground", "onboard"))
    _require("method", [method], [one.value for one in Method])
    settings = (uplink, operation_days, residual_torque_n_m, mode, silence_h, Method(method))
    unit = LoopUnit("", 0, Sensing.AUTOMATIC, *settings)
    plan = LoopPlan(scenarios, runs, WorkerChoice(workers, scheduler), sensings, unit)
    with failures_shown(PlantFailedError, BrokenExecutor, ClusterError, OSError), counted("loops") as show:
        campaign = run_loops(plan, show, flights)
    draw(figures, "closed_loop.figures", lambda study, folder: study.draw_campaign(campaign, folder))
    if as_json:
        typer.echo(json.dumps(as_document(campaign, _loops_command(plan)), allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(campaign), nl=False)
    else:
        last = f"{len(campaign.results)} runs in {campaign.seconds:.0f} s: {_loops_command(campaign.plan)}"
        rows = [cells(group) for group in campaign.groups]
        print_tables(console_of(_LOOPS_WIDTH), [("Closed loops", COLUMNS, rows)], [last])
    if campaign.missed:
        raise typer.Exit(EXIT_MISSED)


def _require(kind: str, reported: list[str], known: Sequence[str]) -> None:
    """Refuse a word that is not known."""
    for word in reported:
        if word not in known:
            end(f"no {kind} {word!r}; there are {', '.join(known)}")


def _loops_command(plan: "LoopPlan") -> str:
    """Return the command that makes the same figures again."""
    unit = plan.unit
    words = ["soo", "study", "closed-loop", "--runs", str(plan.runs), "--uplink", unit.uplink]
    words += [word for name in plan.scenarios for word in ("--scenario", name)]
    words += ["--operation-days", f"{unit.operation_days:g}"] if unit.operation_days else []
    stated_n_m = unit.residual_torque_n_m
    words += [] if stated_n_m is None else ["--residual-torque-n-m", f"{stated_n_m:g}"]
    words += ["--mode", unit.mode, "--method", unit.method.value]
    words += ["--silence-h", *(f"{hours:g}" for hours in unit.silence_h)] if unit.silence_h[1] else []
    words += [word for sensing in plan.sensings for word in ("--sensing", sensing.value)]
    return shlex.join(words)


def limit_cycles(
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
    svg: Annotated[bool, typer.Option("--svg", help="Draw SVG in place of PNG.")] = False,
) -> None:
    """Reproduce limit cycles, capture and torque schedules of a flexible spacecraft."""
    # numba and the study cost half a second that no other command needs
    from service.study.limit_cycles.report import reproduce

    tables = reproduce()
    suffix = "svg" if svg else "png"
    draw(figures, "limit_cycles.figures", lambda study, folder: study.draw_figures(folder, suffix=suffix))
    report(tables, as_json=as_json, as_markdown=as_markdown)


def orbital_frame(
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
    plain: Annotated[bool, typer.Option("--plain", help="Compute without the compiler.")] = False,
) -> None:
    """Fly the orbital-frame model and print its figures beside the published ones."""
    from service.core.dynamics.orbital_frame_kernel import compiled_fly, fly
    from service.study.orbital_frame import reproduce

    kernel = fly if plain else compiled_fly()
    with named_steps() as show:
        rows = reproduce(kernel, show)
    draw(figures, "orbital_frame", lambda study, folder: study.draw_reproduction(kernel, folder))
    report({"Orbital-frame control of Meteor-M No. 2": rows}, as_json=as_json, as_markdown=as_markdown)


def rf_attitude(
    seeds: Annotated[int, typer.Option(min=1, max=100, help="Simulated worlds 1 to this number.")] = 2,
    as_json: AsJson = False,
    as_markdown: AsMarkdown = False,
    figures: Figures = None,
) -> None:
    """Fit the published daily curve and compare sessions with other sensors, beside the published figures."""
    from service.study.estimation.flight.drive import UndrivenError
    from service.study.estimation.flight.world import ExportFailedError
    from service.study.rf_attitude import reproduce

    with failures_shown(ExportFailedError, UndrivenError, OSError), named_steps() as show:
        rows, sessions = reproduce(seeds, show)
    draw(figures, "rf_attitude", lambda study, at: study.draw_reproduction(sessions[0], at))
    report({"Attitude from retransmitted carriers, Yamal-200": rows}, as_json=as_json, as_markdown=as_markdown)


study_app = new_app(help="Campaigns on simulated truth and reproductions of papers.", no_args_is_help=True)
for command in (orbital_frame, limit_cycles, closed_loop, rf_attitude, estimation):
    study_app.command()(command)
