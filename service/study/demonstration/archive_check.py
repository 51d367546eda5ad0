"""Checks of the archive against the simulated measurements, and of replays against live operation."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

from service.client.documents import Attitude
from service.client.service_client import ServiceClient
from service.records.epoch import format_epoch

#: the method that drives control by default, and the one beside it
METHODS = ("robust", "paper")


def compare_with_live(
    client: ServiceClient, spacecraft_id: str, start: str, stop: str, methods: Sequence[str], version: str
) -> dict[str, int]:
    """Count the rows of a replay that equal the live ones.

    A row that only one of the two has is different; rows before any alignment, of which live operation computed
    nothing, are no part of a replay. JSON carries floats so that they come back bit for bit, hence equal
    documents are equal rows.
    """
    found = {"rows": 0, "rows_equal": 0, "rows_different": 0}
    for method in methods:
        live = {_key(row): row for row in client.attitude_history(spacecraft_id, start, stop, method=method)}
        replayed = client.attitude_history(spacecraft_id, start, stop, method=method, version=version)
        rows = {_key(row): {**row, "version": "live"} for row in replayed}
        equal = sum(live.get(key) == row for key, row in rows.items())
        computed = {key for key, row in live.items() if row["alignment_id"] is not None}
        found["rows"] += len(rows)
        found["rows_equal"] += equal
        found["rows_different"] += len(rows.keys() | computed) - equal
    return found


def _key(row: Attitude) -> tuple[str | None, str | None]:
    """Return what names a row of one method."""
    return row["epoch"], row["received_at"]


def check_archive(client: ServiceClient, spacecraft_id: str, truth_deg: Mapping[int, object]) -> dict[str, int]:
    """Compare the epochs of the exported measurements with those that the simulator swept.

    Parameters
    ----------
    client : ServiceClient
        Of the service that was fed.
    spacecraft_id : str
        Spacecraft.
    truth_deg : mapping
        Keyed by the epoch, microseconds UTC, of every row swept.
    """
    measured = {format_epoch(epoch_us) for epoch_us in truth_deg}
    window = {"start": format_epoch(min(truth_deg)), "stop": format_epoch(max(truth_deg) + 1)}
    path = f"/spacecraft/{spacecraft_id}/archive/measurements:export"
    text = b"".join(client.download(path, {"format": "csv", **window})).decode()
    archived = [line.partition(",")[0] for line in text.splitlines()[1:]]
    return {
        "rows_measured": len(measured),
        "rows_archived": len(archived),
        "rows_lost": len(measured - set(archived)),
        "rows_not_measured": len(archived) - len(measured & set(archived)),
    }


def check_replay(
    client: ServiceClient, spacecraft_id: str, window: tuple[str, str], methods: Sequence[str]
) -> dict[str, Any]:
    """Replay a stretch of the archive in order of the journal and compare every method with live operation."""
    start, stop = window
    began = time.monotonic()
    started = client.request("POST", f"/spacecraft/{spacecraft_id}/replays", {"start": start, "stop": stop})
    client.wait_job(started["job"])
    elapsed_s = time.monotonic() - began
    found = compare_with_live(client, spacecraft_id, start, stop, methods, started["version"])
    return {
        "replay_rows": found["rows"],
        "replay_rows_different": found["rows_different"],
        "replay_rows_per_s": round(found["rows"] / elapsed_s),
    }


def missed_promises(statistics: Mapping[str, Any]) -> list[str]:
    """Return which promises of the archive the figures break, in words."""
    missed = [
        f"{name} is {statistics[name]}, not 0"
        for name in ("rows_lost", "rows_not_measured", "replay_rows_different")
        if statistics[name] != 0
    ]
    return missed if statistics["replay_rows"] else [*missed, "the replay has no rows"]
