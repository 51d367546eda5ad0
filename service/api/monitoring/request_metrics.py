"""Figures of requests: how many of each kind, how long they took, and what became of the rows that were sent.

Everything is counted inside the server's event loop by adding to a dictionary, which costs a request about a
microsecond; names and forms of the outside are given when somebody asks, see ``service.api.monitoring.metrics``.

The number of label sets is bounded: routes are templates, methods and codes are those that the service knows.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

from service.records.levels.measurement import BatchReceipt, RowRefusal

#: upper bounds of the classes of durations, s
DURATION_BOUNDS_S = (0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0)
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


@dataclass(slots=True)
class DurationHistogram:
    """Histogram of the durations of one route's requests."""

    #: requests in each class of duration, the last one above all bounds
    counts: list[int] = field(default_factory=lambda: [0] * (len(DURATION_BOUNDS_S) + 1))
    total_s: float = 0.0

    def add(self, duration_s: float) -> None:
        """Count one request."""
        self.counts[bisect_left(DURATION_BOUNDS_S, duration_s)] += 1
        self.total_s += duration_s


@dataclass(slots=True)
class RequestMetrics:
    """Counts since the start of the process."""

    #: by (method, route, status)
    requests: Counter[tuple[str, str, int]] = field(default_factory=Counter)
    #: by route; live streams are left out, for they last as long as their clients like
    durations: dict[str, DurationHistogram] = field(default_factory=dict)
    in_progress: int = 0
    #: rows by what became of them: accepted, duplicates, late (which are accepted too)
    rows: Counter[tuple[str, str]] = field(default_factory=Counter)
    #: rows refused, by (spacecraft, code)
    refused: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add_request(self, method: str, route: str, status: int, duration_s: float, *, is_stream: bool) -> None:
        """Count one request that has ended."""
        self.requests[method if method in _METHODS else "other", route, status] += 1
        if not is_stream:
            self.durations.setdefault(route, DurationHistogram()).add(duration_s)

    def add_receipt(self, spacecraft_id: str, receipt: BatchReceipt, screened: Sequence[RowRefusal]) -> None:
        """Count the rows of one batch of measurements."""
        for outcome in ("accepted", "duplicates", "late"):
            self.rows[spacecraft_id, outcome] += getattr(receipt, outcome)
        for refusal in (*screened, *receipt.refused):
            self.refused[spacecraft_id, refusal.code] += 1
