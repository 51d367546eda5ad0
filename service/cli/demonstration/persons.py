"""Persons at the demonstration: their keys in files, commands for them to try, and its archive to keep at the end."""

import shlex
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import typer
from rich.console import Console

from service.client.service_client import ServiceClient
from service.records.storage import sqlite_url


class Person(NamedTuple):
    """Somebody who releases torques."""

    name: str
    role: str
    key_file: Path

    @property
    def key(self) -> str:
        """The key of the person's file."""
        return self.key_file.read_text(encoding="ascii").strip()


def two_persons(client: ServiceClient, directory: Path) -> tuple[Person, Person]:
    """Make keys of an operator, who prepares commands, and of an approver, who confirms them.

    Raises
    ------
    ClientError
        The service refused, for one because the key that asks is no administrator's.
    """
    operator, approver = (
        Person(name, role, directory / f"{role}.key") for name, role in (("Anna", "operator"), ("Boris", "approver"))
    )
    for person in (operator, approver):
        made = client.request("POST", "/keys", {"name": person.name, "role": person.role})
        write_key(person.key_file, made["key"])
    return operator, approver


def write_key(path: Path, key: str) -> None:
    """Write a key into a new file of mode 0600; one of an earlier run may have another mode and is removed."""
    path.unlink(missing_ok=True)
    path.touch(0o600, exist_ok=False)
    path.write_text(f"{key}\n", encoding="ascii")


def program() -> str:
    """Return the command line program by its path: a second terminal may not have it on its own."""
    script = Path(sys.executable).with_name("soo")
    return shlex.quote(str(script)) if script.exists() else f"{shlex.quote(sys.executable)} -m service"


def commands_to_try(
    url: str, key_file: Path, persons: tuple[Person, ...], *, is_flown: bool
) -> Iterator[tuple[str, str]]:
    """Yield purpose and command line of three commands.

    Parameters
    ----------
    url : str
        Of the service.
    key_file : Path
        Key of the administrator.
    persons : tuple of Person
        Who prepares and who confirms torques; empty where nobody does.
    is_flown : bool
        Whether the spacecraft is flown, so that its world can be changed.
    """

    def as_person(file: Path, command: str, second: str = "") -> str:
        return f"SOO_URL={url} SOO_KEY_FILE={shlex.quote(str(file))} {second}{program()} {command}"

    yield "follow it on one screen", as_person(key_file, "watch")
    if persons:
        first, second = persons
        other_key = f"SOO_SECOND_KEY_FILE={shlex.quote(str(second.key_file))} "
        yield f"{first.name} prepares a torque", as_person(first.key_file, "torque prepare 'a first one'")
        yield f"{second.name} confirms it by its digest", as_person(first.key_file, "torque confirm 1", other_key)
        return
    if is_flown:
        yield "let it rain over the receiving site", f"{program()} demo inject rain"
    else:
        yield "whether torques may go, and why", as_person(key_file, "status")
    yield "stop every torque", as_person(key_file, "control stop")


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
