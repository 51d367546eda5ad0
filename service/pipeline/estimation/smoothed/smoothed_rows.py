"""Rows of method ``robust_smoothed``: the robust row with the angles, sigma and rates that later rows give it.

Everything else is that of the robust row, at whose time it was decided. The law of this file: a smoothed row never
allows control, whatever the robust row did.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from service.core.estimation.filtering.model.filter_state import ATTITUDE
from service.pipeline.estimation.robust.attitude_rows import rates_deg_s
from service.pipeline.estimation.robust.row_recorder import RowRecorder
from service.pipeline.estimation.smoothed.smoother import MOST_ROWS, SmoothedRow, SpanSmoother
from service.records.catalogue import Method
from service.records.epoch import US_PER_S
from service.records.levels.attitude import NO_ANGLES, AttitudeRow, named_axes


class SmoothedRows:
    """Smoothed rows of a span, from the chain's robust rows and what the recorder beside it keeps."""

    def __init__(self) -> None:
        self.recorder = RowRecorder(MOST_ROWS)
        self._span = SpanSmoother(self.recorder)
        #: robust rows that are not smoothed yet, by epoch
        self._waiting: dict[int, AttitudeRow] = {}

    def push(self, rows: Sequence[AttitudeRow]) -> list[AttitudeRow]:
        """Take in what the chain made of a measurement and return the rows that are smoothed by now."""
        self._waiting |= {
            row.epoch_us: row for row in rows if row.method is Method.ROBUST and "late" not in row.inhibitions
        }
        return self._made(self._span.pop())

    def rest(self) -> list[AttitudeRow]:
        """Return the rows that are left at the end of the span."""
        return self._made(self._span.rest())

    def _made(self, found: Sequence[SmoothedRow]) -> list[AttitudeRow]:
        if not found:
            return []
        rows = [(self._waiting.pop(each.epoch_us, None), each) for each in found]
        # what the filter could not take has no smoothed row
        self._waiting = {epoch_us: row for epoch_us, row in self._waiting.items() if epoch_us > found[-1].epoch_us}
        return [smoothed_attitude(row, each) for row, each in rows if row is not None]


def smoothed_attitude(row: AttitudeRow, found: SmoothedRow) -> AttitudeRow:
    """Return the smoothed row of a robust one."""
    mean = found.state.mean
    return replace(
        row,
        method=Method.ROBUST_SMOOTHED,
        attitude_deg=named_axes(mean[ATTITUDE]),
        sigma_deg=named_axes(np.sqrt(found.state.covariance.diagonal()[ATTITUDE])),
        rates_deg_s=named_axes(rates_deg_s(mean, found.coupling_per_h)),
        control_allowed=False,
        control_allowed_axes=(False, False, False),
        inhibitions=(*row.inhibitions, "smoothed"),
        advice=(),
        protection_deg=NO_ANGLES,
        lag_s=found.lag_us / US_PER_S,
    )
