"""Survey of an archive before it is sent: span, gaps, duplicates, empty cells, levels and equal faults; bounded memory.

Gaps and duplicates are counted among the first `MOST_EPOCHS` readable rows.
"""

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, NamedTuple

import numpy as np

from service.records.epoch import US_PER_S, format_epoch

#: epochs that are kept; seven years of a row a minute
MOST_EPOCHS = 4_000_000
#: kinds of faults and gaps that are shown
MOST_SHOWN = 20
#: a distance of rows above this many usual ones is a gap
_GAP_ROWS = 2.5


@dataclass(slots=True)
class _FaultGroup:
    """Rows with the same fault."""

    line: int
    detail: str
    rows: int = 0


@dataclass(slots=True)
class FaultGroups:
    """Unreadable rows, counted by kind of fault."""

    rows: int = 0
    _groups: dict[str, _FaultGroup] = field(default_factory=dict)

    def add(self, kind: str, line: int, detail: str) -> None:
        """Count one row."""
        self.rows += 1
        if kind in self._groups or len(self._groups) < MOST_SHOWN:
            self._groups.setdefault(kind, _FaultGroup(line, detail)).rows += 1

    def as_documents(self) -> list[dict[str, Any]]:
        """Return kind, number of rows, first line and its text, of each group."""
        return [
            {"line": group.line, "rows": group.rows, "kind": kind, "detail": group.detail}
            for kind, group in self._groups.items()
        ]


@dataclass(slots=True)
class ValueSpan:
    """Values of one column, in its unit."""

    least: float = inf
    greatest: float = -inf
    total: float = 0.0
    present: int = 0


class EpochOrder(NamedTuple):
    """Order of the epochs of a file."""

    duplicates: int
    usual_step_s: float | None
    #: start and stop of each gap, longest first
    gaps_us: list[tuple[int, int]]


class Survey:
    """Survey of the readable rows of one file.

    Parameters
    ----------
    carriers : sequence of str
        Carriers of the plan, or axes of a sensor, in the order of the values of a row.
    """

    def __init__(self, carriers: Sequence[str]) -> None:
        self.rows = 0
        self.start_us: int | None = None
        self.stop_us: int | None = None
        self.is_in_order = True
        self.faults = FaultGroups()
        self._last_us: int | None = None
        self._carriers = list(carriers)
        self.spans = [ValueSpan() for _ in carriers]
        self._epochs_us = array("q")

    def add(self, epoch_us: int, values: Sequence[float | None]) -> None:
        """Count one row."""
        self.rows += 1
        self.start_us = epoch_us if self.start_us is None else min(self.start_us, epoch_us)
        self.stop_us = epoch_us if self.stop_us is None else max(self.stop_us, epoch_us)
        self.is_in_order = self.is_in_order and (self._last_us is None or epoch_us > self._last_us)
        self._last_us = epoch_us
        if len(self._epochs_us) < MOST_EPOCHS:
            self._epochs_us.append(epoch_us)
        for span, value in zip(self.spans, values, strict=True):
            if value is not None:
                span.least, span.greatest = min(span.least, value), max(span.greatest, value)
                span.total += value
                span.present += 1

    def mean_dbm(self) -> float | None:
        """Return the mean of all levels; None when there is none."""
        present = sum(span.present for span in self.spans)
        return sum(span.total for span in self.spans) / present if present else None

    def order(self) -> EpochOrder:
        """Return duplicates and gaps."""
        epochs_us = np.sort(np.frombuffer(self._epochs_us, dtype=np.int64))
        steps_us = np.diff(epochs_us)
        duplicates = int(np.count_nonzero(steps_us == 0))
        steps = steps_us[steps_us > 0]
        if not len(steps):
            return EpochOrder(duplicates, None, [])
        usual_us = float(np.median(steps))
        found = np.flatnonzero(steps_us > _GAP_ROWS * usual_us)
        longest = found[np.argsort(-steps_us[found], kind="stable")]
        gaps_us = [(int(epochs_us[k]), int(epochs_us[k + 1])) for k in longest]
        return EpochOrder(duplicates, usual_us / US_PER_S, gaps_us)

    def as_document(self, now_us: int) -> dict[str, Any]:
        """Return the survey for a report; ``age_s`` is that of the newest row."""
        order = self.order()
        return {
            "rows": self.rows,
            "unreadable": self.faults.rows,
            "start": None if self.start_us is None else format_epoch(self.start_us),
            "stop": None if self.stop_us is None else format_epoch(self.stop_us),
            "age_s": None if self.stop_us is None else (now_us - self.stop_us) / US_PER_S,
            "mean_dbm": self.mean_dbm(),
            "is_in_order": self.is_in_order,
            "usual_step_s": order.usual_step_s,
            "duplicate_epochs": order.duplicates,
            "gaps": len(order.gaps_us),
            "longest_gaps": [
                {
                    "start": format_epoch(start_us),
                    "stop": format_epoch(stop_us),
                    "duration_s": (stop_us - start_us) / 1e6,
                }
                for start_us, stop_us in order.gaps_us[:MOST_SHOWN]
            ],
            "levels": {
                carrier: {
                    "least_dbm": span.least if span.present else None,
                    "greatest_dbm": span.greatest if span.present else None,
                    "empty": self.rows - span.present,
                }
                for carrier, span in zip(self._carriers, self.spans, strict=True)
            },
            "faults": self.faults.as_documents(),
        }
