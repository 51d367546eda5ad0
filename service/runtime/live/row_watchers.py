"""Watchers of what the supervisor computes and stores: alarms, and the release of torques."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Protocol

from service.pipeline.control.release.events import StoredRow
from service.pipeline.estimation.row_evidence import RowEvidence
from service.records.inputs import AttitudeReference

#: what alarms look at
Seen = RowEvidence | AttitudeReference


class Watcher(Protocol):
    """Watcher of stored results; it must not make the chain wait."""

    def on_rows(self, spacecraft_id: str, seen: Sequence[Seen]) -> None:
        """Take over rows that are neither late nor caught up with, and references, in the order of the journal."""


class ReleaseWatcher(Protocol):
    """Watcher of stored rows on which control depends."""

    def on_rows(self, spacecraft_id: str, seen: Sequence[StoredRow], *, has_inputs: bool = False) -> None:
        """Take over what was computed, and whether inputs other than rows came in; nothing is raised."""

    def steady(self, spacecraft_id: str) -> AbstractContextManager[bool]:
        """Let nobody trip control meanwhile; tell whether torques are withheld."""
