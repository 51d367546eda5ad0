"""The ports of what front ends say of themselves: links and evidence traces."""

from collections.abc import Sequence
from typing import Protocol

from service.records.calibration import Window
from service.records.levels.trace import KeptTrace, Ring, Trace, TraceHead, TraceReceipt
from service.records.operations.link import LinkReport, LinkState


class Links(Protocol):
    """Link states reported by front ends, and states requested by operators."""

    def report(self, reports: Sequence[LinkReport], at_us: int) -> tuple[LinkState, ...]:
        """Store the newest reports in one transaction and return the state of each link; a new link is enabled.

        ConflictError ``link.too_many``: a thousand links are known already.
        """

    def links(self, spacecraft_id: str | None = None) -> tuple[LinkState, ...]:
        """Return all links, or those of one spacecraft, in order of id."""

    def link(self, link_id: str) -> LinkState:
        """Return one link; NotFoundError ``link.unknown``."""

    def set_enabled(self, link_id: str, *, enabled: bool) -> LinkState:
        """Enable or disable a link until the next call."""

    def request_reset(self, link_id: str) -> LinkState:
        """Count one more reset that is wanted of a link."""

    def remove(self, link_id: str) -> None:
        """Forget a link; it comes back with its next report, enabled."""


class Traces(Protocol):
    """Evidence traces: a ring of sweeps a source."""

    def append(
        self, spacecraft_id: str, source: str, traces: Sequence[Trace], received_at_us: int, ring: Ring
    ) -> TraceReceipt:
        """Store traces of one source and drop, oldest epoch first, what its ring has no place for, as one.

        Same source, sweep and epoch: duplicate, the first one stays.
        """

    def heads(
        self,
        spacecraft_id: str,
        window: Window,
        limit: int,
        after: tuple[int, int] | None,
        source: str | None = None,
        sweep: str | None = None,
        *,
        newest_first: bool = False,
    ) -> list[TraceHead]:
        """Return kept traces without their points in order of (epoch, number) beyond a cursor."""

    def trace(
        self, spacecraft_id: str, epoch_us: int, source: str | None = None, sweep: str | None = None
    ) -> KeptTrace:
        """Return the trace of an epoch; NotFoundError ``trace.unknown``, ConflictError ``trace.ambiguous``."""
