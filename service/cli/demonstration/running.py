"""The demonstration of this user that runs: its addresses in a file of mode 0600, for commands of another terminal."""

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from service.cli.command_group import end
from service.cli.station.state_folder import state_folder


class RunningDemonstration(NamedTuple):
    """Addresses of a demonstration."""

    process_id: int
    service_url: str
    key_file: str
    #: host and port where its world is changed; None = its spacecraft is not flown
    changes: tuple[str, int] | None


def _path() -> Path:
    """Return the file: in the user's runtime folder, which ends with the session, else in that of states."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "soo" if runtime else state_folder("demonstration")
    return folder / "demonstration.json"


@contextmanager
def published(demonstration: RunningDemonstration) -> Iterator[None]:
    """Let other commands find a demonstration while it runs; the newest of several is found."""
    path = _path()
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    new = path.with_suffix(f".{demonstration.process_id}")
    new.unlink(missing_ok=True)
    new.touch(0o600, exist_ok=False)
    new.write_text(json.dumps(demonstration._asdict()), encoding="utf-8")
    new.replace(path)
    try:
        yield
    finally:
        newest = _read(path)
        if newest is not None and newest.process_id == demonstration.process_id:
            path.unlink(missing_ok=True)


def running_demonstration() -> RunningDemonstration:
    """Return the demonstration that runs; without one end with exit code 1."""
    found = _read(_path())
    if found is None or not _is_alive(found.process_id):
        end("no demonstration of this user runs: start one with soo demo and wait until it is aligned", 1)
    return found


def _read(path: Path) -> RunningDemonstration | None:
    """Return what a file holds; None for no file, or one that holds something else."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        changes = document["changes"]
        address = None if changes is None else (str(changes[0]), int(changes[1]))
        return RunningDemonstration(
            int(document["process_id"]), str(document["service_url"]), str(document["key_file"]), address
        )
    except (OSError, ValueError, TypeError, KeyError, IndexError):
        return None


def _is_alive(process_id: int) -> bool:
    """Return whether a process of this user runs under a number."""
    try:
        os.kill(process_id, 0)
    except OSError:
        return False
    return True
