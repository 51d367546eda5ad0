"""Angles of rows that were sent: progress until they exist, and the next command where they cannot."""

import time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from service.client.documents import StatusReply
    from service.client.service_client import ServiceClient

_POLL_S = 0.5


def wait_for_angles(
    client: "ServiceClient", spacecraft_id: str, patience_s: float, *, is_quiet: bool
) -> dict[str, Any]:
    """Return the state of the estimates when no row is pending, or when none was estimated for ``patience_s``."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=is_quiet or not console.is_terminal) as progress:
        task = progress.add_task("angles", total=None)
        least: int | None = None
        deadline_s = time.monotonic() + patience_s
        while True:
            status = _status(client, spacecraft_id, deadline_s)
            pending = status["pending"]
            if least is None or pending < least:
                least, deadline_s = pending, time.monotonic() + patience_s
            progress.update(task, description=f"angles: {pending} rows pending")
            if not pending or time.monotonic() > deadline_s:
                break
            time.sleep(_POLL_S)
    return {name: status[name] for name in ("aligned", "pending", "newest_attitude", "calibration_id", "alignment_id")}


def _status(client: "ServiceClient", spacecraft_id: str, deadline_s: float) -> "StatusReply":
    """Return the state of the estimates; the first row of an installation may wait for the compiler, and it with it."""
    from service.client.problem import ServiceUnavailableError

    while True:
        try:
            return client.status(spacecraft_id)
        except ServiceUnavailableError:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(_POLL_S)


def angles_line(angles: dict[str, Any], spacecraft_id: str) -> str:
    """Return the state of the estimates as a sentence, with the next command."""
    if not angles["aligned"]:
        step = "align" if angles["calibration_id"] is not None else "calibrate"
        return f"no angles yet: the spacecraft is not aligned; next: soo {step} --spacecraft {spacecraft_id} --help"
    if angles["pending"]:
        return f"{angles['pending']} rows still have no angles; the service computes on: soo doctor tells why not"
    return f"angles exist up to {angles['newest_attitude']}"
