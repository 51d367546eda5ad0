"""Replay against live operation, row by row: what a replay writes must equal what was written live to the last bit."""

from collections.abc import Sequence

from service.client.documents import Attitude
from service.client.service_client import ServiceClient

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
