"""Folder of state that outlives a command: the service manager's folder, else the user's folder for state."""

import os
from pathlib import Path


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
