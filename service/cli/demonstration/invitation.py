"""Commands to try beside the demonstration: each runs in a second terminal that knows nothing of this one."""

import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

from service.cli.demonstration.persons import Person


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
