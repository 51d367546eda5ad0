"""Groups of commands that import a command only when it is run: the start of one must not pay for the others."""

import gc
import os
from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn

import typer
from typer.core import TyperCommand, TyperGroup

#: exit code of a wrong option, or of one that names what cannot be had
EXIT_USAGE = 2


class CommandSource(NamedTuple):
    """Module below ``service.cli`` that holds a command ``x``, or a group ``x_app``, and its line in the help."""

    module: str
    help: str


class _LateCommands(Mapping[str, Any]):
    """Commands by name, each imported when it is taken out."""

    def __init__(self, sources: Mapping[str, CommandSource]) -> None:
        self._sources = sources

    def __getitem__(self, name: str) -> Any:
        module = import_module(f"service.cli.{self._sources[name].module}")
        word = name.replace("-", "_")
        app = getattr(module, f"{word}_app", None)
        if app is None:
            app = new_app()
            app.command(name)(getattr(module, word))
        command = typer.main.get_command(app)
        command.name = name
        return command

    def __iter__(self) -> Iterator[str]:
        return iter(self._sources)

    def __len__(self) -> int:
        return len(self._sources)


def new_app(**options: Any) -> typer.Typer:
    """Return a Typer object as all of ours are: help is plain text, the frames of rich cost as much as the rest."""
    shown = {"add_completion": False} | options
    return typer.Typer(pretty_exceptions_show_locals=False, rich_markup_mode=None, **shown)


def begin_command(ctx: typer.Context) -> None:
    """Switch on the collector that ``main`` switched off; what was loaded until now is no garbage and is left out."""
    if not gc.isenabled():
        gc.freeze()
        if ctx.invoked_subcommand != "serve":
            gc.enable()


def late_app(
    sources: Mapping[str, CommandSource],
    begin: Callable[..., None] = begin_command,
    **options: Any,
) -> typer.Typer:
    """Return a group of commands, each imported when it is run; its help is written from the table alone.

    Parameters
    ----------
    sources : Mapping
        Commands by name.
    begin : Callable
        Called before a command of the group; its parameters are the options of the group itself.
    """

    class LateGroup(TyperGroup):
        """Group of the table."""

        def __init__(self, **settings: Any) -> None:
            super().__init__(**settings)
            self.commands: Any = _LateCommands(sources)

        def format_help(self, ctx: Any, formatter: Any) -> None:
            imported_late = self.commands
            self.commands = {name: TyperCommand(name, short_help=source.help) for name, source in sources.items()}
            super().format_help(ctx, formatter)
            self.commands = imported_late

        def shell_complete(self, ctx: Any, incomplete: str) -> Any:
            from click.shell_completion import CompletionItem

            names = [name for name in sources if name.startswith(incomplete)]
            if names:
                # without importing a command
                return [CompletionItem(name, help=sources[name].help) for name in names]
            return super().shell_complete(ctx, incomplete)

        def invoke(self, ctx: Any) -> Any:
            try:
                return super().invoke(ctx)
            except typer.BadParameter as error:
                error.message = _wrong_value(error)
                raise

    app = new_app(**options)
    # Typer makes a group of what has a callback
    app.callback(cls=LateGroup, no_args_is_help=True)(begin)
    return app


def _wrong_value(error: typer.BadParameter) -> str:
    """Return what a value must be; the sentence of the library that judged it is its own."""
    faults = getattr(error.__cause__, "errors", None)
    if faults is None:
        return error.message
    # a right command must not wait for it
    from service.records.field_faults import fault_sentence

    return "; ".join(map(fault_sentence, faults()))


def end(message: str, code: int = EXIT_USAGE, cause: BaseException | None = None) -> NoReturn:
    """End the command with a message on standard error and an exit code."""
    typer.echo(message, err=True)
    raise typer.Exit(code) from cause


#: extra by the name under which a package is imported
EXTRA_OF = {"matplotlib": "study", "pyvisa": "station", "pyvisa_py": "station", "distributed": "cluster"}


def require(name: str) -> None:
    """Import a package of an extra, so that a command ends at once where it is missing.

    Raises
    ------
    ModuleNotFoundError
        It is not installed; ``service.__main__`` says which extra has it.
    """
    import_module(name)


def _reachable(scheduler: str | None) -> str | None:
    """Return the address of a scheduler, or end before the work where the extra is missing."""
    if scheduler is not None:
        require("distributed")
    return scheduler


Scheduler = Annotated[
    str | None,
    typer.Option(help="Compute on the Dask cluster of this scheduler, as tcp://host:8786.", callback=_reachable),
]


def state_folder(kind: str) -> Path:
    """Return the folder for one kind of state: ``$STATE_DIRECTORY``, ``$XDG_STATE_HOME/soo`` or ``~/.local/state/soo``.

    Examples
    --------
    >>> state_folder("spool").name
    'spool'
    """
    given = os.environ.get("STATE_DIRECTORY", "").split(":")[0]
    if given:
        return Path(given) / kind
    home = os.environ.get("XDG_STATE_HOME")
    return (Path(home) if home else Path.home() / ".local" / "state") / "soo" / kind
