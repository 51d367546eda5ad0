"""End of an interrupted demonstration: its archive is kept where somebody at a terminal says so."""

import shlex
import shutil
import signal
import sys
from pathlib import Path

import typer
from rich.console import Console

from service.cli.demonstration.invitation import program
from service.records.storage import sqlite_url

_QUESTION = "Keep the archive? Name a new folder, or press Enter to remove it"


def offer_archive(console: Console, directory: Path, keep: Path | None, *, is_asked: bool) -> None:
    """Say where the archive is, ask for a folder to copy it to, or say how it would have been kept.

    Parameters
    ----------
    console : Console
        Where to say it.
    directory : Path
        Folder of database, logs and figure, which nothing writes to any more.
    keep : Path or None
        The folder that was to be kept; None = `directory` is removed after this.
    is_asked : bool
        Whether a person ended the demonstration; asked only at a terminal.
    """
    if keep is None:
        is_asked = is_asked and console.is_terminal and sys.stdin.isatty()
        keep = _copy(console, directory) if is_asked else None
    if keep is None:
        console.print("the archive is removed; soo demo --keep FOLDER keeps it")
        return
    kept = "database, logs and figure" if any(keep.glob("*.png")) else "database and logs"
    console.print(f"{kept} are in {keep}; to look at the archive again:", soft_wrap=True, highlight=False)
    # the key was this run's own: the archive does not hold it
    key, database = shlex.quote(str(keep / "administrator.key")), shlex.quote(sqlite_url(str(keep / "soo.db")))
    command = f'SOO_BOOTSTRAP_KEY="$(cat {key})" {program()} serve --clock data --database {database}'
    console.print(command, soft_wrap=True, highlight=False)


def _copy(console: Console, directory: Path) -> Path | None:
    """Ask for a folder until there is one that can be made, copy the archive there and return it; None = removed."""
    # ignored since the demonstration was interrupted
    signal.signal(signal.SIGINT, signal.default_int_handler)
    while True:
        try:
            name = typer.prompt(_QUESTION, default="", show_default=False).strip()
        except typer.Abort:
            return None
        if not name:
            return None
        folder = Path(name).expanduser()
        try:
            # modes of key files are kept
            shutil.copytree(directory, folder)
        except OSError as error:
            console.print(f"not copied: {error}", highlight=False)
        else:
            return folder
