"""Output of studies: options, progress bar, tables, drawn figures, the end by a signal."""

import json
import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from service.cli.command_group import end
from service.cli.extras import require

if TYPE_CHECKING:
    from rich.console import Console

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


def draw(folder: Path | None, study: str, drawn: Callable[[Any, Path], Iterable[Path]]) -> None:
    """Draw figures into a folder, where one is given, by the module ``figures`` of a study, and name them."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        # matplotlib costs a second that only figures need
        for path in drawn(import_module(f"service.study.{study}.figures"), folder):
            typer.echo(f"drawn: {path}", err=True)


#: columns of a table that is written to a file
_FILE_WIDTH = 160


def report(rows: "Sequence[Row]", title: str, *, as_json: bool, as_markdown: bool) -> None:
    """Print the rows of a study."""
    from service.study.published import COLUMNS, markdown

    if as_json:
        typer.echo(json.dumps({"rows": [{**asdict(row), "ratio": row.ratio} for row in rows]}, allow_nan=False))
    elif as_markdown:
        typer.echo(markdown(rows), nl=False)
    else:
        print_tables(console_of(_FILE_WIDTH), [(title, COLUMNS, [row.cells for row in rows])])
