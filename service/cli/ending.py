"""End of a command that cannot go on."""

from typing import NoReturn

import typer

#: wrong option, or what it names cannot be had
EXIT_USAGE = 2


def end(message: str, code: int = EXIT_USAGE, cause: BaseException | None = None) -> NoReturn:
    """End the command with a message on standard error and an exit code."""
    typer.echo(message, err=True)
    raise typer.Exit(code) from cause
